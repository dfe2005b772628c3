//! Calibrations of images that a sphere tracer makes of the hand's solid, without any renderer, and derivatives by finite differences.

use std::sync::Arc;

use glam::Vec3;
use mvt_frames::Isometry;
use mvt_frames::camera::{Intrinsics, PosedCamera};
use mvt_robot::hand::solid::HandSolid;
use mvt_robot::hand::{Hand, HandDescription, Joint, JointAngles, JointMotion, Side};
use mvt_robot::rig::PLACEMENTS;
use nalgebra as na;
use ndarray::Array2;

use crate::solver::{by_joints, narrow};
use crate::{Calibration, CalibrationConfig, Calibrator};

const FRAME_S: f64 = 1.0 / 30.0;

fn hand() -> Arc<Hand> {
    Hand::allegro(Side::Left)
}

/// The side camera with fewer pixels, so that tracing is quick.
fn camera() -> PosedCamera {
    let mut camera = PLACEMENTS[3].camera(&hand());
    camera.intrinsics = Intrinsics::from_fov_y(212, 160, 45f64.to_radians());
    camera
}

/// Fingers that close and open at different speeds.
fn joints(time_s: f64) -> JointAngles {
    let joint = |j: usize| {
        let middle = if j.is_multiple_of(4) { 0.0 } else { 0.7 };
        let middle = if j == 12 { 1.0 } else { middle };
        middle + 0.25 * ((3.0 + 0.2 * j as f64) * time_s + j as f64).sin()
    };
    (0..16).map(joint).collect()
}

/// Depth of the hand, and of a ball that lies between its fingers, along the optical axis.
fn depth(camera: &PosedCamera, joints: &[f64]) -> Array2<f32> {
    depth_with(camera, &HandSolid::new(&hand(), joints), |p| p.distance(Vec3::new(0.02, -0.01, 0.06)) - 0.025)
}

/// Depth of the hand and of an object, which is given by its signed distance.
fn depth_with(camera: &PosedCamera, hand: &HandSolid, object: impl Fn(Vec3) -> f32) -> Array2<f32> {
    let k = camera.intrinsics;
    let eye = narrow(&camera.pose.origin().coords());
    Array2::from_shape_fn((k.height, k.width), |(v, u)| {
        let ray = camera.pose.untyped().rotation * k.unproject(u as f64, v as f64, 1.0).coords();
        let (ray, length) = (narrow(&ray), ray.norm() as f32);
        let mut depth = 0.15;
        for _ in 0..100 {
            let p = eye + ray * depth;
            let distance = hand.distance(p).min(object(p));
            if distance < 2e-5 {
                return depth;
            }
            depth += distance / length;
            if depth > 0.6 {
                break;
            }
        }
        0.0
    })
}

/// Calibrates from frames of a moving hand. `read` gives the joint readings at a time; `true_camera` takes the images.
fn calibrate(
    given: PosedCamera,
    true_camera: &PosedCamera,
    frames: usize,
    config: CalibrationConfig,
    moves: impl Fn(f64) -> JointAngles,
    read: impl Fn(f64) -> JointAngles,
) -> Calibration {
    let mut calibrator = Calibrator::new(config, hand(), vec![given]);
    for frame in 0..frames {
        let time_s = frame as f64 * FRAME_S;
        let depth_m = depth(true_camera, &moves(time_s));
        calibrator.observe(time_s, &read(time_s), None, &[Some(depth_m)]);
    }
    calibrator.calibration()
}

/// Degrees and millimetres by which the hand is misplaced.
fn misplaced(found: &Calibration, camera: &PosedCamera) -> [f64; 2] {
    let found =
        Isometry::<mvt_frames::Camera, mvt_frames::World>::from_matrix(&found.cameras[0].pose).unwrap().untyped();
    let wrong = found * camera.pose.untyped().inverse();
    let middle = na::Point3::new(0.0, 0.0, 0.04);
    [wrong.rotation.angle().to_degrees(), (wrong * middle - middle).norm() * 1e3]
}

fn off(camera: &PosedCamera, axis: na::Vector3<f64>, degrees: f64, shift_m: na::Vector3<f64>) -> PosedCamera {
    let mut pose = camera.pose.untyped();
    pose.rotation = na::UnitQuaternion::from_scaled_axis(axis.normalize() * degrees.to_radians()) * pose.rotation;
    pose.translation.vector += shift_m;
    PosedCamera { pose: Isometry::new(pose), ..camera.clone() }
}

