//! Episodes of in-hand manipulation in MuJoCo: the model as text, the simulation, and the controller in the loop.
//!
//! [`episode::Episode`] draws a randomised start, runs the controller of a gait, and returns the true state at the rate
//! of the cameras. The crate renders no images and estimates nothing. It is the only crate that calls libmujoco.
//!
//! ```
//! use mvt_gaits::gait;
//! use mvt_objects::catalogue;
//! use mvt_physics::episode::{self, Episode, EpisodeConfig, Randomisation};
//! use mvt_robot::hand::{Hand, Side};
//!
//! let cube = catalogue::load("cube70", &mut Vec::new())?;
//! let hand = Hand::allegro(Side::Left);
//! let gait = gait::choose("auto", &cube, &hand)?.1.clone();
//! let config = EpisodeConfig { hand, gait, seed: 1, duration_s: 0.2, randomisation: Randomisation::default() };
//! let outcome = episode::run(&mut Episode::new(&cube, &config)?);
//! assert!(outcome.survived_s > 0.1);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

// Its build script puts libmujoco on the link line.
use mvt_mujoco_lib as _;

pub mod air;
pub mod episode;
pub mod messages;
pub mod mjcf;
pub mod shear;
pub mod simulation;
mod start;

pub use {mvt_frames, mvt_gaits, mvt_objects, mvt_robot, nalgebra};
