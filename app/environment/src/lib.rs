//! Tasks for policies that drive the hand: actions in, observations and rewards out, one environment or many at once.
//!
//! [`Scene`] prepares an object, a hand and its sensors. [`Environments`] holds any number of environments with that
//! scene and steps them on all threads. The task is to turn the object in the gait's direction ([`Reward`]); an action
//! changes the targets of the 16 joints. The crate learns nothing. Results are the same for any number of threads.
//!
//! ```
//! use std::sync::Arc;
//!
//! use mvt_environment::{Environments, Scene, Sense, TurnSettings};
//!
//! let settings = TurnSettings { senses: vec![Sense::Proprioception], ..TurnSettings::default() };
//! let scene = Arc::new(Scene::new(mvt_objects::catalogue::load("cube70", &mut Vec::new())?, settings)?);
//! let mut environments = Environments::new(scene, 2, true)?;
//! let first = environments.reset(&[7, 8])?;
//! let outcome = environments.step(&[0.1; 2 * 16])?;
//! assert_eq!(first.len(), outcome.observations.len());
//! println!("{:?}", outcome.rewards.iter().map(|reward| reward.total()).collect::<Vec<_>>());
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

// Its build script puts libmujoco on the link line.
use mvt_mujoco_lib as _;

mod error;
mod many;
mod reward;
mod scene;
mod sense;
mod turn;

pub use error::TaskError;
pub use many::{Environments, LATER_SEED, StepOutcome};
pub use reward::Reward;
pub use scene::{Scene, TurnSettings};
pub use sense::{Readings, Sense};
pub use {mvt_frames, mvt_objects, mvt_physics, mvt_robot};
