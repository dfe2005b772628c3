//! `run` and `evaluate`: simulated episodes, complete and damaged logs, interruptions.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Stdio;

use mvt_feelsight::npz::{DeflatedFrame, NpzReader, NpzWriter};
use serde_json::Value;

use crate::workplace::{Workplace, signal};

const FILES: [&str; 18] = [
    "config.toml",
    "curves.svg",
    "field.safetensors",
    "keyframes.safetensors",
    "mesh.gif",
    "mesh.glb",
    "mesh.obj",
    "mesh.ply",
    "recording/about.json",
    "recording/end.json",
    "recording/events.jsonl",
    "recording/frames.jsonl",
    "recording/images.bin",
    "recording/running",
    "recording/shapes.bin",
    "recording/shapes.jsonl",
    "summary.json",
    "trajectory.csv",
];

pub fn summary(workplace: &Workplace, folder: &str) -> Value {
    workplace.json(&format!("{folder}/summary.json"))
}

/// Returns a trajectory without its times of computation.
fn trajectory(workplace: &Workplace, folder: &str) -> String {
    let text = workplace.text(&format!("{folder}/trajectory.csv"));
    let timeless = |line: &str| line.rsplitn(5, ',').last().unwrap().to_owned();
    assert!(text.lines().next().unwrap().ends_with(",sense_ms,track_ms,map_ms,mesh_ms"));
    text.lines().map(timeless).collect::<Vec<_>>().join("\n")
}

/// Makes a log of one camera and 20 frames.
fn with_log() -> Workplace {
    let workplace = Workplace::new();
    workplace.run("generate --object cube70 --logs 1 --duration 0.667 --cameras side --out set").good();
    workplace
}

const LOG: &str = "set/cube70/00";

#[test]
fn a_closed_loop_reconstructs_and_tracks() {
    let workplace = Workplace::new();
    workplace.run("run --object rubiks_cube_small --duration 3 --quiet").good();
    let names: Vec<_> = workplace.files("out").into_keys().collect();
    assert!(names.iter().map(PathBuf::as_path).eq(FILES.map(Path::new)), "{names:?}");
    let summary = summary(&workplace, "out");
    assert_eq!((&summary["complete"], &summary["frames"]), (&true.into(), &90.into()), "{summary}");
    assert!(summary["f_score"]["5"].as_f64().unwrap() > 0.6, "{summary}");
    assert!((0.0..0.9).contains(&summary["hidden"].as_f64().unwrap()), "{summary}");
    assert!(summary["add_s_mm"]["mean"].as_f64().unwrap() < 3.0, "{summary}");
    for stage in ["sense", "track", "map", "mesh"] {
        assert!(summary["stage_ms"][stage].as_f64().unwrap() > 0.0, "{summary}");
    }
    // `score` computes the same from the files.
    let again = workplace.run("score --run out --json").json();
    let difference =
        again["pose"]["add_s_mm"]["mean"].as_f64().unwrap() - summary["add_s_mm"]["mean"].as_f64().unwrap();
    assert!(difference.abs() < 1e-6, "{again}");

    // A run with its settings moves it away.
    fs::copy(workplace.path("out/config.toml"), workplace.path("settings.toml")).unwrap();
    let line = "run --object rubiks_cube_small --duration 0.2 --config settings.toml --set slam.map.batch=512 --json";
    let again = workplace.run(line);
    let text = again.stdout.clone();
    assert!(again.warned().contains("out.1"));
    assert_eq!(serde_json::from_str::<Value>(&text).unwrap()["frames"], 6, "{text}");
    assert!(workplace.text("out/config.toml").contains(" Default: 2048.\nbatch = 512\n"));
}

#[test]
fn a_goal_ends_the_episode() {
    let workplace = Workplace::new();
    workplace.run("run --object cube70 --duration 20 --goal turn=15deg --mode pose --quiet").good();
    let summary = summary(&workplace, "out");
    assert!(summary["frames"].as_u64().unwrap() < 300, "{summary}");
    let events: Vec<_> = summary["events"].as_array().unwrap().iter().map(|event| &event["text"]).collect();
    assert!(events.contains(&&Value::from("the goal is reached")), "{summary}");
    assert_eq!(summary["complete"], true);
}

