//! Exact signed distance to a triangle mesh.

use std::fmt;

use mvt_frames::{Object, Point};
use mvt_mesh::{Mesh, SignedDistance};
use parry3d::math::Vector;
use parry3d::query::PointQuery as _;
use parry3d::shape::{TriMesh, TriMeshFlags};

/// Exact signed distance to a closed outward triangle mesh: the distance to the closest point on any face, with the
/// sign from the angle-weighted normal at that point (Baerentzen and Aanaes 2005). Computed in `f32`, which is exact to
/// about a tenth of a micrometre for objects that a hand can hold.
pub struct MeshDistance(TriMesh);

impl MeshDistance {
    /// Prepares the distance to a repaired mesh (see [`mvt_mesh::repair()`]). `None` for a mesh without faces.
    pub fn new(mesh: &Mesh) -> Option<Self> {
        let vertices = mesh.vertices.iter().map(|v| Vector::from_array(v.to_array())).collect();
        TriMesh::with_flags(vertices, mesh.faces.clone(), TriMeshFlags::ORIENTED).ok().map(Self)
    }
}

impl SignedDistance for MeshDistance {
    fn distance_m(&self, p: Point<Object>) -> f64 {
        let query = Vector::from_array(p.coords().map(|x| x as f32).into());
        let closest = self.0.project_local_point(query, false);
        let distance =
            (0..3).map(|i| (p.coords()[i] - f64::from(closest.point.to_array()[i])).powi(2)).sum::<f64>().sqrt();
        if closest.is_inside { -distance } else { distance }
    }
}

impl fmt::Debug for MeshDistance {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "MeshDistance({} faces)", self.0.indices().len())
    }
}
