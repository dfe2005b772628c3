//! Object, hand and background in depth images.

mod frame;
mod segmentation;

pub use frame::{Gaps, depth_frame, touch_from_depth};
pub use segmentation::{SegmentationConfig, segment};
