//! The files of a run that never was.

use std::f64::consts::PI;
use std::fs;

use mvt_objects::catalogue;
use proptest::prelude::*;

use super::*;

/// A run with the procedural cube: the error grows, the object is lost for a second and found again.
fn run() -> RunRecord {
    let frame = |k: u32| {
        let time_s = f64::from(k) / 30.0;
        let lost = (300..330).contains(&k);
        let offset_m = if lost { 0.03 } else { 0.001 + 0.0001 * time_s };
        let truth = Isometry::from_parts([0.0, 0.1 * time_s, 0.3], [1.0, 0.1 * time_s, 0.0, 0.2]);
        let error_m = offset_m * (1.0 + 0.2 * (7.0 * time_s).sin());
        FrameRow {
            frame: u64::from(k),
            time_s,
            state: match k {
                330 => TrackState::Relocalised,
                _ if lost => TrackState::Lost,
                _ => TrackState::Tracking,
            },
            confidence: if lost { 0.1 } else { 0.9 },
            deviation: None,
            estimate: truth * Isometry::<Object, Object>::translation(offset_m, 0.0, 0.0),
            truth: Some(truth),
            add_s: Some(AddS { one_directional_m: error_m, symmetric_m: 1.1 * error_m }),
            add_m: Some(1.2 * error_m),
            stage_ms: StageMs {
                sense: 12.0,
                track: 9.0,
                map: 11.0,
                mesh: if k.is_multiple_of(10) { 20.0 } else { 0.0 },
            },
        }
    };
    let point = |k: u32| {
        let time_s = f64::from(k) / 3.0;
        let grown = 1.0 - (-time_s / 6.0).exp();
        ShapePoint {
            time_s,
            f5: 0.95 * grown,
            f2: 0.7 * grown,
            f1: 0.4 * grown,
            f10: 0.99 * grown,
            precision5: 0.98,
            recall5: 0.9 * grown,
        }
    };
    RunRecord {
        object: "cube70".into(),
        seed: 3,
        mode: Mode::Slam,
        modality: Modality::Vitac,
        frames: (0..600).map(frame).collect(),
        shape: (0..60).map(point).collect(),
        events: vec![Event { time_s: 10.0, text: "lost the object".into() }],
        choices: Vec::new(),
        live: None,
        hidden: vec![0.2, 0.4],
        observed: Observed::default(),
        object_from_field: None,
        wall_s: 25.0,
        simulated_s: 20.0,
        peak_memory_mb: peak_memory_mb(),
        calibration: None,
        cameras: Vec::new(),
        complete: true,
    }
}

fn object(name: &str) -> Truth {
    Truth::new(catalogue::load(name, &mut Vec::new()).unwrap())
}

/// The truth, bent by some millimetres.
fn estimate(truth: &Mesh) -> Mesh {
    let bend = |v: &glam::Vec3| *v * (1.0 + 0.04 * (80.0 * v.x).sin() * (60.0 * v.z).cos());
    Mesh { vertices: truth.vertices.iter().map(bend).collect(), faces: truth.faces.clone() }
}

#[test]
fn a_run_leaves_all_its_files_and_nothing_else() {
    let folder = tempfile::tempdir().unwrap();
    let truth = object("cube70");
    let summary = write(folder.path(), &run(), &estimate(truth.mesh()), Some(&truth)).unwrap();
    let mut names: Vec<_> =
        fs::read_dir(&folder).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    assert_eq!(names, ["curves.svg", "mesh.gif", "mesh.obj", "mesh.ply", "summary.json", "trajectory.csv"]);

    let text = fs::read_to_string(folder.path().join(file::SUMMARY)).unwrap();
    let json: serde_json::Value = serde_json::from_str(&text).unwrap();
    assert_eq!(text, serde_json::to_string_pretty(&summary).unwrap() + "\n");
    for (key, expected) in [("frames", 600.0), ("frames_per_second", 24.0), ("lost_frames", 30.0), ("recovered", 1.0)] {
        assert_eq!(json[key].as_f64().unwrap(), expected, "{key}");
    }
    assert_eq!(json["stage_ms"]["mesh"], 2.0);
    assert!((json["hidden"].as_f64().unwrap() - 0.3).abs() < 1e-9, "{text}");
    assert_eq!(json["complete"], true);
    let thresholds: Vec<&String> = json["f_score"].as_object().unwrap().keys().collect();
    assert_eq!(thresholds.len(), 4);
    for key in ["1", "2", "5", "10"] {
        assert!((0.0..=1.0).contains(&json["f_score"][key].as_f64().unwrap()), "{text}");
    }
    assert!(json["f_score"]["5"].as_f64().unwrap() > 0.9, "{text}");
    let add_s = &json["add_s_mm"];
    for key in ["mean", "median", "p95", "final", "mean_original_definition"] {
        assert!(add_s[key].as_f64().unwrap() > 1.0, "{key}");
    }
    assert_eq!(mvt_mesh::read(&folder.path().join(file::PLY)).unwrap().0, estimate(truth.mesh()));
}

