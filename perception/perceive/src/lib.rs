//! One step from the raw observation of a robot to the measurements that its estimator receives.
//!
//! [`Perception`] keeps everything that this step must remember of the frames before: calibration, untouched images, contact, and the
//! warnings it has given. Every source of frames goes through it, so that a log, a simulated episode, an environment of a policy and a
//! Python program give the same estimates from the same images.
//!
//! ```
//! use mvt_perceive::{Perception, PerceptionConfig, PerceptionSetup};
//! use mvt_robot::hand::{Hand, PerPad, Side};
//! use mvt_robot::observation::{Observation, Rgbd};
//! use mvt_robot::rig::PLACEMENTS;
//! use ndarray::Array2;
//!
//! // A left hand, one camera, and touch sensors that measure indentation themselves: there are no weights of a network.
//! let hand = Hand::allegro(Side::Left);
//! let camera = PLACEMENTS[2].camera(&hand);
//! let mut config = PerceptionConfig::default();
//! // The image shows no hand, from which the camera's pose could be refined.
//! config.calibration.refine = false;
//! let setup = PerceptionSetup { weights: None, config };
//! let mut perception = Perception::new(hand, vec![camera], &setup);
//! let observation = Observation {
//!     time_s: 0.0,
//!     joints: vec![0.1; 16],
//!     // No touch sensor delivered anything.
//!     touch: PerPad::default(),
//!     cameras: vec![Rgbd { color: Default::default(), depth_m: Array2::from_elem((480, 640), 0.3), labels: None, world_from_camera: None }],
//! };
//! let seen = perception.see(0, observation, None)?;
//! assert_eq!(seen.percept.cameras[0].as_ref().map(|camera| camera.labels.dim()), Some((480, 640)));
//! # Ok::<(), mvt_perceive::PerceptionError>(())
//! ```

mod error;
mod percept;
mod perception;
mod sensors;

pub use error::PerceptionError;
pub use mvt_segmentation::LabelSource;
pub use perception::{Perception, PerceptionConfig, PerceptionSetup, Seen};
pub use sensors::true_press;
pub use {image, mvt_robot, ndarray};
