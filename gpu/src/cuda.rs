//! The first CUDA device, through burn.

use burn_autodiff::Autodiff;
use burn_cuda::{Cuda, CudaDevice};
use cudarc::{driver, nvrtc};
use mvt_training::backend::Tensors;
use mvt_training::mvt_touch::network::Architecture;
use mvt_training::{Gpu, LossConfig, NoGpu, TrainError, TrainingBatch};

use crate::burn;

/// Pixels of a pass: eight images of a DIGIT. They bound the memory; the scans of the preset `mamba` then take about 6 GB.
const PASS: usize = 8 * 320 * 240;

/// The GPU of this package.
pub const GPU: Gpu = Gpu { name: "first CUDA device", find, gradients };

fn find() -> Result<(), NoGpu> {
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
        Ok(1..) => Ok(()),
        Ok(_) => Err(NoGpu::Device("it counts 0".to_owned())),
        Err(error) => Err(NoGpu::Device(error.to_string())),
    }
}

fn gradients(
    architecture: &Architecture,
    weights: &Tensors,
    config: LossConfig,
    batch: &TrainingBatch,
) -> Result<(f32, Tensors), TrainError> {
    burn::gradients::<Autodiff<Cuda>>(&CudaDevice::default(), architecture, weights, config, batch, PASS)
}
