mod disk;

use rand::{RngExt as _, SeedableRng as _};

use super::*;
use crate::scan;
use crate::synthetic::{BRICK, Solid, camera, pose, seen};
use crate::tracker::{apply, to_na, to_vec};
use mvt_frames::se3;

/// Time between frames, seconds.
const INTERVAL_S: f64 = 1.0 / 30.0;

/// A little field that is taught little, where only what surrounds it matters.
fn quick() -> (MapConfig, field::FieldConfig) {
    (MapConfig { first_steps: 2, steps_per_s: 30.0, batch: 64, ..MapConfig::default() }, field::FieldConfig::default())
}

fn map(config: &MapConfig) -> Map {
    Map::new(config.clone(), &quick().1, Obstacles::default(), 1).unwrap()
}

fn few() -> scan::ScanConfig {
    scan::ScanConfig { camera_outline: 50, camera_misses: 200, ..scan::ScanConfig::default() }
}

/// Frames of a brick that turns about the vertical, with the poses that a tracker gives.
fn learn(
    map: &mut Map,
    frames: usize,
    turn_deg: f64,
    tracked: impl Fn(usize) -> Isometry<Field, World>,
) -> Vec<Learnt> {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    // A tracker goes on in the frame that a loop corrected.
    let mut correction = na::Isometry3::identity();
    (0..frames)
        .map(|k| {
            let depth = seen(k, BRICK, pose([0.0; 3], [0.0, 0.0, turn_deg * k as f64]));
            let scan = Arc::new(Scan::new(k, &depth.measured(), &few(), 1));
            let learnt = map.learn(&scan, Isometry::new(tracked(k).untyped() * correction), INTERVAL_S, &mut rng);
            correction *= learnt.correction.unwrap_or_default();
            assert_in_order(map);
            learnt
        })
        .collect()
}

/// Every loop ties two keyframes that are there, forwards, none is kept for a keyframe that is gone, and keyframes are in the order of time.
fn assert_in_order(map: &Map) {
    let count = map.keyframes.len();
    assert!(map.loops.iter().all(|edge| edge.from < edge.to && edge.to < count), "a loop leads nowhere");
    assert!(map.loops.len() <= count, "{} loops among {count} keyframes", map.loops.len());
    let times: Vec<f64> = map.keyframes.iter().map(|keyframe| keyframe.scan().time_s).collect();
    assert!(times.is_sorted_by(|a, b| a < b));
}

fn turned(by_deg: f64) -> impl Fn(usize) -> Isometry<Field, World> {
    move |k| pose([0.0; 3], [0.0, 0.0, by_deg * k as f64])
}

#[test]
fn keyframes_come_with_turn_distance_and_time() {
    let config = MapConfig { refined_per_s: 0.0, loop_turn_deg: 0.0, ..quick().0 };
    let became = |learnt: &[Learnt]| -> Vec<usize> { (0..learnt.len()).filter(|&k| learnt[k].keyframe).collect() };
    // At 30 Hz: every 3rd frame of 3 degrees, every 2nd of 3 mm, and the first after half a second.
    assert_eq!(became(&learn(&mut map(&config), 9, 3.0, turned(3.0))), [0, 3, 6]);
    let slid = |k| pose([0.003 * k as f64, 0.0, 0.0], [0.0; 3]);
    assert_eq!(became(&learn(&mut map(&config), 6, 0.0, slid)), [0, 2, 4]);
    assert_eq!(became(&learn(&mut map(&config), 20, 0.0, turned(0.0))), [0, 16]);
}

#[test]
fn keyframes_are_bounded_and_the_first_is_kept() {
    let config = MapConfig { keyframes: 12, keyframe_turn_deg: 0.5, refined_per_s: 30.0, ..quick().0 };
    let mut map = map(&config);
    let mut most = 0;
    for frames in learn(&mut map, 60, 2.0, turned(2.0)) {
        assert!(frames.keyframe);
        most = most.max(map.keyframes.len());
    }
    assert!(most <= config.keyframes && most > config.keyframes / 2, "{most}");
    assert_eq!(map.keyframes[0].scan().frame, 0, "the frame that all others refer to");
    assert_eq!(map.keyframes.last().unwrap().scan().frame, 59);
    // Older frames are thinner, and none of the gaps is wide.
    let numbers: Vec<usize> = map.keyframes.iter().map(|keyframe| keyframe.scan().frame).collect();
    let gaps: Vec<usize> = numbers.windows(2).map(|pair| pair[1] - pair[0]).collect();
    assert!(gaps.last() == Some(&1) && gaps.iter().max() > Some(&4), "{numbers:?}");
}

