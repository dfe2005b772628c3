//! Triangle meshes, and signed distances.

use std::fmt;

use glam::Vec3;
use mvt_frames::{Object, Point};

/// Shape with a signed distance at every point.
pub trait SignedDistance: fmt::Debug + Send + Sync {
    /// Returns the Euclidean distance to the surface, metres, negative inside.
    fn distance_m(&self, p: Point<Object>) -> f64;
}

/// Triangle mesh: vertices in metres in the object's frame, faces counter-clockwise seen from outside.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Mesh {
    /// Positions, metres.
    pub vertices: Vec<Vec3>,
    /// Indices into `vertices`.
    pub faces: Vec<[u32; 3]>,
}

impl Mesh {
    /// Returns the corners of every face, in the order of `faces`.
    ///
    /// # Panics
    /// If a face names a vertex that does not exist. No mesh from [`repair`](crate::repair()) has such a face.
    pub fn triangles(&self) -> impl ExactSizeIterator<Item = [Vec3; 3]> {
        self.faces.iter().map(|face| face.map(|v| self.vertices[v as usize]))
    }

    /// Returns the area of the surface, m^2.
    pub fn area_m2(&self) -> f64 {
        self.triangles().map(triangle_area_m2).sum()
    }

    /// Returns the signed volume by the divergence theorem, m^3: positive if the faces of a closed mesh look outward.
    /// For an open mesh it is the volume of the cone over the mesh from the centre of its bounding box.
    pub fn volume_m3(&self) -> f64 {
        let [low, high] = self.bounds_m();
        let centre = (low.as_dvec3() + high.as_dvec3()) * 0.5;
        let six_fold = |corners: [Vec3; 3]| {
            let [a, b, c] = corners.map(|corner| corner.as_dvec3() - centre);
            a.dot(b.cross(c))
        };
        self.triangles().map(six_fold).sum::<f64>() / 6.0
    }

    /// Returns the lowest and highest corner of the bounding box, metres; both are zero for a mesh without vertices.
    pub fn bounds_m(&self) -> [Vec3; 2] {
        let Some(&first) = self.vertices.first() else { return [Vec3::ZERO; 2] };
        self.vertices.iter().fold([first; 2], |[low, high], &v| [low.min(v), high.max(v)])
    }

    /// Returns the size along x, y and z, metres.
    pub fn extents_m(&self) -> Vec3 {
        let [low, high] = self.bounds_m();
        high - low
    }

    /// Returns the faces of which all corners are kept, with the vertices that they need.
    pub fn part(&self, keeps: impl Fn(Vec3) -> bool) -> Self {
        let kept: Vec<bool> = self.vertices.iter().map(|vertex| keeps(*vertex)).collect();
        let is_kept = |face: &&[u32; 3]| face.iter().all(|&corner| kept.get(corner as usize) == Some(&true));
        let mut places = vec![None; self.vertices.len()];
        let mut part = Self { vertices: Vec::new(), faces: Vec::new() };
        for face in self.faces.iter().filter(is_kept) {
            part.faces.push(face.map(|corner| {
                *places[corner as usize].get_or_insert_with(|| {
                    part.vertices.push(self.vertices[corner as usize]);
                    part.vertices.len() as u32 - 1
                })
            }));
        }
        part
    }

    /// Counts the edges that two faces do not share.
    pub fn edges(&self) -> EdgeCount {
        let mut edges: Vec<[u32; 2]> = self
            .faces
            .iter()
            .flat_map(|&[a, b, c]| [[a, b], [b, c], [c, a]])
            .map(|[a, b]| [a.min(b), a.max(b)])
            .collect();
        edges.sort_unstable();
        edges.chunk_by(|a, b| a == b).fold(EdgeCount::default(), |mut count, same| {
            match same.len() {
                1 => count.open += 1,
                2 => {}
                _ => count.crowded += 1,
            }
            count
        })
    }
}

/// Numbers of edges that one face has alone, or that more than two faces share.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct EdgeCount {
    /// Edges of one face: the rim of a hole.
    pub open: usize,
    /// Edges of three or more faces.
    pub crowded: usize,
}

impl EdgeCount {
    /// Returns whether the mesh encloses a volume: every edge belongs to exactly two faces.
    pub fn watertight(self) -> bool {
        self == Self::default()
    }
}

/// Makes a mesh of points that were computed face by face: points within a tenth of a micrometre become one vertex.
pub fn weld(points: &[nalgebra::Vector3<f64>], faces: &[[u32; 3]]) -> Mesh {
    let grid = |metres: f64| (metres * 1e7).round() as i64;
    let mut known = std::collections::HashMap::new();
    let mut vertices = Vec::new();
    let mut index = Vec::with_capacity(points.len());
    for p in points {
        index.push(*known.entry([grid(p.x), grid(p.y), grid(p.z)]).or_insert_with(|| {
            vertices.push(Vec3::new(p.x as f32, p.y as f32, p.z as f32));
            vertices.len() as u32 - 1
        }));
    }
    let faces = faces.iter().map(|face| face.map(|v| index[v as usize]));
    Mesh { vertices, faces: faces.filter(|[a, b, c]| a != b && b != c && c != a).collect() }
}

/// Returns the area of a triangle, m^2.
pub fn triangle_area_m2(corners: [Vec3; 3]) -> f64 {
    let [a, b, c] = corners.map(Vec3::as_dvec3);
    0.5 * (b - a).cross(c - a).length()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn area_volume_and_edges_of_a_tetrahedron() {
        let corner = Mesh {
            vertices: vec![Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::Z],
            faces: vec![[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]],
        };
        assert!((corner.volume_m3() - 1.0 / 6.0).abs() < 1e-12);
        assert!((corner.area_m2() - (1.5 + 0.75_f64.sqrt())).abs() < 1e-7);
        assert!(corner.edges().watertight());
        // Without the corner at z the base alone is left.
        let base = corner.part(|corner| corner.z < 0.5);
        assert_eq!((base.vertices.len(), base.faces.len(), base.area_m2()), (3, 1, 0.5));
        let open = Mesh { faces: corner.faces[..3].to_vec(), ..corner };
        assert_eq!(open.edges(), EdgeCount { open: 3, crowded: 0 });
    }
}
