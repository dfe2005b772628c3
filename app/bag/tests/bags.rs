//! Bags of other programs are read as these programs read them: rosbags, mcap and OpenCV wrote `tests/data` (`make_bags.py`).

#![allow(clippy::unwrap_used, clippy::panic, reason = "a failed assumption in a test is a failed test")]

use std::collections::HashMap;

use crate::common::data;
use mvt_bag::mcap::{McapError, McapRecord, scan};
use mvt_bag::{
    Bag, RgbdBag, RgbdTopics, RosCameraInfo, RosCompressedImage, RosHeader, RosImage, RosJointState, RosLens,
};
use serde_json::Value;

/// All bags with the same messages.
const SAME: [&str; 12] = [
    "db3",
    "db3_unsorted",
    "db3_message",
    "db3_file",
    "mcap",
    "mcap_storage",
    "mcap_message",
    "mcap_file",
    "split",
    "lz4.mcap",
    "unchunked.mcap",
    "unsorted.mcap",
];

fn expected() -> Value {
    serde_json::from_slice(&std::fs::read(data("expected.json")).unwrap()).unwrap()
}

fn numbers(value: &Value) -> Vec<f64> {
    value.as_array().unwrap().iter().map(|number| number.as_f64().unwrap()).collect()
}

#[test]
fn messages_come_in_the_order_of_recording_from_every_storage() {
    let expected = expected();
    for name in SAME {
        let mut bag = Bag::open(&data(name)).unwrap();
        let topics: Vec<String> = bag.topics().iter().map(|topic| topic.name.clone()).collect();
        let names: Vec<&str> = topics.iter().map(String::as_str).collect();
        let count: u64 = bag.topics().iter().map(|topic| topic.count).sum();
        let read: Vec<_> = bag.messages(&names).unwrap().map(Result::unwrap).collect();
        let found: Vec<Value> =
            read.iter().map(|message| serde_json::json!([message.log_ns, topics[message.topic]])).collect();
        assert_eq!(Value::Array(found), expected["order"], "{name}");
        assert_eq!(count, read.len() as u64, "{name}");
        for message in &read {
            assert!(bag.read(message.place).unwrap() == message.data, "{name}");
        }
    }
}

#[test]
fn a_choice_of_topics_is_all_that_comes() {
    for name in SAME {
        let mut bag = Bag::open(&data(name)).unwrap();
        let topic = bag.topics().iter().position(|topic| topic.name == "/tf").unwrap();
        let found: Vec<_> = bag.messages(&["/tf"]).unwrap().map(|message| message.unwrap().topic).collect();
        assert_eq!(found, [topic; 7], "{name}");
        let error = bag.messages(&["/nothing"]).unwrap_err().to_string();
        assert!(
            error.contains("there is no topic \"/nothing\"; there are ") && error.contains("/joint_states"),
            "{error}"
        );
    }
}

#[test]
fn frames_of_every_storage_are_those_of_rosbags_and_opencv() {
    let expected = expected();
    for name in SAME {
        let mut bag = RgbdBag::open(&data(name)).unwrap();
        assert!(bag.notes().iter().any(|note| note.contains("/chatter (std_msgs/msg/String)")), "{:?}", bag.notes());
        let k = numbers(&expected["rgbd"]["k"]);
        let intrinsics = bag.intrinsics();
        assert_eq!([intrinsics.fx, intrinsics.fy, intrinsics.cx, intrinsics.cy], [k[0], k[4], k[2], k[5]]);
        let frames: Vec<_> = bag.frames().map(Result::unwrap).collect();
        let wanted = expected["rgbd"]["frames"].as_array().unwrap();
        assert_eq!(frames.len(), wanted.len());
        for (frame, wanted) in frames.iter().zip(wanted) {
            assert_eq!(frame.stamp_ns, wanted["stamp_ns"].as_i64().unwrap());
            let colors = numbers(&wanted["color"]);
            let worst = frame.color.iter().zip(&colors).map(|(a, b)| (f64::from(*a) - b).abs()).fold(0.0, f64::max);
            // OpenCV counts in parts of 1/32 pixel; neighbours differ by up to 250 levels.
            assert!(worst <= 9.0 && frame.color.len() == colors.len(), "{name}: colours differ by {worst}");
            let depths = numbers(&wanted["depth_m"]);
            assert!(frame.depth_m.iter().zip(&depths).all(|(a, b)| (f64::from(*a) - b).abs() < 1e-5), "{name}");
            let mask = numbers(&wanted["mask"]);
            assert!(frame.mask.as_ref().unwrap().iter().zip(&mask).all(|(a, b)| *a == (*b > 0.0)), "{name}");
            // OpenGL axes: y and z are turned.
            let pose = frame.world_from_camera.unwrap().to_matrix();
            for (row, wanted) in pose.iter().zip(wanted["map_from_optical"].as_array().unwrap()) {
                let [x, y, z, t] = numbers(wanted)[..] else { panic!() };
                let apart = row.iter().zip([x, -y, -z, t]).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
                assert!(apart < 1e-6, "{name}: {row:?}");
            }
            for (joint, wanted) in wanted["joints"].as_object().unwrap() {
                assert!((frame.joints[joint] - wanted.as_f64().unwrap()).abs() < 1e-6, "{name} {joint}");
            }
            assert!(frame.camera_from_object.is_none());
        }
    }
}

