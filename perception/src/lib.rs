//! Pixels to metric geometry: what a camera's pixels show, and the frames that the tracker receives.
//!
//! Nothing here knows of the simulator or receives ground truth; what touch images show comes in as depth and contact.

pub mod engine;
mod frame;
pub mod network;
mod segmentation;

pub use frame::{Config, Gaps, Sensor, SensorError, TouchImages, depth_frame, touch_from_depth};
pub use segmentation::{SegmentationConfig, segment};
