//! A large die: a rounded box with spherical pips cut into its faces.

use mvt_frames::{Object as ObjectFrame, Point};
use mvt_mesh::{Mesh, SignedDistance};
use nalgebra::{Vector2, Vector3};

use super::rounded_box::{self, RoundedBox, SIDES, Side};
use super::shape::Shape;

/// Half the edge, metres: the diagonal of FeelSight's 5 cm die is 87.2 mm.
const HALF_M: f64 = 0.0872 / 3.464_101_615_137_754_6 /* 2 sqrt 3 */;
/// Radius of the edges, metres.
const EDGE_RADIUS_M: f64 = 0.004;
/// Radius of a pip at the face and its depth, metres.
const PIP_RIM_M: f64 = 0.0045;
const PIP_DEPTH_M: f64 = 0.001;
/// Distance between the centres of neighbouring pips, metres.
const PITCH_M: f64 = 0.012;

/// Makes the die.
pub(super) fn large_dice() -> Shape {
    let die = Die::new();
    Shape::new(die.mesh(), die)
}

/// Box with rounded edges from which disjoint balls are cut, each through the flat part of one face.
#[derive(Debug, Clone, Copy)]
struct Die {
    body: RoundedBox,
    /// Radius of the balls, metres.
    ball_m: f64,
    /// Distance of their centres from the face, outside, metres.
    height_m: f64,
}

/// Returns the pips of a side, in pitches from its centre. Opposite sides add up to seven.
fn pips(side: Side) -> &'static [[f64; 2]] {
    match (side.axis, side.sign > 0.0) {
        (0, true) => &[[0.0, 0.0]],
        (1, true) => &[[-1.0, -1.0], [1.0, 1.0]],
        (2, true) => &[[-1.0, -1.0], [0.0, 0.0], [1.0, 1.0]],
        (2, false) => &[[-1.0, -1.0], [-1.0, 1.0], [1.0, -1.0], [1.0, 1.0]],
        (1, false) => &[[-1.0, -1.0], [-1.0, 1.0], [0.0, 0.0], [1.0, -1.0], [1.0, 1.0]],
        _ => &[[-1.0, -1.0], [-1.0, 0.0], [-1.0, 1.0], [1.0, -1.0], [1.0, 0.0], [1.0, 1.0]],
    }
}

impl Die {
    fn new() -> Self {
        // The ball through the rim and the deepest point.
        let ball_m = (PIP_RIM_M * PIP_RIM_M + PIP_DEPTH_M * PIP_DEPTH_M) / (2.0 * PIP_DEPTH_M);
        let body = RoundedBox { half_m: Vector3::repeat(HALF_M), radius_m: EDGE_RADIUS_M };
        Self { body, ball_m, height_m: ball_m - PIP_DEPTH_M }
    }

    /// Returns the distance to the cap of a pip, from a place at a distance from its axis and a height above the face.
    fn cap_distance_m(&self, from_axis: f64, above: f64) -> f64 {
        let to_centre = from_axis.hypot(above - self.height_m);
        // The cap ends at the rim; for directions from the ball's centre beyond the rim, the rim is nearest.
        let faces_cap = (self.height_m - above) * self.ball_m >= self.height_m * to_centre;
        if faces_cap { (to_centre - self.ball_m).abs() } else { (from_axis - PIP_RIM_M).hypot(above) }
    }

    fn mesh(&self) -> Mesh {
        const STEPS: usize = 6;
        let flat_m = self.body.flat_half_m().x;
        let breaks = [-flat_m, -1.5 * PITCH_M, -0.5 * PITCH_M, 0.5 * PITCH_M, 1.5 * PITCH_M, flat_m];
        let places = rounded_box::subdivided(&breaks, PITCH_M / STEPS as f64 * 1.001);
        let lines = rounded_box::lines(places.iter().map(|at| at / flat_m), 4);
        let on_face = |side: Side, u: f64, v: f64| {
            self.body.point(side.put(1.0, u / flat_m, v / flat_m), side.put(1.0, 0.0, 0.0))
        };
        let in_pip_square = |inner: Vector3<f64>| {
            SIDES.iter().any(|side| {
                let [outward, u, v] = side.split(inner);
                let near = |[at_u, at_v]: &[f64; 2]| {
                    let reach = |at: f64, pip: f64| (at * flat_m / PITCH_M - pip).abs() < 0.5;
                    reach(u, *at_u) && reach(v, *at_v)
                };
                outward == 1.0 && pips(*side).iter().any(near)
            })
        };
        let on_body = |inner, outward| self.body.point(inner, outward);
        let (mut points, mut faces) = rounded_box::sides(&lines, on_body, in_pip_square);
        // Corners of the grid on the border of the square around a pip, in turn.
        let from_u = |i: usize| places.iter().position(|&p| (p - (i as f64 - 1.5) * PITCH_M).abs() < 1e-9).unwrap_or(0);
        for side in SIDES {
            for &[at_u, at_v] in pips(side) {
                let (u, v) = (&places[from_u((at_u + 1.0) as usize)..], &places[from_u((at_v + 1.0) as usize)..]);
                let border: Vec<Vector2<f64>> = (0..4 * STEPS)
                    .map(|i| match (i / STEPS, i % STEPS) {
                        (0, i) => Vector2::new(u[i], v[0]),
                        (1, i) => Vector2::new(u[STEPS], v[i]),
                        (2, i) => Vector2::new(u[STEPS - i], v[STEPS]),
                        (_, i) => Vector2::new(u[0], v[STEPS - i]),
                    })
                    .collect();
                self.pip(side, Vector2::new(at_u, at_v) * PITCH_M, &border, on_face, &mut points, &mut faces);
            }
        }
        mvt_mesh::weld(&points, &faces)
    }

