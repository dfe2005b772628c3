use std::fs;
use std::path::Path;

use glam::Vec3;
use image::Rgb;
use mvt_frames::camera::Intrinsics;
use mvt_frames::depth::{CameraDepth, Label};
use mvt_mesh::Mesh;
use mvt_render::tessellation::tessellate;
use mvt_robot::hand::{
    Body, Drive, HandDescription, Inertial, Joint, JointMotion, Placing, Primitive, Side, TouchPad, UPRIGHT,
};
use mvt_robot::observation::{Percept, Press};
use mvt_robot::rig::PLACEMENTS;
use proptest::prelude::*;

use super::*;
use mvt_run::estimator::Mode;
use mvt_run::pipeline::{MeshedShape, Progress};
use mvt_run::report::{Event, StageMs, TrackState};
use mvt_run::sdf_grid::SdfGrid;
use mvt_run::source::{Modality, Pictures, Sensed};

/// Returns a camera of whose images every second row and column is recorded.
fn camera() -> PosedCamera {
    let camera = PLACEMENTS[3].camera(&Hand::allegro(Side::Left));
    PosedCamera { intrinsics: Intrinsics { width: 400, height: 30, ..camera.intrinsics }, ..camera }
}

fn about() -> About {
    About {
        version: VERSION,
        object: "a ball".into(),
        seed: 3,
        mode: Some(Mode::Slam),
        modality: Modality::Vitac,
        hand: Hand::allegro(Side::Left),
        cameras: vec![camera()],
        frames: 9,
        process: 1,
    }
}

fn ball() -> Mesh {
    tessellate(&Primitive::Ellipsoid { centre: [0.0; 3], semi: [0.02; 3], orientation_wxyz: UPRIGHT }, 12)
}

fn row(frame: u64) -> FrameRow {
    let pose = |x: f64| Isometry::from_parts([x, 0.0, 0.06], [0.8, 0.0, 0.6, 0.0]);
    FrameRow {
        frame,
        time_s: frame as f64 / 32.0,
        state: if frame == 4 { TrackState::Relocalised } else { TrackState::Tracking },
        confidence: 0.75,
        deviation: None,
        estimate: pose(-0.05),
        truth: (frame != 5).then(|| pose(-0.0475)),
        add_s: None,
        add_m: None,
        stage_ms: StageMs { sense: 1.0, track: 2.0, map: 3.0, mesh: 0.0 },
    }
}

fn sensed(frame: u64) -> Box<Sensed> {
    sensed_by(&Hand::allegro(Side::Left), frame)
}

/// Returns a frame in which the last pad touches something.
fn sensed_by(hand: &Hand, frame: u64) -> Box<Sensed> {
    let joints = vec![0.1; hand.joints().len()];
    let camera = camera();
    let depth_m = Array2::from_shape_fn((30, 400), |(r, c)| if c < 100 { 0.0 } else { 0.3 + 1e-4 * (r + c) as f32 });
    let seen = CameraDepth {
        intrinsics: camera.intrinsics,
        world_from_camera: camera.pose,
        labels: Array2::from_shape_fn((30, 400), |(_, x)| if x < 100 { Label::Background } else { Label::Object }),
        depth_m,
        colour: Some(RgbImage::from_pixel(400, 30, Rgb([200, 60, 30]))),
    };
    let last = hand.pads().len() - 1;
    let touch = hand.per_pad(|pad| {
        (pad == last).then(|| Press {
            indentation_mm: Array2::from_elem((320, 240), 0.5),
            contact: Array2::from_shape_fn((320, 240), |(_, x)| x < 120),
            sigma_mm: 0.05,
        })
    });
    let percept = Percept { time_s: frame as f64 / 30.0, joints, cameras: vec![Some(seen)], touch };
    let pictures = Pictures {
        touch: hand.per_pad(|_| RgbImage::from_pixel(240, 320, Rgb([90, 90, 140]))),
        true_indentation_mm: PerPad::default(),
        forces_n: Some(hand.per_pad(|pad| if pad == last { 1.5 } else { 0.0 })),
    };
    Box::new(Sensed {
        frame,
        percept,
        truth: None,
        carried: None,
        pictures,
        sense_ms: 1.0,
        hidden: None,
        warnings: vec![],
        events: vec![],
    })
}

fn shape(frame: u64) -> MeshedShape {
    let sdf = SdfGrid { low: Vec3::splat(-0.03), cell_m: 0.01, counts: [7; 3], values: vec![-4; 343] };
    MeshedShape { frame, mesh: ball(), sdf, point: None, object_from_field: Isometry::identity(), mesh_ms: 1.0 }
}

