//! Thins out meshes by collapsing edges in the order of the error that it makes (Garland and Heckbert 1997).

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use glam::{DMat3, DVec3};
use mvt_mesh::Mesh;

/// Weight of the length of an edge to the fourth power against the error that its collapse makes: keeps triangles alike
/// where the surface is flat.
const LENGTH_WEIGHT: f64 = 1e-3;
/// Least cosine between the normals of a face before and after a collapse.
const LEAST_COSINE: f64 = 0.3;

/// Returns the mesh with at most `most` vertices, if it is closed. Vertices that remain are at their places, and neither
/// holes nor handles come or go. Rims of an open mesh remain whole, so that more vertices may be left.
///
/// Every corner of a face must be a vertex.
pub fn thinned(mesh: &Mesh, most: usize) -> Mesh {
    // Why: notes/decisions/viewing.md, "Edges are collapsed in the shapes of a report".
    let mut thinning = Thinning::new(mesh);
    while thinning.count > most.max(4) {
        let Some(Reverse(edge)) = thinning.queue.pop() else { break };
        if thinning.stamps[edge.from] == edge.stamps[0] && thinning.stamps[edge.to] == edge.stamps[1] {
            thinning.collapse(edge.from, edge.to);
        }
    }
    thinning.mesh()
}

/// Sum of weighted squared distances from planes, as a function of a point.
#[derive(Debug, Clone, Copy, Default)]
struct Quadric {
    second: DMat3,
    first: DVec3,
    constant: f64,
}

impl Quadric {
    /// Of the plane of a triangle, weighted by its area.
    fn new([a, b, c]: [DVec3; 3]) -> Self {
        let cross = (b - a).cross(c - a);
        let (area, normal) = (0.5 * cross.length(), cross.normalize_or_zero());
        let offset = -normal.dot(a);
        Self {
            second: area * DMat3::from_cols(normal * normal.x, normal * normal.y, normal * normal.z),
            first: area * offset * normal,
            constant: area * offset * offset,
        }
    }

    fn plus(self, other: Self) -> Self {
        Self {
            second: self.second + other.second,
            first: self.first + other.first,
            constant: self.constant + other.constant,
        }
    }

    fn at(self, p: DVec3) -> f64 {
        (p.dot(self.second * p) + 2.0 * self.first.dot(p) + self.constant).max(0.0)
    }
}

/// Collapse of a vertex into its neighbour, by its cost. It is outdated if a stamp has changed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct Edge {
    /// Bits of a number that is not negative, which have its order.
    cost: u64,
    from: usize,
    to: usize,
    stamps: [u32; 2],
}

struct Thinning {
    places: Vec<DVec3>,
    quadrics: Vec<Quadric>,
    /// Number of changes around each vertex.
    stamps: Vec<u32>,
    faces: Vec<[usize; 3]>,
    /// Faces of each vertex; none of a vertex that has gone.
    faces_of: Vec<Vec<usize>>,
    /// Vertices with faces.
    count: usize,
    queue: BinaryHeap<Reverse<Edge>>,
}

impl Thinning {
    fn new(mesh: &Mesh) -> Self {
        let places: Vec<DVec3> = mesh.vertices.iter().map(|v| v.as_dvec3()).collect();
        let faces = mesh.faces.iter().map(|face| face.map(|corner| corner as usize));
        let faces: Vec<[usize; 3]> = faces.filter(|[a, b, c]| a != b && b != c && c != a).collect();
        let mut quadrics = vec![Quadric::default(); places.len()];
        let mut faces_of = vec![Vec::new(); places.len()];
        for (number, face) in faces.iter().enumerate() {
            let quadric = Quadric::new(face.map(|corner| places[corner]));
            for &corner in face {
                quadrics[corner] = quadrics[corner].plus(quadric);
                faces_of[corner].push(number);
            }
        }
        let count = faces_of.iter().filter(|faces| !faces.is_empty()).count();
        let stamps = vec![0; places.len()];
        let mut thinning = Self { places, quadrics, stamps, faces, faces_of, count, queue: BinaryHeap::new() };
        for vertex in 0..thinning.places.len() {
            thinning.offer(vertex);
        }
        thinning
    }

