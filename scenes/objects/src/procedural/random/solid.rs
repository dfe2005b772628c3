//! Solid random shapes.

use nalgebra::Vector3;

use super::draw::Draw;
use super::moulded;
use super::outline::Outline;
use crate::procedural::lathe::{self, Profile};
use crate::procedural::moulded::{on_table, smooth_min};
use crate::procedural::rounded_box::{self, RoundedBox};
use crate::procedural::shape::Shape;

/// Edge of a cell of the meshed solids, metres: 8,000 to 20,000 faces.
const CELL_M: f64 = 0.0018;

/// Draws a prism.
pub(super) fn prism(draw: &mut Draw) -> Shape {
    let sides = draw.count(3, 8);
    let edge_m = draw.mm([2.5, 5.0]);
    // The fewer sides, the farther the corners reach for the same width.
    let reach_m = draw.mm([29.0, 37.0]) + if sides == 3 { 0.004 } else { 0.0 };
    let radius_m = draw_radius(draw);
    let outline = Outline::convex(draw, sides, reach_m, radius_m);
    extruded(draw, &outline, edge_m)
}

/// Draws a prism over an L, a T, a U or a star.
pub(super) fn concave(draw: &mut Draw) -> Shape {
    let edge_m = draw.mm([2.5, 4.0]);
    let (width_m, depth_m) = (draw.mm([54.0, 70.0]), draw.mm([52.0, 64.0]));
    let radius_m = draw_radius(draw);
    // Width of an arm as a share of half of the width.
    let arm = draw.between([0.68, 0.82]);
    let outline = match draw.count(0, 3) {
        0 => {
            let inner = arm - 1.0;
            let corners = [[-1.0, -1.0], [1.0, -1.0], [1.0, inner], [inner, inner], [inner, 1.0], [-1.0, 1.0]];
            Outline::of_corners(&corners, width_m, depth_m, radius_m)
        }
        1 => {
            let (stem, bar) = (0.5 * arm, 1.0 - arm);
            let corners = [[-stem, -1.0], [stem, -1.0], [stem, bar], [1.0, bar], [1.0, 1.0], [-1.0, 1.0], [-1.0, bar]];
            Outline::of_corners(&[&corners[..], &[[-stem, bar]]].concat(), width_m, depth_m, radius_m)
        }
        2 => {
            let (gap, floor) = (1.1 - arm, arm - 1.0);
            let corners = [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [gap, 1.0], [gap, floor], [-gap, floor], [-gap, 1.0]];
            Outline::of_corners(&[&corners[..], &[[-1.0, 1.0]]].concat(), width_m, depth_m, radius_m)
        }
        _ => Outline::star(draw, 0.54 * width_m, radius_m),
    };
    extruded(draw, &outline, edge_m)
}

/// Draws the radius of the upright edges, metres.
fn draw_radius(draw: &mut Draw) -> f64 {
    draw.mm([2.5, 6.0])
}

/// Draws the height of a prism over an outline.
fn extruded(draw: &mut Draw, outline: &Outline, edge_m: f64) -> Shape {
    let half_m = 0.5 * draw.mm([48.0, 82.0]);
    moulded(|p| outline.prism_m(p, [-half_m, half_m], edge_m), Vector3::new(0.048, 0.048, 0.046), CELL_M)
}

/// Draws a superquadric.
pub(super) fn superquadric(draw: &mut Draw) -> Shape {
    let half_m = half_extents_m(draw, [28.0, 36.0], [24.0, 36.0]);
    // 0.25 is nearly a box, 1 a ball, 2 an octahedron. Between the boxes and cylinders of the first choice and the balls
    // of the second lie shapes that topple in the hand and are then out of its reach.
    let (upright, level) = if draw.coin() {
        (draw.between([0.25, 0.4]), draw.between([0.25, 1.0]))
    } else {
        (draw.between([0.9, 1.05]), draw.between([0.85, 1.1]))
    };
    let field = |p: Vector3<f64>| {
        let unit = p.component_div(&half_m).abs();
        let round = (unit.x.powf(2.0 / level) + unit.y.powf(2.0 / level)).powf(level / upright);
        half_m.min() * ((round + unit.z.powf(2.0 / upright)).powf(0.5 * upright) - 1.0)
    };
    moulded(field, half_m.add_scalar(0.003), CELL_M)
}

