//! Folders in the layouts of other programs and data sets, written here from one scene.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a failed assumption in a test is a failed test")]

mod sequences;

use std::fs;

use image::{GrayImage, Luma};
use mvt_frames::Point;
use mvt_rgbd::{RgbdLayout, RgbdRecording};
use tempfile::TempDir;

use sequences::{K, SIZE, bop, depth_mm, described, folders, ho3d, is_object, mask, save, tum, write};

#[test]
fn all_layouts_give_the_same_frames() {
    let cases = [
        (folders(), RgbdLayout::Folders, 0.04, true),
        (bop(), RgbdLayout::Bop, 1.0 / 30.0, true),
        (ho3d(), RgbdLayout::Ho3d, 1.0 / 30.0, true),
        (tum(), RgbdLayout::Tum, 0.04, false),
        (described(), RgbdLayout::Described, 0.04, true),
    ];
    for (folder, layout, period_s, has_truth) in cases {
        let recording = RgbdRecording::open(folder.path()).unwrap();
        assert_eq!((recording.layout(), recording.len()), (layout, 3), "{:?}", recording.notes());
        let times_s: Vec<f64> = recording.times_s().collect();
        assert!(times_s.windows(2).all(|pair| (pair[1] - pair[0] - period_s).abs() < 1e-6), "{layout:?}: {times_s:?}");
        for k in 0..3 {
            let frame = recording.frame(k as usize).unwrap();
            for ((v, u), depth_m) in frame.depth_m.indexed_iter() {
                let expected = 1e-3 * f32::from(depth_mm(k, u as u32, v as u32));
                assert!((depth_m - expected).abs() < 1e-4, "{layout:?}, frame {k} at ({u}, {v}): {depth_m}");
            }
            let Some(mask) = &frame.mask else { panic!("{layout:?}: no mask") };
            assert!(mask.indexed_iter().all(|((v, u), inside)| *inside == is_object(u as u32, v as u32)), "{layout:?}");
            let i = frame.intrinsics;
            assert_eq!([i.fx, i.fy, i.cx, i.cy], K, "{layout:?}");
            assert!((f64::from(frame.color.get_pixel(9, 5)[0]) - 9.0).abs() < 12.0, "{layout:?}");
            assert_eq!(frame.camera_from_object.is_some(), has_truth, "{layout:?}");
            if let Some(pose) = frame.camera_from_object {
                // The object's origin lies to the right of the axis and below it: OpenGL axes.
                let origin = (pose * Point::new(0.0, 0.0, 0.0)).coords();
                let expected = [0.1, -0.2, -0.5 - 0.01 * f64::from(k)];
                assert!((0..3).all(|axis| (origin[axis] - expected[axis]).abs() < 1e-9), "{layout:?}: {origin}");
                // Its y axis points down in the image, as that of a camera with OpenCV axes.
                let y = (pose * Point::new(0.0, 1.0, 0.0)).coords() - origin;
                assert!((y.y + 1.0).abs() < 1e-6, "{layout:?}: {y}");
            }
        }
    }
}

#[test]
fn cameras_that_move_are_placed() {
    let of = |folder: TempDir, k| {
        let frame = RgbdRecording::open(folder.path()).unwrap().frame(k).unwrap();
        frame.world_from_camera.origin().coords()
    };
    assert!((of(tum(), 2).x - 0.2).abs() < 1e-9);
    // BOP holds the world in the camera, 0.2 m ahead of it.
    assert!((of(bop(), 2).z + 0.2).abs() < 1e-9);
    assert_eq!(of(folders(), 2).norm(), 0.0);
}

/// The message of a folder that is refused.
fn refused(folder: &TempDir) -> String {
    let text = RgbdRecording::open(folder.path()).map(drop).unwrap_err().to_string();
    assert!(!text.contains('\n'), "{text}");
    text
}

