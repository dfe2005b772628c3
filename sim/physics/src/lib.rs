//! Episodes of in-hand manipulation in MuJoCo: the model as text, the world, and the controller in the loop.

// Its build script puts libmujoco on the link line.
use mvt_mujoco_lib as _;

pub mod episode;
pub mod mjcf;
pub mod world;
