//! Training step by step, and checkpoints on disk.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

use mvt_files::{input, seal};
use rayon::prelude::*;
use safetensors::SafeTensors;
use serde::{Deserialize, Serialize};

use crate::batch::{TrainError, TrainingBatch, TrainingImages, check_shape};
use crate::device::{self, Arithmetic, ResidentTraining};
use crate::lanes::add_to;
use crate::loss::{LossConfig, Targets, TouchLoss};
use crate::model::{Model, initial};
use crate::ops::Cpu;
use crate::optimiser::{OptimiserConfig, OptimiserState, Tensors};
use crate::tape::{Shareable as _, TapeValue, Var, apply};
use mvt_products::Instructions;
use mvt_settings::{Limit as _, Nested, SettingError};
use mvt_touch::device::Device;
use mvt_touch::network::{Architecture, Precision, Provenance, WeightTensor, Weights, WeightsError, write_tensors};

/// Largest checkpoint that is read, bytes: four times the largest weights.
const LARGEST_CHECKPOINT: u64 = 16 << 30;

/// Stages, optimiser and loss of a training. The data is configured elsewhere.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TrainingConfig {
    /// Seed of all random numbers, those of the initial weights included.
    pub seed: u64,
    /// Stages, one after the other.
    pub stages: Vec<Stage>,
    /// Whether the network will resize images to the size of the last stage before it sees them; else it sees them at their own size.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub resizes: bool,
    /// The optimiser.
    #[serde(default)]
    pub optimiser: OptimiserConfig,
    /// The loss.
    #[serde(default)]
    pub loss: LossConfig,
    /// Precision of the operands of matrix products on CPUs that are faster with bf16. All else on a CPU is f32.
    #[serde(default = "bf16")]
    pub precision: Precision,
    /// Numbers of a training on a GPU.
    #[serde(default, skip_serializing_if = "is_default")]
    pub gpu_arithmetic: Arithmetic,
    /// Validations and checkpoints follow every so many steps.
    pub validate_every: u64,
    /// Images of a validation.
    pub validation_images: usize,
}

fn is_default(arithmetic: &Arithmetic) -> bool {
    *arithmetic == Arithmetic::default()
}

fn bf16() -> Precision {
    Precision::Bf16
}

/// Part of a training.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Stage {
    /// Rows and columns of the images, multiples of the network's stride. Steps with small images cost less.
    pub size: [usize; 2],
    /// Images of a step.
    pub batch: usize,
    /// Steps.
    pub steps: u64,
}

/// Most steps of a training: decades of computing.
const MOST_STEPS: u64 = 1_000_000_000_000;

impl TrainingConfig {
    /// Returns the number of steps of all stages.
    pub fn steps(&self) -> u64 {
        self.stages.iter().map(|stage| stage.steps).sum()
    }

    /// Returns the stage of a step, or the last stage if all are done; `None` without stages.
    pub fn stage(&self, step: u64) -> Option<Stage> {
        let mut end = 0;
        let current = self.stages.iter().find(|stage| {
            end += stage.steps;
            step < end
        });
        current.or(self.stages.last()).copied()
    }

    /// Checks all settings but the seed, of which every value is valid.
    ///
    /// # Errors
    /// [`SettingError`] names the first setting that is out of range.
    pub fn validate(&self) -> Result<(), SettingError> {
        if self.stages.is_empty() {
            return Err(SettingError::new("stages", "empty", "at least one stage"));
        }
        for Stage { size: _, batch, steps } in &self.stages {
            (1..=4096).check("stages.batch", batch)?;
            (0..=MOST_STEPS).check("stages.steps", steps)?;
        }
        (1..=MOST_STEPS).check("stages.steps", &self.steps())?;
        Nested.check("optimiser", &self.optimiser)?;
        Nested.check("loss", &self.loss)?;
        (1..=MOST_STEPS).check("validate_every", &self.validate_every)?;
        (1..=1_000_000).check("validation_images", &self.validation_images)
    }
}

/// Pixels of a share, which one thread computes: most intermediate results then fit the cache.
const SHARE: usize = 320 * 240;

/// Result of a step.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct TrainingProgress {
    /// Loss of the batch before the step.
    pub loss: f32,
    /// Length of the gradient before clipping.
    pub gradient: f32,
    /// Step size.
    pub rate: f32,
}

