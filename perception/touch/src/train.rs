//! Training of touch networks (cargo feature `train`) on the CPU or, with cargo feature `cuda`, through burn on an NVIDIA GPU. The
//! GPU path compiles, and tests check its mathematics on burn's CPU backend; it has never run on a GPU.
//!
//! On the CPU, the convolutions and the inside of a Mamba block cost nearly all of the time; each is one op with an analytic backward
//! pass. Shares of a batch pass through the network side by side. Blocks, images and shares are summed in a fixed order, so the weights
//! do not depend on the number of threads.

mod attention;
mod batch;
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

pub use batch::{TrainError, TrainingBatch};
pub use device::{Device, NoGpu};
pub use loss::{LossConfig, Penalty, Targets};
pub use optimiser::OptimiserConfig;
pub use trainer::{Stage, TouchTrainer, TrainingConfig, TrainingProgress, predict};
