//! Files of version 0.1.0 are still read, or refused with the reason.
//!
//! golden/v0_1_0 was written by version 0.1.0: `run --object rubiks_cube_small --duration 0.3 --seed 3`, with few rays and a grid of 4
//! vertices per axis so that the files are small, and `generate --object rubiks_cube_small --duration 0.1 --seed 3`. The expected
//! numbers were read from the files by a script that shares no code with our readers: the JSON lines, the inflated depth image, and the
//! field evaluated in double precision from its tensors.

#![allow(clippy::unwrap_used, reason = "a failed assumption in a test is a failed test")]

use std::path::PathBuf;
use std::process::{Command, Output};

use glam::Vec3;
use mvt_field::field::NeuralField;
use mvt_field::shape::Shape as _;
use mvt_recording::{Recording, Status};

fn golden(file: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/golden/v0_1_0").join(file)
}

/// Runs the program in a folder.
fn program(folder: &std::path::Path, arguments: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_mambavitact"));
    command.args(arguments).current_dir(folder).env_remove("MAMBAVITACT_LOG").output().unwrap()
}

#[track_caller]
fn near(found: &[f64], expected: &[f64], tolerance: f64) {
    assert_eq!(found.len(), expected.len());
    let is_near = found.iter().zip(expected).all(|(found, expected)| (found - expected).abs() <= tolerance);
    assert!(is_near, "{found:?} is not {expected:?}");
}

#[test]
fn a_recording_of_version_1_is_read() {
    let recording = Recording::open(&golden("run")).unwrap();
    assert_eq!(recording.warnings(), [""; 0]);
    assert_eq!(recording.status(), Status::Finished);
    let about = recording.about();
    assert_eq!((about.version, about.object.as_str(), about.seed, about.frames), (1, "rubiks_cube_small", 3, 9));
    assert_eq!(about.cameras.len(), 1);
    assert_eq!((about.cameras[0].name.as_str(), about.cameras[0].intrinsics.width), ("side", 320));
    near(&[about.cameras[0].intrinsics.fx], &[289.705_627_484_771_4], 1e-12);

    let moments = recording.moments();
    assert_eq!(moments.len(), 9);
    let keyframes: Vec<bool> = moments.iter().map(|moment| moment.is_keyframe).collect();
    assert_eq!(keyframes, [true, false, false, false, false, false, false, false, false]);
    let last = &moments[8];
    near(&[last.row.time_s], &[0.266_666_666_666_666_66], 1e-15);
    let estimate = last.estimate().unwrap();
    near(
        estimate.origin().coords().as_slice(),
        &[0.011_027_863_711_722_562, 0.005_803_110_372_127_718, 0.039_579_094_404_307_465],
        1e-12,
    );
    let expected =
        [0.711_982_304_597_613_9, 0.022_185_797_600_150_7, -0.020_636_261_949_193_66, 0.701_543_393_538_439_5];
    near(&estimate.quaternion_wxyz(), &expected, 1e-12);
    let truth = last.row.truth.unwrap();
    near(
        truth.origin().coords().as_slice(),
        &[0.004_654_776_133_146_190_5, 0.003_796_777_980_818_624_5, 0.039_220_450_765_986_3],
        1e-12,
    );
    near(&[last.row.add_s.unwrap().one_directional_m], &[0.002_927_279_473_929_957], 1e-15);
    near(&[last.joints[0], last.joints[15]], &[-0.117_409_351_535_470_66, 1.032_339_015_215_355], 1e-15);
    assert_eq!(recording.events().len(), 1);
    assert_eq!((recording.events()[0].time_s, recording.events()[0].text.as_str()), (0.1, "lost the object"));
}

#[test]
fn images_and_shapes_of_version_1_are_read() {
    let recording = Recording::open(&golden("run")).unwrap();
    assert_eq!(recording.image_moments(8), [0, 3, 6]);
    let images = recording.images(4).unwrap().unwrap();
    assert_eq!(images.frame, 3);
    let camera = images.cameras[0].as_ref().unwrap();
    assert_eq!((camera.colour.dimensions(), camera.depth_m.dim()), ((320, 240), (240, 320)));
    let at = [[120, 160], [100, 150], [0, 0]].map(|pixel| f64::from(camera.depth_m[pixel]));
    near(&at, &[0.3903, 0.3783, 0.0], 1e-7);
    assert_eq!(camera.depth_m.iter().filter(|&&depth_m| depth_m > 0.0).count(), 17_429);
    let sum: f64 = camera.depth_m.iter().map(|&depth_m| f64::from(depth_m)).sum();
    near(&[sum], &[5623.6572], 1e-3);
    assert!(images.touch.iter().all(Option::is_some));

    let truth = recording.true_mesh().unwrap();
    assert_eq!((truth.vertices.len(), truth.faces.len()), (7778, 15_552));
    near(&truth.vertices[0].to_array().map(f64::from), &[0.025_250_932, -0.025_250_932, -0.025_250_932], 1e-8);
    let shape = recording.shape(8).unwrap().unwrap();
    assert_eq!((shape.mesh.vertices.len(), shape.mesh.faces.len()), (578, 1152));
    assert_eq!(shape.sdf.as_ref().unwrap().counts, [28, 32, 31]);
}