    /// Returns the neighbours of a vertex, each with the number of faces that they share.
    fn neighbours(&self, vertex: usize) -> Vec<(usize, usize)> {
        let mut neighbours: Vec<(usize, usize)> = Vec::with_capacity(12);
        for &corner in self.faces_of[vertex].iter().flat_map(|&face| &self.faces[face]) {
            match neighbours.iter_mut().find(|(known, _)| *known == corner) {
                _ if corner == vertex => {}
                Some((_, shared)) => *shared += 1,
                None => neighbours.push((corner, 1)),
            }
        }
        neighbours
    }

    /// Puts the collapses of a vertex into its neighbours into the queue.
    fn offer(&mut self, from: usize) {
        for (to, _) in self.neighbours(from) {
            let length = self.places[from].distance(self.places[to]);
            let error = self.quadrics[from].plus(self.quadrics[to]).at(self.places[to]);
            let cost = error + LENGTH_WEIGHT * length.powi(4);
            self.queue.push(Reverse(Edge {
                cost: cost.to_bits(),
                from,
                to,
                stamps: [from, to].map(|v| self.stamps[v]),
            }));
        }
    }

    /// Moves a vertex into its neighbour, unless that would change more than the shape of some faces.
    fn collapse(&mut self, from: usize, to: usize) {
        let around = self.neighbours(from);
        // A vertex on a rim stays, and the two vertices may have only the corners of their two faces in common.
        let beyond = self.neighbours(to);
        let is_inner = around.iter().all(|(_, shared)| *shared == 2);
        let is_common = |vertex: usize| beyond.iter().any(|(other, _)| *other == vertex);
        if !is_inner || around.iter().filter(|(vertex, _)| is_common(*vertex)).count() != 2 {
            return;
        }
        let (gone, kept): (Vec<usize>, Vec<usize>) =
            self.faces_of[from].iter().partition(|&&face| self.faces[face].contains(&to));
        let moved = |face: &[usize; 3]| face.map(|corner| if corner == from { to } else { corner });
        let normal = |face: [usize; 3]| {
            let [a, b, c] = face.map(|corner| self.places[corner]);
            (b - a).cross(c - a)
        };
        let is_turned = |&face: &usize| {
            let (before, after) = (normal(self.faces[face]), normal(moved(&self.faces[face])));
            before.dot(after) <= LEAST_COSINE * before.length() * after.length()
        };
        if kept.iter().any(is_turned) {
            return;
        }
        for &face in &gone {
            for corner in self.faces[face] {
                self.faces_of[corner].retain(|other| *other != face);
            }
        }
        for face in kept {
            self.faces[face] = moved(&self.faces[face]);
            self.faces_of[to].push(face);
        }
        self.faces_of[from].clear();
        self.quadrics[to] = self.quadrics[to].plus(self.quadrics[from]);
        self.count -= 1;
        self.stamps[from] += 1;
        // The neighbours have other faces now, and a refused collapse may be possible.
        for (vertex, _) in around {
            self.stamps[vertex] += 1;
        }
        let changed: Vec<usize> = self.neighbours(to).into_iter().map(|(vertex, _)| vertex).chain([to]).collect();
        for vertex in changed {
            self.stamps[vertex] += 1;
            self.offer(vertex);
        }
    }

    fn mesh(&self) -> Mesh {
        let mut number = vec![None; self.places.len()];
        let mut thin = Mesh::default();
        let is_left = |&(face, corners): &(usize, &[usize; 3])| self.faces_of[corners[0]].contains(&face);
        for (_, corners) in self.faces.iter().enumerate().filter(is_left) {
            thin.faces.push(corners.map(|corner| {
                *number[corner].get_or_insert_with(|| {
                    thin.vertices.push(self.places[corner].as_vec3());
                    thin.vertices.len() as u32 - 1
                })
            }));
        }
        thin
    }
}

