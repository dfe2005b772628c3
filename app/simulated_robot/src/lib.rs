//! A simulated robot on the topics of ROS 2: who has no robot starts one beside `run --ros`.
//!
//! [`SimulatedRobot`] steps an episode, renders its sensors and publishes their messages on the topics that a file of mvt-ros names, with the
//! types of a real robot. The joints aim at what arrives on the command topic. Until the first command, hand and object rest. This crate links
//! libmujoco.
//!
//! ```no_run
//! use std::path::Path;
//! use std::sync::atomic::AtomicBool;
//!
//! use mvt_robot::hand::Hand;
//! use mvt_robot::rig::Placement;
//! use mvt_ros::RosSetup;
//! use mvt_simulated::recorder::NoiseLevel;
//! use mvt_simulated_robot::{RobotSettings, SimulatedRobot};
//! # use mvt_simulated_robot::{mvt_objects, mvt_robot, mvt_ros, mvt_simulated};
//!
//! let setup = RosSetup::read(Path::new("rig.toml"))?;
//! let object = mvt_objects::catalogue::load("cube70", &mut Vec::new())?;
//! let hand = Hand::allegro(setup.side.unwrap_or(mvt_robot::hand::Side::Right));
//! let (_, gait) = mvt_simulated_robot::mvt_gaits::gait::choose("auto", &object, &hand)?;
//! let settings = RobotSettings {
//!     camera: Placement::parse_list("side")?[0].camera(&hand),
//!     gait: gait.clone(),
//!     mover: None,
//!     hand,
//!     seed: 0,
//!     duration_s: 30.0,
//!     noise: NoiseLevel::Full.into(),
//!     speed: 1.0,
//! };
//! let outcome = SimulatedRobot::new(&object, &settings, &setup)?.run(&AtomicBool::new(false))?;
//! println!("{} commands obeyed", outcome.commands);
//! # Ok::<(), anyhow::Error>(())
//! ```

// Its build script puts libmujoco on the link line.
use mvt_mujoco_lib as _;

mod broadcast;
pub mod command;
mod pace;
mod robot;

pub use robot::{RobotOutcome, RobotSettings, SimulatedRobot};
pub use {mvt_frames, mvt_gaits, mvt_objects, mvt_physics, mvt_robot, mvt_ros, mvt_simulated};
