//! `generate`: layout, refusals, options, and bytes that do not depend on the number of threads.

use std::fs;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use crate::workplace::{Files, Workplace, assert_same};

const SHORT: &str = "generate --duration 0.4 --logs 1";

fn times(workplace: &Workplace, folder: &str) -> Vec<(PathBuf, SystemTime)> {
    let modified = |path: &PathBuf| fs::metadata(workplace.path(folder).join(path)).unwrap().modified().unwrap();
    workplace.files(folder).into_keys().map(|path| (path.clone(), modified(&path))).collect()
}

fn paths_with(files: &Files, part: &str) -> usize {
    files.keys().filter(|path| path.to_str().unwrap().contains(part)).count()
}

#[test]
fn logs_are_laid_out_by_object_and_number() {
    let workplace = Workplace::new();
    let line =
        "generate --object cube70 --object large_dice --logs 2 --duration 0.4 --cameras front-left,side --out set";
    assert!(workplace.run(line).good().starts_with("4 logs in set\n"));
    assert_eq!(workplace.logs("set"), ["set/cube70/00", "set/cube70/01", "set/large_dice/00", "set/large_dice/01"]);
    for log in workplace.logs("set") {
        let files = workplace.files(&log);
        for file in ["data.pkl", "scene.json", "realsense/front-left/depth.npz", "realsense/side/depth.npz"] {
            assert!(files.contains_key(Path::new(file)), "{log} lacks {file}");
        }
        // 0.4 s at 30 Hz.
        for folder in ["allegro/thumb/image", "allegro/ring/depth", "allegro/index/mask", "realsense/side/seg"] {
            assert_eq!(paths_with(&files, folder), 12, "{log}/{folder}");
        }
        let summary = workplace.run(&format!("inspect {log}")).good();
        assert!(summary.contains("complete: time is up") && summary.contains("side, 640 x 480"), "{summary}");
    }
    let summary = workplace.run("inspect --json set/cube70/01").json();
    assert_eq!((&summary["object"], &summary["frames"]), (&"cube70".into(), &12.into()));

    // The same command again finds complete logs and changes nothing.
    let before = times(&workplace, "set");
    assert!(workplace.run(line).good().starts_with("4 logs in set\n"));
    assert_eq!(times(&workplace, "set"), before);

    // More logs of the same settings are added.
    let before = times(&workplace, "set/cube70/01");
    workplace.run(&line.replace("--logs 2", "--logs 3")).good();
    assert_eq!(times(&workplace, "set/cube70/01"), before);
    assert_eq!(workplace.logs("set").len(), 6);
    // Log k has the seed SEED + k.
    workplace.run(&line.replace("--logs 2", "--logs 1 --seed 2").replace("set", "third")).good();
    assert_same(&workplace.files("set/cube70/02"), &workplace.files("third/cube70/00"));
}

/// The folder has a plain name, and the log names the true object.
#[test]
fn a_log_of_a_random_object_finds_its_object() {
    let workplace = Workplace::new();
    workplace.run(&format!("{SHORT} --object random:17 --out set")).good();
    assert_eq!(workplace.logs("set"), ["set/random-17/00"]);
    let scene = workplace.text("set/random-17/00/scene.json");
    assert!(scene.contains("\"random:17\"") && scene.contains("\"random-17\""), "{scene}");
    let said = workplace.run("inspect set/random-17/00").good();
    assert!(said.contains("random-17"), "{said}");
    let error = workplace.run(&format!("{SHORT} --object random:x --out other")).stderr;
    assert!(error.contains("no valid seed") && !workplace.path("other").exists(), "{error}");
}