#[test]
fn what_cannot_be_right_is_refused_in_one_line() {
    let empty = tempfile::tempdir().unwrap();
    assert!(refused(&empty).contains("no RGB-D sequence"));
    let folder = folders();
    write(&folder.path().join("cam_K.txt"), "80 0 300\n0 80 25\n0 0 1\n");
    assert!(refused(&folder).contains("another resolution"));
    fs::remove_file(folder.path().join("cam_K.txt")).unwrap();
    assert!(refused(&folder).contains("there is no cam_K.txt"));
    for (text, said) in [
        ("depth_unit_m = 0.1", "is 50.000 m away"),
        ("depth_unit_m = -1.0", "must be above 0"),
        ("intrinsics = [1.0, 2.0]", "expected"),
        ("depthunit = 3", "unknown field"),
        ("color = \"rgb/image.png\"", "one *"),
        ("color = \"rgb/*.tiff\"", "no file fits"),
    ] {
        let folder = folders();
        write(&folder.path().join("rgbd.toml"), text);
        assert!(refused(&folder).contains(said), "{text}: {}", refused(&folder));
    }
    let folder = bop();
    fs::remove_file(folder.path().join("rgbd.toml")).unwrap();
    assert!(refused(&folder).contains("the objects 4, 7: choose one"));
    write(&folder.path().join("rgbd.toml"), "object = 9\n");
    assert!(refused(&folder).contains("object = 9 is none of them"));
    let folder = folders();
    fs::remove_dir_all(folder.path().join("masks")).unwrap();
    assert!(refused(&folder).contains("there are no masks"));
    let folder = folders();
    for entry in fs::read_dir(folder.path().join("masks")).unwrap() {
        save(&entry.unwrap().path(), mask(0, 0));
    }
    assert!(refused(&folder).contains("its mask is empty"));
    let folder = described();
    let text = fs::read_to_string(folder.path().join("rgbd.toml")).unwrap().replace("object = 12\n", "");
    write(&folder.path().join("rgbd.toml"), text);
    // Two labels and no background are two levels, of which neither is 0.
    save(
        &folder.path().join("data/000000-label.png"),
        GrayImage::from_fn(SIZE.0, SIZE.1, |u, _| Luma([(u % 3) as u8 * 5])),
    );
    assert!(refused(&folder).contains("say which is the object"));
    let folder = folders();
    let first = fs::read_dir(folder.path().join("depth")).unwrap().next().unwrap().unwrap().path();
    for entry in fs::read_dir(folder.path().join("depth")).unwrap() {
        write(&entry.unwrap().path(), "version https://git-lfs.github.com/spec/v1\noid sha256:00\nsize 9\n");
    }
    assert!(refused(&folder).contains("git-lfs"), "{first:?}: {}", refused(&folder));
}

#[test]
fn what_is_missing_is_said() {
    let folder = folders();
    let of = |name: &str| {
        let mut files: Vec<_> =
            fs::read_dir(folder.path().join(name)).unwrap().map(|entry| entry.unwrap().path()).collect();
        files.sort();
        files
    };
    fs::remove_file(&of("masks")[2]).unwrap();
    fs::remove_file(&of("rgb")[1]).unwrap();
    let recording = RgbdRecording::open(folder.path()).unwrap();
    assert_eq!(recording.len(), 2);
    let notes = recording.notes().join("\n");
    assert!(notes.contains("2 of 3 frames") && notes.contains("1 of 2 frames have a mask"), "{notes}");
    assert!(recording.frame(1).unwrap().mask.is_none());
    assert!(recording.frame(2).unwrap_err().to_string().contains("there is no frame 2; there are 2"));
}

#[test]
fn colours_and_masks_of_another_size_are_brought_to_that_of_depth() {
    let folder = folders();
    for name in ["rgb", "masks"] {
        for entry in fs::read_dir(folder.path().join(name)).unwrap() {
            let path = entry.unwrap().path();
            let image = image::open(&path).unwrap();
            image.resize_exact(2 * SIZE.0, 2 * SIZE.1, image::imageops::FilterType::Nearest).save(&path).unwrap();
        }
    }
    // The intrinsics are those of the colours.
    write(&folder.path().join("cam_K.txt"), "80 0 30.5\n0 82 25.5\n0 0 1\n");
    let frame = RgbdRecording::open(folder.path()).unwrap().frame(0).unwrap();
    assert_eq!([frame.intrinsics.fx, frame.intrinsics.fy, frame.intrinsics.cx, frame.intrinsics.cy], K);
    let Some(mask) = &frame.mask else { panic!() };
    assert!(mask.indexed_iter().all(|((v, u), inside)| *inside == is_object(u as u32, v as u32)));
    assert_eq!(frame.color.dimensions(), SIZE);
}
