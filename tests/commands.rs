//! `simulate`, `render-touch` and `assets` as a user runs them, with good and with bad input.

#![expect(clippy::unwrap_used, reason = "a failed assumption is a failed test")]

use std::fmt::Write as _;
use std::fs;
use std::io::Read as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

use ndarray::{Array2, Array3};
use ndarray_npy::read_npy;

fn program() -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_mambavitact"));
    command.stdin(Stdio::null());
    command
}

fn succeed(command: &mut Command) -> Output {
    let output = command.output().unwrap();
    assert!(output.status.success(), "{command:?}\n{}", String::from_utf8_lossy(&output.stderr));
    output
}

fn refuse(command: &mut Command, why: &str) {
    let output = command.output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{command:?}\n{said}");
    assert!(said.lines().filter(|line| line.contains("ERROR")).count() == 1 && said.contains(why), "{why}: {said}");
}

/// An octahedron, its corners `size` from a centre, as an OBJ file.
fn octahedron(size: f64, centre: f64, first: usize) -> String {
    let mut obj = String::new();
    for axis in 0..3 {
        for sign in [1.0, -1.0] {
            let v: [f64; 3] = std::array::from_fn(|i| centre + if i == axis { sign * size } else { 0.0 });
            writeln!(obj, "v {} {} {}", v[0], v[1], v[2]).unwrap();
        }
    }
    for [a, b, c] in [[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]] {
        writeln!(obj, "f {} {} {}", a + first, b + first, c + first).unwrap();
    }
    obj
}

fn write(folder: &Path, name: &str, text: &str) -> PathBuf {
    let path = folder.join(name);
    fs::write(&path, text).unwrap();
    path
}

#[test]
fn simulate_prints_one_json_object_that_the_seed_decides() {
    let run = |seed: &str, threads: &str| {
        let mut command = program();
        command.args(["simulate", "--object", "cube70", "--duration", "3", "--json", "--seed", seed]);
        succeed(command.env("RAYON_NUM_THREADS", threads)).stdout
    };
    let bytes = run("4", "1");
    let report: serde_json::Value = serde_json::from_slice(&bytes).unwrap();
    for field in ["survived_s", "turned_rad", "turn_rate_rad_s", "any_contact_fraction", "mean_pads_in_contact"] {
        assert!(report[field].is_f64(), "{field}");
    }
    assert!(report["penetration_mm"].is_f64() && report["tilt_deg"].is_f64());
    assert_eq!(report["per_pad_contact"].as_array().unwrap().len(), 4);
    assert_eq!(report["survived_s"], 3.0);
    assert!(bytes == run("4", "3"));
    assert!(bytes != run("5", "1"));
}

/// Both hands turn the cube about as fast and touch it about as often, over the same few starts.
#[test]
fn both_hands_do_equally_well() {
    let mean = |side: &str, field: &str| {
        let run = |seed: u32| {
            let mut command = program();
            command.args(["simulate", "--object", "cube70", "--duration", "10", "--json", "--side", side, "--seed"]);
            let report: serde_json::Value =
                serde_json::from_slice(&succeed(command.arg(seed.to_string())).stdout).unwrap();
            report[field].as_f64().unwrap()
        };
        (0..6).map(run).sum::<f64>() / 6.0
    };
    for (field, tolerance) in [("turn_rate_rad_s", 0.2), ("mean_pads_in_contact", 0.25)] {
        let (left, right) = (mean("left", field), mean("right", field));
        assert!(left > 0.5 && (left - right).abs() < tolerance, "{field}: left {left}, right {right}");
    }
}