#[test]
fn an_interrupted_run_says_so() {
    let folder = tempfile::tempdir().unwrap();
    let record = RunRecord { frames: Vec::new(), shape: Vec::new(), complete: false, ..run() };
    let summary = write_partial(folder.path(), &record).unwrap();
    assert!(!summary.complete && summary.add_s_mm.is_none() && summary.shape.f_score.is_none());
    assert_eq!(fs::read_dir(&folder).unwrap().count(), 2);
    // Curves of nothing are drawn all the same.
    assert!(curves::curves(&record).contains("interrupted"));
}

#[test]
fn the_span_from_loss_to_recovery_is_shaded() {
    let mut record = run();
    assert_eq!(curves::lost_spans(&record), [10.0..11.0]);
    record.frames.truncate(310);
    assert_eq!(curves::lost_spans(&record), [10.0..309.0 / 30.0]);
}

#[test]
fn the_turntable_shows_what_is_wrong() {
    use image::AnimationDecoder as _;
    let truth = object("cube70");
    for (scale, colour) in [(1.0, "pale"), (1.25, "dark red")] {
        let estimate = Mesh {
            vertices: truth.mesh().vertices.iter().map(|v| *v * scale).collect(),
            faces: truth.mesh().faces.clone(),
        };
        let errors_m = turntable::vertex_errors_m(&estimate, Isometry::identity(), truth.object());
        // A side of 70 mm is half of the growth away.
        let largest = errors_m.iter().copied().fold(0.0, f32::max);
        assert!((0.035 * (scale - 1.0) - 1e-4..0.062 * (scale - 1.0) + 1e-4).contains(&largest), "{largest}");
        let object_from_estimate = Isometry::identity();
        let turntable = turntable::Turntable {
            estimate: &estimate,
            errors_m: &errors_m,
            object_from_estimate,
            truth: truth.mesh(),
        };
        let gif = turntable.gif().unwrap();
        let frames = image::codecs::gif::GifDecoder::new(std::io::Cursor::new(gif)).unwrap().into_frames();
        let frames = frames.collect_frames().unwrap();
        assert_eq!((frames.len(), frames[0].buffer().dimensions()), (48, (480, 274)));
        for frame in &frames {
            let [r, g, b, _] = frame.buffer().get_pixel(120, 120).0.map(i32::from);
            let is_red = 2 * r > 3 * g;
            assert_eq!(is_red, colour == "dark red", "{r} {g} {b}");
            let [r, g, b, _] = frame.buffer().get_pixel(360, 120).0.map(i32::from);
            assert!((r - g).abs() < 30 && (g - b).abs() < 30 && r < 230, "the truth is grey, not {r} {g} {b}");
        }
    }
}

#[test]
fn a_file_that_cannot_be_written_is_named() {
    let error = write_partial(Path::new("/nowhere/at/all"), &run()).unwrap_err();
    assert!(format!("{error:#}").contains("/nowhere/at/all/trajectory.csv"), "{error:#}");
}

#[test]
fn a_trajectory_is_read_as_it_was_written() {
    let mut rows = run().frames;
    rows[5].truth = None;
    (rows[5].add_s, rows[5].add_m) = (None, None);
    let again = read_trajectory(&write_trajectory(&rows)).unwrap();
    assert_eq!(again.len(), rows.len());
    for (read, written) in again.iter().zip(&rows) {
        assert_eq!((read.frame, read.time_s, read.state), (written.frame, written.time_s, written.state));
        assert_eq!((read.confidence, read.stage_ms), (written.confidence, written.stage_ms));
        assert_eq!((read.truth.is_some(), read.add_s.is_some()), (written.truth.is_some(), written.add_s.is_some()));
        assert_eq!(read.add_m.map(|m| (m * 1e9).round()), written.add_m.map(|m| (m * 1e9).round()));
        let difference = read.estimate.untyped().to_homogeneous() - written.estimate.untyped().to_homogeneous();
        assert!(difference.abs().max() < 1e-12);
    }
}

#[test]
fn rotation_errors_and_add_stand_in_the_summary() {
    let turned = |mut row: FrameRow, degrees: f64| {
        let half_rad = 0.5 * degrees.to_radians();
        let turn = Isometry::from_parts([0.0; 3], [half_rad.cos(), 0.0, half_rad.sin(), 0.0]);
        row.estimate = row.truth.unwrap() * turn;
        row.deviation = Some(Deviation { surface_m: 0.001, angle_rad: if degrees < 20.0 { 0.1 } else { PI } });
        row
    };
    let angles = [1.0, 2.0, 3.0, 90.0];
    let frames: Vec<FrameRow> = run().frames.into_iter().zip(angles).map(|(row, angle)| turned(row, angle)).collect();
    let summary = Summary::new(&RunRecord { frames, ..run() }, ShapeScores::default());
    let rotation = summary.rotation_deg.unwrap();
    for (value, expected) in
        [(rotation.mean, 24.0), (rotation.median, 2.5), (rotation.last, 90.0), (rotation.known, 0.75)]
    {
        assert!((value - expected).abs() < 1e-9, "{rotation:?}");
    }
    let add = summary.add_mm.unwrap();
    assert!((add.last - 1.2 * summary.add_s_mm.unwrap().last).abs() < 1e-9);
    let written = write_trajectory(&RunRecord { frames: vec![turned(run().frames[0], 3.0)], ..run() }.frames);
    assert!(written.lines().next().unwrap().contains(",add_mm,rotation_deg,"), "{written}");
    let turn_deg: f64 = written.lines().nth(1).unwrap().split(',').nth(24).unwrap().parse().unwrap();
    assert!((turn_deg - 3.0).abs() < 1e-9, "{written}");
}

