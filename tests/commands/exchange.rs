//! `export` and `import`.

use crate::workplace::Workplace;

#[test]
fn a_log_becomes_an_mcap_file_that_nothing_else_replaces() {
    let workplace = Workplace::new();
    workplace.run("generate --object cube70 --logs 1 --duration 0.2 --cameras side --out set").good();
    let said = workplace.run("export mcap set/cube70/00 --out cube.mcap").good();
    assert!(said.starts_with("6 frames in 18 channels, "), "{said}");
    let file = std::fs::read(workplace.path("cube.mcap")).unwrap();
    assert!(file.starts_with(b"\x89MCAP0\r\n") && file.ends_with(b"\x89MCAP0\r\n"));

    let refused = workplace.run("export mcap set/cube70/00 --out cube.mcap").error();
    assert!(refused.contains("cube.mcap already exists"), "{refused}");
    workplace.run("export mcap set/cube70/00 --out cube.mcap --overwrite").good();
    assert!(std::fs::read(workplace.path("cube.mcap")).unwrap() == file, "the same bytes again");

    let refused = workplace.run("export mcap set --out set.mcap").error();
    assert!(refused.contains("data.pkl"), "{refused}");
    std::fs::remove_file(workplace.path("set/cube70/00/realsense/side/image/3.jpg")).unwrap();
    workplace.run("export mcap set/cube70/00 --out broken.mcap").error();
    assert!(workplace.files("").keys().all(|path| path.extension().is_none_or(|end| end != "partial")));
    assert!(!workplace.path("broken.mcap").exists());
}

/// A run on an imported export must be that on the log.
#[test]
fn an_imported_log_gives_the_same_run() {
    let workplace = Workplace::new();
    workplace.run("generate --object cube70 --logs 1 --duration 1 --cameras side --out set").good();
    workplace.run("export mcap set/cube70/00 --out cube.mcap").good();
    let ended = workplace.run("import cube.mcap --out again");
    assert!(ended.stderr.contains("untouched images of the DIGITs are estimated"), "{}", ended.stderr);
    let said = ended.stdout;
    assert!(said.contains("/camera/side/depth") && said.contains("30 frames in again"), "{said}");
    assert!(said.contains("next: `mambavitact run --log again`"), "{said}");
    assert!(workplace.run("inspect again").good().contains("complete: time is up"));
    let run = |log: &str| {
        let summary = workplace.run(&format!("run --log {log} --out run-{} --quiet --json", log.len())).json();
        [&summary["f_score"]["5"], &summary["add_s_mm"]["mean"]].map(|score| score.as_f64().unwrap())
    };
    let ([shape, pose], [again_shape, again_pose]) = (run("set/cube70/00"), run("again"));
    assert!((shape - again_shape).abs() <= 0.005, "F-score {shape} and {again_shape}");
    assert!((pose - again_pose).abs() <= 0.05, "ADD-S {pose} and {again_pose} mm");
    assert!(workplace.run("import cube.mcap --out again").error().contains("not empty"));
    let refused = workplace.run("run --log again --out other --mcap cube.mcap").error();
    assert!(refused.contains("--overwrite") && !workplace.path("other").exists(), "{refused}");
    let refused = workplace.run("export lerobot again --runs again --out data").error();
    assert!(refused.contains("again") && !workplace.path("data").exists(), "{refused}");
    assert!(workplace.run("import set/cube70/00/data.pkl --out other").error().contains("not an MCAP file"));
    assert!(!workplace.path("other").exists());
}
