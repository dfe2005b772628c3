//! Mesh of a procedural object, with its exact distance.

use std::sync::Arc;

use mvt_mesh::{Mesh, SignedDistance};

use crate::distance::MeshDistance;

/// Closed outward mesh with its bounding box centred on the origin, and the exact distance to the surface that it
/// approximates.
pub(crate) struct Shape {
    pub(crate) mesh: Mesh,
    pub(crate) exact: Option<Arc<dyn SignedDistance>>,
}

impl Shape {
    pub(super) fn new(mesh: Mesh, exact: impl SignedDistance + 'static) -> Self {
        Self { mesh, exact: Some(Arc::new(exact)) }
    }

    /// Makes a shape that is defined by its mesh.
    pub(super) fn polyhedron(mesh: Mesh) -> Self {
        let exact = MeshDistance::new(&mesh).map(|exact| Arc::new(exact) as Arc<dyn SignedDistance>);
        Self { mesh, exact }
    }
}