#[test]
fn the_result_does_not_depend_on_threads() {
    let workplace = Workplace::new();
    for threads in [1, 2] {
        let line = format!("run --object cube70 --duration 0.7 --seed 4 --threads {threads} --out {threads} --quiet");
        workplace.run(&line).good();
    }
    assert_eq!(trajectory(&workplace, "1"), trajectory(&workplace, "2"));
    for name in ["mesh.ply", "field.safetensors"] {
        assert!(workplace.files("1")[Path::new(name)] == workplace.files("2")[Path::new(name)], "{name}");
    }
}

#[test]
fn wrong_arguments_are_refused_before_anything_runs() {
    let workplace = Workplace::new();
    workplace.write("notes.txt", "mine");
    for (line, parts) in [
        ("run --set slam.tracker.icp_wieght=1", &["icp_wieght", "did you mean slam.tracker.icp_weight"][..]),
        ("run --set mesh_cell_mm=0", &["mesh_cell_mm"]),
        ("run --object cube70 --cameras front", &["\"front\"", "front-left", "azimuth/elevation"]),
        ("evaluate --objects cube70 --out e --cameras 330/95", &["330/95", "azimuth/elevation"]),
        ("run --object cube70 --out .", &["notes.txt", "--overwrite"]),
        ("run --log nowhere", &["nowhere"]),
        ("run --object cube71", &["cube71", "cube70"]),
        ("evaluate --objects cube70 --out e --set slam.map.bach=1", &["slam.map.batch"]),
        ("run --object cube70 --explore --controller own.toml", &["by name", "--controller auto"]),
        ("run --object cube70 --explore --controller gallop", &["gallop", "bal, "]),
        ("run --object cube70 --explore --goal pose=90deg", &["a single axis", "explored"]),
        ("run --object cube70 --goal explored", &["--explore"]),
        ("run --object cube70 --explore --mode pose", &["--mode slam or map"]),
    ] {
        let said = workplace.run(line).error();
        assert!(parts.iter().all(|part| said.contains(part)), "{line}: {said}");
    }
    assert!(workplace.run("run --goal turn=360").usage().contains("turn=360deg"));
    assert_eq!(workplace.files("").len(), 1, "something was written");
}

#[test]
fn a_log_serves_all_modes() {
    let workplace = with_log();
    for (mode, limit_mm) in [("slam", 3.0), ("pose", 3.0), ("pose --init truth", 2.0), ("map", 2.0)] {
        workplace.run(&format!("run --log {LOG} --mode {mode} --overwrite --quiet")).good();
        let summary = summary(&workplace, "out");
        assert_eq!(summary["frames"], 20, "{mode}: {summary}");
        assert!(summary["add_s_mm"]["mean"].as_f64().unwrap() < limit_mm, "{mode}: {summary}");
    }
    let said = workplace.run(&format!("run --log {LOG} --cameras front-left")).error();
    assert!(said.contains("\"front-left\"") && said.contains("there are side"), "{said}");
    assert!(workplace.run(&format!("run --log {LOG} --goal turn=1rev")).usage().contains("--log"));
}

#[test]
fn labels_of_a_log_take_the_place_of_the_hands_geometry() {
    let workplace = with_log();
    let given = format!("run --log {LOG} --set segmentation.labels=given --out given");
    workplace.run(&format!("{given} --quiet")).good();
    assert!(summary(&workplace, "given")["add_s_mm"]["mean"].as_f64().unwrap() < 3.0);
    workplace.run(&format!("run --log {LOG} --quiet")).good();
    assert_ne!(trajectory(&workplace, "given"), trajectory(&workplace, "out"));
    let labels = workplace.path(LOG).join("realsense/side/seg");
    fs::write(labels.join("3.jpg"), "no image").unwrap();
    let said = workplace.run(&given).warned();
    assert!(said.contains("frame 3: ") && said.contains("used without this camera"), "{said}");
    fs::remove_dir_all(labels).unwrap();
    let said = workplace.run(&given).error();
    assert!(said.contains("no labels") && said.contains("segmentation.labels=given"), "{said}");
    // A simulator has its own.
    workplace.run("run --object cube70 --duration 0.3 --set segmentation.labels=given --quiet --out simulated").good();
}

