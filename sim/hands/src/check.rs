//! What of a hand is where: extents, overlaps, and gels that link hide.

use std::sync::Arc;

use glam::Vec3;
use mvt_robot::hand::solid::HandSolid;
use mvt_robot::hand::{Body, GraspPoint, Hand, HandDescription, HandError, Part, PartSurface, Placing, Side, TouchPad};
use nalgebra as na;

use crate::shape;

/// Depth from which two parts overlap, metres. Less is due to the reduction of meshes to hulls.
const DEPTH_M: f32 = 0.5e-3;
/// Points per axis by which a part is sampled.
const SAMPLES: usize = 12;
/// Distances before the gel at which it must be free of its own link, metres.
const BEFORE_GEL_M: [f64; 4] = [0.001, 0.003, 0.006, 0.010];
/// Half the sides of the middle of a gel, in shares of the pad's.
const MIDDLE: f64 = 0.3;
/// Share of the space before a gel that may be covered.
const COVERED: f64 = 0.1;

/// Returns the longest side of the box around the hand at joint angles 0, metres; that of the frames if there are no parts.
pub(crate) fn extent_m(description: &HandDescription) -> f64 {
    let poses = poses(description);
    let parts = description.bodies.iter().zip(&poses);
    let outline = parts.flat_map(|(body, pose)| {
        body.parts.iter().flat_map(move |part| shape::outline(&part.shape).into_iter().map(move |p| pose * p))
    });
    let mut points: Vec<na::Point3<f64>> = outline.collect();
    if points.is_empty() {
        points.extend(poses.iter().map(|pose| na::Point3::from(pose.translation.vector)));
    }
    let Some(first) = points.first().map(|point| point.coords) else { return 0.0 };
    let (low, high) = points.iter().fold((first, first), |(low, high), p| (low.inf(&p.coords), high.sup(&p.coords)));
    (high - low).max()
}

/// Returns the poses of the bodies at joint angles 0, of a description that is not checked.
fn poses(description: &HandDescription) -> Vec<na::Isometry3<f64>> {
    let mut poses: Vec<na::Isometry3<f64>> = Vec::with_capacity(description.bodies.len());
    for body in &description.bodies {
        let place = untyped(&body.place);
        let parent = body.parent.and_then(|parent| poses.get(parent)).copied();
        poses.push(parent.map_or(place, |parent| parent * place));
    }
    poses
}

/// Returns the middle of the apexes of the pads at joint angles 0, which moves with no body.
pub(crate) fn middle_of_pads(description: &HandDescription) -> Option<GraspPoint> {
    let poses = poses(description);
    let apex = |pad: &TouchPad| {
        let apex_m = pad.profile.gel_surface().apex_m();
        poses.get(pad.body).map(|pose| pose * untyped(&pad.place) * na::Point3::new(apex_m, 0.0, 0.0))
    };
    let apexes: Vec<na::Point3<f64>> = description.pads.iter().filter_map(apex).collect();
    let sum = apexes.iter().fold(na::Vector3::zeros(), |sum, apex| sum + apex.coords);
    (!apexes.is_empty()).then(|| GraspPoint { body: None, point_m: (sum / apexes.len() as f64).into() })
}

