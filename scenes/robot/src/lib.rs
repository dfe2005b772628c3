//! Hands with touch sensors as data: kinematics, solids, sensors, the cameras around the hand, and its observations.
//!
//! A [`hand::Hand`] describes bodies, joints and pads; everything else is a function of it and of the joint angles. The crate simulates no
//! physics and renders no images.
//!
//! ```
//! use mvt_robot::hand::solid::HandSolid;
//! use mvt_robot::hand::{Hand, Side};
//!
//! let hand = Hand::allegro(Side::Right);
//! let joints = vec![0.2; hand.joints().len()];
//! let tip = hand.world_from_pads(&joints)[0].origin().coords();
//! assert!(tip.x > 0.0, "the fingers point along the world's x axis");
//! let solid = HandSolid::new(&hand, &joints);
//! assert!(solid.is_within(mvt_robot::glam::Vec3::new(tip.x as f32, tip.y as f32, tip.z as f32), 0.01));
//! ```

pub mod digit;
pub mod hand;
mod joint;
pub mod observation;
mod per_pad;
pub mod rig;
mod side;

pub use {glam, image, mvt_frames, nalgebra, ndarray};
