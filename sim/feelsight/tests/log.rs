//! Logs written and read back.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use crate::common;
use mvt_feelsight::array::Array;
use mvt_feelsight::pickle;
use mvt_feelsight::pickle::PickleValue;
use mvt_feelsight::{EncodedFrame, Log, LogError, LogWriter, inspect, inspect_against};
use rayon::prelude::*;

use crate::common::{RADIUS_M, camera, end, frame, meta, write};

fn cameras() -> Vec<mvt_frames::camera::PosedCamera> {
    vec![camera("front-left", 64, 48), camera("top-down", 40, 30)]
}

/// Returns every file of a folder with its bytes.
fn files(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = BTreeMap::new();
    let mut folders = vec![folder.to_path_buf()];
    while let Some(next) = folders.pop() {
        for entry in fs::read_dir(next).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else {
                found.insert(path.strip_prefix(folder).unwrap().to_path_buf(), fs::read(&path).unwrap());
            }
        }
    }
    found
}

#[test]
fn a_log_is_read_back_as_written() {
    let folder = tempfile::tempdir().unwrap();
    let place = folder.path().join("ball/00");
    write(&place, 5, &cameras());

    let log = Log::open(&place).unwrap();
    assert_eq!((log.len(), log.hand(), log.object_name()), (5, &common::hand(), "ball"));
    let scene = log.scene().unwrap();
    assert_eq!((scene.seed, &scene.end), (u64::MAX, &end()));
    for (read, written) in log.cameras().iter().zip(cameras()) {
        assert_eq!((&read.name, read.intrinsics), (&written.name, written.intrinsics));
        assert!((read.pose.origin().coords() - written.pose.origin().coords()).norm() < 1e-12);
    }
    let mut count = 0;
    for (i, read) in log.frames().unwrap().enumerate() {
        let read = read.unwrap();
        let (observation, truth) = frame(i, &cameras());
        let read_truth = read.truth.unwrap();
        assert_eq!((read.observation.time_s, read.observation.joints), (observation.time_s, observation.joints));
        for (a, b) in read.observation.cameras.iter().zip(&observation.cameras) {
            assert_eq!(a.depth_m, b.depth_m, "depth is exact");
            let error = a.color.iter().zip(b.color.iter()).map(|(a, b)| a.abs_diff(*b)).max();
            assert!(error.unwrap() <= 12, "JPEG: {error:?}");
        }
        assert_eq!(read_truth.labels, truth.labels);
        for pad in 0..4 {
            let (a, b) = (&read_truth.touch[pad], &truth.touch[pad]);
            assert_eq!(a.contact, b.contact);
            for ((a, b), contact) in a.depth_m.iter().zip(&b.depth_m).zip(a.contact.iter()) {
                // Half a level, and a whole one where contact may not be level 0.
                let tolerance = if *contact { 3.001e-5 } else { 1.5001e-5 };
                assert!((a - b).abs() <= tolerance, "{a} {b}");
            }
            let sum = |image: &image::RgbImage| image.iter().map(|&c| f64::from(c)).sum::<f64>() / image.len() as f64;
            assert!((sum(&read.observation.touch[pad]) - sum(&observation.touch[pad])).abs() < 0.5);
        }
        let difference = read_truth.object_pose.inverse() * truth.object_pose;
        assert!(difference.untyped().translation.vector.norm() < 1e-12);
        assert!(difference.untyped().rotation.angle() < 1e-7);
        count += 1;
    }
    assert_eq!(count, 5);
    let third = log.frame(3).unwrap().unwrap();
    assert_eq!(third, log.frames().unwrap().nth(3).unwrap().unwrap());
    assert!(log.frame(5).unwrap().is_none());
}