#[test]
fn meshes_of_users_are_repaired_with_a_warning_or_refused() {
    let temp = tempfile::tempdir().unwrap();
    let simulate = |file: &Path| {
        let mut command = program();
        command.args(["simulate", "--duration", "0.2", "--object"]).arg(file);
        command
    };
    let good = octahedron(0.035, 0.0, 1);
    let inverted: String = good.replace("f 1 3 5", "f 3 1 5").lines().map(|line| format!("{line}\n")).collect();
    let all_inverted: String = good
        .lines()
        .map(|line| match line.split_whitespace().collect::<Vec<_>>()[..] {
            ["f", a, b, c] => format!("f {b} {a} {c}\n"),
            _ => format!("{line}\n"),
        })
        .collect();
    for (name, text, warning) in [
        ("good.obj", good.clone(), "mass"),
        ("inverted.obj", inverted, "inverted.obj"),
        ("all_inverted.obj", all_inverted, "all_inverted.obj"),
        ("millimetres.obj", octahedron(35.0, 0.0, 1), "millimetres"),
        ("two.obj", good.clone() + &octahedron(0.005, 0.08, 7), "two.obj"),
    ] {
        let output = succeed(&mut simulate(&write(temp.path(), name, &text)));
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(said.contains("WARN") && said.contains(warning), "{name}: {said}");
    }
    for (name, text) in [
        ("nan.obj", good.replace("v 0.035 0 0", "v nan 0 0")),
        ("index.obj", good.clone() + "f 1 2 99\n"),
        ("empty.obj", String::new()),
        ("points.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\n".to_owned()),
        ("broken.ply", "ply\nformat ascii 1.0\nelement vertex 999999999\n".to_owned()),
        ("short.stl", "solid".to_owned()),
    ] {
        refuse(&mut simulate(&write(temp.path(), name, &text)), name);
    }
    refuse(&mut simulate(&temp.path().join("missing.obj")), "missing.obj");
}

#[test]
fn render_touch_writes_arrays_and_refuses_bad_poses() {
    let temp = tempfile::tempdir().unwrap();
    let mesh = write(temp.path(), "octahedron.obj", &octahedron(0.01, 0.0, 1));
    // A corner 1 mm deep in the gel, whose apex lies 22 mm in front of the camera.
    let pose = write(temp.path(), "T.json", "[[1,0,0,0.031],[0,1,0,0],[0,0,1,0],[0,0,0,1]]");
    let prefix = temp.path().join("press");
    let render = |pose: &Path, more: &[&str]| {
        let mut command = program();
        command
            .arg("render-touch")
            .arg("--mesh")
            .arg(&mesh)
            .arg("--pose")
            .arg(pose)
            .arg("--out")
            .arg(&prefix)
            .args(more);
        command
    };
    for config in ["fork", "tacto"] {
        succeed(&mut render(&pose, &["--config", config]));
    }
    succeed(&mut render(&pose, &[]));
    let file = |name: &str| format!("{}_{name}.npy", prefix.display());
    let raw: Array3<u8> = read_npy(file("rgb_raw")).unwrap();
    let calibrated: Array3<u8> = read_npy(file("rgb_cal")).unwrap();
    let depth: Array2<f32> = read_npy(file("depth")).unwrap();
    assert_eq!((raw.dim(), calibrated.dim(), depth.dim()), ((320, 240, 3), (320, 240, 3), (320, 240)));
    // The corner itself falls between pixels, of which one spans 0.08 mm.
    assert!((depth[(160, 120)] - 0.021).abs() < 1e-4, "{}", depth[(160, 120)]);
    assert!((depth[(0, 0)] - 0.019_105).abs() < 1e-5, "the gel's corner: {}", depth[(0, 0)]);
    for (name, text, why) in [
        ("short.json", "[[1,0,0,0]]", "4 x 4"),
        ("mirror.json", "[[-1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]", "rotation"),
        ("text.json", "pose", "4 x 4"),
    ] {
        refuse(&mut render(&write(temp.path(), name, text), &[]), why);
    }
    let background = temp.path().join("small.png");
    image::RgbImage::new(10, 10).save(&background).unwrap();
    refuse(&mut render(&pose, &["--background", background.to_str().unwrap()]), "240");
}

#[test]
fn a_reader_that_goes_away_is_no_error() {
    let mut child = program().args(["assets", "list"]).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    drop(child.stdout.take());
    let mut said = String::new();
    child.stderr.take().unwrap().read_to_string(&mut said).unwrap();
    assert!(child.wait().unwrap().success(), "{said}");
    assert!(!said.contains("panicked"), "{said}");
}