#[cfg(test)]
pub mod tests {
    use std::f32::consts::{PI, TAU};

    use glam::Vec3;

    use super::*;

    /// Closed sphere of 30 mm around a point.
    pub fn sphere(rows: u32, middle: Vec3) -> Mesh {
        let columns = 2 * rows;
        let point = |row: u32, column: u32| {
            let (polar, around) = (PI * row as f32 / rows as f32, TAU * column as f32 / columns as f32);
            middle + 0.03 * Vec3::new(polar.sin() * around.cos(), polar.sin() * around.sin(), polar.cos())
        };
        let inner = (1..rows).flat_map(|row| (0..columns).map(move |column| point(row, column)));
        let vertices: Vec<Vec3> = inner.chain([point(0, 0), point(rows, 0)]).collect();
        let poles = [vertices.len() as u32 - 2, vertices.len() as u32 - 1];
        let at = |row: u32, column: u32| match row {
            0 => poles[0],
            row if row == rows => poles[1],
            row => (row - 1) * columns + column % columns,
        };
        let faces = (0..rows).flat_map(|row| {
            (0..columns).flat_map(move |k| {
                [[at(row, k), at(row + 1, k), at(row + 1, k + 1)], [at(row, k), at(row + 1, k + 1), at(row, k + 1)]]
            })
        });
        Mesh { vertices, faces: faces.filter(|[a, b, c]| a != b && b != c && c != a).collect() }
    }

    #[test]
    fn thin_spheres_remain_closed_spheres() {
        let full = sphere(60, Vec3::new(0.1, -0.02, 0.3));
        assert!(full.edges().watertight() && full.volume_m3() > 0.0);
        let thin = thinned(&full, 800);
        assert_eq!(thin.vertices.len(), 800);
        assert!(thin.edges().watertight());
        assert_eq!(thin.faces.len(), 2 * 800 - 4, "a sphere, by Euler's formula");
        assert!((thin.volume_m3() / full.volume_m3() - 1.0).abs() < 0.02);
        assert!(thin.vertices.iter().all(|v| full.vertices.contains(v)));
        assert_eq!(thinned(&full, 100_000), thinned(&full, 50_000));
    }

    #[test]
    fn a_thin_wall_is_not_torn() {
        // A hollow ball with a wall of 1 mm: the triangles of the thin one are several times as long.
        let outer = sphere(60, Vec3::ZERO);
        let count = outer.vertices.len() as u32;
        let mut hollow = outer.clone();
        hollow.vertices.extend(outer.vertices.iter().map(|v| *v * (29.0 / 30.0)));
        hollow.faces.extend(outer.faces.iter().map(|[a, b, c]| [a + count, c + count, b + count]));
        let thin = thinned(&hollow, 400);
        assert!(thin.edges().watertight() && thin.vertices.len() == 400);
        let share = thin.volume_m3() / hollow.volume_m3();
        assert!((0.6..1.4).contains(&share), "{share}");
    }

    #[test]
    fn rims_and_single_faces_remain() {
        let mut open = sphere(20, Vec3::ZERO);
        open.faces.retain(|face| face.iter().all(|&corner| open.vertices[corner as usize].z < 0.01));
        let rim = open.edges().open;
        let thin = thinned(&open, 10);
        assert_eq!(thin.edges().open, rim);
        let soup = Mesh { vertices: vec![Vec3::ZERO, Vec3::X, Vec3::Y], faces: vec![[0, 1, 2], [1, 1, 2]] };
        assert_eq!(thinned(&soup, 4).faces, [[0, 1, 2]]);
        assert_eq!(thinned(&Mesh::default(), 4), Mesh::default());
    }
}
