//! `disturb`, `calibrate`, and `run` with a wrong calibration.

use serde_json::Value;

use crate::workplace::Workplace;

fn json(text: &str) -> Value {
    serde_json::from_str(text).unwrap()
}

/// Rows of a 4 x 4 pose.
fn pose(value: &Value) -> [[f64; 4]; 4] {
    serde_json::from_value(value.clone()).unwrap()
}

#[test]
fn a_wrong_calibration_is_found_and_written_for_later_runs() {
    let workplace = Workplace::new();
    workplace.run("generate --object cube70 --logs 1 --duration 1 --cameras side --out set").good();
    let said = workplace
        .run("disturb set/cube70/00 --out wrong --camera-deg 4 --camera-mm 8 --joints-deg 0.7 --lag-ms 20 --seed 3")
        .good();
    assert!(said.starts_with("1 camera(s) moved, 16 joints changed"), "{said}");
    // Images and times are those of the log.
    let (before, after) = (workplace.files("set/cube70/00"), workplace.files("wrong"));
    assert_eq!(before.keys().filter(|path| before[*path] != after[*path]).count(), 1, "data.pkl alone changes");

    // The points on the hand say so before any estimate does.
    assert!(!workplace.run("inspect set/cube70/00").good().contains("sees the hand"));
    let said = workplace.run("inspect wrong").good();
    assert!(said.contains("camera side sees the hand") && said.contains("calibrate"), "{said}");

    workplace.run("calibrate --log wrong --out found.json").warned();
    let found = workplace.json("found.json");
    let truth = workplace.json("wrong/disturbance.json");
    let (found_pose, true_pose) = (pose(&found["cameras"][0]["pose"]), pose(&truth["true_camera_poses"][0][1]));
    let trace: f64 = (0..9).map(|i| found_pose[i / 3][i % 3] * true_pose[i / 3][i % 3]).sum();
    let turned_deg = ((trace - 1.0) / 2.0).clamp(-1.0, 1.0).acos().to_degrees();
    assert!(turned_deg < 0.5, "{turned_deg} degrees off");
    let moved_m = (0..3).map(|row| (found_pose[row][3] - true_pose[row][3]).powi(2)).sum::<f64>().sqrt();
    assert!(moved_m < 0.002, "{moved_m} m off");
    assert!((found["lag_ms"].as_f64().unwrap() - 20.0).abs() < 5.0, "{}", found["lag_ms"]);

    let f5 = |arguments: &str| {
        let line = format!("run --log wrong --touch-depth truth --json --quiet {arguments}");
        let ended = workplace.command(&line).output().unwrap();
        assert!(ended.status.success(), "{}", String::from_utf8_lossy(&ended.stderr));
        let words = String::from_utf8_lossy(&ended.stderr).into_owned();
        (json(&String::from_utf8(ended.stdout).unwrap())["f_score"]["5"].as_f64().unwrap(), words)
    };
    let (refined, words) = f5("--out refined");
    assert!(words.contains("camera side is turned by 4.") && words.contains("ms late"), "{words}");
    let (given, words) = f5("--out given --calibration given");
    assert_eq!(words, "");
    let (read, _) = f5("--out read --calibration given --calibration-file found.json");
    assert!(
        refined > given + 0.2 && read > given + 0.2,
        "F@5 {refined} refined, {read} from the file, {given} as given"
    );
}

#[test]
fn simulated_sensors_are_calibrated_as_they_are() {
    let workplace = Workplace::new();
    let found = json(&workplace.run("calibrate --simulated --duration 1.5 --seed 4 --json").good());
    let camera = &found["cameras"][0];
    // The calibration of the simulated sensors is perfect, and their noise is small.
    for (key, bar) in [("turned_deg", 0.2), ("moved_mm", 1.0)] {
        assert!(camera[key].as_f64().unwrap() < bar, "{camera}");
    }
    assert!(found["lag_ms"].as_f64().unwrap().abs() < 3.0, "{found}");
    let found = json(&workplace.run("calibrate --simulated --rig three_fingers --duration 0.5 --json").good());
    assert_eq!(found["joint_offsets_deg"].as_array().unwrap().len(), 12, "{found}");
    assert!(workplace.run("calibrate --simulated --rig four_fingers").error().contains("three_fingers"));
    assert!(workplace.run("calibrate").usage().contains("--log"));
    assert!(workplace.run("calibrate --simulated --log x").usage().contains("cannot be used with"));
}

#[test]
fn what_is_no_calibration_is_refused_in_words() {
    let workplace = Workplace::new();
    workplace.write("bad.json", r#"{"cameras": []}"#);
    let message = workplace.run("run --object cube70 --duration 0.2 --calibration-file bad.json --out out").error();
    assert!(message.contains("bad.json is not a calibration"), "{message}");
    assert!(workplace.run("calibrate --log nowhere").error().contains("nowhere"));
    assert!(workplace.run("disturb nowhere --out copy").error().contains("nowhere"));
    assert!(workplace.run("disturb nowhere --out copy --camera-deg NaN").usage().contains("from -1000 to 1000"));
}
