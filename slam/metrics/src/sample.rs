//! Points on the surface of a mesh.

use std::collections::HashMap;

use glam::{IVec3, Vec3};
use mvt_mesh::Mesh;
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

/// Draws `n` points uniformly by area, metres, in the mesh's frame. Faces without a finite positive area are left out; without any other
/// face there are no points. The same seed yields the same points.
pub fn sample_surface(mesh: &Mesh, n: usize, seed: u64) -> Vec<Vec3> {
    match Sampler::new(mesh, seed) {
        Some(mut sampler) => (0..n).map(|_| sampler.draw()).collect(),
        None => Vec::new(),
    }
}

/// Draws `n` points by area of which no two are closer than sqrt(area / 3n) (Poisson discs by dart throwing), as trimesh's
/// `sample_surface_even` does, with which NeuralFeels samples the true surface. About 2.2n of at most 3n darts are needed; where a surface
/// lies so close to itself that 3n do not suffice, the rest is drawn as by [`sample_surface`].
pub fn sample_surface_even(mesh: &Mesh, n: usize, seed: u64) -> Vec<Vec3> {
    let Some(mut sampler) = Sampler::new(mesh, seed) else { return Vec::new() };
    let radius_m = (sampler.area_m2() / (3 * n) as f64).sqrt() as f32;
    let mut points = Vec::with_capacity(n);
    // Cells twice as wide as the distance: a point that is too close lies in one of the eight nearest.
    let side_m = 2.0 * radius_m;
    let mut cells = HashMap::<IVec3, Vec<Vec3>>::new();
    for _ in 0..3 * n {
        if points.len() == n {
            break;
        }
        let p = sampler.draw();
        let first = (p / side_m - 0.5).floor().as_ivec3();
        let crowded = (0..8).any(|k| {
            let near = first + IVec3::new(k & 1, k >> 1 & 1, k >> 2);
            cells.get(&near).is_some_and(|others| others.iter().any(|q| q.distance(p) < radius_m))
        });
        if !crowded {
            cells.entry((p / side_m).floor().as_ivec3()).or_default().push(p);
            points.push(p);
        }
    }
    points.resize_with(n, || sampler.draw());
    points
}

/// Source of points of a mesh, uniform by area.
struct Sampler {
    corners: Vec<[Vec3; 3]>,
    /// Sum of the areas up to and including each face, m^2.
    area_up_to_m2: Vec<f64>,
    rng: ChaCha8Rng,
}

impl Sampler {
    fn new(mesh: &Mesh, seed: u64) -> Option<Self> {
        let (mut corners, mut area_up_to_m2, mut total) = (Vec::new(), Vec::new(), 0.0);
        for face in &mesh.faces {
            let [Some(&a), Some(&b), Some(&c)] = face.map(|v| mesh.vertices.get(v as usize)) else { continue };
            let area_m2 = 0.5 * (b - a).as_dvec3().cross((c - a).as_dvec3()).length();
            if area_m2.is_finite() && area_m2 > 0.0 {
                total += area_m2;
                corners.push([a, b, c]);
                area_up_to_m2.push(total);
            }
        }
        (!corners.is_empty()).then(|| Self { corners, area_up_to_m2, rng: ChaCha8Rng::seed_from_u64(seed) })
    }

    fn area_m2(&self) -> f64 {
        self.area_up_to_m2.last().copied().unwrap_or(0.0)
    }

    fn draw(&mut self) -> Vec3 {
        let [area, u, v]: [f64; 3] = std::array::from_fn(|_| self.rng.random());
        let area = area * self.area_m2();
        let face = self.area_up_to_m2.partition_point(|&up_to| up_to <= area).min(self.corners.len() - 1);
        let [a, b, c] = self.corners[face];
        // Beyond the diagonal of the parallelogram: turned back into the triangle.
        let (u, v) = if u + v > 1.0 { (1.0 - u, 1.0 - v) } else { (u, v) };
        a + (b - a) * u as f32 + (c - a) * v as f32
    }
}