#[test]
fn existing_logs_are_replaced_only_on_demand() {
    let workplace = Workplace::new();
    workplace.run(&format!("{SHORT} --object cube70 --out set")).good();
    let first = workplace.files("set");
    for other in [
        "--duration 0.4 --seed 1",
        "--duration 0.4 --noise none",
        "--duration 0.4 --cameras side",
        "--duration 0.4 --gait box",
        "--duration 0.4 --side right",
        "--duration 0.4 --touch-config tacto",
        "--duration 0.3",
    ] {
        let line = format!("generate --object cube70 --logs 1 --out set {other}");
        let said = workplace.run(&line).error();
        assert!(said.contains("set/cube70/00") && said.contains("--overwrite"), "{other}: {said}");
    }
    assert_same(&first, &workplace.files("set"));

    workplace.run(&format!("{SHORT} --object cube70 --out set --seed 1 --overwrite")).good();
    let second = workplace.files("set");
    assert_ne!(second.get(Path::new("cube70/00/data.pkl")), first.get(Path::new("cube70/00/data.pkl")));
    assert!(!second.keys().any(|path| path.to_str().unwrap().contains("/.")), "partial files were left");
    workplace.run("inspect set/cube70/00").good();
    workplace.run(&format!("{SHORT} --object cube70 --out set --overwrite")).good();
    assert_same(&first, &workplace.files("set"));
}

#[test]
fn a_folder_with_other_files_is_refused() {
    let workplace = Workplace::new();
    fs::create_dir_all(workplace.path("home/letters")).unwrap();
    workplace.write("home/letters/mum.txt", "Dear mum");
    let line = format!("{SHORT} --object cube70 --out home");
    let said = workplace.run(&line).error();
    assert!(said.contains("home is not empty") && said.contains("--overwrite"), "{said}");
    assert_eq!(workplace.files("home").len(), 1);
    workplace.run(&format!("{line} --overwrite")).good();
    assert_eq!(workplace.files("home")[Path::new("letters/mum.txt")], b"Dear mum");
    workplace.run("inspect home/cube70/00").good();
}

#[test]
fn wrong_names_and_numbers_are_explained() {
    let workplace = Workplace::new();
    let said = |arguments: &str| workplace.run(&format!("generate --duration 0.4 --out set {arguments}"));
    assert!(said("--object rubiks_cube").error().contains("077_rubiks_cube"));
    // The first object is valid, but nothing is simulated before all are checked.
    assert!(said("--object cube70 --object 013_aple").error().contains("013_apple"));
    assert!(said("--object cube70 --gait stroll").error().contains("ball, box, can"));
    let cameras = said("--object cube70 --cameras front-left,bottom").error();
    assert!(cameras.contains("\"bottom\"") && cameras.contains("front-left, back-right, top-down, side"), "{cameras}");
    assert!(said("--object cube70 --touch-config gelsight").usage().contains("fork or tacto"));
    for wrong in [
        "--logs 0",
        "--occlusion-views 0",
        "--jobs 0",
        "--jobs 1000000",
        "--duration 0",
        "--duration NaN",
        "--noise loud",
        "--logs 2 --occlusion-views 2",
    ] {
        let line = format!("generate --object cube70 --out set {wrong}");
        assert!(workplace.run(&line).usage().contains(wrong.split(' ').next().unwrap()), "{wrong}");
    }
    workplace.run("generate --object cube70").usage();
    workplace.run("generate --out set").usage();
    assert!(said("--object cube70 --background nowhere.png").error().contains("nowhere.png"));
    workplace.write("small.png", png(24, 32));
    assert!(said("--object cube70 --background small.png").error().contains("24 x 32"));
    assert_eq!(workplace.files("set").len(), 0);
}

fn png(width: u32, height: u32) -> Vec<u8> {
    let mut bytes = std::io::Cursor::new(Vec::new());
    image::RgbImage::new(width, height).write_to(&mut bytes, image::ImageFormat::Png).unwrap();
    bytes.into_inner()
}