#[test]
fn poses_of_the_object_are_read_if_they_are_named() {
    let topics = RgbdTopics { object_pose: Some("/object/pose".to_owned()), ..Default::default() };
    let mut bag = RgbdBag::open_with(&data("mcap"), &topics).unwrap();
    for (k, frame) in bag.frames().enumerate() {
        let origin = frame.unwrap().camera_from_object.unwrap().origin().coords();
        let wanted = [0.1, -0.2, -(0.5 + 0.01 * k as f64)];
        assert!(origin.iter().zip(wanted).all(|(a, b)| (a - b).abs() < 1e-9), "{origin}");
    }
}

#[test]
fn pixels_of_every_encoding_are_those_of_opencv() {
    let expected = expected();
    let mut bag = Bag::open(&data("encodings")).unwrap();
    let topics: Vec<_> = bag.topics().to_vec();
    let names: Vec<&str> = topics.iter().map(|topic| topic.name.as_str()).collect();
    let mut seen = 0;
    for message in bag.messages(&names).unwrap() {
        let message = message.unwrap();
        let topic = &topics[message.topic];
        let expected = &expected["encodings"][&topic.name];
        let (kind, wanted) = (expected["kind"].as_str().unwrap(), numbers(&expected["values"]));
        let is_raw = topic.type_name.ends_with("/Image");
        let (raw, packed) = (RosImage::decode(&message.data), RosCompressedImage::decode(&message.data));
        let (found, tolerance): (Vec<f64>, f64) = match kind {
            "lens" => {
                let info = RosCameraInfo::decode(&message.data).unwrap();
                let lens = RosLens::new(&info, false).unwrap();
                let places = wanted.chunks(4).flat_map(|row| {
                    let [u, v] = lens.distorted(row[0], row[1]);
                    [row[0], row[1], u, v]
                });
                (places.collect(), 1e-6)
            }
            "depth" => {
                let depth = if is_raw { raw.unwrap().depth_m(0.001) } else { packed.unwrap().depth_m(0.001) };
                (depth.unwrap().iter().map(|depth| f64::from(*depth)).collect(), 2e-6)
            }
            "labels" => {
                let labels = if is_raw { raw.unwrap().labels() } else { packed.unwrap().labels() };
                (labels.unwrap().iter().map(|label| f64::from(*label)).collect(), 0.0)
            }
            _ => {
                let colours = if is_raw { raw.unwrap().colours() } else { packed.unwrap().colours() };
                let tolerance = match kind {
                    "jpeg" => 5.0,
                    "bayer" => 1.0,
                    _ => 0.0,
                };
                (colours.unwrap().iter().map(|level| f64::from(*level)).collect(), tolerance)
            }
        };
        assert_eq!(found.len(), wanted.len(), "{}", topic.name);
        for (at, (found, wanted)) in found.iter().zip(&wanted).enumerate() {
            // OpenCV repeats the second ring of a Bayer pattern at the border.
            let (row, column) = (at / 3 / 16, at / 3 % 16);
            let is_border = kind == "bayer" && (row == 0 || row == 11 || column == 0 || column == 15);
            assert!(
                is_border || (found - wanted).abs() <= tolerance,
                "{} at {at}: {found} and not {wanted}",
                topic.name
            );
        }
        seen += 1;
    }
    assert_eq!(seen, expected["encodings"].as_object().unwrap().len());
}

