//! Live episodes as a source of frames, and as FeelSight logs.

// Its build script puts libmujoco on the link line.
use mvt_mujoco_lib as _;

mod live;
pub mod recorder;

pub use live::{Fault, LiveSettings, LiveSource};
