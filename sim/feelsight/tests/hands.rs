//! Logs of other hands than the Allegro.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::fs;
use std::path::Path;
use std::sync::Arc;

use crate::common;
use crate::common::{camera, frame_of, gripper, meta_of, write_of};
use mvt_feelsight::array::Array;
use mvt_feelsight::pickle::{self, PickleValue};
use mvt_feelsight::{Log, LogAssembler, LogFormat, LogImage, LogMeta, LogWriter, Timeline, convert, hand, inspect};
use mvt_frames::camera::PosedCamera;
use mvt_robot::hand::{Hand, HandDescription, Side};
use proptest::prelude::*;

fn cameras() -> Vec<PosedCamera> {
    vec![camera("side", 40, 30)]
}

fn check(log: &Path, hand: &Arc<Hand>, frames: usize) {
    let log = Log::open(log).unwrap();
    assert_eq!((log.len(), log.hand()), (frames, hand));
    for (i, read) in log.frames().unwrap().enumerate() {
        let (observation, truth) = frame_of(hand, i, &cameras());
        let read = read.unwrap();
        assert_eq!(read.observation.joints, observation.joints);
        assert_eq!(read.observation.touch.len(), hand.pads().len());
        let labels = read.truth.unwrap();
        for (a, b) in labels.touch.iter().zip(&truth.touch) {
            assert_eq!(a.contact, b.contact);
        }
        let difference = (labels.object_pose.inverse() * truth.object_pose).untyped();
        assert!(difference.translation.vector.norm() < 1e-12);
        assert!((log.cameras()[0].pose.origin().coords() - cameras()[0].pose.origin().coords()).norm() < 1e-12);
    }
}

#[test]
fn a_log_of_a_gripper_is_read_back_as_written() {
    let folder = tempfile::tempdir().unwrap();
    let hand = Hand::new(gripper()).unwrap();
    let [log, compact, again] = ["log", "compact", "again"].map(|name| folder.path().join(name));
    write_of(&hand, &log, 3, &cameras());
    assert!(log.join("allegro/back/lower/image/2.jpg").is_file());
    check(&log, &hand, 3);
    convert(&log, &compact, LogFormat::Compact, |_| ()).unwrap();
    convert(&compact, &again, LogFormat::FeelSight, |_| ()).unwrap();
    for log in [&compact, &again] {
        check(log, &hand, 3);
        let summary = inspect(log).unwrap();
        assert_eq!(summary.contact_fraction.as_ref().unwrap()[..], [1.0, 0.0]);
        assert!(summary.kinematics_deviation.unwrap() < 1e-12);
        assert!(summary.to_string().contains("front 100.0 %, back/lower 0.0 %"), "{summary}");
    }
    let data = pickle::from_bytes(&fs::read(log.join("data.pkl")).unwrap()).unwrap();
    let shape = |key| data.get("allegro").unwrap().get(key).unwrap().to_tensor().unwrap().0;
    assert_eq!((shape("joint_state"), shape("finger_poses")), (vec![3, 3], vec![3, 2, 4, 4]));
}

#[test]
fn a_log_without_a_hand_is_read_back_as_written() {
    let folder = tempfile::tempdir().unwrap();
    let place = folder.path().join("log");
    write_of(&Hand::none(), &place, 2, &cameras());
    check(&place, &Hand::none(), 2);
    let summary = inspect(&place).unwrap();
    assert_eq!((summary.frames, summary.kinematics_deviation), (2, None));
}