    /// Adds the face between the border of a square and the rim of a pip, and the pip.
    fn pip(
        &self,
        side: Side,
        centre: Vector2<f64>,
        border: &[Vector2<f64>],
        on_face: impl Fn(Side, f64, f64) -> Vector3<f64>,
        points: &mut Vec<Vector3<f64>>,
        faces: &mut Vec<[u32; 3]>,
    ) {
        const FLAT_RINGS: usize = 2;
        const CAP_RINGS: usize = 4;
        let first = points.len() as u32;
        let n = border.len() as u32;
        let full_angle = (PIP_RIM_M / self.ball_m).asin();
        for ring in 0..FLAT_RINGS + CAP_RINGS {
            for at in border {
                let rim = centre + (at - centre).normalize() * PIP_RIM_M;
                if ring < FLAT_RINGS {
                    let flat = at.lerp(&rim, ring as f64 / FLAT_RINGS as f64);
                    points.push(on_face(side, flat.x, flat.y));
                } else {
                    let angle = full_angle * (1.0 - (ring - FLAT_RINGS) as f64 / CAP_RINGS as f64);
                    let cap = centre + (at - centre).normalize() * self.ball_m * angle.sin();
                    let sunk = self.ball_m * angle.cos() - self.height_m;
                    points.push(on_face(side, cap.x, cap.y) - side.put(sunk, 0.0, 0.0));
                }
            }
        }
        points.push(on_face(side, centre.x, centre.y) - side.put(PIP_DEPTH_M, 0.0, 0.0));
        let rings = (FLAT_RINGS + CAP_RINGS) as u32;
        for ring in 0..rings {
            for i in 0..n {
                let (a, b) = (first + ring * n + i, first + ring * n + (i + 1) % n);
                if ring + 1 == rings {
                    faces.push([a, b, first + rings * n]);
                } else {
                    faces.extend([[a, b, b + n], [a, b + n, a + n]]);
                }
            }
        }
    }
}

impl SignedDistance for Die {
    /// The surface is that of the body without the discs of the pips, and the caps with their rims. Outside, if the
    /// nearest point of the body lies in a disc, the rim of the disc replaces it, because the body lies below the face.
    /// Inside, every face and rounding is a candidate.
    fn distance_m(&self, p: Point<ObjectFrame>) -> f64 {
        let body_m = self.body.distance_m(p);
        let flat_half_m = self.body.flat_half_m();
        let mut in_ball = false;
        let mut nearest = f64::INFINITY;
        for side in SIDES {
            let [outward, u, v] = side.split(p.coords());
            let above = outward - self.body.half_m[side.axis];
            let mut over_disc = false;
            for pip in pips(side) {
                let from_axis = (u - pip[0] * PITCH_M).hypot(v - pip[1] * PITCH_M);
                nearest = nearest.min(self.cap_distance_m(from_axis, above));
                over_disc |= from_axis < PIP_RIM_M;
                in_ball |= from_axis.hypot(above - self.height_m) < self.ball_m;
            }
            if !over_disc {
                let [_, flat_u, flat_v] = side.split(flat_half_m);
                let beside = (u.abs() - flat_u.abs()).max(0.0).hypot((v.abs() - flat_v.abs()).max(0.0));
                nearest = nearest.min(beside.hypot(above));
            }
        }
        // The roundings, where two or more coordinates are beyond the flat part.
        let beyond = (p.coords().abs() - flat_half_m).sup(&Vector3::zeros());
        if beyond.iter().filter(|&&x| x > 0.0).count() >= 2 {
            nearest = nearest.min((beyond.norm() - self.body.radius_m).abs());
        }
        if body_m < 0.0 && !in_ball { -nearest } else { nearest }
    }
}
