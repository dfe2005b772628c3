//! Hollow random shapes.

use nalgebra::Vector3;

use super::draw::Draw;
use super::moulded;
use super::outline::Outline;
use crate::procedural::lathe::{self, Profile};
use crate::procedural::moulded::{ring_handle, smooth_max, smooth_min};
use crate::procedural::shape::Shape;

/// Edge of a cell as a share of the wall. Half is the limit of the meshing; this keeps the rounded rim smooth.
const CELL_SHARE: f64 = 0.4;

/// Draws a round cup or a pot with corners.
pub(super) fn vessel(draw: &mut Draw) -> Shape {
    if draw.coin() { round(draw) } else { cornered(draw) }
}

fn round(draw: &mut Draw) -> Shape {
    let wall_m = draw.mm([2.0, 4.0]);
    let half_m = 0.5 * draw.mm([46.0, 80.0]);
    let mouth_m = draw.mm([27.0, 36.0]);
    let foot_m = mouth_m * draw.between([0.7, 1.0]);
    lathe::shape(cup(half_m, mouth_m, foot_m, wall_m), 96)
}

/// Returns the profile of a cup of the given half height, outer radii and wall.
fn cup(half_m: f64, mouth_m: f64, foot_m: f64, wall_m: f64) -> Profile {
    let (rim_m, edge_m) = (0.45 * wall_m, 0.004);
    Profile::fitted(&[
        ([0.0, -half_m], 0.0),
        ([foot_m, -half_m], edge_m),
        ([mouth_m, half_m], rim_m),
        ([mouth_m - wall_m, half_m], rim_m),
        ([foot_m - wall_m, wall_m - half_m], edge_m),
        ([0.0, wall_m - half_m], 0.0),
    ])
}

fn cornered(draw: &mut Draw) -> Shape {
    let sides = draw.count(4, 8);
    let (reach_m, half_m) = (draw.mm([30.0, 37.0]), 0.5 * draw.mm([46.0, 72.0]));
    let outline = Outline::convex(draw, sides, reach_m, 0.008);
    let wall_m = draw.mm([3.2, 4.0]);
    let field = |p: Vector3<f64>| {
        let outside = outline.prism_m(p, [-half_m, half_m], 0.0025);
        let cavity = f64::max(outline.distance_m(p.xy()) + wall_m, wall_m - half_m - p.z);
        smooth_max(outside, -cavity, 0.0015)
    };
    moulded(field, Vector3::new(0.042, 0.042, 0.040), CELL_SHARE * wall_m)
}

/// Draws a round cup with a handle.
pub(super) fn handled(draw: &mut Draw) -> Shape {
    let wall_m = draw.mm([3.6, 4.0]);
    let half_m = 0.5 * draw.mm([50.0, 65.0]);
    let mouth_m = draw.mm([25.0, 29.0]);
    let foot_m = mouth_m * draw.between([0.93, 1.0]);
    let body = cup(half_m, mouth_m, foot_m, wall_m);
    let ring_m = draw.mm([11.0, 14.0]);
    let tube_m = draw.mm([4.0, 5.0]);
    // The handle ends in the middle of the wall.
    let end_m = 0.5 * (mouth_m + foot_m - wall_m);
    let field = |p: Vector3<f64>| smooth_min(body.distance_m(p), ring_handle(p, end_m, ring_m, tube_m), 0.004);
    moulded(field, Vector3::new(0.062, 0.037, half_m + 0.003), CELL_SHARE * wall_m)
}
