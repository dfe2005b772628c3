//! The hand as a solid: signed distances, and points that it occupies.
//!
//! Distances are to the union of the hand's [`parts`](Hand::parts). Outside, the distance to a union is the least of the distances
//! to its members; inside, it is the depth below the surface of the member that covers the point most deeply.

use std::sync::Arc;

use glam::{Mat3A, Vec3, Vec3A};
use nalgebra as na;

use mvt_frames::{Isometry, Obstacle, Occupied, World};

use super::parts::{Part, Primitive};
use super::{Hand, Hull};

/// Solid of the hand at given joint angles. Lengths are metres, points are in the world.
#[derive(Debug, Clone)]
pub struct HandSolid {
    /// The palm and the fingers.
    limbs: Vec<Limb>,
    /// Poses of all bodies in the world.
    poses: Vec<na::Isometry3<f64>>,
}

/// Primitives that lie close together, with a sphere around them.
#[derive(Debug, Clone)]
struct Limb {
    bound: Sphere,
    members: Vec<Member>,
}

#[derive(Debug, Clone)]
struct Member {
    body: usize,
    bound: Sphere,
    shape: Shape,
}

/// Surface of the hand near a point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Nearest {
    /// Signed distance to the surface, metres, negative inside the hand.
    pub distance_m: f32,
    /// Unit direction in which the distance grows, world frame.
    pub normal: Vec3,
    /// Index of the body to which the surface belongs.
    pub body: usize,
}

/// Primitive in the world. Matrices take world directions to the primitive's axes; the centre is that of the bounding
/// sphere.
#[derive(Debug, Clone)]
enum Shape {
    Box { axes: Mat3A, half: Vec3A },
    Capsule { half_axis: Vec3A, inverse_square: f32, radius: f32 },
    Ellipsoid { axes: Mat3A, inverse_semi: Vec3A, longest: f32 },
    Hull { axes: Mat3A, hull: Hull },
}

#[derive(Debug, Clone, Copy)]
struct Sphere {
    centre: Vec3A,
    radius: f32,
}

impl Sphere {
    /// Returns whether no solid inside the sphere can have a signed distance from `p` below `distance`.
    fn is_beyond(&self, p: Vec3A, distance: f32) -> bool {
        let reach = self.radius + distance;
        reach <= 0.0 || p.distance_squared(self.centre) >= reach * reach
    }
}

impl HandSolid {
    /// Places all parts of the hand.
    pub fn new(hand: &Hand, joints: &[f64]) -> Self {
        let poses = hand.body_poses(joints);
        let placed: Vec<(usize, &Part)> = hand.parts().collect();
        let member = |&(body, part): &(usize, &Part)| Member::new(body, part, &poses[body]);
        let limb = |parts: &[(usize, &Part)]| Limb::new(parts.iter().map(member).collect());
        let limbs = placed.chunk_by(|a, b| hand.limbs[a.0] == hand.limbs[b.0]).map(limb).collect();
        Self { limbs, poses }
    }

    /// Returns the poses of all bodies in the world.
    pub fn body_poses(&self) -> &[na::Isometry3<f64>] {
        &self.poses
    }

    /// Returns the signed distance of a point, negative inside the hand.
    ///
    /// Exact for boxes, capsules and hulls. Near an ellipsoid it is exact to first order in the distance and never above the
    /// true signed distance: the gauge g(p) = |p / semi-axes| is convex, so the distance to its tangent plane at level
    /// 1, (g - 1) / |grad g|, is a lower bound.
    pub fn distance(&self, p: Vec3) -> f32 {
        self.distance_within(p, f32::INFINITY)
    }

    /// Returns the lesser of [`HandSolid::distance`] and `limit`. A smaller limit takes less time.
    pub fn distance_within(&self, p: Vec3, limit: f32) -> f32 {
        let p = Vec3A::from(p);
        let mut least = limit;
        for limb in &self.limbs {
            if limb.bound.is_beyond(p, least) {
                continue;
            }
            for member in &limb.members {
                if !member.bound.is_beyond(p, least) {
                    let distance = member.distance(p);
                    if distance < least {
                        least = distance;
                    }
                }
            }
        }
        least
    }

