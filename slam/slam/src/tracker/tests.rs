use glam::Vec3;
use mvt_frames::Camera;
use mvt_frames::camera::look_at;
use proptest::prelude::*;
use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;

use super::relocalise::Reach;
use super::*;
use crate::scan;
use crate::scan::Measurement;
use crate::synthetic::{BRICK, GEL_M, PLACE_M, Solid, blotches, camera, feel, frame, pose, see, seen, seen_painted};
use mvt_field::shape::Distance;
use mvt_frames::depth::TouchDepth;

mod scans;
mod texels;

fn matching(points: usize) -> Matching {
    Matching { points, independent: 100.0, reach_m: icp::REACH_M }
}

/// A ball away from the origin, so that turns move it, with distances that have no grid.
struct Ball {
    centre: Vec3,
    radius: f32,
}

const BALL: Ball = Ball { centre: Vec3::new(0.012, -0.008, 0.005), radius: 0.03 };

impl Shape for Ball {
    fn distances(&self, points: &[Vec3], out: &mut [f32]) {
        out.iter_mut().zip(points).for_each(|(out, p)| *out = (p - self.centre).length() - self.radius);
    }

    fn distances_and_gradients(&self, points: &[Vec3], out: &mut [Distance]) {
        for (out, p) in out.iter_mut().zip(points) {
            let from_centre = p - self.centre;
            *out = Distance { value_m: from_centre.length() - self.radius, gradient: from_centre.normalize() };
        }
    }
}

impl Reference for Ball {
    fn trusted(&self, _: &[Vec3], out: &mut [bool]) {
        out.fill(true);
    }

    fn sigma_m(&self) -> f32 {
        0.0002
    }
}

/// All factors are off; a test switches on its own.
fn nothing() -> TrackerConfig {
    TrackerConfig {
        camera_weight: 0.0,
        touch_weight: 0.0,
        free_space_weight: 0.0,
        icp_weight: 0.0,
        colour_weight: 0.0,
        texel_weight: 0.0,
        velocity_weight: 0.0,
        contact_weight: 0.0,
        penetration_weight: 0.0,
        ..TrackerConfig::default()
    }
}

/// Poses of the window: turning, and changing how.
fn poses(count: usize) -> Vec<Isometry<Field, World>> {
    (0..count)
        .map(|k| {
            let k = k as f64;
            pose([0.001 * k, 0.0005 * k * k, -0.0007 * k], [2.0 * k, 1.0 - k * k, 3.0 * k])
        })
        .collect()
}

/// A solid as it is seen and touched, in poses that the tracker is not told exactly.
fn tracker(config: TrackerConfig, solid: Solid, shape: &dyn Reference, occupied: &[Occupied]) -> Tracker {
    let mut tracker = Tracker::new(config);
    for (k, at) in poses(5).into_iter().enumerate() {
        let mut depth = seen(k, solid, at);
        // Fingers move, so that a carried contact does too.
        let touch = feel(solid, at, sensor(solid));
        let t = k as f64;
        let moved = se3::exp(&Twist::new(0.002 * t, -0.001 * t, 0.0005 * t, 0.02 * t, 0.01 * t, -0.03 * t));
        let world_from_pad = Isometry::new(touch.world_from_pad.untyped() * moved);
        depth.touch = vec![Some(TouchDepth { world_from_pad, ..touch })];
        let scan = Arc::new(Scan::new(k, &depth.measured(), &scan::ScanConfig::default(), 1));
        let wrong = Isometry::new(at.untyped() * se3::exp(&Twist::new(0.0007, -0.0004, 0.0006, 0.01, 0.02, -0.015)));
        tracker.push(shape, scan, wrong, occupied.iter().copied());
    }
    tracker
}

/// Above the solid, 1.5 mm into it when it is not turned.
fn sensor(solid: Solid) -> Isometry<Camera, World> {
    let top = f64::from(solid.bounds()[1].z);
    let place = pose([0.003, 0.002, top + f64::from(GEL_M) - 0.0015], [0.0; 3]);
    Isometry::new(place.untyped())
}

