//! `inspect`, `score` and `benchmark` of RGB-D sequences.

use std::fs;

use serde_json::Value;

use crate::rgbd::as_folders;
use crate::workplace::Workplace;

/// A short sequence of a cube in `set/cube`, without a name of its object.
fn with_sequence() -> Workplace {
    let workplace = Workplace::new();
    workplace.run("generate --object cube70 --logs 1 --duration 0.4 --cameras side --out log").good();
    fs::create_dir(workplace.path("set")).unwrap();
    as_folders(&workplace.path("log/cube70/00"), &workplace.path("set/cube"));
    workplace
}

fn json(text: &str) -> Value {
    assert_eq!(text.lines().count(), 1, "{text}");
    serde_json::from_str(text).unwrap()
}

#[test]
fn a_sequence_is_described_beforehand() {
    let workplace = with_sequence();
    workplace.write("set/cube/rgbd.toml", "frame_hz = 10.0\n");
    let facts = json(&workplace.run("inspect set/cube --json --sheet sheet.png").good());
    assert_eq!((&facts["frames"], &facts["has_truth"]), (&Value::from(12), &Value::from(true)));
    let number = |key: &str| facts[key].as_f64().unwrap();
    assert!((number("frames_per_second") - 10.0).abs() < 1e-6 && (0.2..1.0).contains(&number("distance_m")), "{facts}");
    assert!(number("pixels") > number("least_pixels") && number("pixel_mm") > 0.1, "{facts}");
    assert!(facts["difficulties"].as_array().unwrap().iter().all(Value::is_string));
    let sheet = image::open(workplace.path("sheet.png")).unwrap();
    assert!(sheet.width() > 1000 && sheet.height() > 500);
    let error = |line: &str| workplace.run(line).error();
    assert!(error("inspect set/cube --sheet sheet.png").contains("--overwrite"));
    // Masks are missing, then frames.
    for frame in [3, 4, 5] {
        fs::remove_file(workplace.path(&format!("set/cube/masks/{frame:06}.png"))).unwrap();
    }
    fs::remove_file(workplace.path("set/cube/depth/000008.png")).unwrap();
    let words = workplace.run("inspect set/cube").good();
    for part in [
        "11, ",
        "hard: 27 % of the frames have no mask",
        "hard: frames are missing at 1 places, the longest for 0.20 s",
    ] {
        assert!(words.contains(part), "{words}");
    }
    workplace.write("set/cube/rgb/000007.png", "no image");
    assert!(error("inspect set/cube").contains("000007.png"));
}

#[test]
fn poses_of_any_program_are_scored_on_a_sequence() {
    let workplace = with_sequence();
    let line = "score --sequence set/cube --pose set/cube/annotated_poses --truth cube70";
    let perfect = json(&workplace.run(&format!("{line} --json")).good());
    let number = |key: &str| perfect[key].as_f64().unwrap();
    assert!(number("add_auc") > 99.99 && number("add_s_auc") > 99.99, "{perfect}");
    assert_eq!((number("wrong"), number("abstained")), (0.0, 0.0));
    // All but the first are missing: that one is held.
    fs::create_dir(workplace.path("poses")).unwrap();
    fs::copy(workplace.path("set/cube/annotated_poses/000000.txt"), workplace.path("poses/000000.txt")).unwrap();
    let words = workplace.run("score --sequence set/cube --pose poses --truth cube70").good();
    assert!(words.contains("0.0 % are certified and wrong, 91.7 % are not certified"), "{words}");
    let error = |line: &str| workplace.run(line).error();
    workplace.write("poses/000001.txt", "1 0 0 0");
    assert!(error("score --sequence set/cube --pose poses --truth cube70").contains("000001.txt: a pose of 4 x 4"));
    fs::create_dir(workplace.path("none")).unwrap();
    assert!(error("score --sequence set/cube --pose none --truth cube70").contains("such as 000000.txt"));
    fs::remove_dir_all(workplace.path("set/cube/annotated_poses")).unwrap();
    fs::remove_file(workplace.path("poses/000001.txt")).unwrap();
    assert!(error("score --sequence set/cube --pose poses --truth cube70").contains("no true poses"));
    workplace.run("score --sequence set/cube --truth cube70").usage();
}

#[test]
fn a_data_set_is_run_and_resumed() {
    let workplace = with_sequence();
    workplace.write("set/cube/object.txt", "cube70\n");
    let fast = "benchmark set --out out --duration 0.25 --set slam.map.first_steps=20";
    let table = workplace.run(fast).warned_with_output();
    let score = |summary: &Value| summary["add_auc"].as_f64().unwrap();
    let results = workplace.text("out/results.jsonl");
    let first = json(&results);
    assert_eq!((&first["sequence"], &first["object"]), (&Value::from("cube"), &Value::from("cube70")));
    assert!(score(&first["score"]) > 90.0, "{first}");
    let summary = workplace.json("out/cube/summary.json");
    assert_eq!(summary["benchmark"], first["score"]);
    assert!(table.contains("| cube ") && !table.contains("median"), "{table}");

    // A second sequence without a name of its object, and then with one: the first is not repeated.
    as_folders(&workplace.path("log/cube70/00"), &workplace.path("set/mustard0"));
    fs::create_dir(workplace.path("meshes")).unwrap();
    let failed = workplace.run(&format!("{fast} --meshes meshes"));
    assert_eq!(failed.code, Some(1), "{failed:?}");
    assert!(failed.stdout.contains("mustard0: --meshes meshes: there is neither 006_mustard_bottle.obj"), "{failed:?}");
    workplace.write("set/mustard0/object.txt", "cube70\n");
    let table = workplace.run(fast).warned_with_output();
    for part in ["| mustard0 ", "**median**", "6DOPE-GS, YCBInEOAT (arXiv 2412.01543)"] {
        assert!(table.contains(part), "{table}");
    }
    let resumed = workplace.text("out/results.jsonl");
    assert!(resumed.starts_with(&results) && resumed.lines().count() == 2, "{resumed}");

    let error = |line: &str| workplace.run(line).error();
    assert!(error("benchmark set --out out").contains("other settings"));
    assert!(error("benchmark set --out new --only a").contains("there are cube, mustard0"));
    assert!(error("benchmark meshes --out new").contains("no RGB-D sequence"));
    assert!(error("benchmark set --out log").contains("log"));
}