/// Returns the hand with the pairs of bodies whose sensors overlap at rest set apart, and warns of them. Links do not collide with links.
pub(crate) fn without_overlaps(hand: &Arc<Hand>, warnings: &mut Vec<String>) -> Result<Arc<Hand>, HandError> {
    let poses = hand.body_poses(&hand.within_ranges(&vec![0.0; hand.joints().len()]));
    let bodies = hand.bodies();
    let housing = |body: &Body| -> Vec<Part> {
        body.parts.iter().filter(|part| part.surface == PartSurface::Housing).cloned().collect()
    };
    let housings: Vec<Vec<Part>> = bodies.iter().map(housing).collect();
    let mut description = hand.description().clone();
    // Bodies that no joint moves against one another, and neighbours, do not collide anyway.
    let anchored = |body: usize| hand.chain(body).last().copied();
    let before = |body: usize| hand.chain(body).iter().rev().nth(1).copied();
    let mut found = Vec::new();
    for a in 0..bodies.len() {
        for b in a + 1..bodies.len() {
            let neighbours = anchored(a) == anchored(b)
                || (anchored(b).is_some() && before(b) == anchored(a))
                || (anchored(a).is_some() && before(a) == anchored(b));
            let known = |pair: &[usize; 2]| *pair == [a, b] || *pair == [b, a];
            if neighbours || description.apart.iter().any(known) {
                continue;
            }
            if overlap(&housings[a], &poses[a], &housings[b], &poses[b]) {
                description.apart.push([a, b]);
                found.push(format!("{} and {}", bodies[a].name, bodies[b].name));
            }
        }
    }
    if found.is_empty() {
        return Ok(Arc::clone(hand));
    }
    warnings.push(format!(
        "the sensors of these links overlap at joint angles 0, so they do not collide: {}",
        found.join(", ")
    ));
    Hand::new(description)
}

/// Returns whether parts of two bodies lie in one another. The poses are those of the bodies in a common frame.
pub(crate) fn overlap(a: &[Part], pose_a: &na::Isometry3<f64>, b: &[Part], pose_b: &na::Isometry3<f64>) -> bool {
    if a.is_empty() || b.is_empty() {
        return false;
    }
    // In the frame of `a`.
    let between = pose_a.inverse() * pose_b;
    let (solid_a, solid_b) = (solid(a, &na::Isometry3::identity()), solid(b, &between));
    let [Some(solid_a), Some(solid_b)] = [solid_a, solid_b] else { return false };
    let within = |p: &Vec3| solid_a.is_within(*p, -DEPTH_M) && solid_b.is_within(*p, -DEPTH_M);
    let bounds = [bounds(a, &na::Isometry3::identity()), bounds(b, &between)];
    let [(low_a, high_a), (low_b, high_b)] = bounds;
    let (low, high) = (low_a.sup(&low_b), high_a.inf(&high_b));
    if (high - low).min() <= 0.0 {
        return false;
    }
    let at = |axis: usize, k: usize| low[axis] + (high - low)[axis] * (k as f64 + 0.5) / SAMPLES as f64;
    let mut cells = (0..SAMPLES.pow(3)).map(|k| [k % SAMPLES, k / SAMPLES % SAMPLES, k / SAMPLES / SAMPLES]);
    cells.any(|[i, j, k]| within(&Vec3::new(at(0, i) as f32, at(1, j) as f32, at(2, k) as f32)))
}

/// Returns a solid of parts alone.
fn solid(parts: &[Part], pose: &na::Isometry3<f64>) -> Option<HandSolid> {
    let parts = parts.iter().map(|part| Part { surface: PartSurface::Link, shape: part.shape.clone() }).collect();
    let body = Body { name: "body".to_owned(), parent: None, place: placed(pose), inertial: None, parts };
    let description = HandDescription {
        name: "parts".to_owned(),
        side: Side::Right,
        bodies: vec![body],
        joints: Vec::new(),
        pads: Vec::new(),
        apart: Vec::new(),
        palm_centre_m: None,
        grasp: None,
    };
    let hand = Hand::new(description).ok()?;
    Some(HandSolid::new(&hand, &[]))
}

fn bounds(parts: &[Part], pose: &na::Isometry3<f64>) -> (na::Vector3<f64>, na::Vector3<f64>) {
    let points = parts.iter().flat_map(|part| shape::outline(&part.shape)).map(|point| (pose * point).coords);
    let (low, high) = (na::Vector3::repeat(f64::INFINITY), na::Vector3::repeat(f64::NEG_INFINITY));
    points.fold((low, high), |(low, high), p| (low.inf(&p), high.sup(&p)))
}

