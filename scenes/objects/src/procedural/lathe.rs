//! Lathed shapes: a profile of straight lines and arcs, revolved about z.

use std::f64::consts::{FRAC_PI_2, TAU};

use mvt_frames::{Object as ObjectFrame, Point};
use mvt_mesh::{Mesh, SignedDistance};
use nalgebra::{Vector2, Vector3};

use super::shape::Shape;

/// Makes a ball of 65 mm, the size of a tennis ball.
pub(super) fn ball() -> Shape {
    let arc = Arc { centre: Vector2::zeros(), radius_m: 0.0325, from: -FRAC_PI_2, sweep: 2.0 * FRAC_PI_2 };
    shape(Profile(vec![Element::Arc(arc)]), 96)
}

/// Makes a can of 67 x 101 mm whose lid and bottom lie 3 mm below their rims, like YCB's tomato soup can.
pub(super) fn soup_can() -> Shape {
    shape(soup_can_profile(), 108)
}

fn soup_can_profile() -> Profile {
    Profile::rounded(&[
        ([0.0, -47.5], 0.0),
        ([30.5, -47.5], 1.0),
        ([31.0, -50.5], 0.8),
        ([33.5, -50.5], 1.2),
        ([33.5, 50.5], 1.2),
        ([31.0, 50.5], 0.8),
        ([30.5, 47.5], 1.0),
        ([0.0, 47.5], 0.0),
    ])
}

/// Makes a pepper grinder of 50 x 130.6 mm (the diagonal of FeelSight's is 148.5 mm): a waist between a foot and a head
/// with a knob.
pub(super) fn pepper_grinder() -> Shape {
    shape(pepper_grinder_profile(), 96)
}

fn pepper_grinder_profile() -> Profile {
    Profile::rounded(&[
        ([0.0, -65.3], 0.0),
        ([25.0, -65.3], 3.0),
        ([25.0, -40.0], 20.0),
        ([15.5, -8.0], 30.0),
        ([24.0, 22.0], 12.0),
        ([24.0, 48.0], 14.0),
        ([9.0, 52.0], 3.0),
        ([11.0, 65.3], 5.0),
        ([0.0, 65.3], 0.0),
    ])
}

/// Makes a pear of 66 x 100 mm, stem up, with a flat bottom.
pub(super) fn pear() -> Shape {
    shape(pear_profile(), 96)
}

fn pear_profile() -> Profile {
    Profile::rounded(&[
        ([0.0, -50.0], 0.0),
        ([33.0, -50.0], 27.0),
        ([33.0, -2.0], 26.0),
        ([17.0, 16.0], 34.0),
        ([17.0, 50.0], 15.0),
        ([0.0, 50.0], 0.0),
    ])
}

pub(super) fn shape(profile: Profile, sectors: usize) -> Shape {
    Shape::new(profile.mesh(sectors), profile)
}

/// Arc in the half-plane of distance from the axis and height.
#[derive(Debug, Clone, Copy)]
struct Arc {
    centre: Vector2<f64>,
    radius_m: f64,
    /// First angle and length, radians; negative lengths run clockwise.
    from: f64,
    sweep: f64,
}

/// Element of a profile.
#[derive(Debug, Clone, Copy)]
enum Element {
    Line([Vector2<f64>; 2]),
    Arc(Arc),
}

impl Element {
    /// Returns the closest point to `p` and its outward normal, to the right of the direction of travel.
    fn closest(&self, p: Vector2<f64>) -> (Vector2<f64>, Vector2<f64>) {
        match *self {
            Self::Line([a, b]) => {
                let along = b - a;
                let share = ((p - a).dot(&along) / along.norm_squared()).clamp(0.0, 1.0);
                (a + share * along, Vector2::new(along.y, -along.x).normalize())
            }
            Self::Arc(arc) => {
                let towards = p - arc.centre;
                // Angle from the middle of the arc, so that clamping gives the nearer end.
                let middle = arc.from + 0.5 * arc.sweep;
                let turn = (towards.y.atan2(towards.x) - middle + 1.5 * TAU).rem_euclid(TAU) - 0.5 * TAU;
                let angle = middle + turn.clamp(-0.5 * arc.sweep.abs(), 0.5 * arc.sweep.abs());
                let radial = Vector2::new(angle.cos(), angle.sin());
                (arc.centre + arc.radius_m * radial, radial * arc.sweep.signum())
            }
        }
    }

