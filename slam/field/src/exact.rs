//! A known shape: exact distances on a grid, so that thousands of points can be asked for every frame.

use glam::Vec3;
use mvt_frames::Point;
use mvt_mesh::SignedDistance;
use rayon::prelude::*;

use crate::shape::{Distance, Shape};

/// Spacing of the grid, metres: a tenth of a millimetre of error at the sharpest edges.
const CELL_M: f32 = 0.001;
/// How far the grid reaches beyond the shape's bounds, metres. Farther points are given the distance to the grid on top.
const MARGIN_M: f32 = 0.015;
/// Cells along a block's edge. Blocks far from the surface are interpolated from their corners: there, distance is smooth.
const BLOCK: usize = 5;

// Why: notes/decisions/estimation.md, "A given shape is a grid of exact distances, with the gradient of the interpolation".
/// Distances to a shape, exact at the nodes of a grid and trilinear between them.
///
/// The gradient is that of the interpolated function, not the shape's normal: only so does it belong to the values.
pub struct KnownShape {
    lowest: Vec3,
    /// Spacing of the nodes, metres.
    cell_m: f32,
    nodes: [usize; 3],
    values: Vec<f32>,
}

impl KnownShape {
    /// Samples `shape` over its `bounds` (lowest and highest corner, metres).
    pub fn new(shape: &dyn SignedDistance, bounds: [Vec3; 2]) -> Self {
        let lowest = bounds[0] - MARGIN_M;
        let blocks = ((bounds[1] + MARGIN_M - lowest) / (CELL_M * BLOCK as f32)).ceil().max(Vec3::ONE);
        let blocks = blocks.to_array().map(|n| n as usize);
        let nodes = blocks.map(|n| n * BLOCK + 1);
        let position = |i: [usize; 3]| lowest + CELL_M * Vec3::from_array(i.map(|k| k as f32));
        let exact = |i: [usize; 3]| {
            let p = position(i).as_dvec3();
            shape.distance_m(Point::new(p.x, p.y, p.z)) as f32
        };
        let corners = blocks.map(|n| n + 1);
        let coarse: Vec<f32> = (0..corners.iter().product())
            .into_par_iter()
            .map(|i| exact(unflatten(i, corners).map(|k| k * BLOCK)))
            .collect();
        // A distance changes by at most the distance walked, so a block whose corner is farther than this from the surface
        // does not hold it. Twice that keeps interpolated blocks where the gradient is smooth.
        let far = 2.0 * CELL_M * BLOCK as f32 * 3f32.sqrt();
        let value = |i: [usize; 3]| {
            let block: [usize; 3] = std::array::from_fn(|axis| (i[axis] / BLOCK).min(blocks[axis] - 1));
            let corner = |c: usize| {
                let at = std::array::from_fn(|axis| block[axis] + (c >> axis & 1));
                coarse[flatten(at, corners)]
            };
            if (0..8).any(|c| corner(c).abs() < far) {
                return exact(i);
            }
            let part: [f32; 3] = std::array::from_fn(|axis| (i[axis] - block[axis] * BLOCK) as f32 / BLOCK as f32);
            (0..8)
                .map(|c| {
                    let weight = |axis: usize| if c >> axis & 1 == 1 { part[axis] } else { 1.0 - part[axis] };
                    weight(0) * weight(1) * weight(2) * corner(c)
                })
                .sum()
        };
        let values = (0..nodes.iter().product()).into_par_iter().map(|i| value(unflatten(i, nodes))).collect();
        Self { lowest, cell_m: CELL_M, nodes, values }
    }

    /// Distances (metres) that are given at the nodes of a grid, at least two along each axis, by their indices along x, y and z.
    /// The first node lies at `lowest`, the others `cell_m` apart.
    pub fn of_nodes(lowest: Vec3, cell_m: f32, nodes: [usize; 3], value: impl Fn([usize; 3]) -> f32) -> Self {
        // Values that are given are only copied, for which one need not wait for threads that are busy.
        let values = (0..nodes.iter().product()).map(|i| value(unflatten(i, nodes))).collect();
        Self { lowest, cell_m, nodes, values }
    }

