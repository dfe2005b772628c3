//! `touch train`: training of touch networks on images that are rendered during the training.

mod curve;
mod panels;

use std::ops::Range;
use std::path::PathBuf;
use std::sync::{Arc, mpsc};
use std::time::Instant;

use anyhow::{Context as _, Result, bail, ensure};
use clap::{Args, ValueEnum};
use image::RgbImage;
use mvt_files::folder::{ClaimedFolder, Earlier};
use mvt_presses::objects::PressedSurface;
use mvt_presses::{DataConfig, Example, PressSensor, Rack, example, objects, resized};
use mvt_products::Instructions;
use mvt_render::touch::TouchFrame;
use mvt_robot::digit::profile::{Appearance, SensorProfile};
use mvt_run::{progress, settings};
use mvt_touch::accuracy::{Accuracy, Pixel, Scores};
use mvt_touch::engine::{Engine, Prediction};
use mvt_touch::light::{SensorLight, exposure};
use mvt_touch::network::{Architecture, Precision, Weights};
use mvt_touch::untouched::subtract_untouched;
use mvt_training::{Device, Stage, Targets, TouchTrainer, TrainingBatch, TrainingConfig};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use sha2::{Digest as _, Sha256};

use curve::{Curve, Errors, Row};

/// Train a network that turns touch images into indentation and contact
///
/// The images are rendered during the training, from the objects of the catalogue without those that are kept for
/// validation and test.
///
/// DIR receives last.safetensors (averaged weights), best.safetensors (the weights with the smallest error on the
/// validation objects), checkpoint.safetensors (for --resume, which continues exactly as an uninterrupted training
/// would), curve.csv and curve.svg (loss, and errors on validation objects and on those of the training, over the steps) and panels.png (predictions beside the truth).
#[derive(Debug, Args)]
pub struct TouchTrainArguments {
    /// Network: vit, mamba, robust_mamba, swin, convnext or default
    #[arg(long)]
    network: String,
    /// Training configuration (.toml): seed, stages, optimiser, loss, data, and sizes of the network that differ from
    /// its preset; perception/touch/training/ has examples
    #[arg(long, value_name = "FILE")]
    config: PathBuf,
    /// Touch sensor: tacto (a DIGIT; `data.real` says how many look like real ones), digit, gelsight_mini, or the path of a
    /// profile (.toml)
    #[arg(long, value_name = "NAME", default_value = "tacto")]
    profile: String,
    /// Folder for the results
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Allow a folder that contains other files
    #[arg(long)]
    overwrite: bool,
    /// Continue the training in DIR
    #[arg(long)]
    resume: bool,
    /// Start from these weights (.safetensors) instead of random ones
    #[arg(long, value_name = "FILE", conflicts_with = "resume")]
    from: Option<PathBuf>,
    /// Device that computes the gradients
    #[arg(long, value_enum, default_value_t)]
    device: TrainingDevice,
}

/// Device on the command line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, ValueEnum)]
enum TrainingDevice {
    /// The first CUDA device if there is one and the program was built with the feature cuda, else the CPU
    #[default]
    Auto,
    /// The CPU
    Cpu,
    /// The first CUDA device; needs NVIDIA's driver, the CUDA toolkit and a program with the feature cuda
    Cuda,
}

impl TrainingDevice {
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
    /// The network with its sizes; the preset of the command line by default.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    network: Option<Architecture>,
    /// Properties of the images.
    #[serde(default)]
    data: DataConfig,
    /// Properties of the training.
    training: TrainingConfig,
}

/// Combined with the seed for the validation images, so that they show other presses on other sensors.
const VALIDATION_SEED: u64 = 0x5eed_0000_0000_0001;
/// The same for images of objects that the training uses, so that they show other presses than its images.
const TRAINING_SEED: u64 = 0x5eed_0000_0000_0002;
/// Batches that are drawn together, ahead of the training: what one core does for a batch then keeps no other waiting.
const DRAWN_TOGETHER: usize = 4;
/// Greatest side of the images of a stage, pixels.
const LARGEST_SIDE: usize = 1024;
/// Number of images in panels.png.
const PANELS: usize = 6;

