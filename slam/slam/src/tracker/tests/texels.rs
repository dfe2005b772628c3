//! Brightness pixel by pixel, and frames that are laid on each other.

use super::*;
use crate::scan::ScanConfig;

/// The painted solid in a pose, with texels.
fn scan(k: usize, solid: Solid, at: Isometry<Field, World>) -> Arc<Scan> {
    let config = ScanConfig { texels: 400, ..ScanConfig::default() };
    Arc::new(Scan::new(k, &seen_painted(k, solid, at, blotches).measured(), &config, 1))
}

const CENTRED: Ball = Ball { centre: Vec3::ZERO, radius: 0.03 };

/// How far a pose is from another, metres and degrees.
fn apart(a: &na::Isometry3<f64>, b: Isometry<Field, World>) -> (f64, f64) {
    let b = b.untyped();
    ((a.translation.vector - b.translation.vector).norm(), a.rotation.angle_to(&b.rotation).to_degrees())
}

#[test]
fn texel_residuals() {
    let mut tracker = Tracker::new(TrackerConfig { texel_weight: 1.3, ..nothing() });
    let mut earlier = Vec::new();
    for (k, at) in poses(5).into_iter().enumerate() {
        let scan = scan(k, Solid::Ball(0.03), at);
        tracker.push(&CENTRED, Arc::clone(&scan), at, std::iter::empty());
        if let Some(newest) = tracker.window.back_mut() {
            newest.earlier = earlier.clone();
        }
        if k == 0 {
            earlier.push(EarlierView { scan, pose: at });
        }
    }
    for instant in &mut tracker.window {
        instant.pose *= se3::exp(&Twist::new(0.0003, -0.0002, 0.0002, 0.003, 0.004, -0.005));
    }
    // Slopes jump from pixel to pixel.
    check(tracker, &CENTRED, 1.0, 0.05);
}

#[test]
fn an_earlier_scan_compares_alike_without_the_images() {
    let (first, second) = (pose([0.0; 3], [0.0; 3]), pose([0.001, 0.0, 0.0], [1.0, -2.0, 1.0]));
    let (then, now) = (scan(0, Solid::Ball(0.03), first), scan(1, Solid::Ball(0.03), second));
    let earlier = then.earlier();
    let images = |scan: &Scan| scan.views[0].texels().unwrap().levels.len();
    assert_eq!((images(&then), images(&earlier)), (crate::scan::LEVELS, 0));
    let correlation = |then: &Scan| {
        let (then_pose, now_pose) = (first.untyped(), second.untyped());
        let (then, now) = (Posed { scan: then, pose: &then_pose }, Posed { scan: &now, pose: &now_pose });
        photometric::correlation([then], now, FINAL_LEVEL).unwrap()
    };
    assert!(correlation(&then) > 0.7, "{}", correlation(&then));
    assert_eq!(correlation(&then).to_bits(), correlation(&earlier).to_bits());
}

#[test]
fn a_ball_that_jumps_and_turns_is_followed_by_its_paint() {
    let solid = Solid::Ball(0.03);
    let (first, second) = (pose([0.0; 3], [0.0; 3]), pose([0.012, -0.006, 0.008], [4.0, -5.0, 6.0]));
    let follow = |texel_weight: f64| {
        let mut tracker = Tracker::new(TrackerConfig { texel_weight, align_reach_m: 0.024, ..nothing() });
        tracker.push(&CENTRED, scan(0, solid, first), first, std::iter::empty());
        tracker.push(&CENTRED, scan(1, solid, second), first, std::iter::empty());
        tracker.align(&CENTRED, &|_| Vec::new());
        let found = tracker.window.back().unwrap().pose;
        (apart(&found, second), tracker.texels_agree())
    };
    let ((off_m, off_deg), agrees) = follow(1.0);
    assert!(off_m < 0.0005 && off_deg < 0.7 && agrees, "{off_m} m, {off_deg} degrees, {agrees}");
    // Its shape alone does not show the turn.
    let ((off_m, off_deg), _) = follow(0.0);
    assert!(off_m < 0.001 && off_deg > 5.0, "{off_m} m, {off_deg} degrees");
}