    /// Returns points along it, without the last: arcs in steps that deviate by less than 10 um, lines in steps of 4
    /// mm.
    fn points(&self) -> Vec<Vector2<f64>> {
        match *self {
            Self::Line([a, b]) => {
                let steps = ((b - a).norm() / 0.004).ceil().max(1.0);
                (0..steps as usize).map(|i| a.lerp(&b, i as f64 / steps)).collect()
            }
            Self::Arc(arc) => {
                let step = 2.0 * (1.0 - 1e-5 / arc.radius_m).acos();
                let steps = (arc.sweep.abs() / step).ceil().max(1.0);
                let angle = |i: usize| arc.from + arc.sweep * i as f64 / steps;
                let point = |i| arc.centre + arc.radius_m * Vector2::new(f64::cos(angle(i)), f64::sin(angle(i)));
                (0..steps as usize).map(point).collect()
            }
        }
    }
}

/// Curve without corners from the axis at the bottom to the axis at the top. Without corners, the normal at the closest
/// point decides whether a point is inside.
#[derive(Debug, Clone)]
pub(super) struct Profile(Vec<Element>);

impl Profile {
    /// Rounds the corners of a polygon of (distance from the axis, height) by the radius beside each, millimetres. The
    /// first and the last corner lie on the axis and are not rounded.
    pub(super) fn rounded(corners_mm: &[([f64; 2], f64)]) -> Self {
        let metres = |&(at, radius): &([f64; 2], f64)| (Vector2::from(at) * 1e-3, radius * 1e-3);
        Self::of_corners(&corners_mm.iter().map(metres).collect::<Vec<_>>())
    }

    /// Rounds the corners of a polygon, both in metres, by the radius beside each, or by the largest that fits.
    pub(super) fn fitted(corners_m: &[([f64; 2], f64)]) -> Self {
        // Two neighbours leave a tenth of the line between them.
        const SHARE: f64 = 0.45;
        let mut corners: Vec<(Vector2<f64>, f64)> = corners_m.iter().map(|&(at, radius)| (at.into(), radius)).collect();
        for k in 1..corners.len().saturating_sub(1) {
            let (into, out) = (corners[k].0 - corners[k - 1].0, corners[k + 1].0 - corners[k].0);
            let half_turn = 0.5 * into.angle(&out);
            corners[k].1 = f64::min(corners[k].1, SHARE * f64::min(into.norm(), out.norm()) / half_turn.tan());
        }
        Self::of_corners(&corners)
    }

    fn of_corners(corners: &[(Vector2<f64>, f64)]) -> Self {
        let mut elements = Vec::new();
        let mut at = corners[0].0;
        for trio in corners.windows(3) {
            let ((before, _), (corner, radius_m), (after, _)) = (trio[0], trio[1], trio[2]);
            let (into, out) = ((corner - before).normalize(), (after - corner).normalize());
            let turn = into.perp(&out).atan2(into.dot(&out));
            let cut = radius_m * (0.5 * turn.abs()).tan();
            let start = corner - cut * into;
            // On the left of the travel for a left turn.
            let centre = start + radius_m * turn.signum() * Vector2::new(-into.y, into.x);
            let from = start - centre;
            elements.push(Element::Line([at, start]));
            elements.push(Element::Arc(Arc { centre, radius_m, from: from.y.atan2(from.x), sweep: turn }));
            at = corner + cut * out;
        }
        elements.push(Element::Line([at, corners[corners.len() - 1].0]));
        Self(elements)
    }

