//! Simulated episodes: MuJoCo, rendering and perception behind one source of frames, and as FeelSight logs.
//!
//! [`SimulatedSource`] steps an episode and renders it as frames are asked for; a directive of the supervisor reaches the hand two frames later.
//! [`recorder`] writes the same episode as a log. This crate links libmujoco.
//!
//! ```no_run
//! use mvt_simulated::{Fault, SimulatedSettings, SimulatedSource};
//! use mvt_objects::catalogue;
//! use mvt_robot::hand::{Hand, Side};
//! use mvt_run::source::{Modality, Source as _};
//!
//! let object = catalogue::load("cube70", &mut Vec::new())?;
//! let hand = Hand::allegro(Side::Left);
//! let (_, gait) = mvt_gaits::gait::choose("auto", &object, &hand)?;
//! let settings = SimulatedSettings {
//!     hand,
//!     gait: gait.clone(),
//!     mover: None,
//!     schedule: Default::default(),
//!     seed: 0,
//!     duration_s: 1.0,
//!     cameras: Vec::new(),
//!     camera_noise: 5.0,
//!     modality: Modality::Tac,
//!     perception: Default::default(),
//!     hidden_every: None,
//!     fault: Fault::default(),
//! };
//! let mut source = SimulatedSource::new(&object, settings, None)?;
//! while let Some(sensed) = source.next()? {
//!     println!("{:.2} s: {} pads measured", sensed.percept.time_s, sensed.percept.touch.0.iter().flatten().count());
//! }
//! # Ok::<(), anyhow::Error>(())
//! ```

// Its build script puts libmujoco on the link line.
use mvt_mujoco_lib as _;

pub mod recorder;
mod simulated;

pub use simulated::{Fault, HIDDEN_EVERY, SimulatedSettings, SimulatedSource};