#[test]
fn occlusion_views_show_one_episode() {
    let workplace = Workplace::new();
    workplace.run("generate --object cube70 --duration 0.2 --occlusion-views 3 --out views").good();
    assert_eq!(workplace.logs("views"), ["views/cube70/00", "views/cube70/01", "views/cube70/02"]);
    let [first, second, third] = ["00", "01", "02"].map(|log| workplace.files(&format!("views/cube70/{log}")));
    for (path, bytes) in &first {
        let touch = path.starts_with("allegro");
        assert_eq!(second[path] == *bytes, touch, "{}", path.display());
        assert_eq!(third[path] == *bytes, touch, "{}", path.display());
    }
    for log in workplace.logs("views") {
        workplace.run(&format!("inspect {log}")).good();
    }
}

#[test]
fn noise_changes_only_the_chosen_images() {
    let workplace = Workplace::new();
    let [none, touch, full] = ["none", "touch", "full"].map(|noise| {
        workplace
            .run(&format!("generate --object cube70 --logs 1 --duration 0.2 --noise {noise} --out {noise}"))
            .good();
        workplace.run(&format!("inspect {noise}/cube70/00")).good();
        workplace.files(&format!("{noise}/cube70/00"))
    });
    let [gel, depth] = ["allegro/thumb/image/3.jpg", "realsense/front-left/depth.npz"].map(Path::new);
    assert!(none[gel] != touch[gel] && none[depth] == touch[depth]);
    assert!(touch[gel] == full[gel] && touch[depth] != full[depth]);
}

#[test]
fn threads_do_not_change_a_byte() {
    let workplace = Workplace::new();
    let make = |out: &str, more: &str| {
        let line =
            "generate --object rubiks_cube_small --logs 1 --duration 1.4 --noise full --cameras front-left,top-down";
        workplace.run(&format!("{line} --out {out} {more}")).good();
        workplace.files(out)
    };
    let one = make("one", "--jobs 1");
    assert_same(&one, &make("two", "--jobs 2"));
    assert_same(&one, &make("five", "--jobs 5"));
    let other = make("other", "--jobs 2 --seed 1");
    assert!(one.keys().filter(|path| path.ends_with("41.jpg")).all(|path| one[path] != other[path] || masked(path)));
    assert_ne!(one[Path::new("rubiks_cube_small/00/data.pkl")], other[Path::new("rubiks_cube_small/00/data.pkl")]);
}

/// Returns whether a file is depth or mask of a pad, which may be empty in both logs.
fn masked(path: &Path) -> bool {
    path.starts_with("rubiks_cube_small/00/allegro") && !path.to_str().unwrap().contains("image")
}

#[test]
fn a_compact_log_is_small_and_every_command_reads_it() {
    let workplace = Workplace::new();
    workplace.run(&format!("{SHORT} --object cube70 --format compact --out small")).good();
    workplace.run(&format!("{SHORT} --object cube70 --out large")).good();
    let bytes = |set: &str| workplace.files(&format!("{set}/cube70/00")).values().map(Vec::len).sum::<usize>();
    assert!(6 * bytes("small") < bytes("large"), "{} and {}", bytes("small"), bytes("large"));
    // The same episode: data.pkl and scene.json are equal, and so is the conversion of the large log.
    workplace.run("convert large/cube70/00 --out converted").good();
    let [small, converted] = [workplace.files("small/cube70/00"), workplace.files("converted")];
    for file in ["data.pkl", "scene.json"] {
        assert_eq!(small[Path::new(file)], converted[Path::new(file)], "{file}");
    }
    assert!(workplace.run("inspect converted").good().contains("complete: time is up"));
    for log in ["small/cube70/00", "converted"] {
        workplace.run(&format!("run --log {log} --touch-depth truth --quiet --out run --overwrite")).warned();
        assert!(workplace.path("run/summary.json").exists());
    }
    assert!(workplace.run("convert converted --out back").good().contains("layout feelsight"));
    assert_eq!(workplace.files("back").len(), workplace.files("large/cube70/00").len());
    // The layout is one of the settings of a log.
    let said = workplace.run(&format!("{SHORT} --object cube70 --out small")).error();
    assert!(said.contains("made with other settings"), "{said}");
    assert!(workplace.run("convert back --out converted").error().contains("not empty"));
    assert!(workplace.run("convert nowhere --out other").error().contains("nowhere"));
}