#[test]
fn a_loop_brings_drift_back() {
    // Over a turn the object seems to have turned by 5.4 degrees too much.
    let config = MapConfig { refined_per_s: 0.0, keyframe_turn_deg: 5.0, loop_turn_deg: 20.0, ..quick().0 };
    let drifting = |k| pose([0.0; 3], [0.0, 0.0, 3.045 * k as f64]);
    let mut map = map(&config);
    let learnt = learn(&mut map, 121, 3.0, drifting);
    let closed: Vec<usize> = (0..learnt.len()).filter(|&k| learnt[k].correction.is_some()).collect();
    assert!(!closed.is_empty(), "the brick came round and nobody noticed");
    assert!(closed[0] >= 90, "no loop closes within three seconds: {closed:?}");
    let k = closed[0];
    // Carried over, the pose that tracking gave is nearly the true one again: relative to the first keyframe, which stays.
    let corrected = drifting(k).untyped() * learnt[k].correction.unwrap();
    let truth = turned(3.0)(k).untyped();
    let off = |pose: &na::Isometry3<f64>| pose.rotation.angle_to(&truth.rotation).to_degrees();
    assert!(
        off(&corrected) < 0.35 * off(&drifting(k).untyped()),
        "{} {}",
        off(&corrected),
        off(&drifting(k).untyped())
    );
    let newest = map.keyframes.iter().find(|keyframe| keyframe.scan().frame == k).unwrap();
    assert!(off(&newest.pose().untyped()) < 1.5 && map.keyframes[0].pose() == drifting(0));
}

#[test]
fn a_loop_does_not_undo_refinement() {
    // Tracking was off at the start by a turn that refinement found out later; then the loop of the test above closes.
    let config = MapConfig { refined_per_s: 0.0, keyframe_turn_deg: 5.0, loop_turn_deg: 20.0, ..quick().0 };
    let mut map = map(&config);
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let seen_as = |k: usize, off_deg: f64| pose([0.0; 3], [0.0, 0.0, 3.045 * k as f64 + off_deg]);
    let refined = |k: usize| seen_as(k, 0.0);
    let tracked = |k: usize| seen_as(k, if (4..8).contains(&k) { 8.0 } else { 0.0 });
    let closed = (0..121).find(|&k| {
        let depth = seen(k, BRICK, turned(3.0)(k));
        let learnt = map.learn(&Arc::new(Scan::new(k, &depth.measured(), &few(), 1)), tracked(k), INTERVAL_S, &mut rng);
        for keyframe in &mut map.keyframes {
            let frame = keyframe.scan().frame;
            if learnt.correction.is_none() && (4..8).contains(&frame) {
                keyframe.set_pose(refined(frame));
            }
        }
        learnt.correction.is_some()
    });
    assert!(closed.is_some());
    // A loop bends the poses between its ends evenly: none of the first keyframes has gone back to where it was tracked.
    for keyframe in map.keyframes.iter().filter(|keyframe| keyframe.scan().frame < 8) {
        let off = se3::log(&(keyframe.pose().untyped().inverse() * refined(keyframe.scan().frame).untyped()));
        assert!(off.norm() < 0.01, "frame {}: {off}", keyframe.scan().frame);
    }
}

#[test]
fn no_loop_closes_where_nothing_disagrees() {
    let config = MapConfig { refined_per_s: 0.0, keyframe_turn_deg: 5.0, ..quick().0 };
    let learnt = learn(&mut map(&config), 125, 3.0, turned(3.0));
    assert!(learnt.iter().all(|learnt| learnt.correction.is_none()));
}

#[test]
fn loops_survive_thinning() {
    let config =
        MapConfig { keyframes: 20, refined_per_s: 30.0, keyframe_turn_deg: 5.0, loop_turn_deg: 20.0, ..quick().0 };
    let mut map = map(&config);
    let learnt = learn(&mut map, 150, 3.0, |k| pose([0.0; 3], [0.0, 0.0, 3.045 * k as f64]));
    assert!(learnt.iter().any(|learnt| learnt.correction.is_some()));
    assert!(
        map.keyframes.len() <= 20
            && map.keyframes.iter().all(|k| k.pose().untyped().to_homogeneous().sum().is_finite())
    );
}