fn frames(writer: &RecordingWriter, range: std::ops::Range<u64>) {
    for frame in range {
        writer.frame(&row(frame), frame == 2, sensed(frame));
        // Writing is no race here: images are not to be left out.
        writer.wait();
    }
}

fn recorded(folder: &Path) {
    let writer = RecordingWriter::create(folder, &about(), Some(&ball())).unwrap();
    frames(&writer, 0..5);
    writer.receive(Progress::Shape(0, &shape(3)));
    writer.receive(Progress::Event(&Event { time_s: 0.1, text: "re-grasps".into() }));
    writer.receive(Progress::Warning("a camera is silent"));
    frames(&writer, 5..9);
    writer.finish(true).unwrap();
}

#[test]
fn a_run_is_recorded_and_read() {
    let folder = tempfile::tempdir().unwrap();
    recorded(folder.path());
    let mut recording = Recording::open(folder.path()).unwrap();
    assert_eq!(recording.status(), Status::Finished);
    assert_eq!((recording.about().object.as_str(), recording.about().frames), ("a ball", 9));
    let intrinsics = recording.about().cameras[0].intrinsics;
    assert_eq!((intrinsics.width, intrinsics.height), (200, 15));
    let rows: Vec<FrameRow> = recording.moments().iter().map(|moment| moment.row).collect();
    assert_eq!(rows, (0..9).map(row).collect::<Vec<_>>());
    let moment = &recording.moments()[2];
    assert!(moment.is_keyframe && moment.estimate().is_some() && moment.joints == [0.1; 16]);
    let touching = moment.touching[3].unwrap();
    assert!((touching.deepest_mm - 0.5).abs() < 1e-3 && touching.force_n == Some(1.5), "{touching:?}");
    // Half of the 19 x 25 mm that a DIGIT sees.
    assert!((180.0..260.0).contains(&touching.area_mm2), "{touching:?}");
    assert_eq!(moment.touching[2], None);
    assert_eq!(recording.events(), [Event { time_s: 0.1, text: "re-grasps".into() }]);
    assert_eq!(recording.warnings(), ["a camera is silent"]);
    assert_eq!(recording.true_mesh(), Some(&ball()));

    for (moment, expected) in [(0, 0), (2, 0), (3, 3), (8, 6), (99, 6)] {
        assert_eq!(recording.images(moment).unwrap().unwrap().frame, expected);
    }
    let images = recording.images(4).unwrap().unwrap();
    let camera = images.cameras[0].as_ref().unwrap();
    assert_eq!((camera.colour.dimensions(), camera.depth_m.dim()), ((200, 15), (15, 200)));
    assert!((camera.depth_m[(10, 100)] - (0.3 + 1e-4 * 220.0)).abs() < 6e-5 && camera.depth_m[(0, 0)] == 0.0);
    assert!(images.touch[3].is_some() && images.touch[0].is_none());

    assert!(recording.shape(2).unwrap().is_none());
    let known = recording.shape(8).unwrap().unwrap();
    assert_eq!((known.frame, &known.mesh), (3, &ball()));
    assert!((known.sdf.as_ref().unwrap().distance_m(Vec3::ZERO).unwrap() + 0.001).abs() < 1e-7);
    assert!(!recording.refresh().unwrap(), "nothing is new");
}

/// Returns a gripper with two pads and three joints, one of which slides.
fn gripper() -> Arc<Hand> {
    let inertial = Inertial { mass_kg: 0.1, centre_m: [0.0; 3], orientation_wxyz: UPRIGHT, diagonal: [1e-5; 3] };
    let body = |name: &str, parent| Body {
        name: name.to_owned(),
        parent,
        place: Placing::at([0.01, 0.02, 0.03]),
        inertial: Some(inertial),
        parts: vec![],
    };
    let joint = |name: &str, body, motion| {
        let (axis, range, drive) = ([0.0, 1.0, 0.0], [-0.5, 0.5], Drive::default());
        Joint { name: name.to_owned(), body, motion, axis, range, mirrors: false, drive }
    };
    let pad = |name: &str, body| TouchPad {
        name: name.to_owned(),
        body,
        place: Placing::at([0.01, 0.0, 0.02]),
        profile: Default::default(),
    };
    let description = HandDescription {
        name: "gripper".to_owned(),
        side: Side::Right,
        bodies: vec![body("base", None), body("slider", Some(0)), body("jaw", Some(1)), body("lever", Some(0))],
        joints: vec![
            joint("slide", 1, JointMotion::Slide),
            joint("bend", 2, JointMotion::Hinge),
            joint("turn", 3, JointMotion::Hinge),
        ],
        pads: vec![pad("front", 2), pad("back", 3)],
        apart: vec![],
        palm_centre_m: None,
        grasp: None,
    };
    Hand::new(description).unwrap()
}