/// The normal equations' right side against central differences of the cost, over all poses of the window. The cost has a
/// gradient of its own only through its residuals, so that this checks residuals, derivatives, weights and loss at once.
fn check(mut tracker: Tracker, shape: &dyn Reference, scale: f64, tolerance: f64) {
    const STEP: f64 = 2e-5;
    let system = tracker.linearise(shape, scale);
    assert!(system.cost > 0.0, "nothing to check");
    assert_eq!(system.gradient.len(), 6 * tracker.config.window);
    let held = tracker.held();
    // A metre and a radian are not the same: compared by the motion of a surface 3 cm away.
    let unit = |i: usize| if i % 6 < 3 { 1.0 } else { 1.0 / 0.03 };
    let mut expected = system.gradient.clone();
    for i in 0..expected.len() {
        let k = held + i / 6;
        let kept = tracker.window[k].pose;
        let mut cost = |sign: f64| {
            let mut twist = Twist::zeros();
            twist[i % 6] = sign * STEP * unit(i);
            tracker.window[k].pose = kept * se3::exp(&twist);
            tracker.linearise(shape, scale).cost
        };
        expected[i] = (cost(1.0) - cost(-1.0)) / (2.0 * STEP * unit(i));
        tracker.window[k].pose = kept;
    }
    let scaled = |g: &na::DVector<f64>| na::DVector::from_fn(g.len(), |i, _| g[i] * unit(i));
    let (found, expected) = (scaled(&system.gradient), scaled(&expected));
    let off = (&found - &expected).amax();
    assert!(expected.amax() > 0.0);
    assert!(off < tolerance * expected.amax(), "off by {off} of {}:{found}{expected}", expected.amax());
}

proptest! {
    #[test]
    fn the_derivative_of_a_distance_is_that_of_finite_differences(
        at in prop::array::uniform6(-0.3..0.3f64),
        p in prop::array::uniform3(-0.05..0.05f64),
        d in prop::array::uniform3(-1.0..1.0f64),
    ) {
        const STEP: f64 = 1e-6;
        let (at, p, d) = (se3::exp(&Twist::from(at)), na::Point3::from(p), na::Vector3::from(d));
        // A distance that is linear in space: f(x) = d . x.
        let inside = |at: &na::Isometry3<f64>| at.inverse_transform_point(&p).coords;
        let (_, found) = query::surface(to_vec(inside(&at)), Distance { value_m: 0.0, gradient: to_vec(d) });
        let expected = Twist::from_fn(|i, _| {
            let disturbed = |sign: f64| d.dot(&inside(&(at * se3::exp(&(sign * STEP * Twist::ith(i, 1.0))))));
            (disturbed(1.0) - disturbed(-1.0)) / (2.0 * STEP)
        });
        prop_assert!((found - expected).norm() < 1e-5 * (1.0 + expected.norm()), "{found} {expected}");
    }
}

#[test]
fn surface_residuals() {
    for config in [TrackerConfig { camera_weight: 1.3, ..nothing() }, TrackerConfig { touch_weight: 0.7, ..nothing() }]
    {
        check(tracker(config, Solid::Ball(0.03), &BALL, &[]), &BALL, 1.0, 0.01);
    }
}

#[test]
fn colour_residuals() {
    let solid = Solid::Ball(0.03);
    let shape = Ball { centre: Vec3::ZERO, radius: 0.03 };
    let mut tracker = Tracker::new(TrackerConfig { colour_weight: 1.3, ..nothing() });
    let mut earlier = Vec::new();
    for (k, at) in poses(5).into_iter().enumerate() {
        let sensed = seen_painted(k, solid, at, blotches);
        let scan = Arc::new(Scan::new(k, &sensed.measured(), &scan::ScanConfig::default(), 1));
        tracker.push(&shape, Arc::clone(&scan), at, std::iter::empty());
        tracker.compare_colours(&shape, &|_| earlier.clone());
        if k == 0 {
            earlier.push(EarlierView { scan, pose: at });
        }
    }
    for (k, instant) in tracker.window.iter_mut().enumerate() {
        let k = k as f64;
        instant.pose *= se3::exp(&Twist::new(0.0007, -0.0004 * k, 0.0006, 0.005 * k, 0.01, -0.01));
    }
    // The frame before and the first.
    assert!(tracker.window.iter().skip(2).all(|instant| instant.ties.iter().filter(|tie| tie.len() > 30).count() == 2));
    check(tracker, &shape, 1.0, 1e-3);
}

