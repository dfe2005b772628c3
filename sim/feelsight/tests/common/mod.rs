//! A small synthetic log, the same for all tests.
#![allow(dead_code, reason = "not every test uses every function")]

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

use image::{Rgb, RgbImage};
use mvt_feelsight::{EncodedFrame, EpisodeEnd, FORMAT_VERSION, LogMeta, LogWriter, SceneFile, SceneObject};
use mvt_frames::camera::{Intrinsics, PosedCamera, look_at};
use mvt_frames::depth::Label;
use mvt_frames::{Isometry, MeshFile, Object, Point, World};
use mvt_robot::digit;
use mvt_robot::hand::{
    Body, Drive, Hand, HandDescription, Hull, Inertial, Joint, JointAngles, JointMotion, Part, PartSurface, Placing,
    Primitive, Side, TouchPad, UPRIGHT,
};
use mvt_robot::observation::{GroundTruth, Observation, Rgbd, TouchTruth};
use ndarray::Array2;

/// Radius of the ball that the synthetic hand touches, metres.
pub const RADIUS_M: f64 = 0.03;

pub fn camera(name: &str, width: usize, height: usize) -> PosedCamera {
    let eye = nalgebra::Vector3::new(0.3, -0.1, 0.25);
    PosedCamera {
        name: name.into(),
        intrinsics: Intrinsics::from_fov_y(width, height, 0.8),
        pose: look_at(eye, nalgebra::Vector3::zeros(), nalgebra::Vector3::z()),
    }
}

pub fn object_from_file() -> Isometry<MeshFile, Object> {
    Isometry::from_parts([0.01, -0.02, 0.005], [0.8, 0.0, 0.0, 0.6])
}

/// Hand of the synthetic log.
pub fn hand() -> Arc<Hand> {
    Hand::allegro(Side::Left)
}

/// A gripper with two pads and three joints, one of which slides. Its base lies across the world.
pub fn gripper() -> HandDescription {
    let h = std::f64::consts::FRAC_1_SQRT_2;
    let inertial = Inertial { mass_kg: 0.1, centre_m: [0.0; 3], orientation_wxyz: UPRIGHT, diagonal: [1e-5; 3] };
    let corner = |k: usize| [k & 1, k >> 1 & 1, k >> 2 & 1].map(|bit| 0.02 * bit as f64);
    let hull = Primitive::Hull(Hull::of(&(0..8).map(corner).collect::<Vec<_>>()).unwrap());
    let body = |name: &str, parent, place, shape| Body {
        name: name.to_owned(),
        parent,
        place,
        inertial: Some(inertial),
        parts: vec![Part { surface: PartSurface::Link, shape }],
    };
    let capsule = |radius| Primitive::Capsule { from: [0.0; 3], to: [0.05, 0.0, 0.0], radius };
    let joint = |name: &str, body, motion, range| {
        let (axis, drive) = ([0.0, 1.0, 0.0], Drive::default());
        Joint { name: name.to_owned(), body, motion, axis, range, mirrors: false, drive }
    };
    let pad = |name: &str, body| TouchPad {
        name: name.to_owned(),
        body,
        place: Placing::at([0.01, 0.0, 0.02]),
        profile: Default::default(),
    };
    HandDescription {
        name: "gripper".to_owned(),
        side: Side::Right,
        bodies: vec![
            body("base", None, Placing { position_m: [0.1, 0.2, 0.3], orientation_wxyz: [h, h, 0.0, 0.0] }, hull),
            body("slider", Some(0), Placing::at([0.0, 0.03, 0.0]), capsule(0.01)),
            body("jaw", Some(1), Placing::at([0.05, 0.0, 0.0]), capsule(0.008)),
            body("lever", Some(0), Placing::at([0.0, -0.03, 0.0]), capsule(0.009)),
        ],
        joints: vec![
            joint("slide", 1, JointMotion::Slide, [0.0, 0.04]),
            joint("bend", 2, JointMotion::Hinge, [-0.5, 0.5]),
            joint("turn", 3, JointMotion::Hinge, [-20.0, 20.0]),
        ],
        pads: vec![pad("front", 2), pad("back/lower", 3)],
        apart: vec![[2, 3]],
        palm_centre_m: None,
        grasp: None,
    }
}

pub fn meta(cameras: Vec<PosedCamera>) -> LogMeta {
    meta_of(hand(), cameras)
}

pub fn meta_of(hand: Arc<Hand>, cameras: Vec<PosedCamera>) -> LogMeta {
    let scene = SceneFile {
        format_version: FORMAT_VERSION,
        program_version: "0.1.0".into(),
        object: SceneObject {
            name: "ball".into(),
            mesh: "procedural ball".into(),
            mesh_sha256: None,
            object_from_file: object_from_file().to_matrix(),
            mass_kg: 0.1,
        },
        hand,
        seed: u64::MAX,
        gravity_m_s2: [0.5, 0.0, -9.8],
        gait: "bal".into(),
        cameras: cameras.iter().map(|camera| camera.name.clone()).collect(),
        frame_rate_hz: 30.0,
        control_rate_hz: 25.0,
        physics_rate_hz: 500.0,
        noise: BTreeMap::from([("touch_sigma".into(), 7.0)]),
        randomised: BTreeMap::from([("friction".into(), 0.9)]),
        config_sha256: "00".repeat(32),
        end: EpisodeEnd { complete: false, reason: "not ended".into() },
    };
    LogMeta { scene, cameras, untouched: None }
}

