//! Pixels to metric geometry: what a camera's pixels show, and the frames that the tracker receives.
//!
//! Nothing here knows of the simulator or receives ground truth. What touch images show is found by [`contact`], or comes in as depth
//! and contact from whoever knows it.

mod accuracy;
pub mod contact;
pub mod engine;
mod frame;
pub mod network;
mod segmentation;
#[cfg(feature = "train")]
pub mod train;
pub mod untouched;

pub use accuracy::{Accuracy, Pixel, Scores};
pub use frame::{Gaps, Sensor, SensorError, TouchImages, depth_frame, touch_from_depth};
pub use segmentation::{SegmentationConfig, segment};