#[test]
fn a_field_of_version_0_1_0_is_read() {
    let field = NeuralField::load(&golden("run/field.safetensors")).unwrap();
    let points = [Vec3::ZERO, Vec3::new(0.03, -0.01, 0.02), Vec3::new(-0.05, 0.06, 0.07)];
    let mut distances = [0.0; 3];
    field.distances(&points, &mut distances);
    let expected = [-0.000_183_485_096_589_988_8, 0.000_956_492_715_467_114_1, 0.004_656_572_113_315_87];
    near(&distances.map(f64::from), &expected, 1e-8);
}

/// The values that were not the defaults arrive in the settings that a new run writes, under their present names.
#[test]
fn settings_of_version_0_1_0_are_read() {
    let folder = tempfile::tempdir().unwrap();
    let config = golden("run/config.toml");
    let fixed = ["run", "--object", "cube70", "--duration", "0.1", "--quiet", "--out", "out", "--config"];
    let output = program(folder.path(), &[&fixed[..], &[config.to_str().unwrap()]].concat());
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let written: toml::Table = std::fs::read_to_string(folder.path().join("out/config.toml")).unwrap().parse().unwrap();
    let value = |path: &str| {
        let (last, tables) = path.rsplit_once('.').map_or((path, None), |(tables, last)| (last, Some(tables)));
        let table =
            tables.iter().flat_map(|tables| tables.split('.')).try_fold(&written, |t, key| t.get(key)?.as_table());
        table.and_then(|table| table.get(last)).cloned()
    };
    assert_eq!(value("mesh_cell_mm"), Some(6.0.into()));
    assert_eq!(value("slam.scan.camera_hits"), Some(150.into()));
    assert_eq!(value("slam.map.first_steps"), Some(40.into()));
    assert_eq!(value("slam.field.levels"), Some(vec![4].into()));
    // `velocity_sigma = [0.002, 0.04]` in version 0.1.0. Fails until renamed settings are migrated.
    assert_eq!(value("slam.tracker.velocity_sigma_m_s"), Some(0.075.into()));
    assert_eq!(value("slam.tracker.velocity_sigma_rad_s"), Some(1.5.into()));
    // `steps`, per frame.
    assert_eq!(value("slam.map.steps_per_s").and_then(|steps| steps.as_float()).map(|steps| steps % 30.0), Some(0.0));
}

/// Keyframes of version 0.1.0 hold joint angles where later ones hold the poses of obstacles. Fails until they do.
#[test]
fn keyframes_of_version_0_1_0_are_refused_with_the_reason() {
    let folder = tempfile::tempdir().unwrap();
    let run = golden("run");
    let fixed = ["run", "--object", "rubiks_cube_small", "--duration", "0.1", "--quiet", "--out", "out", "--resume"];
    let output = program(folder.path(), &[&fixed[..], &[run.to_str().unwrap()]].concat());
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{said}");
    assert!(said.contains("keyframes.safetensors") && said.contains("joint angles"), "{said}");
    assert_eq!(said.lines().count(), 1, "{said}");
}

#[test]
fn a_log_of_version_0_1_0_passes_inspection() {
    let summary = mvt_feelsight::inspect(&golden("log")).unwrap();
    assert_eq!((summary.object.as_str(), summary.frames, summary.complete), ("rubiks_cube_small", 3, Some(true)));
    assert_eq!(summary.cameras.len(), 1);
    let camera = &summary.cameras[0];
    assert_eq!((camera.name.as_str(), camera.width, camera.height), ("front-left", 640, 480));
    assert!(summary.kinematics_deviation.unwrap() < 1e-12 && summary.notes.is_empty(), "{summary:?}");
}