pub fn end() -> EpisodeEnd {
    EpisodeEnd { complete: true, reason: "time is up".into() }
}

pub fn joints(i: usize) -> JointAngles {
    joints_of(&hand(), i)
}

pub fn joints_of(hand: &Hand, i: usize) -> JointAngles {
    (0..hand.joints().len()).map(|j| 0.2 + 0.03 * j as f64 + 0.02 * i as f64).collect()
}

/// A ball whose centre lies in front of the index finger's gel and drifts with the frames.
pub fn object_pose(i: usize) -> Isometry<Object, World> {
    let camera = hand().world_from_touch_cameras(&joints(i))[0];
    // 21 mm to the surface, 1 mm in front of the gel's apex plane.
    let centre = (camera * Point::new(0.0, 0.0, -0.021 - RADIUS_M)).coords();
    let turn = Isometry::<Object, World>::from_parts([0.0; 3], [1.0, 0.1 * i as f64, 0.2, 0.3]).untyped().rotation;
    Isometry::new(nalgebra::Isometry3::from_parts(centre.into(), turn))
}

/// Depth of the ball along the index finger's camera axis at a pixel.
fn ball_depth(u: f64, v: f64) -> Option<f64> {
    let k = digit::intrinsics();
    let ray = nalgebra::Vector3::new((u - k.cx) / k.fx, -(v - k.cy) / k.fy, -1.0);
    let centre = nalgebra::Vector3::new(0.0, 0.0, -0.021 - RADIUS_M);
    let (a, b, c) = (ray.norm_squared(), ray.dot(&centre), centre.norm_squared() - RADIUS_M * RADIUS_M);
    let discriminant = b * b - a * c;
    (discriminant > 0.0).then(|| (b - discriminant.sqrt()) / a)
}

pub fn frame(i: usize, cameras: &[PosedCamera]) -> (Observation, GroundTruth) {
    frame_of(&hand(), i, cameras)
}

pub fn frame_of(hand: &Hand, i: usize, cameras: &[PosedCamera]) -> (Observation, GroundTruth) {
    let (w, h) = (digit::WIDTH as u32, digit::HEIGHT as u32);
    let touch = hand.per_pad(|pad| {
        let shade = 100 + 20 * pad as u8;
        RgbImage::from_fn(w, h, |x, y| Rgb([shade, (x / 2 + 5 * i as u32) as u8, (y / 3) as u8]))
    });
    let touch_truth = hand.per_pad(|pad| {
        let depth_m = Array2::from_shape_fn((digit::HEIGHT, digit::WIDTH), |(row, column)| {
            let ball = (pad == 0).then(|| ball_depth(column as f64, row as f64)).flatten();
            ball.unwrap_or(0.022).min(0.022) as f32
        });
        let contact = depth_m.mapv(|z| z < 0.022);
        TouchTruth { depth_m, contact }
    });
    let mut rgbds = Vec::new();
    let mut labels = Vec::new();
    for camera in cameras {
        let (width, height) = (camera.intrinsics.width, camera.intrinsics.height);
        rgbds.push(Rgbd {
            color: RgbImage::from_fn(width as u32, height as u32, |x, y| Rgb([x as u8, y as u8, 10 * i as u8])),
            depth_m: Array2::from_shape_fn((height, width), |(row, column)| {
                if row < 10 { 0.0 } else { 0.3 + 1e-4 * (row * 7 % 11) as f32 + 1e-5 * (column + i) as f32 }
            }),
            labels: None,
            world_from_camera: None,
        });
        labels.push(Array2::from_shape_fn((height, width), |(row, column)| match (row, column) {
            (..10, _) => Label::Background,
            (_, ..20) => Label::Hand,
            _ => Label::Object,
        }));
    }
    let observation = Observation { time_s: i as f64 / 30.0, joints: joints_of(hand, i), touch, cameras: rgbds };
    (observation, GroundTruth { object_pose: object_pose(i), touch: touch_truth, shear: None, labels })
}

/// Writes a log of a few frames.
pub fn write(place: &Path, frames: usize, cameras: &[PosedCamera]) {
    write_of(&hand(), place, frames, cameras);
}

pub fn write_of(hand: &Arc<Hand>, place: &Path, frames: usize, cameras: &[PosedCamera]) {
    let mut writer = LogWriter::create(place, meta_of(Arc::clone(hand), cameras.to_vec()), false).unwrap();
    for i in 0..frames {
        let (observation, truth) = frame_of(hand, i, cameras);
        writer.push(&EncodedFrame::encode(&observation, &truth, writer.meta()).unwrap()).unwrap();
    }
    writer.finish(end()).unwrap();
}

/// Says that a test is skipped, and fails where every test must run. Written past the test harness, which hides what passing tests say.
pub fn skip(reason: impl std::fmt::Display) {
    use std::io::Write as _;
    let _ = writeln!(std::io::stderr(), "SKIPPED: {reason}");
    assert!(
        std::env::var_os("REQUIRE_ALL").is_none_or(|value| value != "1"),
        "REQUIRE_ALL=1 allows no skipped test: {reason}"
    );
}
