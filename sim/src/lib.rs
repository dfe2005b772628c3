//! What happens.
use mujoco_lib as _;

pub mod camera;
pub mod depth_noise;
pub mod rays;
pub mod tessellation;
