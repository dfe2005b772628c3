//! Folders in the layouts of other programs and data sets, written here from one scene.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a failed assumption in a test is a failed test")]

use std::fs;
use std::path::Path;

use image::{DynamicImage, GrayImage, ImageBuffer, Luma, RgbImage};
use mvt_feelsight::array::Array;
use mvt_feelsight::pickle::{self, PickleValue};
use mvt_frames::Point;
use mvt_frames::depth::GivenLabels;
use mvt_rgbd::{RgbdLayout, RgbdRecording};
use tempfile::TempDir;

const SIZE: (u32, u32) = (32, 24);
/// fx, fy, cx, cy.
const K: [f64; 4] = [40.0, 41.0, 15.0, 12.5];

/// Depth of frame `k` at a pixel, millimetres: an object at half a metre before a wall, with a hole.
fn depth_mm(k: u32, u: u32, v: u32) -> u16 {
    match (u, v) {
        (0, 0) => 0,
        _ if is_object(u, v) => 500 + 10 * k as u16,
        _ => 900,
    }
}

fn is_object(u: u32, v: u32) -> bool {
    (10..20).contains(&u) && (8..16).contains(&v)
}

fn save(path: &Path, image: impl Into<DynamicImage>) {
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    image.into().save(path).unwrap();
}

fn write(path: &Path, text: impl AsRef<[u8]>) {
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    fs::write(path, text).unwrap();
}

fn color(k: u32) -> RgbImage {
    RgbImage::from_fn(SIZE.0, SIZE.1, |u, v| image::Rgb([u as u8, v as u8, k as u8]))
}

/// Depth in levels, of which `per_mm` are a millimetre.
fn depth(k: u32, per_mm: f64) -> DynamicImage {
    let level = |u, v| Luma([(f64::from(depth_mm(k, u, v)) * per_mm).round() as u16]);
    DynamicImage::ImageLuma16(ImageBuffer::from_fn(SIZE.0, SIZE.1, level))
}

fn mask(object: u8, other: u8) -> GrayImage {
    GrayImage::from_fn(SIZE.0, SIZE.1, |u, v| Luma([if is_object(u, v) { object } else { other }]))
}

fn matrix() -> String {
    format!("{} 0 {}\n0 {} {}\n0 0 1\n", K[0], K[2], K[1], K[3])
}

/// Pose of the object in frame `k`, with OpenCV axes: it stands 0.1 m to the right and 0.2 m below the axis.
fn pose(k: u32) -> String {
    format!("1 0 0 0.1\n0 1 0 0.2\n0 0 1 {}\n0 0 0 1\n", 0.5 + 0.01 * f64::from(k))
}

/// Three frames as BundleSDF and YCBInEOAT have them.
fn folders() -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    for k in 0..3 {
        // Stamps in nanoseconds; poses count from 0.
        let name = format!("{}", 1_581_120_424_100_262_102_u64 + 40_000_000 * u64::from(k));
        save(&folder.path().join(format!("rgb/{name}.png")), color(k));
        save(&folder.path().join(format!("depth/{name}.png")), depth(k, 1.0));
        save(&folder.path().join(format!("masks/{name}.png")), mask(255, 0));
        write(&folder.path().join(format!("annotated_poses/{k:07}.txt")), pose(k));
    }
    write(&folder.path().join("cam_K.txt"), matrix());
    folder
}

fn bop() -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    let (mut cameras, mut truths) = (Vec::new(), Vec::new());
    for k in 0..3 {
        save(&folder.path().join(format!("rgb/{k:06}.jpg")), color(k));
        save(&folder.path().join(format!("depth/{k:06}.png")), depth(k, 10.0));
        save(&folder.path().join(format!("mask_visib/{k:06}_000000.png")), mask(0, 255));
        save(&folder.path().join(format!("mask_visib/{k:06}_000001.png")), mask(255, 0));
        let [fx, fy, cx, cy] = K;
        cameras.push(format!(
            r#""{k}": {{"cam_K": [{fx}, 0, {cx}, 0, {fy}, {cy}, 0, 0, 1], "depth_scale": 0.1, "cam_R_w2c": [1,0,0,0,1,0,0,0,1], "cam_t_w2c": [0, 0, {}]}}"#,
            100 * k
        ));
        let turned = r#""cam_R_m2c": [1,0,0,0,1,0,0,0,1]"#;
        let z_mm = 500 + 10 * k;
        truths.push(format!(
            r#""{k}": [{{"obj_id": 4, {turned}, "cam_t_m2c": [0,0,900]}}, {{"obj_id": 7, {turned}, "cam_t_m2c": [100,200,{z_mm}]}}]"#
        ));
    }
    write(&folder.path().join("scene_camera.json"), format!("{{{}}}", cameras.join(",")));
    write(&folder.path().join("scene_gt.json"), format!("{{{}}}", truths.join(",")));
    write(&folder.path().join("rgbd.toml"), "object = 7\n");
    folder
}

