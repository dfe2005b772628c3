use mvt_robot::digit::profile::SensorProfile;
use mvt_robot::hand::Side;
use proptest::prelude::*;

use super::*;
use crate::cdr_writer::CdrWriter;
use crate::pairing::Stamped;

const STAMP_NS: i64 = 5_000_000_000;

fn head(writer: &mut CdrWriter) {
    writer.i32(5).u32(0).text("camera_optical");
}

fn image(encoding: &str, [width, height]: [u32; 2], bytes_per_pixel: u32, level: u8) -> Vec<u8> {
    let mut writer = CdrWriter::new();
    head(&mut writer);
    writer.u32(height).u32(width).text(encoding).u8(0).u32(width * bytes_per_pixel);
    let size = (width * height * bytes_per_pixel) as usize;
    writer.count(size);
    for _ in 0..size {
        writer.u8(level);
    }
    writer.into_message()
}

fn joint_state(names: &[String], positions: &[f64]) -> Vec<u8> {
    let mut writer = CdrWriter::new();
    head(&mut writer);
    writer.count(names.len());
    for name in names {
        writer.text(name);
    }
    writer.f64s(positions).f64s(&[]).f64s(&[]);
    writer.into_message()
}

fn info(width: usize, height: usize) -> RosCameraInfo {
    RosCameraInfo {
        header: Default::default(),
        width,
        height,
        model: "plumb_bob".to_owned(),
        d: Vec::new(),
        k: [50.0, 0.0, 7.5, 0.0, 50.0, 5.5, 0.0, 0.0, 1.0],
        p: [0.0; 12],
        binning: [0; 2],
        part: [0; 4],
    }
}

fn part(message: Vec<u8>) -> FramePart<Vec<u8>> {
    FramePart::One(Stamped { stamp_ns: STAMP_NS, item: message })
}

fn frame(parts: Vec<FramePart<Vec<u8>>>) -> PairedFrame<Vec<u8>> {
    PairedFrame { stamp_ns: STAMP_NS, time_ns: 0, parts }
}

fn without_hand() -> Observer {
    let text = "[ros]\ndepth = \"/depth\"\ncolor = \"/color\"\ncamera_info = \"/info\"\nmasks = \"/masks\"\n";
    let numbers = StreamNumbers { color: Some(1), masks: Some(2), ..StreamNumbers::default() };
    Observer::new(&RosSetup::parse(text).unwrap(), Hand::none(), info(16, 12), numbers, "rig.toml").unwrap()
}

fn seen(observer: &mut Observer, messages: [Vec<u8>; 3]) -> Result<Observation, String> {
    let observed = observer.observe(&frame(messages.into_iter().map(part).collect()), |_| false, None);
    observed.map_err(|(topic, reason)| format!("{topic}: {reason}"))
}

#[test]
fn images_become_an_observation() {
    let messages = [image("16UC1", [16, 12], 2, 1), image("rgb8", [32, 24], 3, 9), image("mono8", [16, 12], 1, 255)];
    let observation = seen(&mut without_hand(), messages).unwrap();
    let camera = &observation.cameras[0];
    assert_eq!((camera.depth_m.dim(), camera.depth_m[(0, 0)]), ((12, 16), 0.257));
    assert_eq!((camera.color.dimensions(), camera.color.get_pixel(3, 3).0), ((16, 12), [9; 3]));
    let Some(GivenLabels::Mask(mask)) = &camera.labels else { panic!("no mask") };
    assert!(mask.iter().all(|inside| *inside));
}