#[test]
fn what_is_taught_agrees_with_the_solid() {
    let solid = Solid::Ball(0.03);
    let at = pose([0.0; 3], [0.0; 3]);
    let scan = Arc::new(Scan::new(0, &seen(0, solid, at).measured(), &scan::ScanConfig::default(), 1));
    let mut map = map(&MapConfig { batch: 4096, ..quick().0 });
    map.learn(&scan, at, INTERVAL_S, &mut ChaCha8Rng::seed_from_u64(1));
    let current = map.keyframes[0].clone();
    map.samples.clear();
    map.draw(&current, &mut ChaCha8Rng::seed_from_u64(2));
    assert!(map.samples.len() > 3000, "{}", map.samples.len());
    let truncation = f64::from(map.field().config().truncation_m);
    let cell = f64::from(map.space.resolution_m());
    let (mut on, mut free, mut inside) = (0, 0, 0);
    for s in &map.samples {
        let distance = solid.distance(to_na(s.position));
        let target = f64::from(s.target);
        assert!(target.abs() <= 1.0 && s.weight > 0.0);
        if s.at_least {
            continue;
        }
        if target == 1.0 {
            // Far before the surface; rays that graze it are near it sideways.
            assert!(distance > -1e-6, "taught to be free {distance} m deep");
            free += 1;
        } else if target == -1.0 && distance < -0.003 {
            inside += 1;
        } else if target > -1.0 {
            // Along the ray times the cosine: exact on a plane, and on a ball to the bend over so short a way.
            assert!((target * truncation - distance).abs() < 0.004, "{target} at {distance}");
            on += 1;
        } else {
            assert!(distance < 2.5 * cell + 0.005, "taught to be inside {distance} m out");
        }
    }
    assert!(on > 500 && free > 500 && inside > 100, "{on} {free} {inside}");
}

#[test]
fn noise_of_depth_does_not_move_the_surface() {
    /// Standard deviation, metres.
    const NOISE_M: f32 = 0.002;
    let solid = Solid::Ball(0.03);
    let config = MapConfig { batch: 1024, first_steps: 150, steps_per_s: 900.0, refined_per_s: 0.0, ..quick().0 };
    let mut map = map(&config);
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    for k in 0..12 {
        let at = turned(10.0)(k);
        let mut sensed = seen(k, solid, at);
        for depth_m in sensed.cameras.iter_mut().flatten().flat_map(|camera| &mut camera.depth_m) {
            // Of unit variance.
            let noise: f32 = (0..3).map(|_| rng.random_range(-1.0..1.0)).sum();
            *depth_m += if *depth_m > 0.0 { NOISE_M * noise } else { 0.0 };
        }
        map.learn(&Arc::new(Scan::new(k, &sensed.measured(), &few(), 1)), at, INTERVAL_S, &mut rng);
    }
    // Beside the outline rays that passed move the surface, too.
    let to_camera = (turned(60.0)(1).inverse() * camera().1.origin()).coords().normalize();
    let faces_camera = |p: &na::Vector3<f64>| p.normalize().dot(&to_camera) > 0.7;
    let surface: Vec<_> = solid.surface(2000).into_iter().filter(faces_camera).map(to_vec).collect();
    let mut distances_m = vec![0.0; surface.len()];
    map.distances(&surface, &mut distances_m);
    let inwards_m = distances_m.iter().sum::<f32>() / surface.len() as f32;
    assert!(inwards_m.abs() < 0.1e-3, "{inwards_m} m");
}

#[test]
fn what_nobody_saw_weighs_more_deep_inside() {
    let (weight, core_weight, core_depth) = (0.125, 0.375, 0.01);
    let config =
        MapConfig { batch: 4096, inside_weight: weight, core_weight, core_depth_m: core_depth as f32, ..quick().0 };
    let mut map = map(&config);
    // From all sides but below.
    for (turn, k) in [0.0, 120.0, 240.0].into_iter().zip(0..) {
        let pose = pose([0.0; 3], [0.0, 0.0, turn]);
        let scan =
            Arc::new(Scan::new(k, &seen(k, Solid::Ball(0.03), pose).measured(), &scan::ScanConfig::default(), 1));
        map.learn(&scan, pose, INTERVAL_S, &mut ChaCha8Rng::seed_from_u64(1));
    }
    let current = map.keyframes[0].clone();
    map.samples.clear();
    map.draw(&current, &mut ChaCha8Rng::seed_from_u64(2));
    let cell = f64::from(map.space.resolution_m());
    let depths = |wanted: f32| -> Vec<f64> {
        let samples = map.samples.iter().filter(|s| s.weight == wanted && s.target == -1.0);
        samples.map(|s| -Solid::Ball(0.03).distance(to_na(s.position))).collect()
    };
    let (shell, core) = (depths(weight), depths(core_weight));
    assert!(shell.len() > 50 && core.len() > 50, "{} {}", shell.len(), core.len());
    // The hull of the seen points lies in the ball, so that a cell deep in the hull is deeper in the ball.
    assert!(core.iter().all(|depth| *depth > core_depth - cell), "{core:?}");
    assert!(shell.iter().any(|depth| *depth < 0.5 * core_depth), "{shell:?}");
}

