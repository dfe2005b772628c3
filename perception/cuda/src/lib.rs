//! Training and inference of the networks of [`mvt_touch`] on an NVIDIA GPU.
//!
//! [`GpuTraining`] keeps weights, their averages and the optimiser's moments on the GPU; a step uploads images and targets and leaves two
//! numbers. [`GpuNetwork`] predicts. Both work on a [`machine::Machine`]: with the feature `nvidia` the first CUDA device, in tests the
//! emulator of `mvt-cuda-emulator`. `bring_first_device` gives the GPU to all of a program.
//!
//! ```
//! use std::sync::Arc;
//!
//! use mvt_cuda::machine::Arithmetic;
//! use mvt_cuda::mvt_touch::network::Architecture;
//! use mvt_cuda::mvt_training::backend::{OptimiserState, initial};
//! use mvt_cuda::mvt_training::{LossConfig, OptimiserConfig, Targets, TrainingBatch};
//! use mvt_cuda::{Gpu, GpuTraining};
//! use mvt_cuda_emulator::Emulator;
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let network: Architecture = serde_json::from_str(r#"{"name": "default", "widths": [4, 4, 8, 16], "depth": 1}"#)?;
//! let state = OptimiserState::new(initial(&network, 1));
//! // With a GPU, `nvidia::Nvidia::open(Arithmetic::Tf32)?`.
//! let gpu = Gpu::new(Emulator::machine(Arithmetic::Exact));
//! let mut training = GpuTraining::new(gpu, &network, LossConfig::default(), &state)?;
//! // One grey image of 32 x 16 pixels that shows no contact.
//! let targets = Targets { indentation_mm: vec![0.0; 512], contact: vec![0.0; 512] };
//! let batch = TrainingBatch { shape: [1, 16, 32], levels: vec![128; 3 * 512], targets: Arc::new(targets) };
//! for step in 0..2 {
//!     training.advance(&batch, &OptimiserConfig::default().update(step, 2))?;
//! }
//! let losses = training.results()?;
//! assert!(losses[1][0] < losses[0][0]);
//! # Ok(())
//! # }
//! ```

// Why: notes/decisions/touch.md, "Own CUDA kernels, burn as the judge".

mod attention;
mod gpu;
mod inference;
pub mod machine;
mod memory;
#[cfg(feature = "nvidia")]
pub mod nvidia;
mod ops;
mod selective;
mod tape;
mod thread;
mod training;

pub use gpu::Gpu;
pub use inference::GpuNetwork;
pub use memory::DeviceArray;
pub use mvt_training;
pub use mvt_training::mvt_touch;
pub use thread::{NetworkThread, TrainingThread};
pub use training::GpuTraining;

/// Makes the first CUDA device the GPU of the program, for training and inference.
#[cfg(feature = "nvidia")]
pub fn bring_first_device() {
    use machine::Arithmetic;
    use nvidia::Nvidia;

    mvt_training::backend::bring(|architecture, loss, arithmetic, state| {
        Ok(Box::new(TrainingThread::new(architecture, loss, state, move || Nvidia::open(arithmetic))?))
    });
    let load = |weights: &mvt_touch::network::Weights| {
        let thread =
            NetworkThread::new(weights, || Nvidia::open(Arithmetic::Tf32)).map_err(|error| error.to_string())?;
        Ok(Box::new(thread) as Box<dyn mvt_touch::device::Accelerator>)
    };
    mvt_touch::device::InferenceGpu { name: "first CUDA device", find: nvidia::find, load }.bring();
}
