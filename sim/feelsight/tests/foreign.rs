//! Logs of other programs, with parts missing or damaged: each is read rightly, or refused with its reason.

#![allow(clippy::unwrap_used, clippy::panic)]

use std::fs;
use std::path::{Path, PathBuf};

use crate::common::{camera, write};
use mvt_feelsight::array::Array;
use mvt_feelsight::image::{DynamicImage, ImageFormat, RgbImage};
use mvt_feelsight::pickle::{self, PickleValue};
use mvt_feelsight::{Log, LogFormat, convert, inspect};

const FRAMES: usize = 3;

fn cameras() -> Vec<mvt_frames::camera::PosedCamera> {
    vec![camera("front-left", 64, 48), camera("top-down", 40, 30)]
}

/// A log as other programs write it.
fn foreign(folder: &Path) -> PathBuf {
    let place = folder.join("log");
    write(&place, FRAMES, &cameras());
    fs::remove_file(place.join("scene.json")).unwrap();
    place
}

fn refusal(place: &Path) -> String {
    inspect(place).unwrap_err().to_string()
}

/// Changes the times of a log.
fn set_times(place: &Path, times_s: Vec<f64>) {
    let path = place.join("data.pkl");
    let mut data = pickle::from_bytes(&fs::read(&path).unwrap()).unwrap();
    let PickleValue::Dict(items) = &mut data else { panic!() };
    let time = items.iter_mut().find(|(key, _)| key.as_str() == Some("time")).unwrap();
    time.1 = Array::from_f64(vec![times_s.len()], times_s).into();
    fs::write(path, pickle::to_bytes(&data)).unwrap();
}

#[test]
fn a_log_without_a_digit_or_without_colours_is_read_and_converted() {
    let folder = tempfile::tempdir().unwrap();
    let place = foreign(folder.path());
    fs::remove_dir_all(place.join("allegro/ring")).unwrap();
    for camera in cameras() {
        fs::remove_dir_all(place.join("realsense").join(camera.name).join("image")).unwrap();
    }
    for (k, format) in [LogFormat::Compact, LogFormat::FeelSight].into_iter().enumerate() {
        let out = folder.path().join(k.to_string());
        convert(&place, &out, format, |_| ()).unwrap();
        for log in [&place, &out] {
            assert_eq!(inspect(log).unwrap().frames, FRAMES);
            let log = Log::open(log).unwrap();
            assert_eq!([0, 1, 2, 3].map(|pad| log.has_touch_images(pad)), [true, true, false, true]);
            let files = log.image_files(1).unwrap();
            assert!(files.touch[2].is_none() && files.touch[3].is_some());
            assert!(files.colours.iter().all(Option::is_none));
            assert!(log.frame(1).unwrap().unwrap().observation.touch[2].is_empty());
        }
    }
}

#[test]
fn fewer_depths_than_frames_are_an_error() {
    let folder = tempfile::tempdir().unwrap();
    let place = foreign(folder.path());
    let shorter = folder.path().join("shorter");
    write(&shorter, FRAMES - 1, &cameras());
    let depth = Path::new("realsense").join(&cameras()[0].name).join("depth.npz");
    fs::copy(shorter.join(&depth), place.join(&depth)).unwrap();
    let said = refusal(&place);
    assert!(said.contains("depth.npz: it has 2 depth images for 3 frames"), "{said}");
}

#[test]
fn cut_and_grey_images_are_errors() {
    let folder = tempfile::tempdir().unwrap();
    let place = foreign(folder.path());
    let colour = format!("realsense/{}/image/1.jpg", cameras()[0].name);
    for name in ["allegro/index/image/1.jpg", colour.as_str()] {
        let path = place.join(name);
        let whole = fs::read(&path).unwrap();
        fs::write(&path, &whole[..whole.len() * 9 / 10]).unwrap();
        let said = refusal(&place);
        assert!(said.contains(name) && said.contains("the JPEG file is cut or damaged"), "{said}");
        fs::write(&path, &whole).unwrap();
    }
    let path = place.join("allegro/index/image/1.jpg");
    let image = RgbImage::from_fn(240, 320, |x, y| [(x / 2) as u8, (y / 2) as u8, 90].into());
    DynamicImage::ImageRgb8(image).into_luma8().save_with_format(&path, ImageFormat::Png).unwrap();
    let said = refusal(&place);
    assert!(said.contains("index/image/1.jpg: it is a grey image"), "{said}");
}

