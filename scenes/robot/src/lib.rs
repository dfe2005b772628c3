//! The Allegro hand with DIGIT fingertips: kinematics, solids, sensors, the cameras around the hand, and its
//! observations.
//!
//! Everything is a function of the side (left or right) and 16 joint angles in radians. The crate holds no state,
//! simulates no physics and renders no images.
//!
//! ```
//! use mvt_robot::hand::solid::HandSolid;
//! use mvt_robot::hand::{Finger, JOINTS, Side, world_from_tip};
//!
//! let joints = [0.2; JOINTS];
//! let tip = world_from_tip(Side::Right, Finger::Index, &joints).origin().coords();
//! assert!(tip.x > 0.0, "the fingers point along the world's x axis");
//! let hand = HandSolid::new(Side::Right, &joints);
//! assert!(hand.is_within(mvt_robot::glam::Vec3::new(tip.x as f32, tip.y as f32, tip.z as f32), 0.01));
//! ```

pub mod digit;
mod finger;
pub mod hand;
pub mod observation;
pub mod rig;
mod side;

pub use {glam, image, mvt_frames, nalgebra, ndarray};