#[test]
fn a_start_that_fits_the_shape_is_kept() {
    // Another object than that of the frame before: nothing to lay it on.
    let at = pose([0.0; 3], [0.0; 3]);
    let mut tracker = Tracker::new(TrackerConfig { align_reach_m: 0.024, ..nothing() });
    tracker.push(&CENTRED, scan(0, BRICK, pose([0.02, 0.01, 0.0], [0.0; 3])), at, std::iter::empty());
    tracker.push(&CENTRED, scan(1, Solid::Ball(0.03), at), at, std::iter::empty());
    tracker.align(&CENTRED, &|_| Vec::new());
    assert_eq!(apart(&tracker.window.back().unwrap().pose, at), (0.0, 0.0));
}

#[test]
fn a_ball_that_comes_back_is_recognised_by_its_paint() {
    let solid = Solid::Ball(0.03);
    let (then, now) = (pose([0.0; 3], [0.0; 3]), pose([0.02, 0.01, -0.01], [3.0, 5.0, -4.0]));
    let mut tracker = Tracker::new(TrackerConfig { texel_weight: 1.0, camera_weight: 1.0, ..TrackerConfig::default() });
    let turned = |turn_deg: [f64; 3]| Isometry::new(now.untyped() * pose([0.0; 3], turn_deg).untyped().rotation);
    tracker.push(&CENTRED, scan(9, solid, now), turned([0.0, 75.0, 0.0]), std::iter::empty());
    let view = EarlierView { scan: scan(0, solid, then), pose: then };
    let alike = |at: Isometry<Field, World>| crate::earlier::most_alike(std::iter::once(view.clone()), at);
    let candidates = [[0.0, 75.0, 0.0], [60.0, 0.0, 0.0], [5.0, -4.0, 3.0], [0.0, 0.0, 180.0]].map(turned);
    let found = tracker.recognise(&CENTRED, &candidates, &alike).expect("one of them is near");
    let (off_m, off_deg) = apart(&found.untyped(), now);
    assert!(off_m < 0.001 && off_deg < 1.0, "{off_m} m, {off_deg} degrees");
    assert_eq!(tracker.recognise(&CENTRED, &candidates[..2], &alike), None);
    let rivals = tracker.rivals(&CENTRED, found, Vec3::ZERO, &mut ChaCha8Rng::seed_from_u64(0));
    assert!(rivals.len() > 3 && rivals.iter().all(|rival| apart(&rival.untyped(), found).1 > 20.0), "{rivals:?}");
}

#[test]
fn poses_about_an_axis_of_revolution_leave_the_surface_where_it_is() {
    let at = pose([0.0; 3], [10.0, 20.0, 30.0]);
    let mut tracker = Tracker::new(TrackerConfig::default());
    // The ball of which the middle is not the origin.
    let middle = at.untyped() * na::Point3::from(to_na(BALL.centre));
    let ball = Isometry::new(na::Isometry3::from_parts(middle.coords.into(), na::UnitQuaternion::identity()));
    tracker.push(&BALL, scan(0, Solid::Ball(0.03), ball), at, std::iter::empty());
    let spun = tracker.spun(&BALL, at);
    assert_eq!(spun.len(), 23);
    for (k, pose) in spun.iter().enumerate() {
        let pose = pose.untyped();
        let moved = (pose * na::Point3::from(to_na(BALL.centre)) - middle).norm();
        assert!(moved < 0.0015, "turn {k} moves the middle by {moved} m");
        let turn_deg = at.untyped().rotation.angle_to(&pose.rotation).to_degrees();
        let expected_deg = 15.0 * (k + 1).min(23 - k) as f64;
        assert!((turn_deg - expected_deg).abs() < 0.1, "{turn_deg} {expected_deg}");
    }
}

/// Half a turn about each of its axes leaves a block as it is.
#[test]
fn a_block_that_comes_back_has_a_rival_for_each_half_turn() {
    let (half, at) = ([0.05, 0.032, 0.02], pose([0.0; 3], [20.0, 35.0, 10.0]));
    let mut tracker = Tracker::new(TrackerConfig::default());
    tracker.push(&Block(half), scan(0, Solid::Block(half), at), at, std::iter::empty());
    for seed in 0..5 {
        let rivals = tracker.rivals(&Block(half), at, Vec3::ZERO, &mut ChaCha8Rng::seed_from_u64(seed));
        assert_eq!(rivals.len(), 3, "seed {seed}");
        for turn in [[180.0, 0.0, 0.0], [0.0, 180.0, 0.0], [0.0, 0.0, 180.0]] {
            let turned = Isometry::new(at.untyped() * pose([0.0; 3], turn).untyped().rotation);
            assert!(rivals.iter().any(|rival| apart(&rival.untyped(), turned).1 < 3.0), "{turn:?} with seed {seed}");
        }
    }
}