/// Draws a box with rounded edges.
pub(super) fn cuboid(draw: &mut Draw) -> Shape {
    let shape = RoundedBox { half_m: half_extents_m(draw, [25.0, 34.0], [24.0, 41.0]), radius_m: draw.mm([2.0, 10.0]) };
    let lines = rounded_box::lines((0..=28).map(|step| f64::from(step) / 14.0 - 1.0), 6);
    Shape::new(shape.mesh(&lines), shape)
}

/// Draws half of the extents from ranges of half the width and half the height in millimetres.
fn half_extents_m(draw: &mut Draw, width: [f64; 2], height: [f64; 2]) -> Vector3<f64> {
    let width_m = draw.mm(width);
    let depth_m = width_m * draw.between([0.82, 1.0]);
    Vector3::new(width_m, depth_m, draw.mm(height))
}

/// Draws a smooth union of balls with a flat foot.
pub(super) fn blob(draw: &mut Draw) -> Shape {
    let mut balls = vec![(Vector3::zeros(), 0.026)];
    for _ in 0..draw.count(2, 4) {
        let (angle, from_axis_m) = (draw.between([0.0, std::f64::consts::TAU]), draw.mm([10.0, 18.0]));
        let centre = Vector3::new(from_axis_m * angle.cos(), from_axis_m * angle.sin(), draw.mm([-4.0, 24.0]));
        balls.push((centre, draw.mm([13.0, 20.0])));
    }
    let field = |p: Vector3<f64>| {
        let to_ball = |(centre, radius_m): &(Vector3<f64>, f64)| (p - centre).norm() - radius_m;
        let union = balls.iter().map(to_ball).fold(f64::INFINITY, |a, b| smooth_min(a, b, 0.005));
        on_table(union, p, -18.0)
    };
    moulded(field, Vector3::new(0.045, 0.045, 0.048), CELL_M)
}

/// Draws a vase, a barrel or a beaker.
pub(super) fn lathe(draw: &mut Draw) -> Shape {
    let half_m = 0.5 * draw.mm([46.0, 76.0]);
    // Slender or strongly tapered ones topple in the hand and are then out of its reach.
    let widest_m = draw.mm([28.0, 34.0]);
    let edge_m = draw.mm([2.0, 6.0]);
    let (low, high) = ([0.0, -half_m], [0.0, half_m]);
    let profile = match draw.count(0, 2) {
        0 => {
            let foot_m = widest_m * draw.between([0.9, 1.0]);
            let neck_m = widest_m * draw.between([0.6, 0.85]);
            let lip_m = widest_m * draw.between([0.85, 1.0]);
            let belly = [widest_m, -half_m * draw.between([0.1, 0.5])];
            let neck = [neck_m, half_m * draw.between([0.35, 0.6])];
            let corners = [(belly, 0.5), (neck, 0.5)];
            let (foot, lip) = (([foot_m, -half_m], edge_m), ([lip_m, half_m], edge_m));
            Profile::fitted(&[(low, 0.0), foot, corners[0], corners[1], lip, (high, 0.0)])
        }
        1 => {
            let end_m = widest_m * draw.between([0.85, 0.97]);
            let middle = ([widest_m, half_m * draw.between([-0.3, 0.3])], 0.5);
            let ends = (([end_m, -half_m], edge_m), ([end_m, half_m], edge_m));
            Profile::fitted(&[(low, 0.0), ends.0, middle, ends.1, (high, 0.0)])
        }
        _ => {
            let foot_m = widest_m * draw.between([0.9, 1.0]);
            let corners = [([foot_m, -half_m], edge_m), ([widest_m, half_m], edge_m)];
            Profile::fitted(&[(low, 0.0), corners[0], corners[1], (high, 0.0)])
        }
    };
    lathe::shape(profile, 96)
}
