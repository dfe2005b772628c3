//! The Allegro hand with DIGIT fingertips: names, joints, limits, forward kinematics and solids.
//!
//! The numbers are those of SimLab's URDF (finger order if, mf, rf, th); exceptions name their source. The left hand is
//! the mirror image of the right one in the plane y = 0. Its joint conventions follow SimLab's left URDF, which
//! NeuralFeels' loaders use: the abduction joints keep the axis +z, so their angles change sign under the mirror; the
//! thumb's first two axes are mirrored, so its angles keep their sign.

mod kinematics;
mod parts;
pub mod solid;

pub use crate::finger::{Finger, JOINTS, JOINTS_PER_FINGER, JointAngles, PerFinger};
pub use crate::side::Side;
pub use kinematics::{
    Joint, finger_kinematics, joint, joint_ranges, tip_offset_m, world_from_base, world_from_digit_camera,
    world_from_tip,
};
pub use parts::{Body, Inertial, Part, PartSurface, Primitive, inertial, parts};