#[test]
fn payloads_of_rclpy_are_read() {
    let topics = RgbdTopics {
        joints: Some("/joints".to_owned()),
        object_pose: Some("/pose".to_owned()),
        depth: Some("/depth".to_owned()),
        ..Default::default()
    };
    let mut bag = RgbdBag::open_with(&data("fastcdr.mcap"), &topics).unwrap();
    let intrinsics = bag.intrinsics();
    assert_eq!((intrinsics.fx, intrinsics.fy, intrinsics.cx, intrinsics.cy), (6.0, 7.0, 2.0, 1.5));
    for (k, frame) in bag.frames().map(Result::unwrap).enumerate() {
        assert_eq!(frame.stamp_ns, (100 + k as i64) * 1_000_000_000 + 500);
        assert!(
            frame.color.enumerate_pixels().all(|(u, v, pixel)| pixel.0 == [u + k as u32, v, u * v].map(|c| c as u8))
        );
        let is_right =
            |((v, u), depth): ((usize, usize), &f32)| (depth * 1000.0).round() as usize == 1000 + 10 * u + v + k;
        assert!(frame.depth_m.indexed_iter().all(is_right));
        let joints: Vec<_> = frame.joints.into_iter().collect();
        let wanted = [("a", 0.1 * k as f64), ("bc", -1.0), ("def", 2.5)];
        assert!(joints.iter().zip(wanted).all(|(a, b)| a.0 == b.0 && (a.1 - b.1).abs() < 1e-12) && joints.len() == 3);
        let object = frame.camera_from_object.unwrap().origin().coords();
        assert_eq!([object.x, object.z], [0.25, -(0.5 + k as f64)]);
    }
    let mut bag = Bag::open(&data("fastcdr.mcap")).unwrap();
    for message in bag.messages(&["/joints_empty"]).unwrap() {
        let state = RosJointState::decode(&message.unwrap().data).unwrap();
        assert_eq!((state.header.frame.as_str(), state.positions.len()), ("a frame", 0));
    }
    let message = bag.messages(&["/compressed"]).unwrap().next().unwrap().unwrap();
    let image = RosCompressedImage::decode(&message.data).unwrap();
    assert_eq!((image.format, image.data.len()), ("16UC1; compressedDepth png", 13));
    assert!(image.depth_m(0.001).unwrap_err().to_string().contains("neither a PNG"));
    assert!(image.colours().unwrap_err().to_string().contains("it is a depth image"));
}

#[test]
fn a_scan_passes_on_the_records_of_wanted_channels() {
    let expected = expected();
    for name in ["mcap/mcap.mcap", "mcap_storage/mcap_storage.mcap", "lz4.mcap", "unchunked.mcap", "unsorted.mcap"] {
        let (mut topics, mut found) = (HashMap::new(), Vec::new());
        let done: Result<(), McapError> = scan(&data(name), &mut |record| {
            match record {
                McapRecord::Channel(id, channel) => {
                    assert_eq!(channel.encoding, "cdr");
                    topics.insert(id, channel.topic.clone());
                    return Ok(channel.topic != "/tf");
                }
                McapRecord::Message(id, log_ns, message) => {
                    assert!(topics[&id] == "/chatter" || RosHeader::decode(message).is_ok());
                    found.push((log_ns, topics[&id].clone()));
                }
                McapRecord::Attachment(..) => {}
            }
            Ok(true)
        });
        done.unwrap();
        found.sort();
        let all: Vec<(u64, String)> = serde_json::from_value(expected["order"].clone()).unwrap();
        let wanted: Vec<_> = all.into_iter().filter(|(_, topic)| topic != "/tf").collect();
        assert!(found == wanted, "{name}");
    }
    let whole = std::fs::read(data("lz4.mcap")).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("cut.mcap");
    for (end, words) in [(20, "cut off"), (whole.len() / 2, "cut off"), (4, "its first bytes are others")] {
        std::fs::write(&path, &whole[..end]).unwrap();
        let done: Result<(), McapError> = scan(&path, &mut |_| Ok(true));
        assert!(done.unwrap_err().to_string().contains(words), "{end}");
    }
}
