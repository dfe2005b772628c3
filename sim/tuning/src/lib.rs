//! Search for gaits that turn objects about an axis, by CMA-ES over simulated trials.

// Its build script puts libmujoco on the link line.
use mvt_mujoco_lib as _;

pub mod evolution;
pub mod search;
pub mod seeds;
pub mod stroke;
pub mod trial;
