//! `train`: touch networks, on images that are rendered as they are needed.

mod curve;
mod panels;
mod resize;

use std::fs;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Instant;

use anyhow::{Context as _, Result, bail, ensure};
use clap::{Args, ValueEnum};
use image::RgbImage;
use mvt_products::Instructions;
use mvt_render::touch::TouchFrame;
use mvt_robot::digit::{HEIGHT, WIDTH};
use mvt_touch::accuracy::{Accuracy, Pixel, Scores};
use mvt_touch::engine::{Engine, Prediction};
use mvt_touch::network::{Architecture, Precision, Weights};
use mvt_touch::train::{Device, Stage, Targets, TouchTrainer, TrainingBatch, TrainingConfig};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use sha2::{Digest as _, Sha256};

use curve::{Curve, Row};
use resize::resized;

use mvt_presses::objects;
use mvt_presses::objects::Surface;
use mvt_presses::{DataConfig, Example, Rack, example};
use mvt_run::{progress, settings};

/// Train a network that turns touch images into depth and contact
///
/// Images are rendered as they are needed, from the catalogue's objects less those kept for validation and test. DIR receives
/// last.safetensors (the averaged weights), best.safetensors (those that did best on the validation objects), checkpoint.safetensors
/// (with which --resume goes on as if there had been no break), curve.csv, curve.svg and panels.png.
#[derive(Debug, Args)]
pub struct Arguments {
    /// Network: vit, mamba, robust_mamba or default
    #[arg(long)]
    network: String,
    /// TOML file: seed, stages, optimiser, loss, data, and hyper-parameters of the network that differ from the preset's
    #[arg(long)]
    config: PathBuf,
    /// Folder of the results
    #[arg(long)]
    out: PathBuf,
    /// Go on with the training in DIR
    #[arg(long)]
    resume: bool,
    /// Start from these weights instead of drawn ones
    #[arg(long, conflicts_with = "resume")]
    from: Option<PathBuf>,
    /// What computes gradients
    #[arg(long, value_enum, default_value_t)]
    device: Choice,
}

/// On what is trained.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, ValueEnum)]
enum Choice {
    /// The first CUDA device if the program was built with --features cuda and there is one, else the CPU
    #[default]
    Auto,
    /// The CPU
    Cpu,
    /// The first CUDA device; needs NVIDIA's driver, the CUDA toolkit and a program built with --features cuda
    Cuda,
}

impl Choice {
    fn device(self) -> Result<Device> {
        match self {
            Self::Auto => Ok(Device::gpu().unwrap_or_else(|reason| {
                tracing::info!("no GPU: {reason}");
                Device::Cpu
            })),
            Self::Cpu => Ok(Device::Cpu),
            Self::Cuda => Device::gpu().context("--device cuda"),
        }
    }
}

/// The configuration file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct Settings {
    /// The network with hyper-parameters; left out, the preset of the command line.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    network: Option<Architecture>,
    /// What the images are like.
    #[serde(default)]
    data: DataConfig,
    /// How the network is trained.
    training: TrainingConfig,
}

/// Added to the seed for validation, whose images are other contacts with other objects on other sensors.
const VALIDATION_SEED: u64 = 0x5eed_0000_0000_0001;
/// Images in the panels.
const PANELS: usize = 6;

/// Runs the command.
pub fn run(arguments: &Arguments) -> Result<()> {
    let device = arguments.device.device()?;
    let Settings { network, data, training } = settings::read(&arguments.config)?;
    data.check()?;
    let fits = |stage: &Stage| stage.size[0] <= HEIGHT && stage.size[1] <= WIDTH;
    ensure!(training.stages.iter().all(fits), "a stage's size is at most that of a DIGIT's image, [{HEIGHT}, {WIDTH}]");
    let preset = Architecture::preset(&arguments.network)?;
    let architecture = network.unwrap_or_else(|| preset.clone());
    ensure!(
        architecture.name() == preset.name(),
        "{} configures network {}, --network asks for {}",
        arguments.config.display(),
        architecture.name(),
        preset.name()
    );
    let checkpoint = arguments.out.join("checkpoint.safetensors");
    let trainer = if arguments.resume {
        TouchTrainer::resume(&checkpoint, architecture.clone(), training.clone())?
    } else {
        if checkpoint.exists() {
            bail!("{} holds a training; go on with --resume, or choose another folder", arguments.out.display());
        }
        let start = arguments.from.as_deref().map(Weights::read).transpose()?;
        TouchTrainer::new(architecture.clone(), training.clone(), start.as_ref())?
    };
    let mut trainer = trainer.on(device);
    fs::create_dir_all(&arguments.out).with_context(|| format!("cannot make {}", arguments.out.display()))?;
    let hash = data_hash(&data)?;
    let surfaces = objects::load(&data.objects.train)?;
    let watched = Validation::new(&data, &training)?;
    let mut curve = Curve::open(&arguments.out, trainer.step())?;
    let mut rack = Rack::new(&data, training.seed)?;

    let bar = progress::bar(training.steps(), &format!("{} on the {device}", arguments.network));
    bar.set_position(trainer.step());
    let (mut losses, mut images, mut since) = (Vec::new(), 0, Instant::now());
    while trainer.step() < training.steps() {
        let batch = draw_batch(&surfaces, &mut rack, &data, &training, trainer.step())?;
        images += batch.shape[0];
        let progress = trainer.advance(&batch)?;
        losses.push(progress.loss);
        bar.inc(1);
        let step = trainer.step();
        if step.is_multiple_of(training.validate_every) || step == training.steps() {
            let trained_s = since.elapsed().as_secs_f64();
            let weights = trainer.weights(hash.clone())?;
            let predictions = watched.predictions(&weights)?;
            let scores = watched.scores(&predictions);
            let row = Row {
                step,
                images_per_s: images as f64 / trained_s,
                loss: losses.iter().sum::<f32>() / losses.len() as f32,
                gradient: progress.gradient,
                rate: progress.rate,
                contact_mae_mm: scores.contact_mae_mm,
                rmse_mm: scores.rmse_mm,
                iou: scores.iou,
            };
            let is_best = curve.is_best(&row);
            // The checkpoint last: a run that is killed in between repeats the steps since the one before, and writes all this again.
            weights.write(&arguments.out.join("last.safetensors"), Precision::F32)?;
            if is_best {
                weights.write(&arguments.out.join("best.safetensors"), Precision::F32)?;
            }
            panels::write(&arguments.out.join("panels.png"), watched.examples.iter().zip(&predictions).take(PANELS))?;
            curve.push(row)?;
            trainer.save(&checkpoint)?;
            tracing::info!("{row:?}");
            (losses, images, since) = (Vec::new(), 0, Instant::now());
        }
    }
    bar.finish_and_clear();
    Ok(())
}