    /// Returns the surface of the hand that is nearest to a point; `None` if it is not within `limit_m`.
    pub fn nearest(&self, p: Vec3, limit_m: f32) -> Option<Nearest> {
        let p = Vec3A::from(p);
        let mut least = limit_m;
        let mut nearest = None;
        for limb in self.limbs.iter().filter(|limb| !limb.bound.is_beyond(p, limit_m)) {
            for member in &limb.members {
                if !member.bound.is_beyond(p, least) {
                    let distance_m = member.distance(p);
                    if distance_m < least {
                        (least, nearest) = (distance_m, Some(member));
                    }
                }
            }
        }
        let member = nearest?;
        Some(Nearest { distance_m: least, normal: member.gradient(p).into(), body: member.body })
    }

    /// Returns whether [`HandSolid::distance`] is less than `margin`. Faster than the distance itself.
    pub fn is_within(&self, p: Vec3, margin: f32) -> bool {
        let p = Vec3A::from(p);
        let limbs = self.limbs.iter().filter(|limb| !limb.bound.is_beyond(p, margin));
        limbs.flat_map(|limb| &limb.members).any(|m| !m.bound.is_beyond(p, margin) && m.distance(p) < margin)
    }

    /// Returns whether there is no hand, or nothing of it.
    pub fn is_empty(&self) -> bool {
        self.limbs.is_empty()
    }

    /// Returns the primitives within `radius` of `centre`. For a point at distance d from `centre`, they give the same
    /// answer as the whole hand to [`HandSolid::is_within`] with margins up to `radius` - d.
    pub fn cropped(&self, centre: Vec3, radius: f32) -> Self {
        let centre = Vec3A::from(centre);
        let limbs = self.limbs.iter().filter(|limb| !limb.bound.is_beyond(centre, radius));
        let members = limbs.flat_map(|limb| &limb.members);
        let near = members.filter(|m| !m.bound.is_beyond(centre, radius) && m.distance(centre) < radius);
        let members: Vec<Member> = near.cloned().collect();
        let limbs = if members.is_empty() { Vec::new() } else { vec![Limb::new(members)] };
        Self { limbs, poses: self.poses.clone() }
    }
}

/// Points inside the hand, drawn once in the coordinates of its bodies and posed at any joint angles.
#[derive(Debug, Clone)]
pub struct HandSamples {
    hand: Arc<Hand>,
    /// Bodies that have parts, and points in their coordinates.
    bodies: Vec<(usize, Vec<Occupied>)>,
}

impl HandSamples {
    /// Draws one random point per cube of edge `spacing_m` and keeps those inside the hand. `seed` sets the random
    /// positions.
    pub fn new(hand: &Arc<Hand>, spacing_m: f64, seed: u64) -> Self {
        let bodies = Self::sampled(hand).map(|body| {
            let parts = &hand.bodies()[body].parts;
            let mut points = Vec::new();
            for (k, part) in parts.iter().enumerate() {
                // Keeps a point that lies in two parts of a body once.
                let fresh = |p: &na::Vector3<f64>| parts[..k].iter().all(|earlier| depth(&earlier.shape, p) <= 0.0);
                points.extend(jittered_grid(&part.shape, spacing_m, seed).filter(fresh).filter_map(|p| {
                    let depth = parts.iter().map(|part| depth(&part.shape, &p)).fold(0.0, f64::max);
                    (depth > 0.0).then(|| Occupied { point: vec3a(p).into(), depth_m: depth as f32 })
                }));
            }
            (body, points)
        });
        Self { hand: Arc::clone(hand), bodies: bodies.collect() }
    }

    /// The bodies that have parts.
    fn sampled(hand: &Hand) -> impl Iterator<Item = usize> {
        hand.bodies().iter().enumerate().filter(|(_, body)| !body.parts.is_empty()).map(|(k, _)| k)
    }

