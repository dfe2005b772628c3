//! Objects that a hand can turn.

use std::sync::Arc;

use glam::Vec3;
use mvt_frames::{Isometry, MeshFile, Object as ObjectFrame};
use mvt_mesh::{Mesh, SignedDistance};
use nalgebra as na;

/// Object that a hand can turn: shape, collision shape and mass.
#[derive(Debug, Clone)]
pub struct Object {
    /// Name in the catalogue, or the stem of the user's file name.
    pub name: String,
    /// True surface in the object's frame: origin at the centre of the bounding box, z up as the object stands on the
    /// palm, and the footprint aligned with x and y.
    pub mesh: Mesh,
    /// Exact signed distance of a procedural object, to the shape that `mesh` approximates or, if the mesh defines the
    /// object, to `mesh`. `None` for other objects; for those see [`crate::distance::MeshDistance`].
    pub exact: Option<Arc<dyn SignedDistance>>,
    /// Takes coordinates of the published mesh file, in metres, to the object's frame. Logs store the pose of the
    /// published mesh, so that they fit every copy of the file. Identity for procedural objects.
    pub object_from_file: Isometry<MeshFile, ObjectFrame>,
    /// Collision shape for MuJoCo: one or more convex pieces in the object's frame, each as a set of points whose hull
    /// it is.
    pub collision: Vec<Vec<Vec3>>,
    /// Mass, kg.
    pub mass_kg: f64,
}

impl Object {
    /// Returns the size along x, y and z in the object's frame, metres.
    pub fn extents_m(&self) -> [f64; 3] {
        self.mesh.extents_m().to_array().map(f64::from)
    }

    /// Returns the centre of mass (metres) and the inertia about it (kg m^2) of the solid inside the mesh, for a mass,
    /// in the object's frame. For a mesh without a volume, returns the values of its bounding box.
    pub fn solid_inertia(&self, mass_kg: f64) -> (na::Vector3<f64>, na::Matrix3<f64>) {
        // Sum over the tetrahedra between the origin and each face: volume, first and second moments (integral of x
        // x^T).
        let (mut volume, mut first, mut second) = (0.0, na::Vector3::zeros(), na::Matrix3::zeros());
        for face in &self.mesh.faces {
            let corners = face.map(|i| self.mesh.vertices.get(i as usize).copied().unwrap_or_default().as_dvec3());
            let [a, b, c] = corners.map(|v| na::Vector3::new(v.x, v.y, v.z));
            let tetrahedron = a.dot(&b.cross(&c)) / 6.0;
            let sum = a + b + c;
            volume += tetrahedron;
            first += sum * (tetrahedron / 4.0);
            let corners = a * a.transpose() + b * b.transpose() + c * c.transpose();
            second += (corners + sum * sum.transpose()) * (tetrahedron / 20.0);
        }
        let [x, y, z] = self.extents_m();
        if volume < 1e-3 * x * y * z {
            let of = |a: f64, b: f64| mass_kg / 12.0 * (a * a + b * b);
            return (na::Vector3::zeros(), na::Matrix3::from_diagonal(&na::Vector3::new(of(y, z), of(x, z), of(x, y))));
        }
        let centre = first / volume;
        let covariance = second / volume - centre * centre.transpose();
        (centre, (na::Matrix3::identity() * covariance.trace() - covariance) * mass_kg)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use mvt_frames::Isometry;

    #[test]
    fn inertia_of_a_box_is_the_textbook_one() {
        let corner = |i: u32| Vec3::new(0.02 * (i & 1) as f32, 0.04 * (i >> 1 & 1) as f32, 0.06 * (i >> 2) as f32);
        let quads = [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];
        let mesh = Mesh {
            vertices: (0..8).map(corner).collect(),
            faces: quads.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect(),
        };
        let object = Object {
            name: "box".into(),
            exact: None,
            mesh,
            object_from_file: Isometry::identity(),
            collision: vec![],
            mass_kg: 0.1,
        };
        let (centre, inertia) = object.solid_inertia(0.12);
        assert!((centre - na::Vector3::new(0.01, 0.02, 0.03)).norm() < 1e-7, "{centre}");
        let expected = na::Vector3::new(0.0052, 0.0040, 0.0020) * 0.01;
        assert!((inertia - na::Matrix3::from_diagonal(&expected)).norm() < 1e-9, "{inertia}");
    }
}
