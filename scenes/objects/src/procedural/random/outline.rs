//! Outlines in the plane with rounded corners, and prisms over them.

use std::f64::consts::TAU;

use nalgebra::{Vector2, Vector3};

use super::draw::Draw;

/// Polygon that is grown by a radius, which rounds its convex corners. Lengths in metres.
pub(super) struct Outline {
    core: Vec<Vector2<f64>>,
    radius_m: f64,
}

impl Outline {
    /// Draws a convex polygon whose corners lie on an ellipse: a regular one, or one with uneven sides.
    pub(super) fn convex(draw: &mut Draw, sides: usize, reach_m: f64, radius_m: f64) -> Self {
        let is_regular = draw.coin();
        // With 0.2 of a side, the angles of a triangle stay above 35 degrees.
        let (uneven, narrow) = if is_regular { (0.0, 1.0) } else { (0.2, draw.between([0.85, 1.0])) };
        let corner = |i| {
            let angle = TAU * (i as f64 + draw.between([-uneven, uneven])) / sides as f64;
            (reach_m - radius_m) * Vector2::new(angle.cos(), narrow * angle.sin())
        };
        Self { core: (0..sides).map(corner).collect(), radius_m }
    }

    /// Draws a star.
    pub(super) fn star(draw: &mut Draw, reach_m: f64, radius_m: f64) -> Self {
        let tips = draw.count(4, 7);
        // The hull has 1.25 to 1.45 times the area of the star before its tips are rounded.
        let waist = (TAU / (2 * tips) as f64).cos() / draw.between([1.25, 1.45]);
        let corner = |i| {
            let angle = TAU * i as f64 / (2 * tips) as f64;
            let reach_m = (reach_m - radius_m) * if i % 2 == 0 { 1.0 } else { waist };
            reach_m * Vector2::new(angle.cos(), angle.sin())
        };
        Self { core: (0..2 * tips).map(corner).collect(), radius_m }
    }

    /// Makes an outline of corners on a grid of `width_m` by `depth_m`, each between -1 and 1.
    pub(super) fn of_corners(corners: &[[f64; 2]], width_m: f64, depth_m: f64, radius_m: f64) -> Self {
        let half = 0.5 * Vector2::new(width_m, depth_m).add_scalar(-2.0 * radius_m);
        Self { core: corners.iter().map(|&corner| Vector2::from(corner).component_mul(&half)).collect(), radius_m }
    }

    /// Returns the signed distance (Quilez, "2D distance functions"), exact outside and in convex outlines.
    pub(super) fn distance_m(&self, p: Vector2<f64>) -> f64 {
        let before = self.core.iter().skip(self.core.len().saturating_sub(1)).chain(&self.core);
        let (mut squared, mut sign) = (f64::INFINITY, 1.0);
        for (a, b) in self.core.iter().zip(before) {
            let (side, offset) = (b - a, p - a);
            let nearest = offset - side * (offset.dot(&side) / side.norm_squared()).clamp(0.0, 1.0);
            squared = f64::min(squared, nearest.norm_squared());
            // The sign changes with every side that a ray along x crosses.
            let crossing = [p.y >= a.y, p.y < b.y, side.perp(&offset) > 0.0];
            if crossing == [true; 3] || crossing == [false; 3] {
                sign = -sign;
            }
        }
        sign * squared.sqrt() - self.radius_m
    }

    /// Returns the distance to the prism over the outline between two heights, with edges rounded by `edge_m`.
    pub(super) fn prism_m(&self, p: Vector3<f64>, [low_m, high_m]: [f64; 2], edge_m: f64) -> f64 {
        let beside = self.distance_m(p.xy()) + edge_m;
        let above = f64::max(low_m - p.z, p.z - high_m) + edge_m;
        f64::min(beside.max(above), 0.0) + beside.max(0.0).hypot(above.max(0.0)) - edge_m
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn distances_to_a_prism_over_a_square() {
        let square = Outline::of_corners(&[[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]], 0.04, 0.04, 0.004);
        let d = |x: f64, y: f64, z: f64| 1e3 * square.prism_m(1e-3 * Vector3::new(x, y, z), [-0.01, 0.01], 0.002);
        // Computed by hand: beside, above, within, and outside of the rounded corner.
        assert!((d(25.0, 0.0, 0.0) - 5.0).abs() < 1e-9);
        assert!((d(0.0, 0.0, 13.0) - 3.0).abs() < 1e-9);
        assert!((d(0.0, 0.0, 4.0) + 6.0).abs() < 1e-9);
        assert!((d(20.0, 20.0, 0.0) - 4.0 * (2_f64.sqrt() - 1.0)).abs() < 1e-9);
    }
}
