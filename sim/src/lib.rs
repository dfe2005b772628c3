//! What happens.
use mujoco_lib as _;