#[test]
fn images_that_do_not_fit_are_named_in_one_line() {
    let (depth, color, mask) =
        (image("16UC1", [16, 12], 2, 1), image("rgb8", [16, 12], 3, 9), image("mono8", [16, 12], 1, 255));
    let mut cut = depth.clone();
    cut.truncate(200);
    for (messages, words) in [
        ([color.clone(), color.clone(), mask.clone()], ["/depth", "16UC1"]),
        ([depth.clone(), depth.clone(), mask.clone()], ["/color", "rgb8"]),
        ([image("16UC1", [16, 10], 2, 1), color.clone(), mask.clone()], ["/depth", "camera model has 16 x 12"]),
        ([depth.clone(), image("rgb8", [16, 9], 3, 1), mask.clone()], ["/color", "another shape"]),
        ([depth.clone(), color.clone(), image("mono8", [16, 9], 1, 1)], ["/masks", "another shape"]),
        ([cut, color, mask], ["/depth", "damaged"]),
    ] {
        let error = seen(&mut without_hand(), messages).unwrap_err();
        assert!(words.iter().all(|word| error.contains(word)) && !error.contains('\n'), "{words:?}: {error}");
    }
}

#[test]
fn a_camera_model_of_another_size_is_taken_over() {
    let mut observer = without_hand();
    assert_eq!(observer.update(info(16, 12)), Ok(false));
    assert_eq!(observer.update(info(8, 6)), Ok(true));
    assert_eq!(observer.lens().intrinsics.width, 8);
    assert!(observer.update(info(0, 6)).unwrap_err().contains("/info"));
}

/// An observer of an Allegro whose joints have these names in ROS.
fn with_hand(more: &str) -> (Observer, Vec<String>) {
    let text = format!(
        "[ros]\nrig = \"allegro_digit\"\ndepth = \"/depth\"\ncamera_info = \"/info\"\njoints = \"/joints\"\n{more}"
    );
    let hand = Hand::allegro(Side::Right);
    let names = hand.joints().iter().map(|joint| joint.name.clone()).collect();
    let numbers = StreamNumbers { joints: Some(1), touch: vec![None; 4], ..StreamNumbers::default() };
    (Observer::new(&RosSetup::parse(&text).unwrap(), hand, info(16, 12), numbers, "rig.toml").unwrap(), names)
}

fn angles_of(observer: &mut Observer, joints: FramePart<Vec<u8>>) -> Result<Vec<f64>, String> {
    let parts = vec![part(image("16UC1", [16, 12], 2, 1)), joints];
    let observed = observer.observe(&frame(parts), |_| false, None);
    observed.map(|observation| observation.joints.to_vec()).map_err(|(topic, reason)| format!("{topic}: {reason}"))
}

#[test]
fn joints_are_found_by_name_and_interpolated() {
    let (mut observer, mut names) = with_hand("");
    let positions: Vec<f64> = (0..names.len()).map(|k| k as f64 * 0.01).collect();
    assert_eq!(angles_of(&mut observer, part(joint_state(&names, &positions))).unwrap(), positions);
    names.reverse();
    let reversed: Vec<f64> = positions.iter().rev().copied().collect();
    assert_eq!(angles_of(&mut observer, part(joint_state(&names, &reversed))).unwrap(), positions);
    let at = |stamp_ns, add: f64| Stamped {
        stamp_ns,
        item: joint_state(&names, &reversed.iter().map(|angle| angle + add).collect::<Vec<_>>()),
    };
    let between = FramePart::Between(at(STAMP_NS - 3_000_000, -0.3), at(STAMP_NS + 1_000_000, 0.1));
    let found = angles_of(&mut observer, between).unwrap();
    assert!(found.iter().zip(&positions).all(|(a, b)| (a - b).abs() < 1e-12), "{found:?}");
}

#[test]
fn joints_of_another_hand_or_without_a_number_are_named() {
    let (mut observer, names) = with_hand("");
    let mut positions = vec![0.1; names.len()];
    positions[3] = f64::NAN;
    let error = angles_of(&mut observer, part(joint_state(&names, &positions))).unwrap_err();
    assert!(error.starts_with("/joints: 1 of 16 joints") && error.contains(&names[3]), "{error}");
    let others: Vec<String> = (0..16).map(|k| format!("other_{k}")).collect();
    let error = angles_of(&mut observer, part(joint_state(&others, &[0.0; 16]))).unwrap_err();
    assert!(error.contains("16 of 16") && error.contains("other_0") && error.contains("joint_names"), "{error}");
    let error = angles_of(&mut observer, part(joint_state(&names, &[0.0; 3]))).unwrap_err();
    assert!(error.contains("16 names of joints, but 3 positions"), "{error}");
    assert!(!error.contains('\n'));
}

