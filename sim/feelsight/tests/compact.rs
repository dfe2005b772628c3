//! Compact logs: the frames that are read equal those that were recorded, within the bounds that docs/compact_log.md states.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a failed assumption in a test is a failed test")]
#![allow(clippy::print_stderr, reason = "a skipped test says so")]

use std::fs;
use std::path::Path;
use std::process::Command;

use crate::common;
use image::{Rgb, RgbImage};
use mvt_feelsight::{EncodedFrame, Log, LogFormat, LogMeta, LogWriter, convert, inspect};
use mvt_frames::camera::PosedCamera;
use mvt_robot::digit;
use mvt_robot::hand::PerPad;
use proptest::prelude::*;

/// Bound of camera depth: half a step of 0.1 mm, and the rounding of f32.
const DEPTH_M: f32 = 0.05e-3 + 1e-7;

fn cameras() -> Vec<PosedCamera> {
    vec![common::camera("front-left", 48, 40), common::camera("side", 32, 36)]
}

fn write_compact(place: &Path, frames: usize, untouched: PerPad<RgbImage>) {
    let meta = LogMeta { untouched: Some(untouched), ..common::meta(cameras()) };
    let mut writer = LogWriter::create(place, meta, false).unwrap();
    for i in 0..frames {
        let (observation, truth) = common::frame(i, &cameras());
        writer.push(&EncodedFrame::encode(&observation, &truth, writer.meta()).unwrap()).unwrap();
    }
    writer.finish(common::end()).unwrap();
}

fn shade(pad: usize) -> RgbImage {
    let level = 100 + 20 * pad as u8;
    RgbImage::from_fn(digit::WIDTH as u32, digit::HEIGHT as u32, |x, y| Rgb([level, (x / 2) as u8, (y / 3) as u8]))
}

fn largest_difference(a: &RgbImage, b: &RgbImage) -> u8 {
    assert_eq!(a.dimensions(), b.dimensions());
    a.iter().zip(b.iter()).map(|(a, b)| a.abs_diff(*b)).max().unwrap()
}

/// Compares a log with the recorded frames.
fn check(log: &Log, frames: usize) {
    assert_eq!(log.len(), frames);
    for (i, read) in log.frames().unwrap().enumerate() {
        let read = read.unwrap();
        let (observation, truth) = common::frame(i, &cameras());
        let labels = read.truth.unwrap();
        assert_eq!(labels.labels, truth.labels);
        for pad in 0..4 {
            assert_eq!(labels.touch[pad].contact, truth.touch[pad].contact);
            let error = (&labels.touch[pad].depth_m - &truth.touch[pad].depth_m).mapv(f32::abs);
            assert!(error.iter().all(|&error| error <= 0.031e-3), "levels are 0.03 mm apart");
            let largest = largest_difference(&read.observation.touch[pad], &observation.touch[pad]);
            assert!(largest <= 12, "pad {pad} of frame {i}: {largest}");
        }
        for (read, recorded) in read.observation.cameras.iter().zip(&observation.cameras) {
            let largest = largest_difference(&read.color, &recorded.color);
            assert!(largest <= 12, "colours of frame {i}: {largest}");
            let error = (&read.depth_m - &recorded.depth_m).mapv(f32::abs);
            assert!(error.iter().all(|&error| error <= DEPTH_M), "{:?}", error.iter().copied().fold(0.0, f32::max));
            assert!(read.depth_m.iter().zip(&recorded.depth_m).all(|(a, b)| (*a == 0.0) == (*b == 0.0)));
        }
    }
}

#[test]
fn a_compact_log_is_read_back_within_its_bounds() {
    let folder = tempfile::tempdir().unwrap();
    let place = folder.path().join("log");
    write_compact(&place, 3, PerPad::from_fn(4, shade));
    let mut names: Vec<_> = fs::read_dir(&place).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    names.sort();
    assert_eq!(&names[1..], ["data.pkl", "frames.zip", "scene.json"], "{names:?}");
    let log = Log::open(&place).unwrap();
    assert_eq!((log.format(), log.notes().len()), (LogFormat::Compact, 0));
    check(&log, 3);
    // A frame in the middle is read without those before it.
    assert_eq!(log.frame(2).unwrap(), log.frames().unwrap().nth(2).transpose().unwrap());
    let summary = inspect(&place).unwrap();
    assert_eq!((summary.frames, summary.cameras.len()), (3, 2));
}

