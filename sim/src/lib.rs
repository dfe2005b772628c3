//! What happens: MuJoCo stepping, controllers, touch and RGB-D rendering, noise and FeelSight logs.

// Its build script puts libmujoco on the link line.
use mujoco_lib as _;

pub mod camera;
pub mod controller;
pub mod depth_noise;
pub mod directive;
pub mod episode;
pub mod feelsight;
pub mod gait;
pub mod lettering;
pub mod observer;
pub mod rays;
pub mod tessellation;
pub mod touch;
pub mod world;
