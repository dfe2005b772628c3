//! One scene of three frames in the layouts of other programs and data sets.

use std::fs;
use std::path::Path;

use image::{DynamicImage, GrayImage, ImageBuffer, Luma, RgbImage};
use mvt_feelsight::array::Array;
use mvt_feelsight::pickle::{self, PickleValue};
use tempfile::TempDir;

/// Width and height of the images, pixels.
pub const SIZE: (u32, u32) = (32, 24);
/// fx, fy, cx, cy.
pub const K: [f64; 4] = [40.0, 41.0, 15.0, 12.5];

/// Depth of frame `k` at a pixel, millimetres: an object at half a metre before a wall, with a hole.
pub fn depth_mm(k: u32, u: u32, v: u32) -> u16 {
    match (u, v) {
        (0, 0) => 0,
        _ if is_object(u, v) => 500 + 10 * k as u16,
        _ => 900,
    }
}

pub fn is_object(u: u32, v: u32) -> bool {
    (10..20).contains(&u) && (8..16).contains(&v)
}

pub fn save(path: &Path, image: impl Into<DynamicImage>) {
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    image.into().save(path).unwrap();
}

pub fn write(path: &Path, text: impl AsRef<[u8]>) {
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    fs::write(path, text).unwrap();
}

pub fn color(k: u32) -> RgbImage {
    RgbImage::from_fn(SIZE.0, SIZE.1, |u, v| image::Rgb([u as u8, v as u8, k as u8]))
}

/// Depth in levels, of which `per_mm` are a millimetre.
pub fn depth(k: u32, per_mm: f64) -> DynamicImage {
    let level = |u, v| Luma([(f64::from(depth_mm(k, u, v)) * per_mm).round() as u16]);
    DynamicImage::ImageLuma16(ImageBuffer::from_fn(SIZE.0, SIZE.1, level))
}

pub fn mask(object: u8, other: u8) -> GrayImage {
    GrayImage::from_fn(SIZE.0, SIZE.1, |u, v| Luma([if is_object(u, v) { object } else { other }]))
}

pub fn matrix() -> String {
    format!("{} 0 {}\n0 {} {}\n0 0 1\n", K[0], K[2], K[1], K[3])
}

/// Pose of the object in frame `k`, with OpenCV axes: it stands 0.1 m to the right and 0.2 m below the axis.
pub fn pose(k: u32) -> String {
    format!("1 0 0 0.1\n0 1 0 0.2\n0 0 1 {}\n0 0 0 1\n", 0.5 + 0.01 * f64::from(k))
}

/// Three frames as BundleSDF and YCBInEOAT have them.
pub fn folders() -> TempDir {
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

pub fn bop() -> TempDir {
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

pub fn ho3d() -> TempDir {
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

pub fn tum() -> TempDir {
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

pub fn described() -> TempDir {
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
