//! Labels for depth images: which pixels show the object, which the hand, which neither.
//!
//! The hand's shape and joint angles are known and the object's are not, so a pixel shows the hand if its point lies in the hand, the object
//! if its point is near the grasp, and background otherwise. Colour plays no part, and there is no network. Masks or images of labels that
//! others made take the place of the hand's geometry ([`labelled`]).
//!
//! ```
//! use mvt_robot::hand::solid::HandSolid;
//! use mvt_robot::hand::{Hand, Side};
//! use mvt_robot::rig::PLACEMENTS;
//! use mvt_segmentation::{SegmentationConfig, segment};
//! use ndarray::Array2;
//!
//! let hand = Hand::allegro(Side::Left);
//! let (camera, joints) = (PLACEMENTS[2].camera(&hand), [0.1; 16]);
//! let depth_m = Array2::from_elem((480, 640), 0.3);
//! let (solid, grasp) = (HandSolid::new(&hand, &joints), hand.grasp_centre(&joints));
//! let labels = segment(&depth_m, &camera.intrinsics, camera.pose, &solid, grasp, &SegmentationConfig::default());
//! assert_eq!(labels.dim(), (480, 640));
//! ```

mod carry;
mod colours;
mod segmentation;

pub use carry::{CarriedMask, KnownSurface, MaskCarrier};
pub use ndarray;
pub use segmentation::{LabelSource, SegmentationConfig, labelled, segment};
