//! Training of touch networks on the CPU (cargo feature `train`).
//!
//! The convolutions and the inside of a Mamba block cost nearly all of the time, and each is one op with an analytic backward pass.
//! Shares of a batch go through the network side by side; sums go over blocks, images and shares in a fixed order, so that a run's
//! weights do not depend on the number of threads.

mod attention;
mod convolution;
mod lanes;
mod linear;
mod loss;
mod model;
mod optimiser;
mod pointwise;
mod resample;
mod scan;
mod tape;
#[cfg(test)]
mod tests;
mod tokens;
mod trainer;

pub use loss::{LossConfig, Penalty, Targets};
pub use optimiser::OptimiserConfig;
pub use trainer::{Batch, Progress, Stage, TrainError, Trainer, TrainingConfig, predict};