#[test]
fn loaders_find_contact_and_fingers_where_they_look() {
    let folder = tempfile::tempdir().unwrap();
    let place = folder.path().join("00");
    write(&place, 2, &cameras());
    let gray = |kind: &str| {
        let bytes = fs::read(place.join("allegro/index").join(kind).join("1.jpg")).unwrap();
        assert!(bytes.starts_with(b"\x89PNG"), "exact in spite of its name");
        image::load_from_memory(&bytes).unwrap().into_luma8()
    };
    // Loaders take level 0 for no contact, even at the rim, where the indentation is less than half a level.
    let (levels, mask) = (gray("depth"), gray("mask"));
    let (_, truth) = frame(1, &cameras());
    let depth_m = &truth.touch[0].depth_m;
    let rim = mask.iter().zip(depth_m).filter(|(mask, depth)| **mask > 0 && **depth > 0.021_99).count();
    assert!(rim > 0 && levels.iter().zip(mask.iter()).all(|(level, mask)| *level > 0 || *mask == 0));

    let data = pickle::from_bytes(&fs::read(place.join("data.pkl")).unwrap()).unwrap();
    let (shape, poses) = data.get("allegro").unwrap().get("finger_poses").unwrap().to_tensor().unwrap();
    assert_eq!(shape, [2, 4, 4, 4]);
    for (pad, pose) in common::hand().world_from_touch_cameras(&common::joints(1)).iter().enumerate() {
        assert!(pose.to_matrix().iter().flatten().eq(&poses[16 * (4 + pad)..16 * (5 + pad)]), "{pad}");
    }
}

#[test]
fn inspection_finds_the_ball_where_it_was_touched() {
    let folder = tempfile::tempdir().unwrap();
    let place = folder.path().join("00");
    write(&place, 5, &cameras());
    let summary = inspect_against(&place, &|p| p.coords().norm() - RADIUS_M).unwrap();
    assert_eq!((summary.frames, summary.complete), (5, Some(true)));
    assert_eq!(summary.contact_fraction.as_ref().unwrap()[..], [1.0, 0.0, 0.0, 0.0]);
    assert!(summary.kinematics_deviation.unwrap() < 1e-12);
    let contact = summary.contact_distance.clone().unwrap();
    assert!(contact.points > 100 && contact.p95_m < 2e-5, "{contact:?}");
    assert!((summary.rate_hz - 30.0).abs() < 1e-9);
    assert_eq!(summary.cameras[0].object_pixels, Some(f64::from((64 - 20) * (48 - 10))));
    assert!((summary.cameras[0].depth_fraction - 38.0 / 48.0).abs() < 1e-12);
    let text = summary.to_string();
    assert!(text.contains("5 frames in") || text.contains("frames    5 in 0.13 s, 30.00 per second"), "{text}");
}

#[test]
fn bytes_do_not_depend_on_threads() {
    let folder = tempfile::tempdir().unwrap();
    let meta = meta(cameras());
    let mut logs = Vec::new();
    for threads in [1, 2, 5] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let place = folder.path().join(threads.to_string());
        let mut writer = LogWriter::create(&place, meta.clone(), false).unwrap();
        let encode = |i| {
            let (observation, truth) = frame(i, &meta.cameras);
            EncodedFrame::encode(&observation, &truth, &meta).unwrap()
        };
        let frames: Vec<_> = pool.install(|| (0..6).into_par_iter().map(encode).collect());
        frames.iter().for_each(|frame| writer.push(frame).unwrap());
        writer.finish(end()).unwrap();
        logs.push(files(&place));
    }
    // ffmpeg writes the film.
    logs.iter_mut().for_each(|log| log.retain(|path, _| path.extension().is_none_or(|e| e != "mp4")));
    assert!(logs[0] == logs[1] && logs[0] == logs[2]);
    assert_eq!(logs[0].len(), 6 * (4 * 3 + 2 * 2) + 2 + 2 + usize::from(logs[0].contains_key(Path::new("ball.gif"))));
}

#[test]
fn an_interrupted_log_leaves_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let place = folder.path().join("00");
    let mut writer = LogWriter::create(&place, meta(cameras()), false).unwrap();
    let (observation, truth) = frame(0, &cameras());
    writer.push(&EncodedFrame::encode(&observation, &truth, writer.meta()).unwrap()).unwrap();
    assert!(!place.exists());
    drop(writer);
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);

    // Killed: the writer is never dropped. The next one starts anew.
    let mut writer = LogWriter::create(&place, meta(cameras()), false).unwrap();
    writer.push(&EncodedFrame::encode(&observation, &truth, writer.meta()).unwrap()).unwrap();
    std::mem::forget(writer);
    assert!(!place.exists() && folder.path().join(".00.partial").exists());
    assert!(Log::open(&folder.path().join(".00.partial")).is_err());
    write(&place, 2, &cameras());
    assert_eq!(inspect(&place).unwrap().frames, 2);
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
}