fn ho3d() -> TempDir {
    const UNIT_M: f64 = 0.000_124_986_647_279_001_77;
    let folder = tempfile::tempdir().unwrap();
    for k in 0..3 {
        save(&folder.path().join(format!("rgb/{k:04}.jpg")), color(k));
        let packed = RgbImage::from_fn(SIZE.0, SIZE.1, |u, v| {
            let level = (1e-3 * f64::from(depth_mm(k, u, v)) / UNIT_M).round() as u16;
            image::Rgb([level as u8, (level >> 8) as u8, 0])
        });
        save(&folder.path().join(format!("depth/{k:04}.png")), packed);
        let labels = RgbImage::from_fn(SIZE.0, SIZE.1, |u, v| {
            image::Rgb(if is_object(u, v) { [0, 255, 0] } else { [0, 0, 255] })
        });
        save(&folder.path().join(format!("seg/{k:04}.png")), labels);
        let [fx, fy, cx, cy] = K;
        let array = |shape: &[usize], values: Vec<f64>| PickleValue::Array(Array::from_f64(shape.to_vec(), values));
        let meta = PickleValue::dict([
            ("camMat", array(&[3, 3], vec![fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0])),
            // OpenGL axes.
            ("objTrans", array(&[3], vec![0.1, -0.2, -0.5 - 0.01 * f64::from(k)])),
            ("objRot", array(&[3, 1], vec![std::f64::consts::PI, 0.0, 0.0])),
            ("objName", "010_potted_meat_can".into()),
        ]);
        write(&folder.path().join(format!("meta/{k:04}.pkl")), pickle::to_bytes(&meta));
    }
    folder
}

fn tum() -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    let (mut colours, mut depths, mut poses) = ("# color images\n".to_owned(), String::new(), String::new());
    for k in 0..3_u32 {
        let time_s = 1_305_031_102.0 + 0.04 * f64::from(k);
        save(&folder.path().join(format!("rgb/{time_s:.6}.png")), color(k));
        save(&folder.path().join(format!("depth/{k}.png")), depth(k, 5.0));
        save(&folder.path().join(format!("masks/{time_s:.6}.png")), mask(1, 0));
        colours += &format!("{time_s:.6} rgb/{time_s:.6}.png\n");
        depths += &format!("{:.6} depth/{k}.png\n", time_s + 0.005);
        poses += &format!("{:.6} {} 0 0 0 0 0 1\n", time_s - 0.003, 0.1 * f64::from(k));
    }
    // A colour image without depth.
    colours += "1305031103.0 rgb/lonely.png\n";
    write(&folder.path().join("rgb.txt"), colours);
    write(&folder.path().join("depth.txt"), depths);
    write(&folder.path().join("groundtruth.txt"), poses);
    write(&folder.path().join("cam_K.txt"), matrix());
    folder
}

fn described() -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    for k in 0..3 {
        save(&folder.path().join(format!("data/{k:06}-color.png")), color(k));
        save(&folder.path().join(format!("data/{k:06}-depth.png")), depth(k, 10.0));
        save(&folder.path().join(format!("data/{k:06}-label.png")), mask(12, 5));
        write(&folder.path().join(format!("poses/{k}.txt")), pose(k));
    }
    let text = format!(
        "color = \"data/*-color.png\"\ndepth = \"data/*-depth.png\"\nmasks = \"data/*-label.png\"\nobject = 12\nintrinsics = {K:?}\n\
         depth_unit_m = 0.0001\nframe_hz = 25.0\nobject_poses = \"poses/*.txt\"\n"
    );
    write(&folder.path().join("rgbd.toml"), text);
    folder
}

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
            let Some(GivenLabels::Mask(mask)) = &frame.mask else { panic!("{layout:?}: no mask") };
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
    let Some(GivenLabels::Mask(mask)) = &frame.mask else { panic!() };
    assert!(mask.indexed_iter().all(|((v, u), inside)| *inside == is_object(u as u32, v as u32)));
    assert_eq!(frame.color.dimensions(), SIZE);
}
