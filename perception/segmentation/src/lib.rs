//! Labels for depth images: which pixels show the object, which the hand, which neither.
//!
//! The hand's shape and joint angles are known and the object's are not, so a pixel shows the hand if its point lies in the hand, the object
//! if its point is near the grasp, and background otherwise. Colour plays no part, and there is no network.
//!
//! ```
//! use mvt_robot::hand::Side;
//! use mvt_robot::hand::solid::HandSolid;
//! use mvt_robot::rig::PLACEMENTS;
//! use mvt_segmentation::{SegmentationConfig, segment};
//! use ndarray::Array2;
//!
//! let camera = PLACEMENTS[2].camera(Side::Left);
//! let depth_m = Array2::from_elem((480, 640), 0.3);
//! let hand = HandSolid::new(Side::Left, &[0.1; 16]);
//! let labels = segment(&depth_m, &camera.intrinsics, camera.pose, &hand, &SegmentationConfig::default());
//! assert_eq!(labels.dim(), (480, 640));
//! ```

mod segmentation;

pub use ndarray;
pub use segmentation::{SegmentationConfig, segment};
