//! Cameras that are bumped, joints that freeze, and cameras that show another hand than the one that was named.

use super::*;

/// Frames until the change.
const BEFORE: usize = 15;

/// Frames of a hand that moves: with the frame's number, which may change the images or readings.
fn observe(
    calibrator: &mut Calibrator,
    frames: std::ops::Range<usize>,
    seen_by: impl Fn(usize) -> PosedCamera,
    read_at: impl Fn(usize) -> usize,
) -> Vec<crate::Calibrated> {
    let time_s = |frame: usize| frame as f64 * FRAME_S;
    let observe = |frame: usize| {
        let depth_m = depth(&seen_by(frame), &joints(time_s(frame)));
        calibrator.observe(time_s(frame), &joints(time_s(read_at(frame))), None, &[Some(depth_m)])
    };
    frames.map(observe).collect()
}

#[test]
fn a_bumped_camera_is_noticed_within_a_second_and_estimated_anew() {
    let camera = camera();
    let bumped = off(&camera, na::Vector3::new(1.0, 0.4, -0.2), 4.0, na::Vector3::new(0.005, -0.006, 0.006));
    let mut calibrator = Calibrator::new(CalibrationConfig::default(), hand(), vec![camera.clone()]);
    let stands = |frame| if frame < BEFORE { camera.clone() } else { bumped.clone() };
    let seen = observe(&mut calibrator, 0..BEFORE + 30, stands, |frame| frame);
    let warned: Vec<usize> = (0..seen.len()).filter(|&k| !seen[k].warnings.is_empty()).collect();
    assert!(matches!(warned[..], [at] if (BEFORE..BEFORE + 10).contains(&at)), "{warned:?}");
    assert!(seen[warned[0]].warnings[0].contains("camera side moved"), "{:?}", seen[warned[0]].warnings);
    let [degrees, millimetres] = misplaced(&calibrator.calibration(), &bumped);
    assert!(degrees < 0.3 && millimetres < 0.7, "{degrees} degrees, {millimetres} mm");
    // From the second comparison on, no image is used that lies elsewhere.
    let wrong = |k: &usize| {
        seen[*k].agrees[0] && {
            let offset = seen[*k].cameras[0].pose.untyped() * stands(*k).pose.untyped().inverse();
            offset.rotation.angle().to_degrees() > 1.0
        }
    };
    assert!((0..seen.len()).filter(wrong).count() <= 3);
}

#[test]
fn frozen_joints_are_no_bump() {
    let camera = camera();
    let mut calibrator = Calibrator::new(CalibrationConfig::default(), hand(), vec![camera.clone()]);
    // The readings stand still for a second, and then go on.
    let read = |frame: usize| if (BEFORE..BEFORE + 30).contains(&frame) { BEFORE } else { frame };
    let seen = observe(&mut calibrator, 0..BEFORE + 40, |_| camera.clone(), read);
    let warned: Vec<&String> = seen.iter().flat_map(|frame| &frame.warnings).collect();
    assert!(matches!(warned[..], [text] if text.contains("stand still")), "{warned:?}");
    assert!(seen[BEFORE + 25].is_frozen && !seen[BEFORE + 25].agrees[0]);
    assert!(!seen[BEFORE + 38].is_frozen && seen[BEFORE + 38].agrees[0]);
    let [degrees, millimetres] = misplaced(&calibrator.calibration(), &camera);
    assert!(degrees < 0.3 && millimetres < 0.7, "{degrees} degrees, {millimetres} mm");
}

#[test]
fn images_of_another_hand_or_from_another_place_are_skipped() {
    let camera = camera();
    let mut other = PLACEMENTS[0].camera(&hand());
    other.intrinsics = camera.intrinsics;
    let mirrored = Calibrator::new(CalibrationConfig::default(), Hand::allegro(Side::Right), vec![camera.clone()]);
    let swapped = Calibrator::new(CalibrationConfig::default(), hand(), vec![other]);
    for (name, mut calibrator) in [("mirrored", mirrored), ("swapped", swapped)] {
        let seen = observe(&mut calibrator, 0..15, |_| camera.clone(), |frame| frame);
        assert!(seen[7..].iter().all(|frame| !frame.agrees[0]), "{name}");
        let warned: Vec<&String> = seen.iter().flat_map(|frame| &frame.warnings).collect();
        assert!(matches!(warned[..], [text] if text.contains("does not show the hand")), "{name}: {warned:?}");
    }
}
