//! `score`: scores of runs and of files from other programs.

use std::fmt::Write as _;

use mvt_mesh::Mesh;
use mvt_objects::catalogue;
use serde_json::Value;

use crate::workplace::Workplace;

/// Returns the rounded cube of the catalogue as OBJ, moved along x.
fn cube(x: f32, scale: f32) -> String {
    let Mesh { vertices, faces } = catalogue::load("cube70", &mut Vec::new()).unwrap().mesh;
    let mut text = String::new();
    for v in vertices {
        writeln!(text, "v {} {} {}", v.x * scale + x, v.y * scale, v.z * scale).unwrap();
    }
    for [a, b, c] in faces {
        writeln!(text, "f {} {} {}", a + 1, b + 1, c + 1).unwrap();
    }
    text
}

/// Returns 200 poses at 20 Hz of an object that slides along y, with an error of `offset_m` along x that doubles after
/// 5 s.
fn poses(offset_m: f64) -> String {
    poses_from(0.0, offset_m)
}

fn poses_from(start_s: f64, offset_m: f64) -> String {
    let mut text = "time_s,x_m,y_m,z_m,qw,qx,qy,qz\n".to_owned();
    for k in 0..200 {
        let time_s = start_s + f64::from(k) / 20.0;
        let x = if time_s < 5.0 { offset_m } else { 2.0 * offset_m };
        writeln!(text, "{time_s},{x},{},0.3,1,0,0,0", 0.01 * time_s).unwrap();
    }
    text
}

fn json(workplace: &Workplace, arguments: &str) -> Value {
    let text = workplace.run(&format!("score --json {arguments}")).good();
    assert_eq!(text.lines().count(), 1, "{text}");
    serde_json::from_str(&text).unwrap()
}

/// Returns F, precision or recall of 10,000 (`original`) or 100,000 points (`fine`) at a threshold.
fn at(report: &Value, points: &str, threshold_mm: f64, what: &str) -> f64 {
    let scores = report["shape"][points]["scores"].as_array().unwrap();
    scores.iter().find(|row| row["threshold_mm"] == threshold_mm).unwrap()[what].as_f64().unwrap()
}

#[test]
fn a_perfect_shape_has_a_perfect_score_in_its_own_coordinates() {
    let workplace = Workplace::new();
    // Not centred, so that the coordinates of the file are not those of the object.
    workplace.write("cube.obj", cube(0.1, 1.0));
    let report = json(&workplace, "--mesh cube.obj --truth cube.obj");
    assert_eq!(report["shape"]["original"]["scores"].as_array().unwrap().len(), 15);
    assert!(at(&report, "fine", 1.0, "f") > 0.999, "{report}");
    assert!(at(&report, "original", 5.0, "f") == 1.0, "{report}");
    // 10,000 points on 290 cm^2 are about 1.7 mm apart.
    assert!(at(&report, "original", 1.0, "f") < 0.8, "{report}");
    assert!(report["pose"].is_null());

    let elsewhere = json(&workplace, "--mesh cube.obj --truth cube.obj --frame object");
    assert_eq!(at(&elsewhere, "original", 5.0, "f"), 0.0, "{elsewhere}");
    // The coordinates of the catalogue's cube have their origin at its centre.
    workplace.write("centred.obj", cube(0.0, 1.0));
    assert!(at(&json(&workplace, "--mesh centred.obj --truth cube70"), "fine", 1.0, "f") > 0.999);

    let words = workplace.run("score --mesh cube.obj --truth cube.obj").good();
    assert!(words.starts_with("cube\n") && words.contains("\n   5  1.0000     1.0000  1.0000"), "{words}");
}

#[test]
fn precision_counts_estimated_points_and_recall_true_points() {
    let workplace = Workplace::new();
    workplace.write("truth.obj", cube(0.0, 1.0));
    let whole = cube(0.0, 1.0);
    // The first half of the faces.
    let faces = whole.lines().filter(|line| line.starts_with('f')).count();
    let half: Vec<&str> = whole.lines().take(whole.lines().count() - faces / 2).collect();
    workplace.write("half.obj", half.join("\n"));
    let report = json(&workplace, "--mesh half.obj --truth truth.obj");
    assert_eq!(at(&report, "fine", 2.0, "precision"), 1.0, "{report}");
    let recall = at(&report, "fine", 2.0, "recall");
    assert!((0.3..0.8).contains(&recall), "{report}");
    assert!((at(&report, "fine", 2.0, "f") - 2.0 * recall / (1.0 + recall)).abs() < 1e-9, "{report}");
}

