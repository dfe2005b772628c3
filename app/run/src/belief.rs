//! The part of an estimate that supervisor and explorer may use. It holds neither the simulator's state nor ground truth.

use mvt_frames::{Isometry, Model, World};
use nalgebra::Vector3;

/// Estimate of the object at one instant.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Belief {
    /// Seconds since the start of the episode.
    pub time_s: f64,
    /// Estimated pose.
    pub pose: Isometry<Model, World>,
    /// Estimated middle of the object, x and y in the world, metres.
    pub centre_m: [f64; 2],
    /// Angles turned so far about x, y and z of the world, radians.
    pub turned_rad: Vector3<f64>,
    /// Confidence in the pose, 0 to 1.
    pub confidence: f64,
    /// Stated deviation of the pose, one standard deviation of the surface, metres; infinite while it is lost.
    pub deviation_m: f64,
    /// The tracker has declared itself lost.
    pub lost: bool,
    /// Part of the directions around the object in which its surface has not been observed, 0 to 1.
    pub unobserved: f64,
}