/// Returns warnings about gels that face into the parts of their own hand that move with them.
pub(crate) fn covered_gels(hand: &Hand) -> Vec<String> {
    let poses = hand.body_poses(&[]);
    let mut warnings = Vec::new();
    for pad in hand.pads() {
        let with_it = (0..hand.bodies().len()).filter(|&body| hand.chain(body) == hand.chain(pad.body));
        let others: Vec<(usize, HandSolid)> = with_it
            .filter_map(|body| {
                let parts = &hand.bodies()[body].parts;
                // The gel and the housing of the sensor itself are no obstacles before it.
                let own = |part: &&Part| body != pad.body || part.surface == PartSurface::Link;
                let parts: Vec<Part> = parts.iter().filter(own).cloned().collect();
                Some((body, solid(&parts, &poses[body])?)).filter(|_| !parts.is_empty())
            })
            .collect();
        let world_from_gel = poses[pad.body] * untyped(&pad.place);
        let (apex_m, middle_m) = (pad.profile.gel_surface().apex_m(), pad.profile.size_mm.map(|mm| MIDDLE * mm / 1e3));
        let steps = || [-1.0, -0.5, 0.0, 0.5, 1.0].into_iter();
        let points = BEFORE_GEL_M.iter().flat_map(|before| {
            steps().flat_map(move |y| {
                steps().map(move |z| na::Point3::new(apex_m + before, y * middle_m[0], z * middle_m[1]))
            })
        });
        let points: Vec<na::Point3<f64>> = points.map(|point| world_from_gel * point).collect();
        for (body, solid) in others {
            let inside = |p: &&na::Point3<f64>| solid.is_within(Vec3::new(p.x as f32, p.y as f32, p.z as f32), 0.0);
            let share = points.iter().filter(inside).count() as f64 / points.len() as f64;
            if share > COVERED {
                warnings.push(format!(
                    "the gel of pad {} faces into {}, which covers {:.0} % of it; turn or move the pad",
                    pad.name,
                    hand.bodies()[body].name,
                    100.0 * share
                ));
            }
        }
    }
    warnings
}

fn untyped(place: &Placing) -> na::Isometry3<f64> {
    let ([x, y, z], [w, i, j, k]) = (place.position_m, place.orientation_wxyz);
    let turn = na::UnitQuaternion::from_quaternion(na::Quaternion::new(w, i, j, k));
    na::Isometry3::from_parts(na::Translation3::new(x, y, z), turn)
}

fn placed(place: &na::Isometry3<f64>) -> Placing {
    Placing { position_m: place.translation.vector.into(), orientation_wxyz: shape::wxyz(&place.rotation) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use mvt_robot::hand::{Primitive, UPRIGHT};

    fn cube(half: f64) -> [Part; 1] {
        let shape = Primitive::Box { centre: [0.0; 3], half: [half; 3], orientation_wxyz: UPRIGHT };
        [Part { surface: PartSurface::Link, shape }]
    }

    #[test]
    fn overlaps_are_found() {
        let at = |x: f64| na::Isometry3::translation(x, 0.0, 0.0);
        let overlaps = |x: f64| overlap(&cube(0.01), &at(0.1), &cube(0.02), &at(0.1 + x));
        assert!(overlaps(0.0) && overlaps(0.028) && overlaps(-0.028));
        assert!(!overlaps(0.0305) && !overlaps(0.5));
        assert!(!overlap(&[], &at(0.0), &cube(0.02), &at(0.0)));
    }

    #[test]
    fn sensors_that_overlap_at_rest_do_not_collide() {
        let hand = Hand::allegro(Side::Right);
        let mut description = hand.description().clone();
        let mut warnings = Vec::new();
        assert_eq!(without_overlaps(&hand, &mut warnings).unwrap(), hand);
        assert_eq!(warnings, Vec::<String>::new());
        // The middle finger where the index finger is.
        description.bodies[6].place = description.bodies[1].place;
        let hand = without_overlaps(&Hand::new(description).unwrap(), &mut warnings).unwrap();
        assert_eq!(hand.description().apart.last(), Some(&[5, 10]));
        assert!(warnings[0].contains("index_tip and middle_tip"), "{warnings:?}");
    }

    #[test]
    fn the_allegro_spans_a_hand() {
        let hand = Hand::allegro(Side::Right);
        let extent = extent_m(hand.description());
        assert!((0.2..0.3).contains(&extent), "{extent}");
        assert_eq!(covered_gels(&hand), Vec::<String>::new());
    }
}