#[test]
fn anybodys_poses_are_read_in_any_order_of_columns() {
    let rows = read_trajectory("\u{feff}qx,qy,qz, qw ,note,x_m,y_m,z_m,time_s\r\n0,0,0,2,hello,1,2,3,0.5\r\n").unwrap();
    assert_eq!(rows[0].estimate, Isometry::translation(1.0, 2.0, 3.0));
    assert_eq!((rows[0].frame, rows[0].time_s, rows[0].state), (0, 0.5, TrackState::Tracking));
    assert_eq!((rows[0].truth, rows[0].add_s), (None, None));
}

#[test]
fn what_is_wrong_with_a_trajectory_is_said_with_its_line() {
    const HEADER: &str = "time_s,x_m,y_m,z_m,qw,qx,qy,qz,add_s_mm,add_s_symmetric_mm,state";
    for (lines, expected) in [
        ("", "line 1: the file has no poses"),
        ("HEADER", "line 1: the file has no poses"),
        ("time_s,x_m", "line 1: the header has no column y_m"),
        ("HEADER,x_m", "line 1: the header has column x_m twice"),
        ("HEADER\n0,1,2,3,1,0,0,0,1", "line 2: 9 values, but the header has 11 columns"),
        ("HEADER\n0,1,2,east,1,0,0,0,,,", "line 2: z_m is \"east\", not a finite number"),
        ("HEADER\n0,1,inf,3,1,0,0,0,,,", "line 2: y_m is \"inf\", not a finite number"),
        ("HEADER\n0,1,2,3,0,0,0,0,,,", "line 2: the quaternion from qw on is no rotation"),
        ("HEADER\n0,1,2,,1,0,0,0,,,", "line 2: z_m is empty, but its neighbours are not"),
        ("HEADER\n0,1,2,3,1,0,0,0,-1,1,", "line 2: add_s_mm is \"-1\", not a number from 0 on"),
        ("HEADER\n0,1,2,3,1,0,0,0,,,gone", "line 2: state is \"gone\", not tracking, lost or relocalised"),
        ("HEADER\n,1,2,3,1,0,0,0,,,", "line 2: time_s is \"\", not a number"),
        ("HEADER\n1,1,2,3,1,0,0,0,,,\n\n1,1,2,3,1,0,0,0,,,", "line 4: time_s is not greater than on the line before"),
    ] {
        let error = read_trajectory(&lines.replace("HEADER", HEADER)).unwrap_err().to_string();
        assert!(error.starts_with(expected), "{error} for {lines}");
    }
}

proptest! {
    #[test]
    fn damaged_trajectories_are_refused_or_make_sense(
        cuts in prop::collection::vec((any::<prop::sample::Index>(), prop::sample::select(b",\n.-+e019infaNqx\"\x00".to_vec())), 1..6),
        remove in any::<bool>(),
    ) {
        let mut bytes = write_trajectory(&run().frames[298..302]).into_bytes();
        for (place, byte) in cuts {
            let k = place.index(bytes.len());
            if remove { bytes.remove(k); } else { bytes[k] = byte; }
        }
        let text = String::from_utf8_lossy(&bytes);
        match read_trajectory(&text) {
            Ok(rows) => for row in &rows {
                prop_assert!(row.time_s.is_finite() && row.estimate.untyped().to_homogeneous().iter().all(|x| x.is_finite()));
            },
            Err(error) => prop_assert!((1..=text.lines().count().max(1)).contains(&error.line), "{error}"),
        }
    }
}

#[test]
fn a_shape_is_placed_by_the_last_pose_that_is_certified() {
    let mut rows = run().frames;
    let of = |row: &FrameRow| row.truth.unwrap().inverse() * row.estimate;
    let last = of(rows.last().unwrap());
    assert_eq!(placed_shape(&rows), Some(last), "none is certified");
    let stated = |surface_m| Some(Deviation { surface_m, angle_rad: 3.0 });
    for (k, deviation) in [(20, stated(0.002)), (40, stated(0.009)), (50, stated(0.02)), (310, stated(0.001))] {
        rows[k].deviation = deviation;
    }
    // Frame 310 is lost, and frame 50 too uncertain.
    assert_eq!(placed_shape(&rows), Some(of(&rows[40])));
    rows[40].truth = None;
    assert_eq!(placed_shape(&rows), Some(of(&rows[20])));
    assert_eq!(placed_shape(&[]), None);
}
