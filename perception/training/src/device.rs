//! Devices on which networks are trained.

use std::fmt;
use std::sync::OnceLock;

use mvt_touch::network::Architecture;

use crate::batch::{TrainError, TrainingBatch};
use crate::loss::LossConfig;
use crate::optimiser::Tensors;

/// Device that computes gradients in training.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub enum Device {
    /// All cores of the CPU.
    #[default]
    Cpu,
    /// The GPU that the program brings; see [`Device::gpu`].
    Gpu,
}

/// Returns the loss of a batch and its gradients by all weights.
pub type Gradients = fn(&Architecture, &Tensors, LossConfig, &TrainingBatch) -> Result<(f32, Tensors), TrainError>;

/// A GPU for training.
#[derive(Debug, Clone, Copy)]
pub struct Gpu {
    /// What it is, such as "first CUDA device".
    pub name: &'static str,
    /// Returns an error that names the missing part if it cannot be used.
    pub find: fn() -> Result<(), NoGpu>,
    /// Its gradients.
    pub gradients: Gradients,
}

static GPU: OnceLock<Gpu> = OnceLock::new();

impl Gpu {
    /// Makes this GPU the one of the program. Call it before training begins; the first one holds.
    pub fn bring(self) {
        let _ = GPU.set(self);
    }
}

/// Reason that no GPU is available for training.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum NoGpu {
    /// The program brings none.
    #[error("this program has no CUDA; build the one in the folder gpu, see its README.md, or train on the CPU")]
    NotBuilt,
    /// A library of CUDA is missing.
    #[error("{0} cannot be loaded; install it, or train on the CPU")]
    Library(&'static str),
    /// The driver offers no device.
    #[error("NVIDIA's driver offers no device ({0}); check it with nvidia-smi, or train on the CPU")]
    Device(String),
}

impl fmt::Display for Device {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Cpu => "CPU",
            Self::Gpu => GPU.get().map_or("GPU", |gpu| gpu.name),
        })
    }
}

impl Device {
    /// Returns the GPU.
    ///
    /// # Errors
    /// [`NoGpu`] names the missing part.
    pub fn gpu() -> Result<Self, NoGpu> {
        let gpu = GPU.get().ok_or(NoGpu::NotBuilt)?;
        (gpu.find)().map(|()| Self::Gpu)
    }
}

/// Returns the loss of a batch and its gradients by all weights, computed on the GPU.
pub(crate) fn gradients(
    architecture: &Architecture,
    weights: &Tensors,
    config: LossConfig,
    batch: &TrainingBatch,
) -> Result<(f32, Tensors), TrainError> {
    match GPU.get() {
        Some(gpu) => (gpu.gradients)(architecture, weights, config, batch),
        None => Err(TrainError::Gpu(NoGpu::NotBuilt.to_string())),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_missing_gpu_is_reported_with_a_remedy() {
        let error = Device::gpu().unwrap_err().to_string();
        assert!(error.ends_with("or train on the CPU"), "{error}");
    }
}
