//! A box with rounded edges.

use nalgebra::Vector3;

use super::{ObjectFrame, Point, SignedDistance};
use crate::mesh::{self, Mesh};

/// A box with rounded edges, centred on the origin.
#[derive(Debug, Clone, Copy)]
pub(crate) struct RoundedBox {
    /// Half of its size, metres.
    half_m: Vector3<f64>,
    /// Radius of edges and corners, metres.
    radius_m: f64,
}

impl RoundedBox {
    pub(crate) fn new(half_m: Vector3<f64>, radius_m: f64) -> Self {
        Self { half_m, radius_m }
    }

    /// Half of the size of its flat faces, metres.
    pub(crate) fn flat_half_m(&self) -> Vector3<f64> {
        self.half_m.add_scalar(-self.radius_m)
    }

    /// Signed distance: that of the inner box, less the radius (Quilez).
    pub(crate) fn distance_m(&self, p: Vector3<f64>) -> f64 {
        let q = p.abs() - self.flat_half_m();
        q.sup(&Vector3::zeros()).norm() + q.max().min(0.0) - self.radius_m
    }

    /// A closed mesh: each flat face in `flat` x `flat` squares, each quarter round in `2 * round` steps.
    pub(crate) fn mesh(&self, flat: usize, round: usize) -> Mesh {
        let lines = grid_lines(flat, round);
        sides(&lines, |inner, outward| self.point(inner, outward))
    }

    /// The surface point over a place on the inner box (-1 to 1 along each axis) in a direction.
    pub(crate) fn point(&self, inner: Vector3<f64>, outward: Vector3<f64>) -> Vector3<f64> {
        inner.component_mul(&self.flat_half_m()) + self.radius_m * outward.normalize()
    }
}

/// A grid line of a side: where on the inner box it lies (-1 to 1), and how far it leans over the edge (tangent, -1 to 1).
pub(crate) type Line = (f64, f64);

/// Lines for a side: `round` steps up each rounding to 45 degrees, `flat` steps in between.
pub(crate) fn grid_lines(flat: usize, round: usize) -> Vec<Line> {
    let lean = |step: usize| (std::f64::consts::FRAC_PI_4 * step as f64 / round as f64).tan();
    let below = (1..=round).rev().map(|step| (-1.0, -lean(step)));
    let across = (0..=flat).map(|step| (2.0 * step as f64 / flat as f64 - 1.0, 0.0));
    let above = (1..=round).map(|step| (1.0, lean(step)));
    below.chain(across).chain(above).collect()
}

/// The six sides as grids over `lines`, welded where they meet. `place` gives the surface point for a place on the inner box
/// (-1 to 1 along each axis) and an outward direction.
pub(crate) fn sides(lines: &[Line], place: impl Fn(Vector3<f64>, Vector3<f64>) -> Vector3<f64>) -> Mesh {
    let mut points = Vec::new();
    let mut faces = Vec::new();
    let n = lines.len();
    for (axis, sign) in (0..3).flat_map(|axis| [(axis, 1.0), (axis, -1.0)]) {
        let first = points.len() as u32;
        // Swapping the in-plane axes of the negative sides keeps the faces outward.
        let (u, v) = if sign > 0.0 { ((axis + 1) % 3, (axis + 2) % 3) } else { ((axis + 2) % 3, (axis + 1) % 3) };
        for &(at_v, lean_v) in lines {
            for &(at_u, lean_u) in lines {
                let (mut inner, mut outward) = (Vector3::zeros(), Vector3::zeros());
                (inner[axis], outward[axis]) = (sign, sign);
                (inner[u], outward[u]) = (at_u, lean_u);
                (inner[v], outward[v]) = (at_v, lean_v);
                points.push(place(inner, outward));
            }
        }
        for row in 0..n - 1 {
            for column in 0..n - 1 {
                let at = |r: usize, c: usize| first + (r * n + c) as u32;
                let (a, b, c, d) = (at(row, column), at(row, column + 1), at(row + 1, column + 1), at(row + 1, column));
                faces.extend([[a, b, c], [a, c, d]]);
            }
        }
    }
    mesh::weld(&points, &faces)
}

impl SignedDistance for RoundedBox {
    fn distance_m(&self, p: Point<ObjectFrame>) -> f64 {
        self.distance_m(p.coords())
    }
}
