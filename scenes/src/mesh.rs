//! Triangle meshes.

use glam::Vec3;

/// A triangle mesh: vertices in metres in the object's frame, faces counter-clockwise seen from outside.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Mesh {
    /// Positions, metres.
    pub vertices: Vec<Vec3>,
    /// Indices into `vertices`.
    pub faces: Vec<[u32; 3]>,
}
