//! Search for gaits that turn objects about an axis, by CMA-ES over simulated trials.
//!
//! ```
//! use mvt_gaits::axis::TurnAxis;
//! use mvt_gaits::gait;
//! use mvt_objects::catalogue;
//! use mvt_robot::hand::{Hand, Side};
//! use mvt_tuning::search::{Search, SearchSettings};
//!
//! let cube = catalogue::load("cube70", &mut Vec::new())?;
//! let (_, from) = gait::find("tumble_back")?;
//! let settings = SearchSettings {
//!     objects: vec!["cube70".to_owned()],
//!     axis: TurnAxis::MinusY,
//!     duration_s: 0.2,
//!     starts: 1,
//!     sufficient_rate_rad_s: None,
//!     population: 4,
//!     sigma: 0.3,
//!     only: vec![],
//!     seed: 1,
//! };
//! let mut search = Search::new(settings, from, &Hand::allegro(Side::Right));
//! search.advance(&[cube])?;
//! assert_eq!(search.gait("an example").table.len(), 32);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

// Its build script puts libmujoco on the link line.
use mvt_mujoco_lib as _;

pub mod air;
pub mod carried;
mod equilibrium;
pub mod evolution;
pub mod first_stroke;
pub mod grasp;
mod pads;
pub mod search;
pub mod seeds;
pub mod speed;
pub mod stroke;
pub mod survey;
pub mod trial;

pub use {mvt_gaits, mvt_objects, mvt_physics, mvt_robot};