#[test]
fn velocity_residuals() {
    check(
        tracker(TrackerConfig { velocity_weight: 1.3, ..nothing() }, Solid::Ball(0.03), &BALL, &[]),
        &BALL,
        1.0,
        1e-3,
    );
}

#[test]
fn contact_residuals() {
    let tracker = tracker(TrackerConfig { contact_weight: 1.3, ..nothing() }, BRICK, &BALL, &[]);
    assert!(tracker.window.iter().all(|instant| instant.pads.len() == 1));
    check(tracker, &BALL, 1.0, 1e-3);
}

#[test]
fn a_contact_that_changes_ties_less() {
    // Two frames that both feel the brick; the poses they are given let its surface slip under the pad.
    let mut tracker = tracker(TrackerConfig { contact_weight: 1.0, window: 1, ..nothing() }, BRICK, &BALL, &[]);
    let mut cost = |before: usize, after: usize| {
        let newest = tracker.window.len() - 1;
        for (k, pressed_px) in [(newest - 1, before), (newest, after)] {
            for pad in &mut tracker.window[k].pads {
                pad.pressed_px = pressed_px;
            }
        }
        tracker.linearise(&BALL, 1.0).cost
    };
    let (steady, halved, gone, small) = (cost(8000, 8000), cost(8000, 4000), cost(8000, 800), cost(20, 20));
    assert!(halved < 0.6 * steady && gone < 0.7 * halved, "{steady} {halved} {gone}");
    assert_eq!(gone, cost(800, 8000));
    // Of a few pixels nobody can tell whether they changed.
    assert!(small < 0.7 * halved, "{steady} {halved} {small}");
}

#[test]
fn penetration_residuals() {
    // Points of a hand around the ball, some in it and some at it.
    let at = poses(5)[2];
    let hand: Vec<Occupied> = Solid::Ball(0.03)
        .surface(60)
        .into_iter()
        .enumerate()
        .map(|(i, p)| {
            let inside = BALL.centre.as_dvec3() + glam::DVec3::new(p.x, p.y, p.z) * (0.8 + 0.005 * i as f64);
            let point = (at * mvt_frames::Point::new(inside.x, inside.y, inside.z)).coords();
            Occupied { point: to_vec(point), depth_m: 0.004 }
        })
        .collect();
    let tracker = tracker(TrackerConfig { penetration_weight: 1.3, ..nothing() }, Solid::Ball(0.03), &BALL, &hand);
    // The touch image's free pixels stand in the list as well.
    assert!(tracker.window[3].occupied.iter().filter(|v| v.clearance_m > 0.0).count() > 20);
    check(tracker, &BALL, 1.0, 0.01);
}

#[test]
fn free_space_residuals() {
    // The ball that is assumed is thicker than the one that is seen: rays past the one run through the other.
    let thick = Ball { radius: 0.036, ..BALL };
    let mut tracker = tracker(TrackerConfig { free_space_weight: 1.3, ..nothing() }, Solid::Ball(0.03), &thick, &[]);
    tracker.choose_passed(&thick);
    let held = tracker.held();
    assert!(tracker.window.iter().skip(held).all(|instant| instant.passed.len() > 20));
    check(tracker, &thick, 1.0, 0.01);
}

#[test]
fn all_residuals_together() {
    let mut tracker =
        tracker(TrackerConfig { icp_weight: 0.0, ..TrackerConfig::default() }, Solid::Ball(0.03), &BALL, &[]);
    tracker.choose_passed(&BALL);
    check(tracker, &BALL, 1.0, 0.01);
}