    fn distance(&self, point: Vec3) -> Distance {
        let highest = Vec3::from_array(self.nodes.map(|n| (n - 1) as f32));
        let grid = (point - self.lowest) / self.cell_m;
        // Just inside the last cell, so that its upper corner exists.
        let inside = grid.clamp(Vec3::ZERO, highest - 1e-3);
        let cell = inside.floor();
        let part = inside - cell;
        let first = flatten(cell.to_array().map(|x| x as usize), self.nodes);
        let (dy, dz) = (self.nodes[0], self.nodes[0] * self.nodes[1]);
        let edge = |offset: usize| {
            let (a, b) = (self.values[first + offset], self.values[first + offset + 1]);
            (a + part.x * (b - a), b - a)
        };
        let (v00, g00) = edge(0);
        let (v10, g10) = edge(dy);
        let (v01, g01) = edge(dz);
        let (v11, g11) = edge(dy + dz);
        let mix = |t: f32, a: f32, b: f32| a + t * (b - a);
        let (low, high) = (mix(part.y, v00, v10), mix(part.y, v01, v11));
        let gradient = Vec3::new(
            mix(part.z, mix(part.y, g00, g10), mix(part.y, g01, g11)),
            mix(part.z, v10 - v00, v11 - v01),
            high - low,
        ) / self.cell_m;
        let outside = (grid - inside) * self.cell_m;
        let beyond = outside.length();
        // Half a cell: points within the clamp's rounding still count as inside.
        if beyond < 0.5 * self.cell_m {
            return Distance { value_m: mix(part.z, low, high), gradient };
        }
        Distance { value_m: mix(part.z, low, high) + beyond, gradient: outside / beyond }
    }
}

impl Shape for KnownShape {
    fn distances(&self, points: &[Vec3], out: &mut [f32]) {
        for (point, out) in points.iter().zip(out) {
            *out = self.distance(*point).value_m;
        }
    }

    fn distances_and_gradients(&self, points: &[Vec3], out: &mut [Distance]) {
        for (point, out) in points.iter().zip(out) {
            *out = self.distance(*point);
        }
    }
}

fn unflatten(i: usize, n: [usize; 3]) -> [usize; 3] {
    [i % n[0], i / n[0] % n[1], i / (n[0] * n[1])]
}

fn flatten(i: [usize; 3], n: [usize; 3]) -> usize {
    i[0] + n[0] * (i[1] + n[1] * i[2])
}

#[cfg(test)]
mod tests {
    use super::*;
    use mvt_frames::Object;

    #[derive(Debug)]
    struct Ball(f64);
    impl SignedDistance for Ball {
        fn distance_m(&self, p: Point<Object>) -> f64 {
            p.coords().norm() - self.0
        }
    }

    fn directions() -> impl Iterator<Item = Vec3> {
        (0..500).map(|i| {
            let z = 1.0 - (2 * i + 1) as f32 / 500.0;
            let (sin, cos) = (2.399_963 * i as f32).sin_cos();
            Vec3::new((1.0 - z * z).sqrt() * cos, (1.0 - z * z).sqrt() * sin, z)
        })
    }

    #[test]
    fn ball_near_and_far() {
        let shape = KnownShape::new(&Ball(0.03), [Vec3::splat(-0.03), Vec3::splat(0.03)]);
        for direction in directions() {
            for (radius, tolerance) in [(0.016, 2e-4), (0.028, 1e-4), (0.03, 1e-4), (0.035, 1e-4), (0.04, 4e-4)] {
                let d = shape.distance(direction * radius);
                assert!((d.value_m - (radius - 0.03)).abs() < tolerance, "{radius}: {d:?}");
                assert!((d.gradient - direction).length() < 0.1, "{radius} {direction}: {d:?}");
            }
            // Beyond the grid the value is an upper bound that grows outwards.
            let far = shape.distance(direction * 0.2);
            assert!(far.value_m > 0.15 && far.value_m < 0.2 && far.gradient.dot(direction) > 0.7, "{far:?}");
        }
    }

    #[test]
    fn gradient_is_that_of_the_values() {
        let shape = KnownShape::new(&Ball(0.03), [Vec3::splat(-0.03), Vec3::splat(0.03)]);
        let mut compared = 0;
        for direction in directions() {
            let p = direction * 0.0312;
            let d = shape.distance(p);
            let grid = (p - shape.lowest) / CELL_M;
            for axis in [Vec3::X, Vec3::Y, Vec3::Z] {
                let h = 1e-5;
                // Within one cell only: the gradient jumps at its faces.
                if ((grid + axis * h / CELL_M).floor() != grid.floor())
                    || ((grid - axis * h / CELL_M).floor() != grid.floor())
                {
                    continue;
                }
                let slope = (shape.distance(p + axis * h).value_m - shape.distance(p - axis * h).value_m) / (2.0 * h);
                assert!((slope - d.gradient.dot(axis)).abs() < 5e-3, "{slope} {d:?}");
                compared += 1;
            }
        }
        assert!(compared > 1000);
    }
}
