//! Devices on which networks are trained.

use std::fmt;

#[cfg(feature = "cuda")]
use burn_autodiff::Autodiff;
#[cfg(feature = "cuda")]
use burn_cuda::{Cuda, CudaDevice};
#[cfg(feature = "cuda")]
use cudarc::{driver, nvrtc};

#[cfg(feature = "cuda")]
use crate::batch::{TrainError, TrainingBatch};
#[cfg(feature = "cuda")]
use crate::{burn, loss::LossConfig, optimiser::Tensors};
#[cfg(feature = "cuda")]
use mvt_touch::network::Architecture;

/// Device that computes gradients in training.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub enum Device {
    /// All cores of the CPU.
    #[default]
    Cpu,
    /// The first CUDA device; see [`Device::gpu`].
    #[cfg(feature = "cuda")]
    Cuda,
}

/// Reason that no GPU is available for training.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum NoGpu {
    /// The program was built without the feature `cuda`.
    #[error("this program was built without CUDA; build it with --features cuda, or train on the CPU")]
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
            #[cfg(feature = "cuda")]
            Self::Cuda => "first CUDA device",
        })
    }
}

impl Device {
    /// Returns the first CUDA device.
    ///
    /// # Errors
    /// [`NoGpu`] names the missing part.
    #[cfg(not(feature = "cuda"))]
    pub fn gpu() -> Result<Self, NoGpu> {
        Err(NoGpu::NotBuilt)
    }

    /// Returns the first CUDA device.
    ///
    /// # Errors
    /// [`NoGpu`] names the missing part.
    #[cfg(feature = "cuda")]
    pub fn gpu() -> Result<Self, NoGpu> {
        // First, since calls of a missing library panic.
        // SAFETY: loading NVIDIA's libraries runs nothing but their initialisers, which have no preconditions.
        let [driver, compiler] = unsafe { [driver::sys::is_culib_present(), nvrtc::sys::is_culib_present()] };
        if !driver {
            return Err(NoGpu::Library("the library of NVIDIA's driver (libcuda)"));
        }
        if !compiler {
            return Err(NoGpu::Library("the compiler of the CUDA toolkit (libnvrtc)"));
        }
        match driver::CudaContext::device_count() {
            Ok(1..) => Ok(Self::Cuda),
            Ok(_) => Err(NoGpu::Device("it counts 0".to_owned())),
            Err(error) => Err(NoGpu::Device(error.to_string())),
        }
    }
}

/// Pixels of a pass on a GPU: eight images of a DIGIT. They bound the memory; the scans of the preset `mamba` then take about 6 GB.
#[cfg(feature = "cuda")]
const PASS: usize = 8 * 320 * 240;

/// Returns the loss of a batch and its gradients by all weights, computed on the first CUDA device.
#[cfg(feature = "cuda")]
pub(crate) fn gradients(
    architecture: &Architecture,
    weights: &Tensors,
    config: LossConfig,
    batch: &TrainingBatch,
) -> Result<(f32, Tensors), TrainError> {
    burn::gradients::<Autodiff<Cuda>>(&CudaDevice::default(), architecture, weights, config, batch, PASS)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_missing_gpu_is_reported_with_the_missing_part() {
        match Device::gpu() {
            Ok(device) => assert_ne!(device, Device::Cpu),
            Err(error) => assert!(error.to_string().ends_with("or train on the CPU"), "{error}"),
        }
    }
}
