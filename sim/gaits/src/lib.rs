//! Gaits that turn objects in a robot hand, the directives that change them, and the rates of an episode.
//!
//! A [`Controller`](controller::Controller) receives proprioception, never the pose of the object. One that holds an
//! object in the air also receives its estimated place: see [`feedback`]. Gaits are
//! tables of joint angles for the right hand; the left hand plays the mirror image. Those that are shipped were made for
//! [`Hand::allegro`](mvt_robot::hand::Hand::allegro). The crate does not simulate: it only computes joint angles to aim at.
//!
//! ```
//! use mvt_gaits::controller::{Controller, Proprioception};
//! use mvt_gaits::directed::DirectedController;
//! use mvt_gaits::gait;
//! use mvt_robot::hand::{Hand, Side};
//!
//! let (_, gait) = gait::find("bal")?;
//! let mut controller = DirectedController::new(gait, &Hand::allegro(Side::Left));
//! controller.regrasp();
//! let targets = controller.command(&Proprioception::at(0.0, vec![0.2; 16]));
//! assert!(targets.iter().all(|angle| angle.is_finite()));
//! # Ok::<(), gait::UnknownGait>(())
//! ```

pub mod axis;
pub mod clock;
pub mod controller;
pub mod controller_file;
pub mod directed;
pub mod directive;
pub mod feedback;
pub mod gait;
mod place;
pub mod safe;
pub mod schedule;
pub mod shape;
pub mod stroke;

pub use {mvt_frames, mvt_objects, mvt_robot};
