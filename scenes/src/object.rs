//! An object that the hand can turn.

use glam::Vec3;

use crate::frame::{Isometry, MeshFile, Object as ObjectFrame};
use crate::mesh::Mesh;

/// An object that the hand can turn: shape, collision shape and mass.
#[derive(Debug, Clone)]
pub struct Object {
    /// Name in the catalogue, or the file stem of a user's mesh.
    pub name: String,
    /// True surface in the object's frame: origin at the centre of the bounding box, turned so that z is up as the object
    /// stands on the palm and its footprint is aligned with x and y.
    pub mesh: Mesh,
    /// Takes coordinates of the mesh file as it was published to the object's frame. FeelSight logs store object poses of the
    /// published mesh, so that they fit other people's copies of it. Identity for procedural objects.
    pub object_from_file: Isometry<MeshFile, ObjectFrame>,
    /// What MuJoCo collides with: one or more convex pieces in the object's frame, each as a set of points whose hull it is.
    pub collision: Vec<Vec<Vec3>>,
    /// Mass, kg.
    pub mass_kg: f64,
}

impl Object {
    /// Size along x, y and z in the object's frame, metres.
    pub fn extents_m(&self) -> [f64; 3] {
        let zero = (Vec3::splat(f32::INFINITY), Vec3::splat(f32::NEG_INFINITY));
        let (low, high) = self.mesh.vertices.iter().fold(zero, |(low, high), &v| (low.min(v), high.max(v)));
        (high - low).to_array().map(|extent| f64::from(extent.max(0.0)))
    }
}