#[test]
fn a_log_without_scene_json_holds_its_hand_in_the_pickle() {
    let folder = tempfile::tempdir().unwrap();
    let hands = [Hand::new(gripper()).unwrap(), Hand::allegro(Side::Right), Hand::allegro(Side::Left), Hand::none()];
    for (k, hand) in hands.into_iter().enumerate() {
        let place = folder.path().join(k.to_string());
        let mut log = LogAssembler::create(&place, Arc::clone(&hand), vec![]).unwrap();
        let black = mvt_feelsight::image::RgbImage::new(240, 320);
        let mut file = std::io::Cursor::new(Vec::new());
        black.write_to(&mut file, mvt_feelsight::image::ImageFormat::Jpeg).unwrap();
        for pad in 0..hand.pads().len() {
            log.image(LogImage::Touch(pad), 0, file.get_ref(), "black".as_ref()).unwrap();
        }
        let beyond = log.image(LogImage::Touch(hand.pads().len()), 0, file.get_ref(), "black".as_ref());
        assert!(beyond.unwrap_err().to_string().contains("there is no pad"));
        let timeline = |joints| Timeline {
            object_name: "ball".into(),
            times_s: vec![0.0],
            joints: vec![joints],
            object_poses: vec![None],
            scene: None,
            live: None,
        };
        log.finish(timeline(common::joints_of(&hand, 0))).unwrap();
        assert_eq!(Log::open(&place).unwrap().hand(), &hand);
        let log = LogAssembler::create(&folder.path().join("other"), Arc::clone(&hand), vec![]).unwrap();
        let refused = log.finish(timeline(vec![0.0; 5])).unwrap_err().to_string();
        assert!(refused.contains("5 joint angles"), "{refused}");
    }
}

#[test]
fn another_number_of_joints_or_pads_is_refused_with_both_numbers() {
    let folder = tempfile::tempdir().unwrap();
    let hand = Hand::new(gripper()).unwrap();
    let place = folder.path().join("log");
    write_of(&hand, &place, 2, &cameras());
    let path = place.join("data.pkl");
    let whole = pickle::from_bytes(&fs::read(&path).unwrap()).unwrap();
    let refusal = |key: &str, value: PickleValue| {
        let PickleValue::Dict(mut items) = whole.clone() else { panic!() };
        let PickleValue::Dict(of_hand) = &mut items.iter_mut().find(|(k, _)| k.as_str() == Some("allegro")).unwrap().1
        else {
            panic!()
        };
        of_hand.push((key.into(), value));
        fs::write(&path, pickle::to_bytes(&PickleValue::Dict(items))).unwrap();
        Log::open(&place).unwrap_err().to_string()
    };
    let said = refusal("joint_state", Array::from_f64(vec![2, 16], vec![0.1; 32]).into());
    assert!(said.contains("data.pkl: allegro.joint_state: 16 per frame, and hand gripper has 3"), "{said}");
    let said = refusal("joint_state", Array::from_f64(vec![1 << 40, 0], []).into());
    assert!(said.contains("0 per frame, and hand gripper has 3"), "{said}");
    let said = refusal("joint_state", Array::from_f64(vec![2, 3, 1], vec![0.1; 6]).into());
    assert!(said.contains("has the shape [2, 3, 1]"), "{said}");
    let said = refusal("finger_poses", Array::from_f64(vec![2, 1, 4, 4], vec![0.1; 32]).into());
    assert!(said.contains("allegro.finger_poses: 1 per frame, and hand gripper has 2"), "{said}");
    // The third joint turns three times round, the second one hardly.
    let said = refusal("joint_state", Array::from_f64(vec![2, 3], vec![0.01, 0.1, 19.0, 0.01, 7.0, 19.0]).into());
    assert!(said.contains("the joint angle of bend in frame 1 is 7.000e0 rad"), "{said}");
    let said = refusal("joint_state", Array::from_f64(vec![2, 3], vec![40.0, 0.1, 19.0, 40.0, 0.1, 19.0]).into());
    assert!(said.contains("the joint angle of slide in frame 0 is 4.000e1 m"), "{said}");
}

#[test]
fn untouched_images_of_another_hand_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let hand = Hand::new(gripper()).unwrap();
    let untouched = Some(Hand::allegro(Side::Left).per_pad(|_| image::RgbImage::new(240, 320)));
    let meta = LogMeta { untouched, ..meta_of(hand, cameras()) };
    let refused = LogWriter::create(&folder.path().join("log"), meta, false).err().unwrap().to_string();
    assert!(refused.contains("hand gripper has another number of untouched images"), "{refused}");
}