#[test]
fn a_wrong_camera_wrong_joints_and_late_readings_are_found_together() {
    let camera = camera();
    let offsets: JointAngles = (0..16).map(|j| if j % 3 == 0 { 0.017 } else { -0.012 }).collect();
    let lag_s = 0.033;
    let read = |time_s: f64| {
        let late = joints(time_s - lag_s);
        late.iter().zip(&offsets).map(|(late, offset)| late - offset).collect()
    };
    let given = off(&camera, na::Vector3::new(0.3, 1.0, -0.5), 5.0, na::Vector3::new(0.006, -0.006, 0.005));
    let found = calibrate(given, &camera, 40, CalibrationConfig::default(), joints, read);
    let [degrees, millimetres] = misplaced(&found, &camera);
    assert!(degrees < 0.3 && millimetres < 0.7, "{degrees} degrees, {millimetres} mm");
    assert!((found.lag_ms - 33.0).abs() < 2.0, "{} ms", found.lag_ms);
    let errors: Vec<f64> = (0..16).map(|j| found.joint_offsets_deg[j] - offsets[j].to_degrees()).collect();
    let rms = (errors.iter().map(|e| e * e).sum::<f64>() / 16.0).sqrt();
    assert!(rms < 0.5, "{rms} degrees: {errors:?}");
    for (error, sigma) in errors.iter().zip(&found.joint_sigmas_deg) {
        assert!(error.abs() < 3.5 * sigma, "off by {error} degrees, said to be within {sigma}");
    }
}

#[test]
fn a_right_calibration_stays_right() {
    let camera = camera();
    let found = calibrate(camera.clone(), &camera, 6, CalibrationConfig::default(), joints, joints);
    let [degrees, millimetres] = misplaced(&found, &camera);
    assert!(degrees < 0.15 && millimetres < 0.3, "{degrees} degrees, {millimetres} mm");
    assert!(found.lag_ms.abs() < 2.0 && found.joint_offsets_deg.iter().all(|offset| offset.abs() < 0.6), "{found:?}");
    assert_eq!(found.warnings(&hand()), Vec::<String>::new());
}

#[test]
fn a_large_object_is_not_taken_for_the_hand() {
    // A coffee can hides most of the fingers.
    let can = |p: Vec3| (p.truncate().distance(glam::Vec2::new(0.01, 0.0)) - 0.051).max((p.z - 0.081).abs() - 0.07);
    let camera = camera();
    for [degrees, shift_m] in [[0.0, 0.0], [5.0, 0.01]] {
        let given = off(&camera, na::Vector3::new(0.3, 1.0, -0.5), degrees, na::Vector3::x() * shift_m);
        let mut calibrator = Calibrator::new(CalibrationConfig::default(), hand(), vec![given]);
        for frame in 0..8 {
            let time_s = f64::from(frame) * FRAME_S;
            let depth_m = depth_with(&camera, &HandSolid::new(&hand(), &joints(time_s)), can);
            let seen = calibrator.observe(time_s, &joints(time_s), None, &[Some(depth_m)]);
            assert!(seen.agrees[0] && seen.warnings.is_empty(), "{degrees} degrees: {:?}", seen.warnings);
        }
        let [degrees, millimetres] = misplaced(&calibrator.calibration(), &camera);
        assert!(degrees < 0.5 && millimetres < 1.5, "{degrees} degrees, {millimetres} mm");
    }
}

