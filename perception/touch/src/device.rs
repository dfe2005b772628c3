//! Devices that compute networks.

use std::fmt;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicBool, Ordering};

use crate::network::Weights;

/// Device that computes networks.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Device {
    /// All cores of the CPU.
    #[default]
    Cpu,
    /// The GPU that the program brings; see [`Device::gpu`].
    Gpu,
}

/// A network on a GPU.
pub trait Accelerator: fmt::Debug + Send + Sync {
    /// Predicts indentation in millimetres, at least 0, and the logit of contact for each pixel of RGB images `[images, rows, columns]`.
    /// Images are resized as by [`Engine::infer`](crate::engine::Engine::infer).
    ///
    /// # Errors
    /// What the GPU says.
    fn predict(&self, levels: Vec<u8>, shape: [usize; 3]) -> Result<Vec<[f32; 2]>, String>;
}

/// A GPU that a program brings.
#[derive(Debug, Clone, Copy)]
pub struct InferenceGpu {
    /// What it is, such as "first CUDA device".
    pub name: &'static str,
    /// Returns an error that names the missing part if it cannot be used.
    pub find: fn() -> Result<(), NoGpu>,
    /// Copies a network to it.
    pub load: fn(&Weights) -> Result<Box<dyn Accelerator>, String>,
}

static GPU: OnceLock<InferenceGpu> = OnceLock::new();
/// Whether engines use the GPU.
static IS_USED: AtomicBool = AtomicBool::new(false);

impl InferenceGpu {
    /// Makes this GPU the one of the program. Call it before anything asks for a GPU; the first one holds.
    pub fn bring(self) {
        let _ = GPU.set(self);
    }
}

/// Reason that no GPU is available.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum NoGpu {
    /// The program brings none.
    #[error("this program has no CUDA; build it with the feature cuda, or use the CPU")]
    NotBuilt,
    /// A library of CUDA is missing.
    #[error("{0} cannot be loaded; install it, or use the CPU")]
    Library(&'static str),
    /// The library that was found is the toolkit's stand-in for the driver's.
    #[error(
        "the libcuda that was found is the CUDA toolkit's stub, which is for linking only (CUDA_ERROR_STUB_LIBRARY); take the toolkit's \
         folder stubs off LD_LIBRARY_PATH, or use the CPU"
    )]
    Stub,
    /// The driver offers no device.
    #[error("NVIDIA's driver offers no device ({0}); check it with nvidia-smi, or use the CPU")]
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

    /// Lets engines that are made from now on compute on this device.
    pub fn use_for_inference(self) {
        IS_USED.store(self == Self::Gpu, Ordering::Relaxed);
    }

    /// Copies a network to the device that engines use; `None` for the CPU.
    pub(crate) fn load(weights: &Weights) -> Option<Box<dyn Accelerator>> {
        let gpu = GPU.get().filter(|_| IS_USED.load(Ordering::Relaxed))?;
        match (gpu.load)(weights) {
            Ok(accelerator) => Some(accelerator),
            Err(error) => {
                tracing::warn!("{}: {error}; network {} runs on the CPU", gpu.name, weights.architecture().name());
                None
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_missing_gpu_is_reported_with_a_remedy() {
        let error = Device::gpu().unwrap_err().to_string();
        assert!(error.ends_with("or use the CPU"), "{error}");
    }
}
