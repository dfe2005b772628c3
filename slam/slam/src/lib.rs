//! Geometry to pose and shape.
//!
//! Receives metric depth and the poses of the sensors that measured it ([`mvt_robot::observation::DepthFrame`]), and estimates the pose of
//! the object and its shape. Nothing here knows of MuJoCo or of networks, and nothing here receives ground truth but
//! [`metrics`].

mod config;
pub mod graph;
pub mod map;

pub mod scan;

mod slam;
pub mod space;
pub mod tracker;

pub use config::{SlamConfig, TrustConfig};
pub use mvt_settings::SettingError;
pub use slam::{Estimate, Slam, Spent, State};

#[cfg(test)]
#[path = "../tests/synthetic/mod.rs"]
mod synthetic;
