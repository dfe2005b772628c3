//! Gradients of touch networks on burn's backends, for training on an NVIDIA GPU.

pub mod burn;
#[cfg(feature = "cuda")]
pub mod cuda;