#[test]
fn a_run_of_a_gripper_is_recorded_and_read() {
    let folder = tempfile::tempdir().unwrap();
    let hand = gripper();
    let about = About { hand: Arc::clone(&hand), ..about() };
    let writer = RecordingWriter::create(folder.path(), &about, None).unwrap();
    for frame in 0..3 {
        let mut sensed = sensed_by(&hand, frame);
        if frame == 1 {
            // No touch sensor delivers anything.
            (sensed.percept.touch, sensed.pictures) = (PerPad::default(), Pictures::default());
        }
        writer.frame(&row(frame), false, sensed);
        writer.wait();
    }
    writer.finish(true).unwrap();

    let recording = Recording::open(folder.path()).unwrap();
    assert!(recording.warnings().is_empty(), "{:?}", recording.warnings());
    assert_eq!(recording.about().hand, hand);
    let joints: Vec<&[f64]> = recording.moments().iter().map(|moment| &*moment.joints).collect();
    assert_eq!(joints, [[0.1; 3]; 3]);
    let touching = recording.moments().iter().map(|moment| moment.touching.map(Option::is_some).0);
    assert_eq!(touching.collect::<Vec<_>>(), [[false, true], [false, false], [false, true]]);
    assert_eq!(recording.moments()[2].touching[1].unwrap().force_n, Some(1.5));
    let images = recording.images(2).unwrap().unwrap();
    assert!(images.touch[0].is_none() && images.touch[1].is_some() && images.touch.len() == 2);

    // Frames of another hand are no frames of this one.
    let path = folder.path().join(FOLDER).join("about.json");
    let mut about: serde_json::Value = serde_json::from_slice(&fs::read(&path).unwrap()).unwrap();
    about.as_object_mut().unwrap().remove("hand");
    fs::write(&path, about.to_string()).unwrap();
    let recording = Recording::open(folder.path()).unwrap();
    assert_eq!((recording.moments().len(), &recording.about().hand), (0, &Hand::allegro(Side::Right)));
    assert!(
        recording.warnings()[0].contains("3 joint angles; hand allegro_digit has 16"),
        "{:?}",
        recording.warnings()
    );
    about["hand"] = serde_json::json!({ "name": "a" });
    fs::write(&path, about.to_string()).unwrap();
    let error = Recording::open(folder.path()).err().unwrap().to_string();
    assert!(error.contains("about.json is damaged: missing field `side`"), "{error}");
}

#[test]
fn a_recording_of_an_allegro_says_its_side_alone() {
    let folder = tempfile::tempdir().unwrap();
    recorded(folder.path());
    let read = |name| fs::read_to_string(folder.path().join(FOLDER).join(name)).unwrap();
    let about: serde_json::Value = serde_json::from_str(&read("about.json")).unwrap();
    assert_eq!((&about["side"], about.get("hand")), (&serde_json::json!("left"), None));
    let line: serde_json::Value = serde_json::from_str(read("frames.jsonl").lines().next().unwrap()).unwrap();
    assert_eq!(line["fingers"].as_array().unwrap()[..3], [(); 3].map(|()| serde_json::Value::Null));
    assert_eq!(line["joints"].as_array().unwrap().len(), 16);
}

#[test]
fn a_run_is_read_while_it_goes_on_and_after_it_is_killed() {
    let folder = tempfile::tempdir().unwrap();
    assert!(matches!(Recording::open(folder.path()), Err(RecordingError::NoRecording(_))));
    let writer = RecordingWriter::create(folder.path(), &about(), None).unwrap();
    let mut recording = Recording::open(folder.path()).unwrap();
    assert_eq!((recording.status(), recording.moments().len()), (Status::Running, 0));
    assert!(recording.images(0).unwrap().is_none() && recording.shape(0).unwrap().is_none());
    frames(&writer, 0..2);
    assert!(recording.refresh().unwrap());
    assert_eq!((recording.status(), recording.moments().len()), (Status::Running, 2));
    assert!(!recording.refresh().unwrap());
    let taken = RecordingWriter::create(folder.path(), &about(), None).err().map(|error| error.to_string());
    assert!(taken.is_some_and(|error| error.contains("another run")), "two runs cannot write into one folder");
    writer.die();
    assert!(recording.refresh().unwrap());
    assert_eq!((recording.status(), recording.moments().len()), (Status::Crashed, 2));
    // A later run in the same folder takes its place.
    let writer = RecordingWriter::create(folder.path(), &About { process: 2, ..about() }, None).unwrap();
    frames(&writer, 0..1);
    assert!(recording.refresh().unwrap());
    assert_eq!((recording.status(), recording.moments().len()), (Status::Running, 1));
    writer.finish(false).unwrap();
    assert!(recording.refresh().unwrap());
    assert_eq!(recording.status(), Status::Interrupted);
}

