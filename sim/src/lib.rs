//! What happens.
use mujoco_lib as _;

pub mod camera;
pub mod rays;
pub mod tessellation;