    /// The points of each body, in its coordinates.
    pub fn bodies(&self) -> impl Iterator<Item = &[Occupied]> {
        self.bodies.iter().map(|(_, points)| points.as_slice())
    }

    /// Where each body is at given joint angles, in the order of [`HandSamples::bodies`].
    pub fn body_poses(hand: &Hand, joints: &[f64]) -> Vec<Isometry<Obstacle, World>> {
        let poses = hand.body_poses(joints);
        Self::sampled(hand).map(|body| Isometry::new(poses[body])).collect()
    }

    /// The points in the world at given joint angles, in an order that does not depend on them.
    pub fn posed(&self, joints: &[f64]) -> impl Iterator<Item = Occupied> {
        let poses = self.hand.body_poses(joints);
        self.bodies.iter().flat_map(move |(body, points)| {
            let (rotation, translation) = Isometry::<Obstacle, World>::new(poses[*body]).to_f32();
            points.iter().map(move |&Occupied { point, depth_m }| Occupied {
                point: (rotation * point) + Vec3::from(translation),
                depth_m,
            })
        })
    }
}

/// Returns one random point in each cube of a grid around a primitive.
fn jittered_grid(shape: &Primitive, spacing_m: f64, seed: u64) -> impl Iterator<Item = na::Vector3<f64>> {
    let (centre, half, rotation) = match shape {
        Primitive::Box { centre, half: extent, orientation_wxyz }
        | Primitive::Ellipsoid { centre, semi: extent, orientation_wxyz } => {
            let is_turned = orientation_wxyz[1..].iter().any(|q| *q != 0.0);
            let turned = is_turned.then(|| turn(orientation_wxyz));
            (na::Vector3::from(*centre), na::Vector3::from(*extent), turned)
        }
        Primitive::Capsule { from, to, radius } => {
            let (from, to) = (na::Vector3::from(*from), na::Vector3::from(*to));
            let half = (to - from).abs() / 2.0 + na::Vector3::repeat(*radius);
            ((from + to) / 2.0, half, None)
        }
        Primitive::Hull(hull) => {
            let corners = || hull.vertices().iter().map(|v| na::Vector3::from(*v));
            let low = corners().fold(na::Vector3::repeat(f64::INFINITY), |low, v| low.inf(&v));
            let high = corners().fold(na::Vector3::repeat(f64::NEG_INFINITY), |high, v| high.sup(&v));
            ((low + high) / 2.0, (high - low) / 2.0, None)
        }
    };
    let cells: na::Vector3<u64> = (half * 2.0 / spacing_m).map(|n| n.ceil().max(1.0) as u64);
    let cubes = (0..cells.x).flat_map(move |x| (0..cells.y).flat_map(move |y| (0..cells.z).map(move |z| [x, y, z])));
    let corner = centre - cells.map(|n| n as f64) * (spacing_m / 2.0);
    cubes.enumerate().map(move |(cube, cell)| {
        let within = |axis: usize| uniform(seed ^ (3 * cube as u64 + axis as u64));
        let point = corner + na::Vector3::from_fn(|axis, _| (cell[axis] as f64 + within(axis)) * spacing_m);
        rotation.map_or(point, |rotation| centre + rotation * (point - centre))
    })
}

/// Maps an integer to a number in [0, 1) (the mixing step of SplitMix64).
fn uniform(seed: u64) -> f64 {
    let mut z = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
}

/// Returns a lower bound of the depth of a point in a primitive, in a body's coordinates; negative or 0 outside.
fn depth(shape: &Primitive, p: &na::Vector3<f64>) -> f64 {
    let from_centre = |centre: &[f64; 3], orientation_wxyz: &[f64; 4]| {
        turn(orientation_wxyz).inverse_transform_vector(&(p - na::Vector3::from(*centre)))
    };
    match shape {
        Primitive::Box { centre, half, orientation_wxyz } => {
            (na::Vector3::from(*half) - from_centre(centre, orientation_wxyz).abs()).min()
        }
        Primitive::Capsule { from, to, radius } => {
            let (from, to) = (na::Vector3::from(*from), na::Vector3::from(*to));
            let axis = to - from;
            let along = (axis.dot(&(p - from)) / axis.norm_squared().max(f64::MIN_POSITIVE)).clamp(0.0, 1.0);
            radius - (p - from - axis * along).norm()
        }
        Primitive::Ellipsoid { centre, semi, orientation_wxyz } => {
            // The gauge changes by at most 1 over the shortest semi-axis per metre.
            let semi = na::Vector3::from(*semi);
            (1.0 - from_centre(centre, orientation_wxyz).component_div(&semi).norm()) * semi.min()
        }
        Primitive::Hull(hull) => f64::from(-hull.distance(vec3a(*p)).0),
    }
}

