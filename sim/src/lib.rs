//! What happens.
pub mod feelsight;

use mujoco_lib as _;