#[test]
fn an_incomplete_line_is_read_later() {
    let folder = tempfile::tempdir().unwrap();
    recorded(folder.path());
    let path = folder.path().join(FOLDER).join("frames.jsonl");
    let text = fs::read(&path).unwrap();
    fs::write(&path, &text[..text.len() - 40]).unwrap();
    let mut recording = Recording::open(folder.path()).unwrap();
    assert_eq!((recording.moments().len(), recording.warnings().len()), (8, 1));
    fs::write(&path, &text).unwrap();
    assert!(recording.refresh().unwrap());
    assert_eq!((recording.moments().len(), recording.warnings().len()), (9, 1));
}

#[test]
fn errors_name_the_damaged_file() {
    let folder = tempfile::tempdir().unwrap();
    recorded(folder.path());
    let inner = folder.path().join(FOLDER);
    let about = fs::read_to_string(inner.join("about.json")).unwrap();
    let message = |text: &str| {
        fs::write(inner.join("about.json"), text).unwrap();
        Recording::open(folder.path()).err().map(|error| error.to_string()).unwrap_or_default()
    };
    // Other contents of a later version are ignored.
    let newer = message(r#"{"version": 2, "about": ["other", "things"]}"#);
    assert!(newer.contains("version 2") && newer.contains("use a newer one"), "{newer}");
    for wrong in ["", "{}", "[1", &about.replace("\"left\"", "\"up\""), &about.replace("\"fx\": ", "\"fx\": -")] {
        let message = message(wrong);
        assert!(message.contains("about.json is damaged"), "{wrong}: {message}");
    }
    fs::write(inner.join("about.json"), &about).unwrap();
    let mut images = fs::read(inner.join("images.bin")).unwrap();
    images[20] ^= 1;
    fs::write(inner.join("images.bin"), images).unwrap();
    let recording = Recording::open(folder.path()).unwrap();
    let error = recording.images(0).unwrap_err().to_string();
    assert!(error.contains("images.bin is damaged") && error.contains("has the wrong checksum"), "{error}");
    assert!(recording.images(3).is_ok());
}

/// Reads everything.
fn look(folder: &Path) {
    let Ok(mut recording) = Recording::open(folder) else { return };
    let _ = recording.refresh();
    for moment in [1, 8] {
        let _ = (recording.images(moment), recording.shape(moment));
    }
}

#[test]
fn damaged_recordings_never_panic() {
    let folder = tempfile::tempdir().unwrap();
    recorded(folder.path());
    look(folder.path());
    let inner = folder.path().join(FOLDER);
    let names = ["about.json", "frames.jsonl", "images.bin", "shapes.jsonl", "shapes.bin", "events.jsonl", "end.json"];
    let files = names.map(|name| (inner.join(name), fs::read(inner.join(name)).unwrap()));
    let damage = (0..names.len(), any::<prop::sample::Index>(), any::<u8>(), 0..4usize);
    let mut runner = proptest::test_runner::TestRunner::new(ProptestConfig::with_cases(100));
    runner
        .run(&damage, |(file, at, byte, how)| {
            let (path, bytes) = &files[file];
            let mut damaged = bytes.clone();
            let at = at.index(bytes.len());
            match how {
                0 => damaged[at] = byte,
                1 => damaged.truncate(at),
                2 => damaged.insert(at, byte),
                // Changes a number.
                _ => damaged.iter_mut().skip(at).find(|b| b.is_ascii_digit()).into_iter().for_each(|b| *b = b'9'),
            }
            fs::write(path, damaged).unwrap();
            look(folder.path());
            fs::write(path, bytes).unwrap();
            fs::remove_file(path).unwrap();
            look(folder.path());
            fs::write(path, bytes).unwrap();
            Ok(())
        })
        .unwrap();
}