#[test]
fn names_of_joints_may_differ() {
    let (_, names) = with_hand("");
    let (mut observer, _) = with_hand(&format!("joint_names.{} = \"ah_joint00\"\n", names[0]));
    let mut others = names;
    others[0] = "ah_joint00".to_owned();
    let positions: Vec<f64> = (0..16).map(f64::from).collect();
    assert_eq!(angles_of(&mut observer, part(joint_state(&others, &positions))).unwrap(), positions);
}

#[test]
fn a_gel_that_is_a_part_of_the_images_of_a_topic_is_cut_out() {
    let text = "[ros]\nrig = \"allegro_digit\"\ndepth = \"/depth\"\ncamera_info = \"/info\"\njoints = \"/joints\"\ntouch.index = \"/touch\"\n";
    let corners = [[20.0, 10.0], [260.0, 10.0], [260.0, 330.0], [20.0, 330.0]];
    let profile = SensorProfile { corners_px: Some(corners), ..SensorProfile::tacto() };
    let hand = Hand::allegro(Side::Right).with_profile(&profile);
    let names: Vec<String> = hand.joints().iter().map(|joint| joint.name.clone()).collect();
    let numbers = StreamNumbers { joints: Some(1), touch: vec![Some(2), None, None, None], ..StreamNumbers::default() };
    let mut observer = Observer::new(&RosSetup::parse(text).unwrap(), hand, info(16, 12), numbers, "rig.toml").unwrap();
    let mut touch = |size| {
        let messages = [image("16UC1", [16, 12], 2, 1), joint_state(&names, &[0.0; 16]), image("rgb8", size, 3, 9)];
        let observed = observer.observe(&frame(messages.into_iter().map(part).collect()), |_| false, None);
        observed.map(|observation| observation.touch.0[0].clone())
    };
    let gel = touch([300, 340]).unwrap();
    assert_eq!((gel.dimensions(), gel.get_pixel(7, 7).0), ((240, 320), [9; 3]));
    let (topic, reason) = touch([100, 100]).unwrap_err();
    assert!(topic == "/touch" && reason.contains("corners_px"), "{topic}: {reason}");
}

proptest! {
    /// Any bytes, and messages with some bytes changed or cut off, are an observation or a reason.
    #[test]
    fn any_bytes_are_an_observation_or_a_reason(
        changes in prop::collection::vec((0usize..3, 0usize..200, any::<u8>()), 0..6),
        cuts in prop::collection::vec((0usize..3, 0usize..700), 0..2),
    ) {
        let mut messages =
            [image("16UC1", [16, 12], 2, 1), image("rgb8", [16, 12], 3, 9), image("mono8", [16, 12], 1, 255)];
        for (of, at, value) in changes {
            if let Some(byte) = messages[of].get_mut(at) {
                *byte = value;
            }
        }
        for (of, length) in cuts {
            messages[of].truncate(length);
        }
        let seen = seen(&mut without_hand(), messages);
        prop_assert!(seen.is_ok() || !seen.unwrap_err().contains('\n'));
    }

    #[test]
    fn any_joint_state_is_angles_or_a_reason(changes in prop::collection::vec((0usize..600, any::<u8>()), 0..8)) {
        let (mut observer, names) = with_hand("");
        let mut message = joint_state(&names, &[0.1; 16]);
        for (at, value) in changes {
            if let Some(byte) = message.get_mut(at) {
                *byte = value;
            }
        }
        let angles = angles_of(&mut observer, part(message));
        if let Ok(angles) = angles {
            prop_assert!(angles.len() == 16 && angles.iter().all(|angle| angle.is_finite()));
        }
    }
}