#[test]
fn an_estimated_shape_is_continued_and_meshed() {
    let workplace = with_log();
    workplace.run(&format!("run --log {LOG} --quiet")).good();
    let size = |folder: &str| fs::metadata(workplace.path(folder).join("keyframes.safetensors")).unwrap().len();
    let before = size("out");
    workplace.run(&format!("run --log {LOG} --resume out --out again --quiet")).good();
    let again = summary(&workplace, "again");
    assert!(again["lost_frames"].as_u64().unwrap() < 10 && again["f_score"]["5"].as_f64().unwrap() > 0.5, "{again}");
    assert!(size("again") > before);
    let settings = workplace.text("again/config.toml");
    let command = format!("# mambavitact run --object cube70 --log {LOG} --seed 0 --mode slam");
    assert!(settings.starts_with(&command) && settings.contains("--resume out"), "{settings}");

    let told = workplace.run("mesh --run out --cell-mm 2 --out shape.obj").good();
    assert!(told.contains("triangles") && workplace.path("shape.obj").exists(), "{told}");
    let counted = |line: &str| {
        let told = workplace.run(line).good();
        told.split(' ').next().unwrap().parse::<u32>().unwrap_or_else(|_| panic!("{told}"))
    };
    let whole = counted("mesh --run out --cell-mm 2 --out whole.ply");
    let seen = counted("mesh --run out --cell-mm 2 --seen-only --out seen.ply");
    assert!(seen > whole / 4 && seen < whole, "two seconds do not show all sides: {seen} of {whole}");
    let header = String::from_utf8_lossy(&fs::read(workplace.path("whole.ply")).unwrap()[..400]).into_owned();
    assert!(header.contains("property uchar seen\nproperty float deviation\n"), "{header}");
    let said = workplace.run("mesh --run out/field.safetensors --seen-only --out alone.ply").error();
    assert!(said.contains("keyframes.safetensors"), "{said}");
    assert!(workplace.run("mesh --run out --out shape.stl").error().contains(".ply or .obj"));
    assert!(workplace.run("mesh --run nowhere --out shape.ply").error().contains("nowhere"));
    fs::write(workplace.path("again/keyframes.safetensors"), "no tensors").unwrap();
    let said = workplace.run(&format!("run --log {LOG} --resume again")).error();
    assert!(said.contains("keyframes.safetensors"), "{said}");
    assert!(workplace.run(&format!("run --log {LOG} --resume out --mode pose")).error().contains("--mode slam"));
}

#[test]
fn a_damaged_log_is_used_as_far_as_possible() {
    let workplace = with_log();
    let run = |more: &str| workplace.run(&format!("run --log {LOG} --touch-depth truth --quiet {more}"));
    let depth = workplace.path(LOG).join("realsense/side/depth.npz");
    let whole = fs::read(&depth).unwrap();

    // Depths that are no numbers.
    let mut reader = NpzReader::open(&depth).unwrap();
    let [frames, height, width] = reader.shape();
    let mut images: Vec<Vec<f32>> = (0..frames).map(|_| reader.read().unwrap().unwrap()).collect();
    images[3][..1000].fill(f32::NAN);
    images[5].fill(f32::NAN);
    fs::remove_file(&depth).unwrap();
    let mut writer = NpzWriter::create(&depth, height, width).unwrap();
    for image in images {
        writer.push(&DeflatedFrame::new(image.into_iter()).unwrap()).unwrap();
    }
    writer.finish(1.0).unwrap();
    let said = run("").warned();
    assert!(
        said.contains("frame 3: 1000 depths of camera side are not numbers") && said.lines().count() == 1,
        "{said}"
    );
    assert_eq!(summary(&workplace, "out")["frames"], 20);

    // A finger that fails and one that is missing from the start lead to one warning each.
    fs::write(&depth, &whole).unwrap();
    for k in 10..20 {
        fs::remove_file(workplace.path(LOG).join(format!("allegro/{}/depth/{k}.jpg", "index"))).unwrap();
    }
    fs::remove_dir_all(workplace.path(LOG).join(format!("allegro/{}/mask", "thumb"))).unwrap();
    let said = run("").warned();
    let told = |part: &str| said.lines().filter(|line| line.contains(part)).count();
    assert!(told("the touch sensor index is missing") == 1 && told("frame 10: ") == 1, "{said}");
    assert!(told("the touch sensor thumb is missing") == 1, "{said}");
    assert_eq!(summary(&workplace, "out")["frames"], 20);

    // Without the camera, whose file ends early, touch is used.
    fs::write(&depth, &whole[..whole.len() / 2]).unwrap();
    let said = run("").warned();
    assert!(said.contains("depth.npz") && said.contains("camera side is missing"), "{said}");
    let said = run("--modality vi").error();
    assert!(said.contains("depth.npz") && said.contains("--modality vi"), "{said}");

    // Two frames have the same time.
    fs::write(&depth, &whole).unwrap();
    let pickle = workplace.path(LOG).join("data.pkl");
    let mut bytes = fs::read(&pickle).unwrap();
    let [before, stands] = [7.0, 8.0].map(|k: f64| (k / 30.0).to_le_bytes());
    let at = bytes.windows(8).position(|window| window == stands).unwrap();
    bytes[at..at + 8].copy_from_slice(&before);
    fs::write(&pickle, &bytes).unwrap();
    let said = run("").warned();
    assert!(said.contains("time does not increase") && said.contains("frame 8: "), "{said}");
    assert_eq!(summary(&workplace, "out")["frames"], 19);
    fs::write(&pickle, &bytes[..bytes.len() / 2]).unwrap();
    assert!(run("").error().contains("data.pkl"));
}

