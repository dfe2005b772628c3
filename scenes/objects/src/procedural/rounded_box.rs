//! Boxes with rounded edges, plain or with the grooves of a Rubik's cube.

use mvt_frames::{Object as ObjectFrame, Point};
use mvt_mesh::{Mesh, SignedDistance};
use nalgebra::Vector3;

use super::shape::Shape;

/// Makes a cube of 70 mm with edges rounded by 2 mm.
pub(super) fn cube70() -> Shape {
    let shape = RoundedBox { half_m: Vector3::repeat(0.035), radius_m: 0.002 };
    let lines = lines((0..=30).map(|step| step as f64 / 15.0 - 1.0), 3);
    Shape::new(shape.mesh(&lines), shape)
}

/// Makes a cube of 52.2 mm (the diagonal of FeelSight's is 90.4 mm) with grooves of 0.8 mm between its 3 x 3 x 3 parts.
pub(super) fn rubiks_cube_small() -> Shape {
    const HALF_M: f64 = 0.0904 / 3.464_101_615_137_754_6 /* 2 sqrt 3 */;
    const DEPTH_M: f64 = 0.0008;
    let shape = RoundedBox { half_m: Vector3::repeat(HALF_M), radius_m: 0.002 };
    let flat_m = shape.flat_half_m().x;
    let groove_m = HALF_M / 3.0;
    // A groove is 1.6 mm wide at the top and 0.8 mm at the bottom.
    let depth = |at_m: f64| ((0.0008 - (at_m.abs() - groove_m).abs()) / 0.0004).clamp(0.0, 1.0) * DEPTH_M;
    let breaks = [-flat_m, -groove_m - 0.0008, -groove_m - 0.0004, -groove_m + 0.0004, -groove_m + 0.0008];
    let mirrored = breaks.iter().rev().map(|at| -at);
    let breaks: Vec<f64> = breaks.iter().copied().chain(mirrored).collect();
    let lines = lines(subdivided(&breaks, 0.0021).into_iter().map(|at| at / flat_m), 4);
    let place = |inner: Vector3<f64>, outward: Vector3<f64>| {
        // Along the axis of the side, the place lies at the end of the inner box, where there is no groove.
        let depth_m = inner.iter().map(|&at| depth(at * flat_m)).fold(0.0, f64::max);
        shape.point(inner, outward) - depth_m * outward.normalize()
    };
    let (points, faces) = sides(&lines, place, |_| false);
    Shape::polyhedron(mvt_mesh::weld(&points, &faces))
}

/// Box with rounded edges, centred on the origin.
#[derive(Debug, Clone, Copy)]
pub(super) struct RoundedBox {
    /// Half of the size, metres.
    pub(super) half_m: Vector3<f64>,
    /// Radius of edges and corners, metres.
    pub(super) radius_m: f64,
}

impl RoundedBox {
    /// Returns half of the size of the flat faces, metres.
    pub(super) fn flat_half_m(&self) -> Vector3<f64> {
        self.half_m.add_scalar(-self.radius_m)
    }

    /// Returns the surface point in a direction from a place on the inner box (-1 to 1 along each axis).
    pub(super) fn point(&self, inner: Vector3<f64>, outward: Vector3<f64>) -> Vector3<f64> {
        inner.component_mul(&self.flat_half_m()) + self.radius_m * outward.normalize()
    }

    /// Returns a closed mesh whose six sides are grids over `lines`.
    pub(super) fn mesh(&self, lines: &[Line]) -> Mesh {
        let (points, faces) = sides(lines, |inner, outward| self.point(inner, outward), |_| false);
        mvt_mesh::weld(&points, &faces)
    }
}

impl SignedDistance for RoundedBox {
    /// The distance to the inner box, minus the radius (Quilez, "distance functions").
    fn distance_m(&self, p: Point<ObjectFrame>) -> f64 {
        let q = p.coords().abs() - self.flat_half_m();
        q.sup(&Vector3::zeros()).norm() + q.max().min(0.0) - self.radius_m
    }
}