/// Returns the rotation of a quaternion (w, x, y, z).
fn turn(&[w, x, y, z]: &[f64; 4]) -> na::UnitQuaternion<f64> {
    na::UnitQuaternion::from_quaternion(na::Quaternion::new(w, x, y, z))
}

impl Limb {
    fn new(members: Vec<Member>) -> Self {
        let ends = |sign: f32| members.iter().map(move |m| m.bound.centre + sign * Vec3A::splat(m.bound.radius));
        let low = ends(-1.0).fold(Vec3A::INFINITY, Vec3A::min);
        let high = ends(1.0).fold(Vec3A::NEG_INFINITY, Vec3A::max);
        let centre = (low + high) / 2.0;
        let reach = |m: &Member| (m.bound.centre - centre).length() + m.bound.radius;
        Self { bound: Sphere { centre, radius: members.iter().map(reach).fold(0.0, f32::max) }, members }
    }
}

impl Member {
    fn new(body: usize, part: &Part, world_from_body: &na::Isometry3<f64>) -> Self {
        // There is no frame type for bodies; any frame serves for the conversion.
        let axes_of = |rotation: na::UnitQuaternion<f64>| {
            let pose = na::Isometry3::from_parts(world_from_body.translation, world_from_body.rotation * rotation);
            Isometry::<Obstacle, World>::new(pose).to_f32().0.transpose()
        };
        let place = |p: na::Vector3<f64>| vec3a((world_from_body * na::Point3::from(p)).coords);
        let (centre, radius, shape) = match &part.shape {
            Primitive::Box { centre, half, orientation_wxyz } => {
                let half = vec3a((*half).into());
                ((*centre).into(), half.length(), Shape::Box { axes: axes_of(turn(orientation_wxyz)), half })
            }
            Primitive::Capsule { from, to, radius } => {
                let (from, to) = (na::Vector3::from(*from), na::Vector3::from(*to));
                let half_axis = vec3a(world_from_body.rotation * (to - from) / 2.0);
                let radius = *radius as f32;
                // A capsule of zero length is a ball, without an axis to project on.
                let square = half_axis.length_squared();
                let inverse_square = if square > 0.0 { 1.0 / square } else { 0.0 };
                let shape = Shape::Capsule { half_axis, inverse_square, radius };
                ((from + to) / 2.0, half_axis.length() + radius, shape)
            }
            Primitive::Ellipsoid { centre, semi, orientation_wxyz } => {
                let semi = vec3a((*semi).into());
                let (axes, longest) = (axes_of(turn(orientation_wxyz)), semi.max_element());
                ((*centre).into(), longest, Shape::Ellipsoid { axes, inverse_semi: semi.recip(), longest })
            }
            Primitive::Hull(hull) => {
                let (centre, radius) = hull.bound();
                let axes = axes_of(na::UnitQuaternion::identity());
                let centre = na::Vector3::from(centre.to_array().map(f64::from));
                (centre, radius, Shape::Hull { axes, hull: hull.clone() })
            }
        };
        Self { body, bound: Sphere { centre: place(centre), radius }, shape }
    }