#[test]
fn poses_are_scored_and_place_the_mesh() {
    let workplace = Workplace::new();
    workplace.write("cube.obj", cube(0.0, 1.0));
    workplace.write("estimate.csv", poses(0.003));
    workplace.write("truth.csv", poses(0.0));
    let report = json(&workplace, "--mesh cube.obj --truth cube70 --pose estimate.csv --truth-pose truth.csv");
    assert_eq!(report["pose"]["frames"], 200);
    let errors = &report["pose"]["add_s_mm"];
    let [mean, last, original] = ["mean", "final", "mean_original_definition"].map(|key| errors[key].as_f64().unwrap());
    // At the end, two of six faces are 6 mm off; the others move within their planes.
    assert!((2.0..4.0).contains(&last), "{errors}");
    assert!((original - last).abs() < 1e-6 && mean < 0.8 * last, "{errors}");
    // The last pose places the mesh: two faces are more than 5 mm off, no face more than 10 mm.
    assert!((0.6..0.8).contains(&at(&report, "fine", 5.0, "precision")), "{report}");
    assert_eq!(at(&report, "fine", 10.0, "f"), 1.0);

    let words = workplace.run("score --truth cube70 --pose estimate.csv --truth-pose truth.csv").good();
    assert!(
        words.contains("200 frames") && words.contains("as NeuralFeels") && !words.contains("precision"),
        "{words}"
    );
    // Exchanging the files does not change the symmetric error.
    let swapped = json(&workplace, "--truth cube70 --pose truth.csv --truth-pose estimate.csv");
    let symmetric = |report: &Value| report["pose"]["add_s_symmetric_mm"]["mean"].as_f64().unwrap();
    assert!((symmetric(&swapped) - symmetric(&report)).abs() < 1e-6);
}

#[test]
fn a_run_and_its_files_have_the_same_scores() {
    let workplace = Workplace::new();
    std::fs::create_dir(workplace.path("out")).unwrap();
    workplace.write("out/summary.json", "{\"object\": \"cube70\", \"complete\": false}");
    let columns = "time_s,x_m,y_m,z_m,qw,qx,qy,qz,true_x_m,true_y_m,true_z_m,true_qw,true_qx,true_qy,true_qz";
    let rows = "0,0.001,0,0,1,0,0,0,0,0,0,1,0,0,0\n0.1,0.002,0,0,1,0,0,0,,,,,,,\n0.2,0.004,0,0,1,0,0,0,0,0,0,1,0,0,0\n";
    workplace.write("out/trajectory.csv", format!("{columns}\n{rows}"));
    let interrupted = json(&workplace, "--run out");
    assert!(interrupted["shape"].is_null() && interrupted["pose"]["frames"] == 2, "{interrupted}");

    let vertices = "0.03 0 0\n0 0.03 0\n-0.03 -0.03 0.01\n";
    workplace.write(
        "out/mesh.ply",
        format!(
            "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n\
             element face 1\nproperty list uchar int vertex_indices\nend_header\n{vertices}3 0 1 2\n"
        ),
    );
    let run = json(&workplace, "--run out");
    let files = json(&workplace, "--mesh out/mesh.ply --pose out/trajectory.csv --truth cube70 --frame object");
    assert_eq!(run, files);
    assert!(run["shape"]["original"]["mesh_error_mm"].as_f64().unwrap() > 5.0, "{run}");
}

#[test]
fn mistakes_are_explained() {
    let workplace = Workplace::new();
    workplace.write("cube.obj", cube(0.0, 1.0));
    workplace.write("millimetres.obj", cube(0.0, 1000.0));
    workplace.write("points.obj", "v 0 0 0\nv 0.01 0 0\n");
    workplace.write("index.obj", "v 0 0 0\nv 0.01 0 0\nf 1 2 9\n");
    workplace.write("good.csv", poses(0.0));
    workplace.write("later.csv", poses_from(100.0, 0.0));
    workplace.write("bad.csv", poses(0.0).replacen("0.3,1,0,0,0", "0.3,0,0,0,0", 1));
    for (arguments, words) in [
        ("--run nowhere", vec!["nowhere"]),
        ("--mesh nowhere.obj --truth cube70", vec!["nowhere.obj"]),
        ("--mesh cube.obj --truth cub70", vec!["cub70", "cube70"]),
        ("--mesh millimetres.obj --truth cube70", vec!["millimetres.obj", "give the unit: --mesh millimetres.obj:mm"]),
        ("--mesh points.obj --truth cube70", vec!["points.obj", "no faces"]),
        ("--mesh index.obj --truth cube70", vec!["index.obj"]),
        ("--pose good.csv --truth cube70", vec!["good.csv", "--truth-pose"]),
        ("--pose bad.csv --truth-pose good.csv --truth cube70", vec!["bad.csv", "line 2", "no rotation"]),
        ("--pose good.csv --truth-pose cube.obj --truth cube70", vec!["cube.obj", "line 1", "time_s"]),
        ("--pose good.csv --truth-pose later.csv --truth cube70", vec!["good.csv", "later.csv", "same time"]),
    ] {
        let said = workplace.run(&format!("score {arguments}")).error();
        assert!(words.iter().all(|word| said.contains(word)), "{arguments}: {said}");
    }
    for arguments in ["", "--truth cube70", "--mesh cube.obj", "--pose good.csv", "--run out --mesh cube.obj"] {
        workplace.run(&format!("score {arguments}")).usage();
    }
}