#[test]
fn matches_vanish_at_the_true_motion() {
    let (a, b) = (pose([0.0; 3], [20.0, 10.0, 35.0]), pose([0.001, 0.0005, -0.0005], [21.0, 11.0, 36.0]));
    let scan = |k, at| Scan::new(k, &seen(k, BRICK, at).measured(), &scan::ScanConfig::default(), 1);
    let (scan_a, scan_b) = (scan(0, a), scan(1, b));
    let cost = |b: Isometry<Field, World>| {
        let mut system = System::new(1);
        let (a, b) = (a.untyped(), b.untyped());
        let first = Posed { scan: &scan_a, pose: &a };
        let second = Posed { scan: &scan_b, pose: &b };
        let counts = icp::add(&mut system, (None, first), (Some(0), second), matching(500));
        (system.cost, counts, system.step(1e-6).unwrap())
    };
    let (true_cost, [tried, matched], _) = cost(b);
    assert_eq!(tried, 500);
    assert!(matched > 400, "{matched}");
    let off = se3::exp(&Twist::new(0.0005, -0.0003, 0.0004, 0.005, -0.01, 0.005));
    let wrong = b.untyped() * off;
    let (wrong_cost, _, step) = cost(Isometry::new(wrong));
    assert!(true_cost < 0.2 * wrong_cost, "{true_cost} {wrong_cost}");
    let corrected = wrong * se3::exp(&step.fixed_rows::<6>(0).into_owned());
    let left = se3::log(&(b.untyped().inverse() * corrected));
    assert!(left.fixed_rows::<3>(0).norm() < 0.0002 && left.fixed_rows::<3>(3).norm() < 0.004, "{left}");
}

#[test]
fn scans_without_a_camera_in_common_do_not_match() {
    let at = pose([0.0; 3], [0.0; 3]);
    let full = Scan::new(0, &seen(0, BRICK, at).measured(), &scan::ScanConfig::default(), 1);
    let none = Scan::new(1, &frame(0.1, vec![None]).measured(), &scan::ScanConfig::default(), 1);
    let pose = at.untyped();
    for (a, b) in [(&full, &none), (&none, &full), (&none, &none)] {
        let mut system = System::new(2);
        let [a, b] = [a, b].map(|scan| Posed { scan, pose: &pose });
        assert_eq!(icp::add(&mut system, (Some(0), a), (Some(1), b), matching(100)), [0, 0]);
        assert_eq!(system.cost, 0.0);
    }
}

#[test]
fn the_window_slides() {
    let shape = BALL;
    let mut tracker = Tracker::new(TrackerConfig::default());
    assert!(tracker.solve(&shape).is_none() && tracker.predicted(0.0).is_none());
    assert_eq!(tracker.assess(&shape).confidence, 0.0);
    let empty = Arc::new(Scan::new(0, &frame(0.0, Vec::new()).measured(), &scan::ScanConfig::default(), 1));
    for k in 0..50 {
        tracker.push(&shape, Arc::clone(&empty), pose([0.0; 3], [0.0; 3]), std::iter::empty());
        assert!(tracker.window.len() <= tracker.config.window + 2, "frame {k}");
        assert!(tracker.window.len() - tracker.held() <= tracker.config.window);
    }
    // Without measurements nothing moves, and nothing is believed.
    let solution = tracker.solve(&shape).unwrap();
    assert!(
        (solution.pose().untyped().inverse() * pose([0.0; 3], [0.0; 3]).untyped()).translation.vector.norm() < 1e-9
    );
    assert_eq!(tracker.assess(&shape).confidence, 0.0);
    tracker.reset();
    assert!(tracker.predicted(0.0).is_none());
}

#[test]
fn prediction_goes_on_as_the_object_moves() {
    // The velocity halves in 50 ms.
    let memory_s = 0.05 / 2_f64.ln();
    let mut tracker = Tracker::new(TrackerConfig { velocity_memory_s: memory_s, ..TrackerConfig::default() });
    for (time_s, at) in [(0.0, pose([0.0; 3], [0.0; 3])), (0.05, pose([0.002, 0.0, 0.0], [0.0, 0.0, 8.0]))] {
        let empty = Measurement { time_s, cameras: &[], touch: &[], obstacles: &[] };
        let empty = Arc::new(Scan::new(0, &empty, &scan::ScanConfig::default(), 1));
        tracker.push(&BALL, empty, at, std::iter::empty());
    }
    for (time_s, turned_deg, x_m) in
        [(0.1, 12.0, 0.003), (0.15, 12.0, 0.003), (0.075, 8.0 + 8.0 * 0.5 * 0.5_f64.sqrt(), 0.0027)]
    {
        let predicted = tracker.predicted(time_s).unwrap().untyped();
        assert!((predicted.rotation.angle().to_degrees() - turned_deg).abs() < 1e-9, "{time_s}");
        assert!((predicted.translation.vector.x - x_m).abs() < 1e-4, "{time_s}");
    }
}

