//! An object that the hand can turn.

use std::fmt;
use std::sync::Arc;

use glam::Vec3;

use crate::frame::{Isometry, MeshFile, Object as ObjectFrame, Point};
use crate::mesh::Mesh;

/// A shape that knows how far any point is from its surface.
pub trait SignedDistance: fmt::Debug + Send + Sync {
    /// Euclidean distance to the surface, metres, negative inside.
    fn distance_m(&self, p: Point<ObjectFrame>) -> f64;
}

/// An object that the hand can turn: shape, collision shape and mass.
#[derive(Debug, Clone)]
pub struct Object {
    /// Name in the catalogue, or the file stem of a user's mesh.
    pub name: String,
    /// True surface in the object's frame: origin at the centre of the bounding box, turned so that z is up as the object
    /// stands on the palm and its footprint is aligned with x and y.
    pub mesh: Mesh,
    /// Exact signed distance to the true shape, which procedural objects have: the shape that `mesh` approximates, or `mesh` itself
    /// where the object is defined by it. For any other object see [`crate::mesh::MeshDistance`].
    pub exact: Option<Arc<dyn SignedDistance>>,
    /// Takes coordinates of the mesh file as it was published, in metres, to the object's frame. FeelSight logs store object poses
    /// of the published mesh, so that they fit other people's copies of it. Identity for procedural objects.
    pub object_from_file: Isometry<MeshFile, ObjectFrame>,
    /// What MuJoCo collides with: one or more convex pieces in the object's frame, each as a set of points whose hull it is.
    pub collision: Vec<Vec<Vec3>>,
    /// Mass, kg.
    pub mass_kg: f64,
}

impl Object {
    /// Size along x, y and z in the object's frame, metres.
    pub fn extents_m(&self) -> [f64; 3] {
        self.mesh.extents_m().to_array().map(f64::from)
    }
}