    /// Returns the exact distance in the half-plane, which equals that to the revolved surface.
    pub(super) fn distance_m(&self, p: Vector3<f64>) -> f64 {
        let p = Vector2::new(p.x.hypot(p.y), p.z);
        let (offset, normal) = self
            .0
            .iter()
            .map(|element| element.closest(p))
            .map(|(closest, normal)| (p - closest, normal))
            .min_by(|a, b| a.0.norm_squared().total_cmp(&b.0.norm_squared()))
            .unwrap_or_default();
        offset.norm().copysign(offset.dot(&normal))
    }

    fn mesh(&self, sectors: usize) -> Mesh {
        let mut curve: Vec<Vector2<f64>> = self.0.iter().flat_map(Element::points).collect();
        match self.0.last() {
            Some(Element::Line([_, end])) => curve.push(*end),
            Some(Element::Arc(arc)) => curve.push(arc.centre + Vector2::new(0.0, arc.radius_m)),
            None => {}
        }
        let turned = |p: &Vector2<f64>| {
            let p = *p;
            (0..sectors).map(move |sector| {
                let (sin, cos) = (TAU * sector as f64 / sectors as f64).sin_cos();
                Vector3::new(p.x * cos, p.x * sin, p.y)
            })
        };
        let points: Vec<Vector3<f64>> = curve.iter().flat_map(turned).collect();
        let n = sectors as u32;
        let quad = |ring: u32, i: u32| {
            let (a, b) = (ring * n + i, ring * n + (i + 1) % n);
            [[a, b, b + n], [a, b + n, a + n]]
        };
        // A ring on the axis is one point; welding drops the collapsed faces.
        let rings = curve.len() as u32 - 1;
        let faces: Vec<[u32; 3]> = (0..rings).flat_map(|ring| (0..n).flat_map(move |i| quad(ring, i))).collect();
        mvt_mesh::weld(&points, &faces)
    }
}

impl SignedDistance for Profile {
    fn distance_m(&self, p: Point<ObjectFrame>) -> f64 {
        self.distance_m(p.coords())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A line between roundings that are too large would run backwards.
    #[test]
    fn profiles_have_no_corners() {
        for profile in [soup_can_profile(), pepper_grinder_profile(), pear_profile()] {
            let ends = |element: &Element| match *element {
                Element::Line([a, b]) => [(a, (b - a).normalize()), (b, (b - a).normalize())],
                Element::Arc(arc) => [arc.from, arc.from + arc.sweep].map(|angle| {
                    let radial = Vector2::new(angle.cos(), angle.sin());
                    (arc.centre + arc.radius_m * radial, Vector2::new(-radial.y, radial.x) * arc.sweep.signum())
                }),
            };
            for pair in profile.0.windows(2) {
                let ([_, (end, leaving)], [(start, entering), _]) = (ends(&pair[0]), ends(&pair[1]));
                assert!((end - start).norm() < 1e-12 && (leaving - entering).norm() < 1e-9, "{pair:?}");
            }
        }
    }

    #[test]
    fn distances_to_a_rounded_cylinder() {
        let square =
            Profile::rounded(&[([0.0, -10.0], 0.0), ([10.0, -10.0], 2.0), ([10.0, 10.0], 2.0), ([0.0, 10.0], 0.0)]);
        let d = |x: f64, z: f64| square.distance_m(Vector3::new(x, 0.0, z) * 1e-3) * 1e3;
        // Computed by hand: outside the side, outside the rounding, inside, and in the corner that the rounding cuts
        // off.
        assert!((d(13.0, 0.0) - 3.0).abs() < 1e-12);
        assert!((d(11.0, 11.0) - (3.0 * 2_f64.sqrt() - 2.0)).abs() < 1e-12);
        assert!((d(0.0, 0.0) + 10.0).abs() < 1e-12);
        assert!((d(9.9, 9.9) - (1.9 * 2_f64.sqrt() - 2.0)).abs() < 1e-12);
    }
}
