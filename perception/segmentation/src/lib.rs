//! Labels for depth images: which pixels show the object, which the hand, which neither.
//!
//! The hand's shape and joint angles are known and the object's are not, so a pixel shows the hand if its point lies in the hand, the object
//! if its point is near the grasp, and background otherwise. Colour plays no part, and there is no network.
//!
//! ```
//! use mvt_robot::hand::{PerFinger, Side};
//! use mvt_robot::rig::PLACEMENTS;
//! use mvt_segmentation::{SegmentationConfig, percept};
//! use ndarray::Array2;
//!
//! let camera = PLACEMENTS[2].camera(Side::Left);
//! let depth_m = Array2::from_elem((480, 640), 0.3);
//! let config = SegmentationConfig::default();
//! let percept = percept(0.0, [0.1; 16], vec![Some(depth_m)], PerFinger::default(), &[camera], Side::Left, &config)?;
//! assert_eq!(percept.cameras[0].as_ref().map(|camera| camera.labels.dim()), Some((480, 640)));
//! # Ok::<(), mvt_robot::observation::SensorError>(())
//! ```

mod frame;
mod segmentation;

pub use frame::percept;
pub use ndarray;
pub use segmentation::{SegmentationConfig, segment};