/// Runs the command.
pub fn run(arguments: &TouchTrainArguments) -> Result<()> {
    let device = arguments.device.device()?;
    // Validations, too.
    device.use_for_inference();
    let Settings { network, data, training } = settings::read(&arguments.config)?;
    data.objects.check()?;
    data.validate().map_err(|error| error.within("data"))?;
    let profile = SensorProfile::load(&arguments.profile)?;
    let [rows, columns] = profile.shape();
    let most = if training.resizes { [LARGEST_SIDE; 2] } else { [rows, columns] };
    let fits = |stage: &Stage| stage.size[0] <= most[0] && stage.size[1] <= most[1];
    ensure!(
        training.stages.iter().all(fits),
        "training.stages: a size must be at most that of the sensor's images, [{rows}, {columns}], or, with training.resizes = true, \
         [{LARGEST_SIDE}, {LARGEST_SIDE}]"
    );
    let preset = Architecture::preset(&arguments.network)?;
    let architecture = network.unwrap_or_else(|| preset.clone());
    ensure!(
        architecture.name() == preset.name(),
        "--config {} configures network {}, but --network asks for {}; give the same network",
        arguments.config.display(),
        architecture.name(),
        preset.name()
    );
    let checkpoint = arguments.out.join("checkpoint.safetensors");
    let trainer = if arguments.resume {
        TouchTrainer::resume(&checkpoint, architecture.clone(), training.clone())?
    } else {
        if checkpoint.exists() {
            bail!(
                "--out {} contains a training; continue it with --resume or choose another folder",
                arguments.out.display()
            );
        }
        let start = arguments.from.as_deref().map(Weights::read).transpose()?;
        TouchTrainer::new(architecture.clone(), training.clone(), start.as_ref())?
    };
    let mut trainer = trainer.on(device);
    let earlier = if arguments.resume { Earlier::Keep } else { Earlier::Move };
    // Trainings of version 0.1.0 have no mark.
    let overwrite = arguments.resume || arguments.overwrite;
    let _claimed = ClaimedFolder::claim(&arguments.out, "touch train", earlier, overwrite)?;
    let hash = data_hash(&data, &profile)?;
    let surfaces = objects::load(&data.objects.train)?;
    let watched = WatchedImages::new(&data.objects.validate, &data, &profile, &training, VALIDATION_SEED)?;
    let seen = WatchedImages::new(&data.objects.train, &data, &profile, &training, TRAINING_SEED)?;
    let mut curve = Curve::open(&arguments.out, trainer.step())?;
    let mut rack = Rack::new(&data, &profile, training.seed)?;

    let bar = progress::bar(training.steps(), &format!("{} on the {device}", arguments.network));
    bar.set_position(trainer.step());
    let first = trainer.step();
    std::thread::scope(|scope| {
        // Images of later steps are drawn while a step is computed.
        let (sender, batches) = mpsc::sync_channel(DRAWN_TOGETHER);
        scope.spawn(|| {
            let (sender, look) = (sender, profile.appearance.as_ref());
            for begin in (first..training.steps()).step_by(DRAWN_TOGETHER) {
                let steps = begin..training.steps().min(begin + DRAWN_TOGETHER as u64);
                let drawn = match draw_batches(&surfaces, &mut rack, (&data, look), &training, steps) {
                    Ok(drawn) => drawn.into_iter().map(Ok).collect(),
                    Err(error) => vec![Err(error)],
                };
                // The training ends when it fails.
                if drawn.into_iter().try_for_each(|batch| sender.send(batch)).is_err() {
                    break;
                }
            }
        });
        let (mut images, mut since) = (0, Instant::now());
        while trainer.step() < training.steps() {
            let batch = batches.recv().context("no more images are drawn")??;
            images += batch.shape[0];
            trainer.queue(&batch)?;
            bar.inc(1);
            let step = trainer.step();
            if step.is_multiple_of(training.validate_every) || step == training.steps() {
                let done = trainer.finish()?;
                let trained_s = since.elapsed().as_secs_f64();
                let last = done.last().context("no step was done")?;
                let weights = trainer.weights(hash.clone())?.for_sensor(profile.appearance);
                let engine = Engine::new(&weights, Instructions::best());
                let predictions = watched.predictions(&engine)?;
                let row = Row {
                    step,
                    images_per_s: images as f64 / trained_s,
                    loss: done.iter().map(|done| done.loss).sum::<f32>() / done.len() as f32,
                    gradient: last.gradient,
                    rate: last.rate,
                    validation: watched.errors(&predictions),
                    training: seen.errors(&seen.predictions(&engine)?),
                };
                let is_best = curve.is_best(&row);
                // The checkpoint is written last: a training that is killed before it repeats the steps and writes all
                // files again.
                weights.write(&arguments.out.join("last.safetensors"), Precision::F32)?;
                if is_best {
                    weights.write(&arguments.out.join("best.safetensors"), Precision::F32)?;
                }
                let shown = watched.examples.iter().zip(&predictions).take(PANELS);
                panels::write(&arguments.out.join("panels.png"), shown)?;
                curve.push(row)?;
                trainer.save(&checkpoint)?;
                tracing::info!("{row:?}");
                (images, since) = (0, Instant::now());
            }
        }
        Ok::<_, anyhow::Error>(())
    })?;
    bar.finish_and_clear();
    Ok(())
}

/// Increases by one whenever the same configuration draws other images.
const IMAGES_VERSION: u32 = 3;