/// Network in training.
pub struct TouchTrainer {
    architecture: Architecture,
    config: TrainingConfig,
    device: Device,
    /// The state on the GPU, from the first step on it on.
    resident: Option<Box<dyn ResidentTraining>>,
    /// The state; its tensors are older than those on the GPU if it `is_stale`.
    state: OptimiserState,
    is_stale: bool,
    /// Step and rate of the steps that the GPU was asked for.
    queued: Vec<(u64, f32)>,
    /// Results that nobody has seen.
    done: Vec<TrainingProgress>,
}

/// Metadata of a checkpoint.
#[derive(Serialize, Deserialize)]
struct Header {
    architecture: Architecture,
    config: TrainingConfig,
    step: u64,
}

/// Key of the metadata.
const KEY: &str = "checkpoint";
/// Prefixes of the names of a checkpoint's tensors.
const PARTS: [&str; 4] = ["weights.", "average.", "mean.", "square."];

impl TouchTrainer {
    /// Prepares a training that starts from given weights or, without any, from random ones.
    ///
    /// # Errors
    /// [`TrainError`] if architecture or configuration is invalid, or if the weights belong to another architecture.
    pub fn new(
        architecture: Architecture,
        config: TrainingConfig,
        start: Option<&Weights>,
    ) -> Result<Self, TrainError> {
        architecture.check()?;
        config.validate()?;
        if let Some(stage) = config.stages.iter().find(|stage| architecture.fit(stage.size) != stage.size) {
            let size = format!("{:?}", stage.size);
            return Err(SettingError::new("stages.size", size, "two multiples of the network's stride").into());
        }
        let weights = match start {
            Some(weights) if *weights.architecture() == architecture => weights.tensors().clone(),
            Some(_) => return Err(TrainError::OtherStart),
            None => initial(&architecture, config.seed),
        };
        let state = OptimiserState::new(weights);
        let (device, resident, is_stale, queued, done) = Default::default();
        Ok(Self { architecture, config, device, resident, state, is_stale, queued, done })
    }

    /// Moves the training to another device; it begins on the CPU. A checkpoint may be resumed on any device.
    #[must_use]
    pub fn on(self, device: Device) -> Self {
        Self { device, ..self }
    }

    /// Returns the number of completed steps.
    pub fn step(&self) -> u64 {
        self.state.step
    }

    /// Does a step.
    ///
    /// # Errors
    /// [`TrainError::NotFinite`] if loss or gradient are not finite, [`TrainError::Batch`] if images or targets do not have the batch's
    /// shape, [`TrainError::Gpu`] if the device fails. The training is unchanged after an error.
    pub fn advance(&mut self, batch: &TrainingBatch) -> Result<TrainingProgress, TrainError> {
        self.queue(batch)?;
        self.finish()?.pop().ok_or_else(|| TrainError::Gpu("it gave no result of a step".to_owned()))
    }

    /// Begins a step. On the CPU it is done at once; on a GPU the call returns while the GPU computes.
    ///
    /// # Errors
    /// As for [`advance`](Self::advance); on a GPU, [`finish`](Self::finish) is the one that finds numbers that are not finite.
    pub fn queue(&mut self, batch: &TrainingBatch) -> Result<(), TrainError> {
        check_shape(&self.architecture, batch.levels.len(), batch.shape)?;
        let Targets { indentation_mm, contact } = &*batch.targets;
        if 3 * indentation_mm.len() != batch.levels.len() || indentation_mm.len() != contact.len() {
            return Err(TrainError::Batch { shape: batch.shape, levels: batch.levels.len() });
        }
        let (step, rate) = (self.state.step, self.config.optimiser.rate(self.state.step, self.config.steps()));
        match self.device {
            Device::Cpu => {
                let (loss, gradient) = self.advance_here(batch);
                if !gradient.is_finite() {
                    return Err(TrainError::NotFinite { step, loss, gradient });
                }
                self.done.push(TrainingProgress { loss, gradient, rate });
            }
            Device::Gpu => {
                self.advance_there(batch)?;
                self.queued.push((step, rate));
            }
        }
        Ok(())
    }

    /// Waits for the steps that have begun and returns their results, since the last call.
    ///
    /// # Errors
    /// [`TrainError::NotFinite`] if loss or gradient of a step were not finite; it changed nothing, but later steps may have been done.
    /// [`TrainError::Gpu`] if the device fails.
    pub fn finish(&mut self) -> Result<Vec<TrainingProgress>, TrainError> {
        let mut done = std::mem::take(&mut self.done);
        let results = self.resident.as_mut().map(|resident| resident.results()).transpose()?.unwrap_or_default();
        for ((step, rate), [loss, gradient]) in std::mem::take(&mut self.queued).into_iter().zip(results) {
            if !loss.is_finite() || !gradient.is_finite() {
                return Err(TrainError::NotFinite { step, loss, gradient });
            }
            done.push(TrainingProgress { loss, gradient, rate });
        }
        Ok(done)
    }