#[test]
fn confidence_falls_with_distance_from_the_truth() {
    let solid = Solid::Ball(0.03);
    let at = pose([0.0; 3], [0.0; 3]);
    let scan = Arc::new(Scan::new(0, &seen(0, solid, at).measured(), &scan::ScanConfig::default(), 1));
    let shape = Ball { centre: Vec3::ZERO, radius: 0.03 };
    let confidence = |shift: f64| {
        let mut tracker = Tracker::new(TrackerConfig::default());
        tracker.push(&shape, Arc::clone(&scan), pose([0.0, shift, 0.0], [0.0; 3]), std::iter::empty());
        tracker.choose_passed(&shape);
        tracker.assess(&shape).confidence
    };
    let [exact, near, far] = [0.0, 0.003, 0.02].map(confidence);
    assert!(exact > 0.98 && exact > near && near > far && far < 0.3, "{exact} {near} {far}");
}

#[test]
fn one_point_of_the_hand_does_not_outweigh_a_camera() {
    let solid = Solid::Ball(0.03);
    let at = pose([0.0; 3], [0.0; 3]);
    let scan = Arc::new(Scan::new(0, &seen(0, solid, at).measured(), &scan::ScanConfig::default(), 1));
    let shape = Ball { centre: Vec3::ZERO, radius: 0.03 };
    let inside = Occupied { point: to_vec((at.untyped() * na::Point3::new(0.0, 0.0, 0.02)).coords), depth_m: 0.005 };
    let confidence = |occupied: &[Occupied]| {
        let mut tracker = Tracker::new(TrackerConfig::default());
        tracker.push(&shape, Arc::clone(&scan), at, occupied.iter().copied());
        tracker.assess(&shape).confidence
    };
    let (one, many) = (confidence(&[inside]), confidence(&[inside; 40]));
    assert!(one > 0.9 && many < 0.1, "{one} {many}");
}

#[test]
fn free_space_bounds_what_depth_alone_leaves_open() {
    // A block seen straight from the front: only what passes beside it tells where it is sideways.
    let solid = Solid::Block([0.02, 0.02, 0.02]);
    let at = pose([0.0; 3], [0.0; 3]);
    let place = na::Vector3::from(PLACE_M);
    let above = (camera().0, look_at(place + na::Vector3::z() * 0.35, place, na::Vector3::x()));
    let depth = frame(0.0, vec![Some(see(solid, at, above))]);
    let scan = Arc::new(Scan::new(0, &depth.measured(), &scan::ScanConfig::default(), 1));
    let shape = Block([0.02, 0.02, 0.02]);
    let error = |config: TrackerConfig| {
        let mut tracker = Tracker::new(TrackerConfig { window: 1, ..config });
        tracker.push(&shape, Arc::clone(&scan), pose([0.004, -0.003, 0.0], [0.0; 3]), std::iter::empty());
        let found = tracker.solve(&shape).unwrap().pose().untyped();
        (found.translation.vector - place).norm()
    };
    let only_surface = error(TrackerConfig { free_space_weight: 0.0, outline_points: 0, ..TrackerConfig::default() });
    let with_free_space = error(TrackerConfig { outline_points: 0, ..TrackerConfig::default() });
    assert!(only_surface > 0.0025, "{only_surface}");
    assert!(with_free_space < 0.001, "{with_free_space}");
    assert!(error(TrackerConfig::default()) < 0.001);
}

/// Two planes that all but agree on where sideways is: the evidence of one pad is noise divided by a slope of nearly 0.
struct Ramp;

impl Shape for Ramp {
    fn distances(&self, points: &[Vec3], out: &mut [f32]) {
        let mut found = vec![Distance::default(); points.len()];
        self.distances_and_gradients(points, &mut found);
        out.iter_mut().zip(found).for_each(|(out, found)| *out = found.value_m);
    }