    fn distance(&self, p: Vec3A) -> f32 {
        let p = p - self.bound.centre;
        match &self.shape {
            &Shape::Box { axes, half } => {
                let beyond = (axes * p).abs() - half;
                beyond.max(Vec3A::ZERO).length() + beyond.max_element().min(0.0)
            }
            &Shape::Capsule { half_axis, inverse_square, radius } => {
                from_axis(p, half_axis, inverse_square).length() - radius
            }
            &Shape::Ellipsoid { axes, inverse_semi, longest } => gauge(axes * p, inverse_semi, longest),
            Shape::Hull { axes, hull } => hull.distance(*axes * p + hull.bound().0).0,
        }
    }

    /// Returns the unit direction in which the distance grows, world frame. Any such direction where there are several.
    fn gradient(&self, p: Vec3A) -> Vec3A {
        let p = p - self.bound.centre;
        let direction = match &self.shape {
            &Shape::Box { axes, half } => {
                let local = axes * p;
                let beyond = local.abs() - half;
                let outside = beyond.max(Vec3A::ZERO);
                let away = if outside != Vec3A::ZERO {
                    outside
                } else {
                    // Inside, the nearest face.
                    let most = beyond.max_element();
                    let faces = beyond.cmpeq(Vec3A::splat(most));
                    Vec3A::select(faces, Vec3A::ONE, Vec3A::ZERO)
                };
                axes.transpose() * (away * local.signum())
            }
            &Shape::Capsule { half_axis, inverse_square, .. } => from_axis(p, half_axis, inverse_square),
            &Shape::Ellipsoid { axes, inverse_semi, .. } => {
                let local = axes * p;
                axes.transpose() * (local * inverse_semi * inverse_semi)
            }
            Shape::Hull { axes, hull } => axes.transpose() * hull.distance(*axes * p + hull.bound().0).1,
        };
        direction.normalize_or(Vec3A::Z)
    }
}

/// Returns the vector to `p` from the nearest point of the segment between plus and minus `half_axis`.
fn from_axis(p: Vec3A, half_axis: Vec3A, inverse_square: f32) -> Vec3A {
    p - half_axis * (p.dot(half_axis) * inverse_square).clamp(-1.0, 1.0)
}

/// Returns a lower bound of the signed distance from an ellipsoid around the origin: the greater of two bounds. The
/// distance from the sphere around the ellipsoid is the better bound far away, and the only one at the centre, where
/// the gauge has no gradient.
fn gauge(p: Vec3A, inverse_semi: Vec3A, longest: f32) -> f32 {
    let scaled = p * inverse_semi;
    let along = scaled * inverse_semi;
    let (g, slope, distance) = (scaled.length(), along.length(), p.length());
    let tangent = g * (g - 1.0) / slope;
    let sphere = distance - longest;
    if tangent > sphere { tangent } else { sphere }
}

