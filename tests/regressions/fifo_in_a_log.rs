//! A FIFO in the place of a file made `inspect` and `run` wait for ever.

use std::fs;
use std::process::Command;

use crate::workplace::Workplace;

#[cfg(unix)]
#[test]
fn a_fifo_is_refused_at_once() {
    let workplace = Workplace::new();
    workplace.run("generate --object cube70 --logs 1 --duration 0.2 --cameras side --out set").good();
    workplace.run("run --object cube70 --duration 0.2 --quiet").good();
    let log = "set/cube70/00";
    for (file, line) in [
        (format!("{log}/scene.json"), format!("inspect {log}")),
        (format!("{log}/data.pkl"), format!("inspect {log}")),
        (format!("{log}/allegro/thumb/image/2.jpg"), format!("inspect {log}")),
        (format!("{log}/realsense/side/depth.npz"), format!("inspect {log}")),
        (format!("{log}/realsense/side/seg/1.jpg"), format!("inspect {log}")),
        ("out/field.safetensors".to_owned(), "mesh --run out --out m.ply".to_owned()),
        ("out/keyframes.safetensors".to_owned(), "run --object cube70 --resume out --out again".to_owned()),
        ("out/config.toml".to_owned(), "run --object cube70 --config out/config.toml --out again".to_owned()),
        ("out/trajectory.csv".to_owned(), "score --run out".to_owned()),
        ("out/mesh.ply".to_owned(), "run --object out/mesh.ply --out again".to_owned()),
        ("out/recording/about.json".to_owned(), "view --run out --record a.png".to_owned()),
        ("out/recording/frames.jsonl".to_owned(), "view --run out --record a.png".to_owned()),
    ] {
        let path = workplace.path(&file);
        let bytes = fs::read(&path).unwrap();
        fs::remove_file(&path).unwrap();
        assert!(Command::new("mkfifo").arg(&path).status().unwrap().success());
        let said = workplace.run(&line).error();
        assert!(said.contains("regular file"), "{line}: {said}");
        fs::remove_file(&path).unwrap();
        fs::write(&path, bytes).unwrap();
    }
}