#[test]
fn an_old_log_stays_until_the_new_log_is_complete() {
    let folder = tempfile::tempdir().unwrap();
    let place = folder.path().join("00");
    write(&place, 2, &cameras());
    let refused = LogWriter::create(&place, meta(cameras()), false).err().unwrap();
    assert!(matches!(refused, LogError::NotEmpty { .. }) && refused.to_string().contains("00"), "{refused}");

    let mut writer = LogWriter::create(&place, meta(cameras()), true).unwrap();
    assert_eq!(Log::open(&place).unwrap().len(), 2);
    for i in 0..3 {
        let (observation, truth) = frame(i, &cameras());
        writer.push(&EncodedFrame::encode(&observation, &truth, writer.meta()).unwrap()).unwrap();
    }
    writer.finish(end()).unwrap();
    assert_eq!(Log::open(&place).unwrap().len(), 3);
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
}

#[test]
fn unfitting_frames_and_names_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let place = folder.path().join("00");
    let meta = meta(cameras());
    let (observation, truth) = frame(0, &meta.cameras);
    let refusal = |observation: &_, truth: &_| EncodedFrame::encode(observation, truth, &meta).unwrap_err().to_string();
    let mut small = observation.clone();
    small.touch[2] = image::RgbImage::new(10, 10);
    assert!(refusal(&small, &truth).contains("ring"));
    let mut blind = observation.clone();
    blind.cameras.pop();
    assert!(refusal(&blind, &truth).contains("1 cameras and the log 2"));
    let mut nan = observation.clone();
    nan.joints[3] = f64::NAN;
    assert!(refusal(&nan, &truth).contains("not finite"));
    let mut stiff = observation.clone();
    stiff.joints.pop();
    assert!(refusal(&stiff, &truth).contains("15 joint angles and hand allegro_digit 16"));

    let mut writer = LogWriter::create(&place, meta.clone(), false).unwrap();
    let encoded = EncodedFrame::encode(&observation, &truth, &meta).unwrap();
    writer.push(&encoded).unwrap();
    assert!(matches!(writer.push(&encoded), Err(LogError::Frame { .. })), "time stands still");
    drop(writer);
    let empty = LogWriter::create(&place, meta.clone(), false).unwrap();
    assert!(empty.finish(end()).unwrap_err().to_string().contains("first frame"));
    let mut climbing = meta;
    climbing.scene.object.name = "../ball".into();
    assert!(LogWriter::create(&place, climbing, false).is_err());
}

#[test]
fn a_place_that_cannot_be_written_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("file");
    fs::write(&file, "").unwrap();
    let error = LogWriter::create(&file.join("00"), meta(cameras()), false).err().unwrap().to_string();
    assert!(error.contains("file"), "{error}");
    #[cfg(target_os = "linux")]
    {
        let error = LogWriter::create(Path::new("/proc/nowhere/00"), meta(cameras()), false).err().unwrap();
        assert!(error.to_string().contains("/proc/nowhere"), "{error}");
    }
}

#[test]
fn every_kind_of_damage_is_found_and_named() {
    let folder = tempfile::tempdir().unwrap();
    let place = folder.path().join("00");
    write(&place, 3, &cameras());
    let good = files(&place);
    let restore = |path: &str| fs::write(place.join(path), &good[Path::new(path)]).unwrap();
    let refused = |name: &str| {
        let error = inspect(&place).expect_err(name).to_string();
        assert!(error.contains(name), "{error}");
    };
    // Missing, empty and foreign files.
    for path in ["allegro/ring/image/1.jpg", "allegro/thumb/mask/2.jpg", "realsense/top-down/seg/0.jpg"] {
        fs::remove_file(place.join(path)).unwrap();
        refused(Path::new(path).parent().unwrap().to_str().unwrap());
        fs::write(place.join(path), b"").unwrap();
        refused(path);
        fs::write(place.join(path), &good[Path::new("realsense/front-left/seg/0.jpg")]).unwrap();
        refused(path);
        restore(path);
    }
    // A grey that is no label.
    fs::write(place.join("allegro/index/mask/0.jpg"), &good[Path::new("allegro/index/depth/0.jpg")]).unwrap();
    refused("allegro/index/mask/0.jpg");
    restore("allegro/index/mask/0.jpg");
    // Depths of another camera, cut off, and with a changed bit.
    let depth = Path::new("realsense/front-left/depth.npz");
    fs::write(place.join(depth), &good[Path::new("realsense/top-down/depth.npz")]).unwrap();
    refused("depth.npz");
    fs::write(place.join(depth), &good[depth][..good[depth].len() / 2]).unwrap();
    refused("depth.npz");
    let mut bent = good[depth].clone();
    let middle = bent.len() / 3;
    bent[middle] ^= 1;
    fs::write(place.join(depth), bent).unwrap();
    refused("depth.npz");
    restore("realsense/front-left/depth.npz");
    fs::write(place.join("data.pkl"), b"cos\nsystem\n(S'echo'\ntR.").unwrap();
    refused("os.system");
    restore("data.pkl");
    fs::write(place.join("scene.json"), b"{").unwrap();
    refused("scene.json");
    restore("scene.json");
    assert!(inspect(&place).is_ok());
}