fn vec3a(v: na::Vector3<f64>) -> Vec3A {
    glam::DVec3::new(v.x, v.y, v.z).as_vec3a()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hand::{JointAngles, PartSurface, Side};
    use parry3d::math::Vector as Parry;
    use parry3d::query::PointQuery as _;
    use parry3d::shape::{Capsule, Cuboid};
    use proptest::prelude::*;

    /// Returns the signed distance to one part, computed by parry, and by bisection for ellipsoids.
    fn reference(part: &Part, pose: &na::Isometry3<f64>, p: Vec3) -> f32 {
        let p = pose.inverse() * na::Point3::new(p.x.into(), p.y.into(), p.z.into());
        let local = |origin: [f64; 3]| {
            let d = p.coords - na::Vector3::from(origin);
            Parry::new(d.x as f32, d.y as f32, d.z as f32)
        };
        let v = |a: [f64; 3]| Parry::new(a[0] as f32, a[1] as f32, a[2] as f32);
        match &part.shape {
            Primitive::Box { centre, half, .. } => Cuboid::new(v(*half)).distance_to_local_point(local(*centre), false),
            Primitive::Capsule { from, to, radius } => {
                Capsule::new(v(*from), v(*to), *radius as f32).distance_to_local_point(local([0.0; 3]), false)
            }
            Primitive::Ellipsoid { centre, semi, .. } => {
                ellipsoid_distance(p.coords - na::Vector3::from(*centre), (*semi).into()) as f32
            }
            Primitive::Hull(_) => unreachable!("the Allegro has no hulls"),
        }
    }

    /// The nearest point x of an ellipsoid has p - x = t x / semi^2; t by bisection.
    fn ellipsoid_distance(p: na::Vector3<f64>, semi: na::Vector3<f64>) -> f64 {
        let square = semi.component_mul(&semi);
        let nearest = |t: f64| p.component_mul(&square).component_div(&square.add_scalar(t));
        let (mut low, mut high) = (-square.min(), p.norm() * semi.max());
        for _ in 0..200 {
            let t = (low + high) / 2.0;
            if nearest(t).component_div(&semi).norm() > 1.0 { low = t } else { high = t }
        }
        let sign = if p.component_div(&semi).norm() < 1.0 { -1.0 } else { 1.0 };
        (p - nearest(high)).norm() * sign
    }

    fn is_gel(part: &Part) -> bool {
        matches!(part.surface, PartSurface::Gel(_))
    }

    /// The hand without its gels, whose distances are only bounds.
    fn without_gels(side: Side, joints: &JointAngles) -> HandSolid {
        let mut description = Hand::allegro(side).description().clone();
        for body in &mut description.bodies {
            body.parts.retain(|part| !is_gel(part));
        }
        HandSolid::new(&Hand::new(description).unwrap(), joints)
    }

    fn solid(side: Side, joints: &JointAngles) -> HandSolid {
        HandSolid::new(&Hand::allegro(side), joints)
    }

    fn posture() -> impl Strategy<Value = JointAngles> {
        proptest::array::uniform16(0.0..1.0f64).prop_map(|t| {
            let ranges = Hand::allegro(Side::Right).ranges();
            ranges.iter().zip(t).map(|([low, high], t)| low + t * (high - low)).collect()
        })
    }

    fn place() -> impl Strategy<Value = Vec3> {
        (-0.13..0.18f32, -0.12..0.12f32, -0.08..0.2f32).prop_map(|(x, y, z)| Vec3::new(x, y, z))
    }

    fn side() -> impl Strategy<Value = Side> {
        prop_oneof![Just(Side::Left), Just(Side::Right)]
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(2000))]

        #[test]
        fn distance_is_that_of_the_nearest_part(side in side(), joints in posture(), p in place()) {
            for (solid, with_gels) in [(solid(side, &joints), true), (without_gels(side, &joints), false)] {
                let (hand, poses) = (Hand::allegro(side), solid.body_poses());
                let wanted = hand.parts().filter(|(_, part)| with_gels || !is_gel(part));
                let exact = wanted.map(|(body, part)| reference(part, &poses[body], p)).fold(f32::INFINITY, f32::min);
                let distance = solid.distance(p);
                prop_assert!(distance <= exact + 1e-6, "{distance} is more than {exact}");
                // Boxes and capsules are exact; the error of a gel's bound grows with the square of the distance.
                // Inside, the error is largest at the centre: the true depth is 9 mm, the bound is the longest
                // semi-axis, 16.5 mm.
                let growth = if exact < 0.0 { 7.5e-3 / 9e-3f32.powi(2) } else { 60.0 };
                let lacks = if with_gels { (growth * exact * exact).min(0.0075) } else { 0.0 };
                prop_assert!(distance >= exact - lacks - 2e-6, "{distance} instead of {exact}");
                prop_assert!(distance * exact >= 0.0 || exact.abs() < 1e-6, "sign of {distance} against {exact}");
            }
        }

        #[test]
        fn the_normal_is_the_gradient_of_the_distance(side in side(), joints in posture(), p in place()) {
            const STEP_M: f32 = 2e-4;
            let solid = without_gels(side, &joints);
            let Some(nearest) = solid.nearest(p, 0.05) else {
                prop_assert!(solid.distance(p) >= 0.05);
                return Ok(());
            };
            prop_assert!((nearest.distance_m - solid.distance(p)).abs() < 1e-7);
            // Of the nearest primitive alone: at its own creases, and where another is as near, there is no gradient. A mean of two normals that is
            // shorter than one by 1e-3 is up to 0.045 from either.
            let along = |axis: Vec3| (solid.distance(p + axis * STEP_M) - solid.distance(p - axis * STEP_M)) / (2.0 * STEP_M);
            let gradient = Vec3::new(along(Vec3::X), along(Vec3::Y), along(Vec3::Z));
            if (gradient.length() - 1.0).abs() < 1e-3 && nearest.distance_m.abs() > 1e-3 {
                prop_assert!(gradient.angle_between(nearest.normal) < 0.05, "{gradient} {:?}", nearest);
            }
        }

        #[test]
        fn limit_changes_nothing_below_it(joints in posture(), p in place(), limit in -0.01..0.05f32) {
            let solid = solid(Side::Left, &joints);
            prop_assert!((solid.distance_within(p, limit) - solid.distance(p).min(limit)).abs() < 1e-7);
            prop_assert!(solid.is_within(p, limit) == (solid.distance(p) < limit) || (solid.distance(p) - limit).abs() < 1e-7);
        }

        #[test]
        fn crop_answers_for_points_around_its_centre(joints in posture(), p in place(), to in place(), ball in 0.001..0.03f32) {
            let solid = solid(Side::Left, &joints);
            const MARGIN: f32 = 0.003;
            let q = p + (to - p).normalize_or_zero() * (0.999 * ball);
            let cropped = solid.cropped(p, ball + MARGIN);
            // A gel's bound is below its distance, so only points that are truly near must be found again.
            let truly = without_gels(Side::Left, &joints).is_within(q, MARGIN);
            prop_assert!(cropped.is_within(q, MARGIN) || !truly);
            prop_assert!(solid.is_within(q, MARGIN) || !cropped.is_within(q, MARGIN));
        }

        #[test]
        fn left_hand_is_the_mirror_image(joints in posture(), p in place()) {
            let mirror = Vec3::new(1.0, -1.0, 1.0);
            let right = solid(Side::Right, &joints).distance(p);
            let left = solid(Side::Left, &Hand::allegro(Side::Left).mirrored(&joints)).distance(p * mirror);
            prop_assert!((right - left).abs() < 1e-6);
        }

        #[test]
        fn samples_are_inside_and_no_nearer_to_the_outside_than_they_say(joints in posture(), side in side()) {
            let solid = solid(side, &joints);
            for Occupied { point, depth_m } in HandSamples::new(&Hand::allegro(side), 0.008, 5).posed(&joints) {
                prop_assert!(solid.distance(point) <= -depth_m + 1e-6, "{point}: {} and {depth_m}", solid.distance(point));
            }
        }
    }

    #[test]
    fn samples_fill_the_volume_and_follow_the_seed() {
        let (joints, hand) = ([0.3; 16], Hand::allegro(Side::Right));
        let of = |spacing, seed| HandSamples::new(&hand, spacing, seed).posed(&joints).collect::<Vec<_>>();
        assert_eq!(of(0.005, 1), of(0.005, 1));
        assert_ne!(of(0.005, 1), of(0.005, 2));
        let palm = HandSamples::new(&hand, 0.004, 9);
        let (body, points) = &palm.bodies[0];
        assert_eq!(hand.bodies()[*body].name, "palm");
        let volume = points.len() as f64 * 0.004f64.powi(3) / (8.0 * 0.0204 * 0.0565 * 0.0475);
        assert!((volume - 1.0).abs() < 0.05, "{volume}");
        assert!(palm.bodies.iter().any(|(body, points)| hand.bodies()[*body].name == "thumb_tip" && points.len() > 50));
    }

    #[test]
    fn centre_of_a_gel_is_deep_inside() {
        let joints = vec![0.2; 16];
        let pose = Hand::allegro(Side::Right).world_from_pads(&joints)[0].untyped();
        let centre = pose * na::Point3::new(0.0111, 0.0, 0.0165);
        let centre = Vec3::new(centre.x as f32, centre.y as f32, centre.z as f32);
        assert!(solid(Side::Right, &joints).distance(centre) < -0.008);
    }
}