    /// Returns the instructions of the products.
    fn instructions(&self) -> Instructions {
        // Why: notes/decisions/touch.md, "Training multiplies as inference does, in bf16 where the CPU has tiles".
        let best = Instructions::best();
        if self.config.precision == Precision::Bf16 { best } else { best.exact() }
    }

    /// Does a step on the CPU; returns loss and length of the gradient.
    fn advance_here(&mut self, batch: &TrainingBatch) -> (f32, f32) {
        let (architecture, weights, config) = (&self.architecture, &self.state.weights, self.config.loss);
        let (loss, gradients) = gradients(self.instructions(), architecture, weights, config, batch);
        if !loss.is_finite() {
            return (loss, f32::NAN);
        }
        (loss, self.state.advance(&gradients, &self.config.optimiser, self.config.steps()))
    }

    /// Queues a step on the GPU.
    fn advance_there(&mut self, batch: &TrainingBatch) -> Result<(), TrainError> {
        let resident = match &mut self.resident {
            Some(resident) => resident,
            none => {
                let TrainingConfig { loss, gpu_arithmetic, .. } = self.config;
                none.insert(device::begin(&self.architecture, loss, gpu_arithmetic, &self.state)?)
            }
        };
        let update = self.config.optimiser.update(self.state.step, self.config.steps());
        resident.advance(batch, &update)?;
        self.state.step += 1;
        self.is_stale = true;
        Ok(())
    }

    /// Copies the state from the GPU if it is newer there.
    ///
    /// # Errors
    /// [`TrainError::Gpu`] if the GPU fails.
    fn refresh(&mut self) -> Result<(), TrainError> {
        if let Some(resident) = self.resident.as_ref().filter(|_| self.is_stale) {
            resident.read(&mut self.state)?;
            self.is_stale = false;
        }
        Ok(())
    }

    /// Returns the averaged weights; `data` is the SHA-256 of the description of the data.
    ///
    /// # Errors
    /// [`TrainError`] if a weight is not finite or the GPU fails.
    pub fn weights(&mut self, data: String) -> Result<Weights, TrainError> {
        self.refresh()?;
        let training = serde_json::to_value(&self.config).unwrap_or_default();
        let provenance = Provenance { seed: self.config.seed, step: self.state.step, data, training };
        let source = Path::new("training");
        let weights = Weights::new(self.architecture.clone(), provenance, self.state.average.clone(), source)?;
        let input_size = self.config.stages.last().filter(|_| self.config.resizes).map(|stage| stage.size);
        let weights = weights
            .with_input_size(input_size)
            .map_err(|error| WeightsError::File { path: source.to_owned(), message: error.to_string() })?;
        Ok(weights)
    }

    /// Writes a checkpoint, from which a later run continues with the same results. The file appears whole or not at all.
    ///
    /// # Errors
    /// [`TrainError`] if the file cannot be written or the GPU fails.
    pub fn save(&mut self, path: &Path) -> Result<(), TrainError> {
        self.refresh()?;
        let damaged = |message: String| WeightsError::File { path: path.to_owned(), message };
        let OptimiserState { step, weights, average, mean, square } = &self.state;
        let header = Header { architecture: self.architecture.clone(), config: self.config.clone(), step: *step };
        let header = serde_json::to_string(&header).map_err(|error| damaged(error.to_string()))?;
        let parts = PARTS.into_iter().zip([weights, average, mean, square]);
        let tensors = parts.flat_map(|(prefix, tensors)| {
            tensors.iter().map(move |(name, tensor)| (format!("{prefix}{name}"), tensor))
        });
        Ok(write_tensors(path, tensors, Precision::F32, [KEY, &header])?)
    }