#[test]
fn what_nothing_measures_keeps_its_prior() {
    let camera = camera();
    let config = CalibrationConfig::default();
    let still = |_: f64| joints(0.0);
    let found = calibrate(camera.clone(), &camera, 4, config, still, still);
    // Without motion late readings cannot be told from others.
    assert!(found.lag_ms.abs() < 1e-6, "{}", found.lag_ms);
    assert!((found.lag_sigma_ms - 1e3 * config.lag_sigma_s).abs() < 0.1, "{}", found.lag_sigma_ms);
    // Offsets that are held are held.
    let held = CalibrationConfig { joint_sigma_deg: 0.0, lag_sigma_s: 0.0, ..config };
    let found = calibrate(camera.clone(), &camera, 4, held, joints, joints);
    assert_eq!((found.joint_offsets_deg, found.lag_ms), (vec![0.0; 16], 0.0));
    // Without any image everything does.
    let mut blind = Calibrator::new(config, hand(), vec![camera.clone()]);
    (0..5).for_each(|k| drop(blind.observe(k as f64 * FRAME_S, &joints(0.1 * k as f64), None, &[None])));
    let found = blind.calibration();
    assert!(!found.cameras[0].hand_found && found.joint_sigmas_deg.iter().all(|s| (s - 1.0).abs() < 1e-9));
    assert!(found.warnings(&hand())[0].contains("has not seen the hand"));
}

#[test]
fn a_calibration_survives_its_file() {
    let camera = camera();
    let given = off(&camera, na::Vector3::x(), 2.0, na::Vector3::zeros());
    let found = calibrate(given.clone(), &camera, 3, CalibrationConfig::default(), joints, joints);
    let text = serde_json::to_string(&found).unwrap();
    let read: Calibration = serde_json::from_str(&text).unwrap();
    let mut calibrator =
        Calibrator::new(CalibrationConfig { refine: false, ..CalibrationConfig::default() }, hand(), vec![given]);
    calibrator.start_from(&read).unwrap();
    let frame = calibrator.observe(0.0, &joints(0.0), None, &[None]);
    let pose = frame.cameras[0].pose.to_matrix();
    for (row, column) in (0..4).flat_map(|row| (0..4).map(move |column| (row, column))) {
        assert!((pose[row][column] - found.cameras[0].pose[row][column]).abs() < 1e-12);
    }
    assert!((frame.joints[3] - joints(0.0)[3] - found.joint_offsets_deg[3].to_radians()).abs() < 1e-12);
    let mut wrong = read;
    wrong.cameras[0].pose[0][0] = 3.0;
    assert!(calibrator.start_from(&wrong).unwrap_err().to_string().contains("camera side"));
}

#[test]
fn derivatives_by_joints_are_those_of_finite_differences() {
    compare_derivatives(&hand());
    // The fingers slide out of the palm, and the palm itself, which carries them, turns.
    let with = |change: fn(&mut HandDescription)| {
        let mut description = hand().description().clone();
        change(&mut description);
        Hand::new(description).unwrap()
    };
    compare_derivatives(&with(|of| of.joints[0].motion = JointMotion::Slide));
    compare_derivatives(&with(|of| {
        of.joints.insert(0, Joint { name: "wrist".to_owned(), body: 0, ..of.joints[0].clone() });
    }));
}

fn compare_derivatives(hand: &Hand) {
    const STEP_RAD: f64 = 1e-3;
    let at: Vec<f64> = (0..hand.joints().len()).map(|j| joints(0.4)[j % 16]).collect();
    let solid = HandSolid::new(hand, &at);
    let mut compared = 0;
    for k in 0..2000 {
        let golden = 0.618_034 * f64::from(k);
        let p = na::Vector3::new(
            0.16 * golden.fract() - 0.02,
            0.12 * (3.7 * golden).fract() - 0.06,
            0.1 * (7.3 * golden).fract(),
        );
        let Some(nearest) = solid.nearest(narrow(&p), 0.02) else { continue };
        // The distance from a gel is a bound, whose slope is not that of the distance.
        if hand.bodies()[nearest.body].name.ends_with("tip") || nearest.distance_m < 0.001 {
            continue;
        }
        for (joint, slope) in by_joints(hand, &solid, p, &nearest) {
            let moved = |step: f64| {
                let mut moved = at.clone();
                moved[joint] += step;
                f64::from(HandSolid::new(hand, &moved).distance(narrow(&p)))
            };
            let (ahead, behind) = (moved(STEP_RAD) - moved(0.0), moved(0.0) - moved(-STEP_RAD));
            // Where another part becomes the nearest one there is no derivative.
            if (ahead - behind).abs() < 2e-6 {
                assert!((slope - (ahead + behind) / (2.0 * STEP_RAD)).abs() < 2e-3, "{joint}: {slope}, {nearest:?}");
                compared += 1;
            }
        }
    }
    assert!(compared > 200, "{compared}");
}

mod changes;
mod hands;