/// Grid line of a side: its place on the inner box (-1 to 1), and the tangent of its lean over the edge (-1 to 1).
pub(super) type Line = (f64, f64);

/// Returns the lines of a side: the given ones on the flat part, from -1 to 1, and `round` steps down each rounding to
/// 45 degrees.
pub(super) fn lines(flat: impl Iterator<Item = f64>, round: usize) -> Vec<Line> {
    let lean = |step: usize| (std::f64::consts::FRAC_PI_4 * step as f64 / round as f64).tan();
    let below = (1..=round).rev().map(|step| (-1.0, -lean(step)));
    let above = (1..=round).map(|step| (1.0, lean(step)));
    below.chain(flat.map(|at| (at, 0.0))).chain(above).collect()
}

/// Returns the given places, and between each two as many even steps as keep the steps below a length.
pub(super) fn subdivided(places: &[f64], step: f64) -> Vec<f64> {
    let between = places.windows(2).flat_map(|pair| {
        let (from, to) = (pair[0], pair[1]);
        let steps = ((to - from) / step).ceil().max(1.0);
        (0..steps as usize).map(move |i| from + (to - from) * i as f64 / steps)
    });
    between.chain(places.last().copied()).collect()
}

/// Returns points and faces of the six sides as grids over `lines`; the caller welds them. `place` returns the surface
/// point for a place on the inner box (-1 to 1 along each axis) and an outward direction. Leaves out squares whose
/// centre on the inner box satisfies `skip`.
pub(super) fn sides(
    lines: &[Line],
    place: impl Fn(Vector3<f64>, Vector3<f64>) -> Vector3<f64>,
    skip: impl Fn(Vector3<f64>) -> bool,
) -> (Vec<Vector3<f64>>, Vec<[u32; 3]>) {
    let mut points = Vec::new();
    let mut faces = Vec::new();
    for side in SIDES {
        for pair_v in lines.windows(2) {
            for pair_u in lines.windows(2) {
                let corner = |i: usize, j: usize| {
                    (side.put(1.0, pair_u[i].0, pair_v[j].0), side.put(1.0, pair_u[i].1, pair_v[j].1))
                };
                if skip((corner(0, 0).0 + corner(1, 1).0) * 0.5) {
                    continue;
                }
                let first = points.len() as u32;
                points.extend([corner(0, 0), corner(1, 0), corner(1, 1), corner(0, 1)].map(|(at, out)| place(at, out)));
                faces.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
            }
        }
    }
    (points, faces)
}

/// Side of a box: its axis and direction. For its in-plane axes u and v, u x v points outward.
#[derive(Debug, Clone, Copy)]
pub(super) struct Side {
    pub(super) axis: usize,
    pub(super) sign: f64,
}

pub(super) const SIDES: [Side; 6] = [
    Side { axis: 0, sign: 1.0 },
    Side { axis: 1, sign: 1.0 },
    Side { axis: 2, sign: 1.0 },
    Side { axis: 2, sign: -1.0 },
    Side { axis: 1, sign: -1.0 },
    Side { axis: 0, sign: -1.0 },
];

impl Side {
    /// Returns the vector with these components outward, along u and along v.
    pub(super) fn put(self, outward: f64, u: f64, v: f64) -> Vector3<f64> {
        let (next, last) = ((self.axis + 1) % 3, (self.axis + 2) % 3);
        let (u_axis, v_axis) = if self.sign > 0.0 { (next, last) } else { (last, next) };
        let mut vector = Vector3::zeros();
        vector[self.axis] = self.sign * outward;
        vector[u_axis] = u;
        vector[v_axis] = v;
        vector
    }

    /// Returns the components of a vector outward, along u and along v: the inverse of [`Self::put`].
    pub(super) fn split(self, vector: Vector3<f64>) -> [f64; 3] {
        let (next, last) = (vector[(self.axis + 1) % 3], vector[(self.axis + 2) % 3]);
        let (u, v) = if self.sign > 0.0 { (next, last) } else { (last, next) };
        [self.sign * vector[self.axis], u, v]
    }
}
