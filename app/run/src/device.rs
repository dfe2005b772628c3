//! The device that computes touch networks, on the command line.

use anyhow::{Context as _, Result};
use clap::{Args, ValueEnum};
use mvt_touch::device::Device;

/// Device of a command that runs touch networks.
#[derive(Debug, Clone, Copy, Args)]
pub struct DeviceArguments {
    /// Device that computes touch networks
    #[arg(long, value_enum, default_value_t)]
    device: InferenceDevice,
}

/// Device on the command line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, ValueEnum)]
enum InferenceDevice {
    /// All cores of the CPU
    #[default]
    Cpu,
    /// The first CUDA device; needs NVIDIA's driver, the CUDA toolkit and a program with the feature cuda
    Cuda,
}

impl DeviceArguments {
    /// Returns the name of the device, unless it is the default.
    pub fn option(self) -> Option<String> {
        (self.device == InferenceDevice::Cuda).then(|| "cuda".to_owned())
    }

    /// Lets the networks of this process run on the device, and returns it.
    ///
    /// # Errors
    /// If there is no such device; the error says what is missing.
    pub fn choose(self) -> Result<Device> {
        let device = match self.device {
            InferenceDevice::Cpu => Device::Cpu,
            InferenceDevice::Cuda => Device::gpu().context("--device cuda")?,
        };
        device.use_for_inference();
        Ok(device)
    }
}