    fn distances_and_gradients(&self, points: &[Vec3], out: &mut [Distance]) {
        const SLOPE: f32 = 1e-3;
        for (out, p) in out.iter_mut().zip(points) {
            let (step_m, slope) = if p.x > 0.003 { (-0.003, SLOPE) } else { (0.0, 0.0) };
            let value_m = p.z - 0.03 + step_m + slope * p.x;
            *out = Distance { value_m, gradient: Vec3::new(slope, 0.0, 1.0) };
        }
    }
}

impl Reference for Ramp {
    fn trusted(&self, _: &[Vec3], out: &mut [bool]) {
        out.fill(true);
    }

    fn sigma_m(&self) -> f32 {
        0.0001
    }
}

#[test]
fn what_nothing_measures_carries_nothing_away() {
    let solid = Solid::Ball(0.03);
    let at = pose([0.0; 3], [0.0; 3]);
    let mut depth = frame(0.0, vec![None]);
    depth.touch = vec![Some(feel(solid, at, sensor(solid)))];
    let scan = Arc::new(Scan::new(0, &depth.measured(), &scan::ScanConfig::default(), 1));
    let mut tracker = Tracker::new(TrackerConfig { window: 1, touch_weight: 1.0, ..nothing() });
    tracker.push(&Ramp, scan, at, std::iter::empty());
    let found = tracker.solve(&Ramp).unwrap().pose().untyped();
    let moved = (at.untyped().inverse() * found).translation.vector.norm();
    assert!(moved < 0.05, "moved by {moved} m");
}

/// A pad fits in many places: the pose that is expected decides.
#[test]
fn a_pad_alone_does_not_throw_an_object() {
    let solid = Solid::Block([0.03; 3]);
    let shape = Block([0.03; 3]);
    let at = pose([0.0; 3], [0.0; 3]);
    let touched = |k: usize, side: [f64; 3]| {
        let mut depth = frame(k as f64 / 30.0, vec![None]);
        let above = Isometry::<Camera, Camera>::translation(0.008, 0.004, 0.03 + f64::from(GEL_M) - 0.0015);
        depth.touch = vec![Some(feel(solid, at, Isometry::new(pose([0.0; 3], side).untyped()) * above))];
        Arc::new(Scan::new(k, &depth.measured(), &scan::ScanConfig::default(), 1))
    };
    for seed in 0..20 {
        let mut tracker = Tracker::new(TrackerConfig::default());
        // First from above, then from a side and askew: the middle of the touched points moves by four centimetres.
        tracker.push(&shape, touched(0, [0.0; 3]), at, std::iter::empty());
        let near = pose([0.004, 0.003, 0.002], [6.0, -5.0, 4.0]);
        tracker.push(&shape, touched(1, [20.0, 75.0, 10.0]), near, std::iter::empty());
        tracker.look_around(&shape, near, Reach::JERK, &mut ChaCha8Rng::seed_from_u64(seed));
        let moved = (near.untyped().inverse() * tracker.window[1].pose).translation.vector.norm();
        assert!(moved < 0.008, "moved by {moved} m with seed {seed}");
    }
}

#[test]
fn a_pose_that_went_astray_some_frames_ago_is_found_again() {
    let (solid, shape) = (Solid::Block([0.03, 0.022, 0.016]), Block([0.03, 0.022, 0.016]));
    let at = pose([0.0; 3], [0.0, 0.0, 20.0]);
    let astray = pose([0.007, -0.004, 0.003], [9.0, -8.0, 35.0]);
    let mut tracker = Tracker::new(TrackerConfig { iterations: 1, ..TrackerConfig::default() });
    for k in 0..3 {
        let scan = Arc::new(Scan::new(k, &seen(k, solid, at).measured(), &scan::ScanConfig::default(), 1));
        tracker.push(&shape, scan, astray, std::iter::empty());
    }
    let followed = tracker.assess(&shape).confidence;
    tracker.config.iterations = TrackerConfig::default().iterations;
    for seed in 0..5 {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let (_, solution, assessment) = tracker.alternative(&shape, astray, &mut rng).unwrap();
        let left = at.untyped().inverse() * solution.pose().untyped();
        assert!(left.translation.vector.norm() < 0.001, "{left} with seed {seed}");
        assert!(left.rotation.angle().to_degrees() < 1.0, "{left} with seed {seed}");
        assert!(followed < 0.8 && assessment.confidence > 0.97, "{followed}, {assessment:?} with seed {seed}");
    }
}

