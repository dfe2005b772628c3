//! Points inside bodies that the object cannot occupy.

use glam::Vec3;

/// A point inside a body.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Occupied {
    /// Where it is, metres.
    pub point: Vec3,
    /// No point outside the body is nearer than this, metres.
    pub depth_m: f32,
}