/// Returns the SHA-256 of everything that decides which images a seed draws.
fn data_hash(data: &DataConfig, profile: &SensorProfile) -> Result<String> {
    let mut description = serde_json::to_string(&(data, &data.objects.train, IMAGES_VERSION))?;
    if !profile.is_tacto() {
        description += &serde_json::to_string(profile)?;
    }
    Ok(Sha256::digest(description).iter().map(|byte| format!("{byte:02x}")).collect())
}

/// Draws the images of some steps.
fn draw_batches(
    surfaces: &[PressedSurface],
    rack: &mut Rack,
    (data, look): (&DataConfig, Option<&Appearance>),
    training: &TrainingConfig,
    steps: Range<u64>,
) -> Result<Vec<TrainingBatch>> {
    let sensors = rack.of_steps(steps.clone())?;
    let draw = |(step, sensors): (u64, Vec<&PressSensor>)| {
        let stage = training.stage(step).context("there is no stage")?;
        let first = step << 16;
        let [rows, columns] = stage.size;
        let pixels = rows * columns;
        let mut levels = vec![0; 3 * stage.batch * pixels];
        let mut indentation_mm = vec![0.0; stage.batch * pixels];
        let mut contact = vec![0.0; stage.batch * pixels];
        let places = levels.par_chunks_exact_mut(3 * pixels).zip(indentation_mm.par_chunks_exact_mut(pixels));
        let places = places.zip(contact.par_chunks_exact_mut(pixels)).enumerate();
        places.for_each_init(TouchFrame::default, |frame, (k, ((levels, indentation_mm), contact))| {
            let index = first + k as u64;
            let drawn = subtracted(example(surfaces, &sensors, data, (training.seed, index), frame), look);
            let drawn = resized(drawn, stage.size);
            levels.copy_from_slice(&drawn.levels);
            indentation_mm.copy_from_slice(&drawn.indentation_mm);
            contact.copy_from_slice(&drawn.contact);
        });
        let targets = Arc::new(Targets { indentation_mm, contact });
        Ok(TrainingBatch { shape: [stage.batch, rows, columns], levels, targets })
    };
    steps.into_iter().zip(sensors).collect::<Vec<_>>().into_par_iter().map(draw).collect()
}

/// Images on which the errors are measured while the training goes on, and from which it does not learn.
struct WatchedImages {
    examples: Vec<Example>,
}

impl WatchedImages {
    fn new(
        objects: &[String],
        data: &DataConfig,
        profile: &SensorProfile,
        training: &TrainingConfig,
        seed: u64,
    ) -> Result<Self> {
        // A single image of a far too deep press would outweigh all others.
        let data = &DataConfig { deep: 0.0, ..data.clone() };
        let surfaces = objects::load(objects)?;
        let seed = training.seed ^ seed;
        let mut rack = Rack::new(data, profile, seed)?;
        let sensors = rack.of_step(0)?;
        let images = (0..training.validation_images as u64).into_par_iter();
        let images = images.map_init(TouchFrame::default, |frame, index| {
            subtracted(example(&surfaces, &sensors, data, (seed, index), frame), profile.appearance.as_ref())
        });
        Ok(Self { examples: images.collect() })
    }

    fn predictions(&self, engine: &Engine) -> Result<Vec<Prediction>> {
        let images: Vec<RgbImage> = self.examples.iter().map(Example::image).collect();
        let mut predictions = Vec::new();
        engine.infer_each(&images.iter().collect::<Vec<_>>(), &mut predictions)?;
        Ok(predictions)
    }

    fn errors(&self, predictions: &[Prediction]) -> Errors {
        let mut accuracy = Accuracy::default();
        for (example, prediction) in self.examples.iter().zip(predictions) {
            let truth = example.indentation_mm.iter().zip(&example.contact);
            let truth = truth.map(|(&millimetres, &contact)| Pixel { millimetres, contact: contact > 0.5 });
            accuracy.add(Pixel::all(prediction).zip(truth));
        }
        let Scores { contact_mae_mm, rmse_mm, mae_mm, iou, .. } = accuracy.scores();
        Errors { contact_mae_mm, rmse_mm, mae_mm, iou }
    }
}

/// Subtracts the untouched image of the example's sensor where it is known, as is done before every inference; levels of sensors with an
/// appearance become those of the usual one, too.
fn subtracted(mut example: Example, look: Option<&Appearance>) -> Example {
    match (example.untouched(), look) {
        (Some(untouched), Some(look)) => {
            let (image, mut seen) = (example.image(), example.image());
            let exposure = exposure(&image, &untouched);
            SensorLight::of(&untouched, look, true).change(&image, &untouched, exposure, &mut seen);
            example.levels = seen.into_raw();
        }
        (Some(untouched), None) => subtract_untouched(&untouched, &mut example.levels),
        (None, _) => {}
    }
    example.untouched = None;
    example
}
