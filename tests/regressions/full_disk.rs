//! A full disk left manual pages and touch images that were cut off.

use std::fs;
use std::process::Command;

use crate::workplace::{Ended, Workplace, skip};

/// Runs the program so that no file can grow beyond a size, with the same errors as on a full disk.
fn limited(workplace: &Workplace, line: &str, kilobytes: u32) -> Ended {
    let mut command = Command::new("bash");
    command.args(["-c", &format!("trap '' XFSZ; ulimit -f {kilobytes}; exec \"$@\"")]);
    command.args(["bash", env!("CARGO_BIN_EXE_mambavitact")]).args(line.split_whitespace());
    Ended::of(command.current_dir(workplace.path("")))
}

#[test]
fn what_does_not_fit_is_not_there() {
    if Command::new("bash").arg("--version").output().is_err() {
        return skip("bash cannot be started");
    }
    let workplace = Workplace::new();
    workplace.run("run --object cube70 --duration 0.3 --quiet").good();
    // Each of them writes larger files than the limit.
    for (line, out, kilobytes) in [
        ("generate --object cube70 --logs 1 --duration 0.2 --cameras side --out set", "set", 2),
        ("generate --object cube70 --logs 1 --duration 0.2 --cameras side --out set", "set", 100),
        ("run --object cube70 --duration 0.2 --quiet --out again", "again", 1),
        ("run --object cube70 --duration 0.2 --quiet --out again", "again", 100),
        ("mesh --run out --out some/mesh.ply", "some", 100),
        ("mesh --run out --out some/mesh.obj", "some", 100),
        ("view --run out --record some/film.gif --size 200x200", "some", 2),
        ("view --run out --record some/picture.png --size 200x200", "some", 2),
        ("touch data --objects mug --images 2 --out data", "data", 2),
        ("touch data --objects mug --images 2 --out data", "data", 100),
        ("man --out pages", "pages", 1),
    ] {
        // The files of the case before would count as done.
        let _ = fs::remove_dir_all(workplace.path(out));
        fs::create_dir_all(workplace.path("some")).unwrap();
        let said = limited(&workplace, line, kilobytes).error();
        assert!(said.contains("File too large"), "{line}: {said}");
        let left = workplace.files(out);
        assert_eq!(workplace.run(line).code, Some(0), "{line} fails afterwards");
        let whole = workplace.files(out);
        for (path, bytes) in left {
            // The tables of a recording grow; the rest is whole or absent.
            let is_whole = line.starts_with("run") || whole.get(&path) == Some(&bytes);
            assert!(is_whole && !path.to_string_lossy().contains("partial"), "{line}: {}", path.display());
        }
    }
}