#[test]
fn a_recorded_log_without_labels_is_read_with_notes() {
    let folder = tempfile::tempdir().unwrap();
    let place = folder.path().join("00");
    write(&place, 3, &cameras());
    fs::remove_file(place.join("scene.json")).unwrap();
    for pad in common::hand().pads() {
        for kind in ["depth", "mask"] {
            fs::remove_dir_all(place.join("allegro").join(&pad.name).join(kind)).unwrap();
        }
    }
    for camera in cameras() {
        fs::remove_dir_all(place.join("realsense").join(camera.name).join("seg")).unwrap();
    }
    fs::remove_file(place.join("allegro/ring/image/2.jpg")).unwrap();
    let log = Log::open(&place).unwrap();
    assert_eq!(log.len(), 2, "as many frames as every sensor has");
    assert!(!log.notes().is_empty());
    let frame = log.frame(1).unwrap().unwrap();
    assert!(frame.truth.is_none() && log.object_poses()[1].is_some());
    // Without scene.json poses are those of the published mesh.
    let expected = (common::object_pose(1) * common::object_from_file()).to_matrix();
    let read = log.object_poses()[1].unwrap().to_matrix();
    assert!(read.iter().flatten().zip(expected.iter().flatten()).all(|(a, b)| (a - b).abs() < 1e-12));
    let summary = inspect(&place).unwrap();
    assert_eq!((summary.contact_fraction, summary.complete), (None, None));
}

/// Multiplies every matrix of a value from the left.
fn moved(value: &PickleValue, by: &nalgebra::Matrix4<f64>) -> PickleValue {
    if let PickleValue::List(matrices) = value {
        return PickleValue::List(matrices.iter().map(|matrix| moved(matrix, by)).collect());
    }
    let (shape, elements) = value.to_tensor().unwrap();
    let product = by * nalgebra::Matrix4::from_row_slice(&elements);
    Array::from_f64(shape, product.transpose().iter().copied()).into()
}

fn entry<'a>(value: &'a mut PickleValue, key: &str) -> &'a mut PickleValue {
    let PickleValue::Dict(items) = value else { panic!("{key}") };
    &mut items.iter_mut().find(|(k, _)| k.as_str() == Some(key)).unwrap().1
}

#[test]
fn a_log_in_another_world_is_brought_into_ours() {
    let folder = tempfile::tempdir().unwrap();
    let place = folder.path().join("00");
    write(&place, 2, &cameras());
    fs::remove_file(place.join("scene.json")).unwrap();
    let ours = Log::open(&place).unwrap();

    // The robot stands elsewhere, and the pose of a camera at rest is repeated for every frame, as in simulated logs.
    let pkl = place.join("data.pkl");
    let mut data = pickle::from_bytes(&fs::read(&pkl).unwrap()).unwrap();
    let by = nalgebra::Isometry3::new(nalgebra::Vector3::new(1.0, 2.0, -0.5), nalgebra::Vector3::new(0.3, -1.0, 2.0));
    let by = by.to_homogeneous();
    let base = entry(entry(&mut data, "allegro"), "base_pose");
    *base = moved(base, &by);
    let object = entry(entry(&mut data, "object"), "pose");
    *object = moved(object, &by);
    let fingers = entry(entry(&mut data, "allegro"), "finger_poses");
    *fingers = PickleValue::None;
    for camera in cameras() {
        let pose = entry(entry(entry(&mut data, "realsense"), &camera.name), "pose");
        *pose = PickleValue::List(vec![moved(pose, &by), moved(pose, &by)]);
    }
    fs::write(&pkl, pickle::to_bytes(&data)).unwrap();

    let theirs = Log::open(&place).unwrap();
    let same = |a: [[f64; 4]; 4], b: [[f64; 4]; 4]| {
        a.iter().flatten().zip(b.iter().flatten()).all(|(a, b)| (a - b).abs() < 1e-12)
    };
    for (a, b) in theirs.object_poses().iter().zip(ours.object_poses()) {
        assert!(same(a.unwrap().to_matrix(), b.unwrap().to_matrix()));
    }
    for (a, b) in theirs.cameras().iter().zip(ours.cameras()) {
        assert!(same(a.pose.to_matrix(), b.pose.to_matrix()));
    }
    assert_eq!(inspect(&place).unwrap().kinematics_deviation, None);
}