    /// Resumes a training from a checkpoint.
    ///
    /// # Errors
    /// [`TrainError`] if the file cannot be read, is damaged, or belongs to another architecture or configuration.
    pub fn resume(path: &Path, architecture: Architecture, config: TrainingConfig) -> Result<Self, TrainError> {
        let io = |source| WeightsError::Io { path: path.to_owned(), source };
        let damaged = |message: String| WeightsError::File { path: path.to_owned(), message };
        let bytes = input::read(path, LARGEST_CHECKPOINT).map_err(io)?;
        seal::check(&bytes).map_err(|broken| damaged(broken.to_string()))?;
        let (_, metadata) = SafeTensors::read_metadata(&bytes).map_err(|error| damaged(error.to_string()))?;
        let header = metadata.metadata().as_ref().and_then(|metadata| metadata.get(KEY));
        let header = header.ok_or_else(|| damaged("it is not a checkpoint".to_owned()))?;
        let header: Header = serde_json::from_str(header).map_err(|error| damaged(error.to_string()))?;
        let other = |what| TrainError::OtherTraining { path: path.to_owned(), what };
        if header.architecture != architecture {
            return Err(other("network"));
        }
        if header.config != config {
            return Err(other("training configuration"));
        }
        let mut trainer = Self::new(architecture, config, None)?;
        trainer.state.step = header.step;
        let file = SafeTensors::deserialize(&bytes).map_err(|error| damaged(error.to_string()))?;
        let OptimiserState { weights, average, mean, square, .. } = &mut trainer.state;
        for (prefix, tensors) in PARTS.into_iter().zip([weights, average, mean, square]) {
            for (name, tensor) in tensors {
                let name = format!("{prefix}{name}");
                let wrong = |message| damaged(format!("tensor {name}: {message}"));
                let view = file.tensor(&name).map_err(|error| wrong(error.to_string()))?;
                if view.shape() != tensor.shape || view.data().len() != 4 * tensor.values.len() {
                    let message = format!("{:?} {:?}; F32 of {:?} expected", view.dtype(), view.shape(), tensor.shape);
                    return Err(wrong(message).into());
                }
                for (value, bytes) in tensor.values.iter_mut().zip(view.data().as_chunks().0) {
                    *value = f32::from_le_bytes(*bytes);
                }
            }
        }
        Ok(trainer)
    }
}

/// Returns the loss of a batch and its gradients by all weights, computed on the CPU.
pub(crate) fn gradients(
    instructions: Instructions,
    architecture: &Architecture,
    weights: &Tensors,
    config: LossConfig,
    batch: &TrainingBatch,
) -> (f32, Tensors) {
    let values = shared(weights);
    let share = |(first, images)| {
        let variables = values.iter().map(|(&name, value)| (name, Var::parameter(value.clone()))).collect();
        let model = Model { architecture, ops: &Cpu { instructions }, variables: &variables };
        let loss = apply(TouchLoss { config, targets: batch.targets.clone(), first }, [model.forward(images)]);
        let value: f32 = loss.tensor().values.iter().sum();
        let mut slopes = loss.backward();
        let gradients: Vec<_> = variables.values().map(|variable| slopes.take(variable)).collect();
        (value, gradients)
    };
    let (losses, shares): (Vec<f32>, Vec<Vec<Option<WeightTensor>>>) =
        batch.shares(SHARE).into_par_iter().map(share).collect();
    // The order of the shares, not of their completion.
    let sum = |(k, (name, tensor)): (usize, (&String, &WeightTensor))| {
        let mut sum = tensor.zeros();
        shares.iter().filter_map(|share| share[k].as_ref()).for_each(|part| add_to(&mut sum.values, &part.values));
        (name.clone(), sum)
    };
    let named: Vec<_> = weights.iter().enumerate().collect();
    (losses.iter().sum(), named.into_par_iter().map(sum).collect())
}

/// Predicts with the forward pass of training, for RGB images `[images, rows, columns]` whose sides are multiples of the network's
/// stride: per pixel indentation in millimetres, at least 0, and the logit of contact. [`mvt_touch::engine`] is faster and takes any size.
///
/// # Errors
/// [`TrainError::Batch`] if the number of levels does not fit the shape, or its sides are not multiples of the stride.
pub fn predict(weights: &Weights, levels: &[u8], shape: [usize; 3]) -> Result<Vec<[f32; 2]>, TrainError> {
    check_shape(weights.architecture(), levels.len(), shape)?;
    let values = shared(weights.tensors());
    let variables = values.into_iter().map(|(name, value)| (name, Var::constant(value))).collect();
    let ops = Cpu { instructions: Instructions::best().exact() };
    let model = Model { architecture: weights.architecture(), ops: &ops, variables: &variables };
    let output = model.forward(TrainingImages { levels, shape });
    let pixels = output.tensor().values.as_chunks::<2>().0;
    Ok(pixels.iter().map(|&[indentation, logit]| [indentation.max(0.0), logit]).collect())
}

/// Returns tensors that several threads may read.
fn shared(tensors: &Tensors) -> BTreeMap<&str, Arc<TapeValue>> {
    tensors.iter().map(|(name, tensor)| (name.as_str(), tensor.clone().shared())).collect()
}
