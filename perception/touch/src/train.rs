//! Training of touch networks (cargo feature `train`) on the CPU or, with cargo feature `cuda`, through burn on an NVIDIA GPU. The
//! latter has been compiled, and its mathematics checked on burn's CPU backend; it has never run on a GPU.
//!
//! On the CPU, the convolutions and the inside of a Mamba block cost nearly all of the time, and each is one op with an analytic
//! backward pass. Shares of a batch go through the network side by side; sums go over blocks, images and shares in a fixed order, so
//! that a run's weights do not depend on the number of threads.

mod attention;
#[cfg(any(test, feature = "cuda"))]
mod burn;
mod convolution;
mod device;
mod lanes;
mod linear;
mod loss;
mod model;
mod ops;
mod optimiser;
mod pointwise;
mod resample;
mod scan;
mod tape;
#[cfg(test)]
mod tests;
mod tokens;
mod trainer;

pub use device::{Device, NoGpu};
pub use loss::{LossConfig, Penalty, Targets};
pub use optimiser::OptimiserConfig;
pub use trainer::{Batch, Progress, Stage, TrainError, Trainer, TrainingConfig, predict};
