//! Other hands than the Allegro: with sliding joints, without joints, and none.

use mvt_robot::hand::{Body, Inertial, Part, PartSurface, Placing, Primitive, TouchPad, UPRIGHT};

use super::*;

/// A gripper: a base that is turned a little about the vertical by its joint, and two fingers that slide on it.
fn gripper(joints: bool) -> Arc<Hand> {
    let body = |name: &str, parent, position_m, half| Body {
        name: name.to_owned(),
        parent,
        place: Placing::at(position_m),
        inertial: Some(Inertial { mass_kg: 0.1, centre_m: [0.0; 3], orientation_wxyz: UPRIGHT, diagonal: [1e-5; 3] }),
        parts: vec![Part {
            surface: PartSurface::Link,
            shape: Primitive::Box { centre: [0.0; 3], half, orientation_wxyz: UPRIGHT },
        }],
    };
    let joint = |name: &str, body, motion, axis, range| Joint {
        name: name.to_owned(),
        body,
        motion,
        axis,
        range,
        mirrors: false,
        drive: Default::default(),
    };
    let [y, z] = [[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    let pad = |name: &str, body| TouchPad {
        name: name.to_owned(),
        body,
        place: Placing::at([0.0; 3]),
        profile: Default::default(),
    };
    let mut description = HandDescription {
        name: "gripper".to_owned(),
        bodies: vec![
            body("base", None, [0.0, 0.0, 0.02], [0.06, 0.04, 0.02]),
            body("left", Some(0), [-0.03, 0.0, 0.05], [0.01, 0.02, 0.03]),
            body("right", Some(0), [0.03, 0.0, 0.05], [0.01, 0.02, 0.03]),
        ],
        joints: vec![
            joint("wrist", 0, JointMotion::Hinge, z, [-1.0, 1.0]),
            joint("left_slide", 1, JointMotion::Slide, y, [-0.03, 0.03]),
            joint("right_slide", 2, JointMotion::Slide, y, [-0.03, 0.03]),
        ],
        pads: vec![pad("left", 1), pad("right", 2)],
        apart: Vec::new(),
        ..Hand::none().description().clone()
    };
    if !joints {
        description.joints.clear();
    }
    Hand::new(description).unwrap()
}

/// Depth of a hand alone.
fn alone(camera: &PosedCamera, hand: &Hand, joints: &[f64]) -> Array2<f32> {
    depth_with(camera, &HandSolid::new(hand, joints), |_| f32::INFINITY)
}

fn seen(config: CalibrationConfig, hand: &Arc<Hand>, given: PosedCamera, offsets: &[f64]) -> Calibrator {
    let true_camera = camera();
    let mut calibrator = Calibrator::new(config, Arc::clone(hand), vec![given]);
    for frame in 0..12 {
        let time_s = f64::from(frame) * FRAME_S;
        let moves = [0.2 * (3.0 * time_s).sin(), 0.01 * (2.0 * time_s).sin(), 0.01 * (4.0 * time_s).cos()];
        let moves = &moves[..hand.joints().len()];
        let read: Vec<f64> = moves.iter().zip(offsets).map(|(angle, offset)| angle - offset).collect();
        let depth_m = alone(&true_camera, hand, moves);
        let frame = calibrator.observe(time_s, &read, None, &[Some(depth_m)]);
        assert!(frame.agrees[0] && !frame.is_frozen && frame.warnings.is_empty(), "{:?}", frame.warnings);
    }
    calibrator
}

#[test]
fn sliding_joints_have_offsets_in_millimetres() {
    let hand = gripper(true);
    // A camera that is right, so that the turn of the base is not taken for the camera's.
    let config = CalibrationConfig {
        camera_sigma_m: 1e-4,
        camera_sigma_deg: 0.01,
        arm_joint_sigma_deg: 1.0,
        ..CalibrationConfig::default()
    };
    let found = seen(config, &hand, camera(), &[0.01, 0.0015, -0.001]).calibration();
    let [wrist, left, right] = found.joint_offsets_deg[..] else { panic!("{found:?}") };
    assert!((wrist - 0.01f64.to_degrees()).abs() < 0.2, "{wrist} degrees: {found:?}");
    assert!((left - 1.5).abs() < 0.2 && (right + 1.0).abs() < 0.2, "{left} mm, {right} mm: {found:?}");
    let text = found.described(&hand);
    let lines: Vec<&str> = text.lines().skip(1).collect();
    assert!(lines[0].starts_with("joints of left: +1.") && lines[0].ends_with(" mm"), "{text}");
    assert!(lines[1].starts_with("joints of right: -") && lines[2].starts_with("other joints: +0."), "{text}");
    assert!(lines[2].ends_with(" degrees") && lines[3].starts_with("joint readings: "), "{text}");
    let off = Calibration { joint_offsets_deg: vec![0.0, 3.0, 0.0], ..found };
    assert_eq!(off.warnings(&hand), ["joint left_slide is off by 3.0 mm, which is corrected"]);
}

/// With joints of an arm that may be off by a degree, the camera would be misplaced by several millimetres.
#[test]
fn the_joints_of_an_arm_are_believed_and_the_camera_is_corrected() {
    let given = off(&camera(), na::Vector3::new(0.3, 1.0, -0.5), 3.0, na::Vector3::new(0.004, -0.003, 0.005));
    let found = seen(CalibrationConfig::default(), &gripper(true), given, &[0.0, 0.0015, -0.001]).calibration();
    let [degrees, millimetres] = misplaced(&found, &camera());
    assert!(degrees < 0.2 && millimetres < 1.0, "{degrees} degrees, {millimetres} mm");
    assert!(found.joint_offsets_deg[0].abs() < 0.05 && (found.joint_offsets_deg[1] - 1.5).abs() < 0.3, "{found:?}");
}

#[test]
fn a_camera_is_calibrated_by_a_hand_without_joints() {
    let given = off(&camera(), na::Vector3::new(0.3, 1.0, -0.5), 3.0, na::Vector3::new(0.004, -0.003, 0.005));
    let found = seen(CalibrationConfig::default(), &gripper(false), given, &[]).calibration();
    let [degrees, millimetres] = misplaced(&found, &camera());
    assert!(degrees < 0.2 && millimetres < 0.5, "{degrees} degrees, {millimetres} mm");
    assert!(found.joint_offsets_deg.is_empty() && (found.lag_sigma_ms - 30.0).abs() < 0.1, "{found:?}");
}

#[test]
fn without_a_hand_nothing_is_calibrated() {
    let mut calibrator = Calibrator::new(CalibrationConfig::default(), Hand::none(), vec![camera()]);
    let depth_m = alone(&camera(), &hand(), &joints(0.0));
    for k in 0..4 {
        let frame = calibrator.observe(f64::from(k), &[], None, &[Some(depth_m.clone())]);
        assert_eq!((frame.agrees, frame.warnings.len(), frame.cameras), (vec![true], 0, vec![camera()]));
    }
    assert_eq!(calibrator.refined(), None);
}

#[test]
fn a_calibration_of_another_hand_is_refused() {
    let of = |hand| Calibrator::new(CalibrationConfig::default(), hand, vec![camera()]);
    let error = of(gripper(true)).start_from(&of(hand()).calibration()).unwrap_err().to_string();
    assert!(error.contains("16 joints") && error.contains("hand gripper has 3"), "{error}");
}