#[test]
fn only_other_hands_are_described() {
    for side in [Side::Left, Side::Right] {
        assert_eq!(hand::stored(&Hand::allegro(side)), None);
        assert_eq!(hand::restored(side, None), Ok(Hand::allegro(side)));
    }
    let gripper = Hand::new(gripper()).unwrap();
    assert_eq!(hand::restored(Side::Left, hand::stored(&gripper).cloned()), Ok(gripper));
    assert!(hand::stored(&Hand::none()).is_some());
}

fn with_hand(place: &Path, scene: &serde_json::Value, hand: serde_json::Value) -> Result<Log, String> {
    let mut scene = scene.clone();
    scene["hand"] = hand;
    fs::write(place.join("scene.json"), scene.to_string()).unwrap();
    Log::open(place).map_err(|error| error.to_string())
}

#[test]
fn an_invalid_hand_is_an_error_of_one_line() {
    let folder = tempfile::tempdir().unwrap();
    write_of(&Hand::new(gripper()).unwrap(), folder.path().join("log").as_path(), 1, &cameras());
    let place = folder.path().join("log");
    let scene: serde_json::Value = serde_json::from_slice(&fs::read(place.join("scene.json")).unwrap()).unwrap();
    let with = |spoil: &dyn Fn(&mut serde_json::Value)| {
        let mut hand = scene["hand"].clone();
        spoil(&mut hand);
        let said = with_hand(&place, &scene, hand).unwrap_err();
        assert!(said.contains("scene.json: ") && said.lines().count() == 1, "{said}");
        said
    };
    assert!(with(&|hand| *hand = "middle".into()).contains("unknown variant `middle`"));
    assert!(with(&|hand| *hand = 3.into()).contains("invalid type"));
    assert!(with(&|hand| *hand = serde_json::json!({})).contains("missing field `name`"));
    assert!(with(&|hand| hand["pads"][0]["body"] = 99.into()).contains("pad front: there is no body 99"));
    assert!(with(&|hand| hand["bodies"][1]["parent"] = 7.into()).contains("body slider: its parent"));
    let spoilt = with(&|hand| {
        hand["name"] = "two\nlines".into();
        hand["joints"][1]["axis"] = serde_json::json!([0, 0, 0]);
    });
    assert!(spoilt.contains("hand two lines: joint bend: its axis"), "{spoilt}");
    assert!(with(&|hand| hand["joints"][1]["colour\nred"] = 1.into()).contains("unknown field"));
    let flat = |hand: &mut serde_json::Value| {
        hand["bodies"][0]["parts"][0]["shape"]["hull"] = serde_json::json!([[0, 0, 0], [1, 0, 0], [0, 1, 0]]);
    };
    assert!(with(&flat).contains("the points have no convex hull"));
    let huge = |hand: &mut serde_json::Value| {
        hand["bodies"][0]["parts"][0]["shape"]["hull"][3] = serde_json::json!([1e300, 0, 0]);
    };
    with(&huge);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(256))]

    #[test]
    fn a_damaged_description_is_an_error_or_another_hand(changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..4)) {
        let mut text = serde_json::to_vec(&gripper()).unwrap();
        for (at, byte) in changes {
            let at = at.index(text.len());
            // Mostly digits and signs, which leave the text JSON.
            text[at] = if byte < 200 { b"0123456789-e.,[]"[usize::from(byte % 16)] } else { byte };
        }
        if let Ok(description) = serde_json::from_slice::<HandDescription>(&text)
            && let Ok(hand) = Hand::new(description)
        {
            let joints = vec![0.1; hand.joints().len()];
            prop_assert_eq!(hand.world_from_touch_cameras(&joints).len(), hand.pads().len());
            mvt_robot::hand::solid::HandSolid::new(&hand, &joints);
        }
    }
}