/// Pillow and NumPy read the same as we do, to a few grey levels of JPEG decoders.
#[test]
fn a_compact_log_is_read_without_this_program() {
    if !Command::new("python3").args(["-c", "import numpy, PIL"]).output().is_ok_and(|o| o.status.success()) {
        common::skip("there is no python3 with NumPy and Pillow on the path");
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let (place, dump) = (folder.path().join("log"), folder.path().join("dump"));
    write_compact(&place, 2, PerPad::from_fn(4, shade));
    fs::create_dir(&dump).unwrap();
    let write = |name: String, bytes: Vec<u8>| fs::write(dump.join(name), bytes).unwrap();
    let metres = |depth: &ndarray::Array2<f32>| depth.iter().flat_map(|depth_m| depth_m.to_le_bytes()).collect();
    for (i, frame) in Log::open(&place).unwrap().frames().unwrap().enumerate() {
        let frame = frame.unwrap();
        let truth = frame.truth.unwrap();
        for (k, pad) in common::hand().pads().iter().enumerate() {
            let name = &pad.name;
            write(format!("{name}-{i}"), frame.observation.touch[k].to_vec());
            write(format!("{name}-depth-{i}"), metres(&truth.touch[k].depth_m));
            write(format!("{name}-contact-{i}"), truth.touch[k].contact.iter().map(|&is| u8::from(is)).collect());
        }
        for (camera, read) in cameras().iter().zip(&frame.observation.cameras) {
            write(format!("{}-{i}", camera.name), read.color.to_vec());
            write(format!("{}-depth-{i}", camera.name), metres(&read.depth_m));
        }
    }
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/check_compact.py");
    let ended = Command::new("python3").arg(script).args([&place, &dump]).arg("2").output().unwrap();
    assert!(ended.status.success(), "{}", String::from_utf8_lossy(&ended.stderr));
}

#[test]
fn logs_are_converted_both_ways() {
    let folder = tempfile::tempdir().unwrap();
    let [first, second, third, fourth] = ["1", "2", "3", "4"].map(|name| folder.path().join(name));
    common::write(&first, 3, &cameras());
    let mut told = 0;
    convert(&first, &second, LogFormat::Compact, |frames| told = frames).unwrap();
    assert_eq!(told, 3);
    check(&Log::open(&second).unwrap(), 3);
    convert(&second, &third, LogFormat::FeelSight, |_| ()).unwrap();
    let log = Log::open(&third).unwrap();
    assert_eq!(log.format(), LogFormat::FeelSight);
    check(&log, 3);
    for file in ["data.pkl", "scene.json"] {
        assert_eq!(fs::read(first.join(file)).unwrap(), fs::read(third.join(file)).unwrap(), "{file}");
    }
    for exact in ["allegro/index/depth/1.jpg", "allegro/thumb/mask/2.jpg", "realsense/side/seg/0.jpg"] {
        assert_eq!(fs::read(first.join(exact)).unwrap(), fs::read(third.join(exact)).unwrap(), "{exact}");
    }
    // Depth in steps of the layout is kept to the bit.
    convert(&third, &fourth, LogFormat::Compact, |_| ()).unwrap();
    let [once, twice] = [&third, &fourth].map(|place| Log::open(place).unwrap());
    for (a, b) in once.frames().unwrap().zip(twice.frames().unwrap()) {
        let (a, b) = (a.unwrap().observation, b.unwrap().observation);
        assert!(a.cameras.iter().zip(&b.cameras).all(|(a, b)| a.depth_m == b.depth_m));
    }
    assert!(convert(&first, &second, LogFormat::Compact, |_| ()).is_err(), "nothing is replaced");
}

#[test]
fn a_difference_that_is_too_large_is_stored_whole() {
    let folder = tempfile::tempdir().unwrap();
    let place = folder.path().join("log");
    let black = RgbImage::new(digit::WIDTH as u32, digit::HEIGHT as u32);
    write_compact(&place, 2, PerPad::from_fn(4, |pad| if pad == 3 { black.clone() } else { shade(pad) }));
    let archive = zip::ZipArchive::new(fs::File::open(place.join("frames.zip")).unwrap()).unwrap();
    for (name, there) in [
        ("allegro/thumb/image/1.jpg", true),
        ("allegro/thumb/difference/1.jpg", false),
        ("allegro/index/difference/1.jpg", true),
    ] {
        assert_eq!(archive.index_for_name(name).is_some(), there, "{name}");
    }
    check(&Log::open(&place).unwrap(), 2);
}

#[test]
fn damage_is_found_and_named() {
    let folder = tempfile::tempdir().unwrap();
    let place = folder.path().join("log");
    write_compact(&place, 2, PerPad::from_fn(4, shade));
    let path = place.join("frames.zip");
    let whole = fs::read(&path).unwrap();
    let flipped = |at: usize| {
        let mut bytes = whole.clone();
        bytes[at] ^= 4;
        fs::write(&path, bytes).unwrap();
        inspect(&place).unwrap_err().to_string()
    };
    // In the images, and in the directory at the end.
    for at in [whole.len() / 3, whole.len() / 2, whole.len() - 30] {
        assert!(flipped(at).contains("frames.zip"), "{}", flipped(at));
    }
    fs::write(&path, &whole[..whole.len() / 2]).unwrap();
    assert!(Log::open(&place).unwrap_err().to_string().contains("frames.zip"));
    fs::remove_file(&path).unwrap();
    assert!(Log::open(&place).is_err());
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(16))]

    #[test]
    fn depth_in_sensor_steps_is_exact(steps in prop::collection::vec(0u16..=u16::MAX, 20 * 12), tenths: bool) {
        let folder = tempfile::tempdir().unwrap();
        let place = folder.path().join("log");
        let cameras = vec![common::camera("front-left", 20, 12)];
        let meta = LogMeta { untouched: Some(PerPad::from_fn(4, shade)), ..common::meta(cameras.clone()) };
        let mut writer = LogWriter::create(&place, meta, false).unwrap();
        let (mut observation, truth) = common::frame(0, &cameras);
        // Sensors measure in steps of 0.1 or of 1 mm.
        let metres = |steps: u16| if tenths { steps as f32 / 1e4 } else { (steps % 6554) as f32 / 1e3 };
        observation.cameras[0].depth_m = ndarray::Array2::from_shape_fn((12, 20), |(row, column)| metres(steps[20 * row + column]));
        writer.push(&EncodedFrame::encode(&observation, &truth, writer.meta()).unwrap()).unwrap();
        writer.finish(common::end()).unwrap();
        let read = Log::open(&place).unwrap().frame(0).unwrap().unwrap().observation;
        prop_assert_eq!(&read.cameras[0].depth_m, &observation.cameras[0].depth_m);
    }
}
