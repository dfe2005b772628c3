//! Training on a GPU that the program brings.

use std::sync::OnceLock;

use mvt_touch::device::NoGpu;
use mvt_touch::network::Architecture;
use serde::{Deserialize, Serialize};

use crate::batch::{TrainError, TrainingBatch};
use crate::loss::LossConfig;
use crate::optimiser::{OptimiserState, Update};

/// Numbers in which a GPU stores activations and computes products. Weights, their gradients and all sums are 32-bit floats.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Arithmetic {
    /// 32-bit floats throughout, as on the CPU.
    Exact,
    /// 32-bit floats, whose products have the 10 bits of TF32.
    #[default]
    Tf32,
    /// Activations and their gradients in bf16, which take half the memory.
    Bf16,
}

/// Training whose state lies on a GPU.
pub trait ResidentTraining: Send {
    /// Queues a step. If its loss or gradient are not finite, it changes nothing.
    ///
    /// # Errors
    /// [`TrainError::Gpu`] if the GPU is gone. An error of a step is that of the next [`results`](Self::results).
    fn advance(&mut self, batch: &TrainingBatch, update: &Update) -> Result<(), TrainError>;

    /// Waits for the queued steps. Returns the loss before each step since the last call, and the length of its gradient.
    ///
    /// # Errors
    /// [`TrainError::Gpu`] if the GPU fails.
    fn results(&mut self) -> Result<Vec<[f32; 2]>, TrainError>;

    /// Copies weights, averages and moments to a state of the same network.
    ///
    /// # Errors
    /// [`TrainError::Gpu`] if the GPU fails.
    fn read(&self, state: &mut OptimiserState) -> Result<(), TrainError>;
}

/// Begins a training from a state.
pub type Begin =
    fn(&Architecture, LossConfig, Arithmetic, &OptimiserState) -> Result<Box<dyn ResidentTraining>, TrainError>;

static BEGIN: OnceLock<Begin> = OnceLock::new();

/// Makes this the way in which the program trains on its GPU. Call it before training begins; the first one holds.
pub fn bring(begin: Begin) {
    let _ = BEGIN.set(begin);
}

/// Begins a training on the GPU.
pub(crate) fn begin(
    architecture: &Architecture,
    loss: LossConfig,
    arithmetic: Arithmetic,
    state: &OptimiserState,
) -> Result<Box<dyn ResidentTraining>, TrainError> {
    match BEGIN.get() {
        Some(begin) => begin(architecture, loss, arithmetic, state),
        None => Err(TrainError::Gpu(NoGpu::NotBuilt.to_string())),
    }
}