#[cfg(unix)]
#[test]
fn an_interrupted_run_leaves_what_it_has() {
    let workplace = Workplace::new();
    let mut command = workplace.command("run --object rubiks_cube_small --duration 60 --quiet");
    let mut child = command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    while !workplace.path("out/summary.json").exists() {
        assert!(child.try_wait().unwrap().is_none(), "the run ended before it was interrupted");
        std::thread::yield_now();
    }
    signal(&child, "TERM");
    assert_eq!(child.wait().unwrap().code(), Some(1));
    let summary = summary(&workplace, "out");
    assert_eq!(summary["complete"], false, "{summary}");
    let frames = summary["frames"].as_u64().unwrap();
    assert!((1..1800).contains(&frames), "{summary}");
    assert_eq!(trajectory(&workplace, "out").lines().count() as u64, frames + 1);
}

#[test]
fn an_evaluation_continues_where_it_stopped() {
    let workplace = Workplace::new();
    let line = |seeds: u32| {
        format!("evaluate --objects cube70 --seeds {seeds} --modes pose --modalities vitac,tac --duration 0.3 --out e")
    };
    let table = |line: &str| {
        let said = workplace.run(line).good();
        assert!(said.contains("side pose vitac") && said.contains("next: open e/table.md"), "{said}");
        workplace.text("e/table.md")
    };
    let one = table(&line(1));
    assert!(
        one.contains("| side | pose | vitac | full | 1 |") && one.contains("| side | pose | tac | full | 1 |"),
        "{one}"
    );
    let lines = || workplace.text("e/runs.jsonl");
    let before = lines();
    let hidden =
        serde_json::from_str::<Value>(before.trim().lines().next().unwrap()).unwrap()["hidden"].as_f64().unwrap();
    assert!((0.0..0.5).contains(&hidden), "{before}");
    let two = table(&line(2));
    assert!(two.contains("| side | pose | vitac | full | 2 |"), "{two}");
    assert!(lines().starts_with(&before) && lines().trim().lines().count() == 4, "{}", lines());
    assert_eq!(table(&line(1)), one);
}

#[test]
fn fields_are_compared_on_the_same_frames() {
    let workplace = Workplace::new();
    let line = "evaluate --fields --objects rubiks_cube_small --seeds 1 --duration 1 --cameras 90/45 --out e";
    let table = workplace.run(line).good();
    let text = workplace.text("e/fields.jsonl");
    let lines: Vec<Value> = text.trim().lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert_eq!(lines.len(), 4, "{text}");
    for (line, name) in lines.iter().zip(["refined", "dense", "hashed", "tsdf"]) {
        assert!(table.contains(&format!("| 90/45 | {name} | 1 |")), "{table}");
        assert_eq!((&line["variant"], &line["frames"]), (&name.into(), &30.into()), "{line}");
        // By then the camera has seen one side of the cube.
        assert!(line["f_score"]["5"].as_f64().unwrap() > 0.4, "{line}");
        assert!(line["mesh_error_mm"].as_f64().unwrap() < 8.0, "{line}");
        assert!(line["learning_mb"].as_f64() >= line["shape_mb"].as_f64(), "{line}");
    }
    // A finished comparison is not repeated.
    assert_eq!(workplace.run(line).good(), table);
    assert_eq!(workplace.text("e/fields.jsonl"), text);
    assert!(workplace.run(&format!("{line} --ablate")).usage().contains("--ablate"));
    assert!(workplace.run(&format!("{line} --modes pose")).usage().contains("--modes"));
}