#[test]
fn refinement_returns_a_keyframe_to_the_surface() {
    // The field learns from frames at their true poses; one keyframe is then put wrong.
    let config =
        MapConfig { batch: 1024, first_steps: 150, steps_per_s: 300.0, refined_per_s: 0.0, ..MapConfig::default() };
    let mut map = map(&config);
    learn(&mut map, 30, 3.0, turned(3.0));
    let k = 5;
    let truth = map.keyframes[k].pose().untyped();
    let wrong = truth * se3::exp(&se3::Twist::new(0.001, -0.001, 0.001, 0.0, 0.0, 0.02));
    map.keyframes[k].set_pose(Isometry::new(wrong));
    let off = |map: &Map| {
        let found = map.keyframes[k].pose().untyped();
        let corner = na::Point3::new(0.03, 0.02, 0.015);
        (found * corner - truth * corner).norm()
    };
    let before = off(&map);
    for _ in 0..40 * map.keyframes.len() {
        map.refine_one();
    }
    assert!(off(&map) < 0.4 * before, "{} of {before}", off(&map));
    let others = map.keyframes.iter().map(|keyframe| keyframe.pose().untyped().translation.vector);
    let place = pose([0.0; 3], [0.0; 3]).untyped().translation.vector;
    assert!(others.map(|at| (at - place).norm()).fold(0.0, f64::max) < 0.0015);
}

#[test]
fn the_frame_of_the_field_is_that_of_the_first_keyframe() {
    let mut map = map(&quick().0);
    assert_eq!(map.field_from_model(), Isometry::identity());
    learn(&mut map, 4, 3.0, turned(3.0));
    assert!(map.field_from_model().untyped().translation.vector.norm() < 1e-12);
    let moved = map.keyframes[0].pose().untyped() * na::Isometry3::translation(0.001, 0.0, 0.0);
    map.keyframes[0].set_pose(Isometry::new(moved));
    // A point of the model lies in the world where the first pose put it, in whichever frame it is expressed.
    let p = Vec3::new(0.01, 0.02, 0.03);
    let through_field = apply(&moved, apply(&map.field_from_model().untyped(), p));
    let first = apply(&pose([0.0; 3], [0.0; 3]).untyped(), p);
    assert!((through_field - first).length() < 1e-6, "{through_field} {first}");
}

#[test]
fn the_box_grows_until_the_object_fits_or_the_largest_box_is_reached() {
    let tall = Solid::Block([0.02, 0.02, 0.09]);
    let changes = |largest_m: f32| {
        let config = MapConfig { largest_half_extent_m: largest_m, keyframe_turn_deg: 0.5, ..quick().0 };
        let mut map = map(&config);
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let learnt: Vec<Option<BoxChange>> = (0..8)
            .map(|k| {
                let at = pose([0.0; 3], [0.0, 0.0, 2.0 * k as f64]);
                let scan = Arc::new(Scan::new(k, &seen(k, tall, at).measured(), &few(), 1));
                map.learn(&scan, at, INTERVAL_S, &mut rng).box_change
            })
            .collect();
        assert_eq!(map.keyframes.len(), 8, "keyframes survive");
        (learnt.into_iter().flatten().collect::<Vec<_>>(), map)
    };
    let (grown, map) = changes(0.125);
    let [BoxChange::Grown(half_m)] = grown[..] else { panic!("{grown:?}") };
    assert!(half_m > 0.09 && half_m == map.half_extent_m(), "{half_m}");
    assert!(map.space.is_near_surface(Vec3::new(0.0, 0.02, 0.085)), "what lay outside is known now");
    assert_eq!(changes(0.075).0, [BoxChange::TooSmall], "said once");
}