#[test]
fn files_that_a_desktop_leaves_are_no_frames() {
    let folder = tempfile::tempdir().unwrap();
    let place = foreign(folder.path());
    for name in ["._0.jpg", ".DS_Store", "Thumbs.db"] {
        fs::write(place.join("allegro/index/image").join(name), "x").unwrap();
    }
    let log = Log::open(&place).unwrap();
    assert_eq!((log.len(), log.notes().len()), (FRAMES, 0), "{:?}", log.notes());
}

#[test]
fn times_that_stand_still_are_said_with_their_number() {
    let folder = tempfile::tempdir().unwrap();
    let place = foreign(folder.path());
    // Seconds since 1970 in 32-bit floats.
    set_times(&place, [0.0, 0.03, 0.06].map(|time_s| f64::from((1.7e9 + time_s) as f32)).to_vec());
    let said = refusal(&place);
    assert!(said.contains("the times of 2 of 3 frames are not after") && said.contains("64-bit floats"), "{said}");
    set_times(&place, vec![0.0, 0.0, 0.06]);
    let summary = inspect(&place).unwrap();
    assert!(summary.notes.iter().any(|note| note.starts_with("the times of 1 of 3 frames")), "{summary}");
    assert!(summary.rate_hz.is_finite(), "{summary}");
}

#[test]
fn a_pickle_in_text_mode_and_a_joint_without_a_number_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let place = foreign(folder.path());
    let path = place.join("data.pkl");
    let whole = fs::read(&path).unwrap();
    // A pickle of protocol 0 is text.
    fs::write(&path, b"(dp0\r\nS'time'\r\np1\r\n(lp2\r\nF0.5\r\nasg2\r\n.").unwrap();
    let said = refusal(&place);
    assert!(said.contains("line ends of Windows"), "{said}");
    let converted: Vec<u8> =
        whole.iter().flat_map(|&byte| if byte == b'\n' { vec![b'\r', byte] } else { vec![byte] }).collect();
    fs::write(&path, converted).unwrap();
    let said = refusal(&place);
    assert!(said.contains("data.pkl: it was converted to text with line ends of Windows"), "{said}");

    let mut data = pickle::from_bytes(&whole).unwrap();
    let PickleValue::Dict(items) = &mut data else { panic!() };
    let PickleValue::Dict(hand) = &mut items.iter_mut().find(|(key, _)| key.as_str() == Some("allegro")).unwrap().1
    else {
        panic!()
    };
    let joints = &mut hand.iter_mut().find(|(key, _)| key.as_str() == Some("joint_state")).unwrap().1;
    let (shape, mut numbers) = joints.to_tensor().unwrap();
    numbers[16 + 3] = f64::NAN;
    *joints = Array::from_f64(shape, numbers).into();
    fs::write(&path, pickle::to_bytes(&data)).unwrap();
    let said = refusal(&place);
    assert!(said.contains("allegro.joint_state of frame 1 holds a number that is not finite"), "{said}");
}

#[test]
fn a_git_lfs_pointer_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let place = foreign(folder.path());
    let depth = format!("realsense/{}/depth.npz", cameras()[0].name);
    for name in ["data.pkl", &depth, "allegro/index/image/1.jpg"] {
        let whole = fs::read(place.join(name)).unwrap();
        fs::write(place.join(name), "version https://git-lfs.github.com/spec/v1\noid sha256:4d\nsize 12\n").unwrap();
        let said = refusal(&place);
        assert!(said.contains(name) && said.contains("it is a git-lfs pointer; run `git lfs pull`"), "{said}");
        fs::write(place.join(name), whole).unwrap();
    }
}