/// A block by formula, its gradient by differences.
struct Block([f64; 3]);

impl Shape for Block {
    fn distances(&self, points: &[Vec3], out: &mut [f32]) {
        let solid = Solid::Block(self.0);
        out.iter_mut().zip(points).for_each(|(out, p)| *out = solid.distance(to_na(*p)) as f32);
    }

    fn distances_and_gradients(&self, points: &[Vec3], out: &mut [Distance]) {
        const STEP: f64 = 1e-7;
        let solid = Solid::Block(self.0);
        for (out, p) in out.iter_mut().zip(points) {
            let p = to_na(*p);
            let slope = |axis: usize| {
                let step = na::Vector3::ith(axis, STEP);
                ((solid.distance(p + step) - solid.distance(p - step)) / (2.0 * STEP)) as f32
            };
            *out = Distance { value_m: solid.distance(p) as f32, gradient: Vec3::new(slope(0), slope(1), slope(2)) };
        }
    }
}

impl Reference for Block {
    fn trusted(&self, _: &[Vec3], out: &mut [bool]) {
        out.fill(true);
    }

    fn sigma_m(&self) -> f32 {
        0.0001
    }
}

/// A block of which only the top was seen, and the space around it that was looked through.
struct TopOfBlock {
    block: Block,
    knows_empty_space: bool,
}

impl Shape for TopOfBlock {
    fn distances(&self, points: &[Vec3], out: &mut [f32]) {
        self.block.distances(points, out);
    }

    fn distances_and_gradients(&self, points: &[Vec3], out: &mut [Distance]) {
        self.block.distances_and_gradients(points, out);
    }
}

impl Reference for TopOfBlock {
    fn trusted(&self, points: &[Vec3], out: &mut [bool]) {
        let [x, y, z] = self.block.0.map(|half| half as f32);
        let is_top = |p: &Vec3| p.x.abs() < x && p.y.abs() < y && (p.z - z).abs() < 0.003;
        out.iter_mut().zip(points).for_each(|(out, p)| *out = is_top(p));
    }

    fn seen_empty(&self, points: &[Vec3], out: &mut [bool]) {
        let mut distances = vec![0.0; points.len()];
        self.distances(points, &mut distances);
        out.iter_mut().zip(distances).for_each(|(out, distance)| *out = self.knows_empty_space && distance > 0.003);
    }

    fn sigma_m(&self) -> f32 {
        0.0002
    }
}

/// Points that slide off the known face lie where nothing can be: without that, a slide along the face costs nothing.
#[test]
fn a_known_face_does_not_slide_into_space_that_was_seen_empty() {
    let half = [0.03, 0.025, 0.02];
    let at = pose([0.0; 3], [0.0; 3]);
    let place = na::Vector3::from(PLACE_M);
    let (intrinsics, _) = camera();
    let above = (intrinsics, look_at(place + na::Vector3::z() * 0.35, place, na::Vector3::x()));
    let image = see(Solid::Block(half), at, above);
    let scan = Arc::new(Scan::new(0, &frame(0.0, vec![Some(image)]).measured(), &scan::ScanConfig::default(), 1));
    let slid = |knows_empty_space: bool| {
        let shape = TopOfBlock { block: Block(half), knows_empty_space };
        let mut tracker = Tracker::new(TrackerConfig { camera_weight: 1.0, window: 1, ..nothing() });
        tracker.push(&shape, Arc::clone(&scan), pose([0.009, -0.004, 0.0], [0.0; 3]), std::iter::empty());
        let found = tracker.solve(&shape).unwrap().pose().untyped();
        (at.untyped().inverse() * found).translation.vector.norm()
    };
    let (free, held) = (slid(false), slid(true));
    assert!(free > 0.008, "without empty space the face slid by {free} m");
    assert!(held < 0.002, "with it by {held} m");
}
