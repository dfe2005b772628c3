//! Training of the networks of [`mvt_touch`] on the CPU, or on a GPU that the program brings ([`backend::bring`]), as `mvt-cuda` does.
//!
//! On the CPU, the convolutions and the inside of a Mamba block cost nearly all of the time; each is one op with an analytic backward
//! pass. Shares of a batch pass through the network side by side. Blocks, images and shares are summed in a fixed order, so the weights
//! do not depend on the number of threads.
//!
//! ```
//! use std::sync::Arc;
//!
//! use mvt_touch::network::Architecture;
//! use mvt_training::{Targets, TouchTrainer, TrainingBatch, TrainingConfig};
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let network: Architecture = serde_json::from_str(r#"{"name": "default", "widths": [4, 4, 8, 16], "depth": 1}"#)?;
//! let config: TrainingConfig = serde_json::from_str(
//!     r#"{"seed": 1, "stages": [{"size": [16, 32], "batch": 1, "steps": 2}], "validate_every": 1, "validation_images": 1}"#,
//! )?;
//! let mut trainer = TouchTrainer::new(network, config, None)?;
//! // One grey image of 32 x 16 pixels that shows no contact.
//! let targets = Targets { indentation_mm: vec![0.0; 512], contact: vec![0.0; 512] };
//! let batch = TrainingBatch { shape: [1, 16, 32], levels: vec![128; 3 * 512], targets: Arc::new(targets) };
//! let first = trainer.advance(&batch)?.loss;
//! assert!(trainer.advance(&batch)?.loss < first);
//! # Ok(())
//! # }
//! ```

mod attention;
pub mod backend;
mod batch;
mod convolution;
mod depthwise;
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
pub use device::Arithmetic;
pub use loss::{LossConfig, Penalty, Targets};
pub use mvt_touch;
pub use mvt_touch::device::Device;
pub use optimiser::OptimiserConfig;
pub use trainer::{Stage, TouchTrainer, TrainingConfig, TrainingProgress, predict};