/// Goes up by one whenever other images are drawn with the same configuration.
const IMAGES_VERSION: u32 = 3;

/// SHA-256 over everything that decides which images a seed draws.
fn data_hash(data: &DataConfig) -> Result<String> {
    let description = serde_json::to_string(&(data, &data.objects.train, IMAGES_VERSION))?;
    Ok(Sha256::digest(description).iter().map(|byte| format!("{byte:02x}")).collect())
}

/// The images of a step.
fn draw_batch(
    surfaces: &[Surface],
    rack: &mut Rack,
    data: &DataConfig,
    training: &TrainingConfig,
    step: u64,
) -> Result<TrainingBatch> {
    let stage = training.stage(step).context("there is no stage")?;
    let sensors = rack.of_step(step)?;
    let first = step << 16;
    let images = (first..first + stage.batch as u64).into_par_iter().map_init(TouchFrame::default, |frame, index| {
        resized(subtracted(example(surfaces, &sensors, data, (training.seed, index), frame)), stage.size)
    });
    Ok(batch(&images.collect::<Vec<_>>()))
}

/// Images of one size, put together.
fn batch(examples: &[Example]) -> TrainingBatch {
    let [rows, columns] = examples.first().map_or([0, 0], |example| example.size);
    let mut batch = TrainingBatch { shape: [examples.len(), rows, columns], ..TrainingBatch::default() };
    let mut targets = Targets::default();
    for example in examples {
        batch.levels.extend(&example.levels);
        targets.indentation_mm.extend(&example.indentation_mm);
        targets.contact.extend(&example.contact);
    }
    batch.targets = Arc::new(targets);
    batch
}

/// Images of objects that are not trained on.
struct Validation {
    examples: Vec<Example>,
}

impl Validation {
    fn new(data: &DataConfig, training: &TrainingConfig) -> Result<Self> {
        // A single image of an object that is far too deep would outweigh all others.
        let data = &DataConfig { deep: 0.0, ..data.clone() };
        let surfaces = objects::load(&data.objects.validate)?;
        let seed = training.seed ^ VALIDATION_SEED;
        let mut rack = Rack::new(data, seed)?;
        let sensors = rack.of_step(0)?;
        let images = (0..training.validation_images as u64).into_par_iter();
        let images = images.map_init(TouchFrame::default, |frame, index| {
            subtracted(example(&surfaces, &sensors, data, (seed, index), frame))
        });
        Ok(Self { examples: images.collect() })
    }

    fn predictions(&self, weights: &Weights) -> Result<Vec<Prediction>> {
        let engine = Engine::new(weights, Instructions::best());
        let images: Vec<RgbImage> = self.examples.iter().map(Example::image).collect();
        let mut predictions = Vec::new();
        engine.infer_each(&images.iter().collect::<Vec<_>>(), &mut predictions)?;
        Ok(predictions)
    }

    fn scores(&self, predictions: &[Prediction]) -> Scores {
        let mut accuracy = Accuracy::default();
        for (example, prediction) in self.examples.iter().zip(predictions) {
            let truth = example.indentation_mm.iter().zip(&example.contact);
            let truth = truth.map(|(&millimetres, &contact)| Pixel { millimetres, contact: contact > 0.5 });
            accuracy.add(Pixel::all(prediction).zip(truth));
        }
        accuracy.scores()
    }
}

/// The example as a network sees it: without the untouched image of its sensor, where that is known.
fn subtracted(mut example: Example) -> Example {
    if let Some(untouched) = example.untouched.take() {
        mvt_touch::untouched::subtract_untouched(&untouched, &mut example.levels);
    }
    example
}
