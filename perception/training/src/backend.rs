//! Parts for another computation of the gradients than that on the CPU.
//!
//! [`Model`] is the networks' forward pass over any [`Ops`]; [`gradients`] computes those of the CPU, with which another computation is
//! compared.

use mvt_products::Instructions;
use mvt_touch::network::Architecture;

pub use crate::attention::WindowAttention;
pub use crate::batch::TrainingImages;
pub use crate::device::{Begin, ResidentTraining, bring};
pub use crate::lanes::add_to;
pub use crate::model::{Model, initial};
pub use crate::ops::Ops;
pub use crate::optimiser::{OptimiserState, Tensors, Update};
pub use crate::resample::Resample;
use crate::{LossConfig, TrainingBatch};

/// Returns the loss of a batch and its gradients by all weights, computed on the CPU in 32-bit floats.
pub fn gradients(
    architecture: &Architecture,
    weights: &Tensors,
    config: LossConfig,
    batch: &TrainingBatch,
) -> (f32, Tensors) {
    crate::trainer::gradients(Instructions::best().exact(), architecture, weights, config, batch)
}