#[test]
fn wrong_kinematics_and_times_are_found() {
    let folder = tempfile::tempdir().unwrap();
    let place = folder.path().join("00");
    write(&place, 2, &cameras());
    let pkl = place.join("data.pkl");
    let good = pickle::from_bytes(&fs::read(&pkl).unwrap()).unwrap();
    let with = |change: &dyn Fn(&mut PickleValue)| {
        let mut data = good.clone();
        change(&mut data);
        fs::write(&pkl, pickle::to_bytes(&data)).unwrap();
        inspect(&place).unwrap_err().to_string()
    };
    // A hundredth of a degree.
    let bent = with(&|data| {
        let joints = entry(entry(data, "allegro"), "joint_state");
        let (shape, mut elements) = joints.to_tensor().unwrap();
        elements[17] += 1.7e-4;
        *joints = Array::from_f64(shape, elements).into();
    });
    assert!(bent.contains("frame 1, index") && bent.contains("kinematics"), "{bent}");
    let back = with(&|data| *entry(data, "time") = Array::from_f64(vec![2], [1.0, 0.5]).into());
    assert!(back.contains("time does not increase"), "{back}");
    let mirror = with(&|data| {
        let poses = entry(entry(data, "object"), "pose");
        *poses = moved(poses, &nalgebra::Matrix4::from_diagonal(&[1.0, 1.0, -1.0, 1.0].into()));
    });
    assert!(mirror.contains("object.pose of frame 0 is not a rigid motion"), "{mirror}");
    let missing = with(&|data| *entry(data, "allegro") = PickleValue::dict([]));
    assert!(missing.contains("joint_state is missing"), "{missing}");
    let short = with(&|data| *entry(data, "time") = Array::from_f64(vec![1], [0.0]).into());
    assert!(short.contains("2 joint states for 1 frames"), "{short}");
}

#[test]
fn image_files_are_those_of_the_log_unless_a_lens_distorts() {
    let folder = tempfile::tempdir().unwrap();
    let place = folder.path().join("00");
    write(&place, 2, &cameras());
    let read = |path: &str| fs::read(place.join(path)).unwrap();
    let log = Log::open(&place).unwrap();
    let files = log.image_files(1).unwrap();
    assert_eq!(files.colours[1], Some(read("realsense/top-down/image/1.jpg")));
    assert_eq!(files.labels.unwrap()[0], read("realsense/front-left/seg/1.jpg"));
    assert_eq!(files.touch[2], Some(read("allegro/ring/image/1.jpg")));
    let [depth, mask] = files.touch_truth.unwrap()[3].clone();
    assert_eq!((depth, mask), (read("allegro/thumb/depth/1.jpg"), read("allegro/thumb/mask/1.jpg")));
    assert_eq!(log.scene_file().unwrap().unwrap(), read("scene.json"));
    assert!(log.image_files(2).is_err());

    let mut data = pickle::from_bytes(&read("data.pkl")).unwrap();
    let intrinsics = entry(entry(entry(&mut data, "realsense"), "front-left"), "intrinsics");
    let PickleValue::Dict(items) = intrinsics else { panic!() };
    items.push(("k1".into(), 0.2.into()));
    fs::write(place.join("data.pkl"), pickle::to_bytes(&data)).unwrap();
    let log = Log::open(&place).unwrap();
    let files = log.image_files(1).unwrap();
    assert_ne!(files.colours[0], Some(read("realsense/front-left/image/1.jpg")));
    assert_eq!(files.colours[1], Some(read("realsense/top-down/image/1.jpg")));
    let straight = log.frame(1).unwrap().unwrap();
    let labels = image::load_from_memory(&files.labels.unwrap()[0]).unwrap().into_luma8();
    let labels = labels.iter().map(|&grey| mvt_frames::depth::Label::from_grey(grey).unwrap());
    assert!(labels.eq(straight.truth.unwrap().labels[0].iter().copied()));
}
