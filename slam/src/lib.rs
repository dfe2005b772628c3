//! Geometry to pose and shape.
//!
//! Receives metric depth and the poses of the sensors that measured it ([`scenes::depth::DepthFrame`]), and estimates the pose of
//! the object and its shape. Nothing here knows of MuJoCo or of networks, and nothing here receives ground truth but
//! [`metrics`].

mod config;
pub mod exact;
pub mod field;
pub mod graph;
pub mod map;
pub mod metrics;
pub mod scan;
pub mod se3;
pub mod shape;
mod slam;
pub mod space;
pub mod surface;
mod tensors;
pub mod tracker;

pub use config::{Config, ConfigError, Trust};
pub use slam::{Estimate, Slam, Spent, State};
pub use tensors::FileError;

#[cfg(test)]
#[path = "../tests/synthetic/mod.rs"]
mod synthetic;
