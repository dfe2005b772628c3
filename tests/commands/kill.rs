//! SIGKILL at any moment: a log with its final name is complete, and the same command finishes the work.

use std::fs;
use std::path::Path;
use std::process::{Child, Command, Stdio};

use crate::workplace::{Workplace, assert_same, skip};

/// Moment at which the process is killed.
enum Moment {
    /// When there are this many files and folders more than at the fewest.
    Entries(usize),
    /// When this path exists: for the short but decisive steps at the end of a log.
    Exists(&'static str),
}

fn count(folder: &Path) -> usize {
    // The process renames and removes folders while they are counted.
    let Ok(entries) = fs::read_dir(folder) else { return 0 };
    entries.flatten().map(|entry| 1 + if entry.path().is_dir() { count(&entry.path()) } else { 0 }).sum()
}

/// Runs until the moment, kills the process, and returns whether it was still running.
fn killed_at(workplace: &Workplace, line: &str, moment: &Moment) -> bool {
    let mut command = workplace.command(line);
    let mut child: Child = command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    // The process first removes the files that an earlier kill left.
    let mut fewest = usize::MAX;
    let mut has_come = || match moment {
        Moment::Entries(more) => {
            let entries = count(&workplace.path("set"));
            fewest = fewest.min(entries);
            entries >= fewest + more
        }
        Moment::Exists(path) => workplace.path(path).exists(),
    };
    while !has_come() && child.try_wait().unwrap().is_none() {
        std::thread::yield_now();
    }
    child.kill().unwrap();
    !child.wait().unwrap().success()
}

fn check_visible_logs(workplace: &Workplace) -> usize {
    let logs = workplace.logs("set");
    for log in &logs {
        // A log without scene.json would be taken for one of another program.
        assert!(workplace.path(log).join("scene.json").exists(), "{log}");
        workplace.run(&format!("inspect {log}")).good();
    }
    logs.len()
}

#[test]
fn a_killed_run_is_resumed() {
    let workplace = Workplace::new();
    let line = |out: &str| format!("generate --object cube70 --logs 6 --duration 0.3 --out {out}");
    let mut kills = 0;
    // A log has about 140 entries. The numbers are arbitrary.
    for moment in [
        Moment::Entries(1),
        Moment::Entries(17),
        Moment::Entries(143),
        Moment::Exists("set/cube70/00"),
        Moment::Exists("set/cube70/.01.partial/data.pkl"),
        Moment::Entries(71),
        Moment::Entries(209),
        Moment::Exists("set/cube70/01"),
        Moment::Exists("set/cube70/.02.partial/scene.json"),
        Moment::Entries(33),
    ] {
        kills += usize::from(killed_at(&workplace, &line("set"), &moment));
        check_visible_logs(&workplace);
    }
    // A busy machine may let a run finish before its moment is seen, but not at the first moment.
    assert!(kills >= 2, "only {kills} runs were killed before they were done");
    workplace.run(&line("set")).good();
    assert_eq!(check_visible_logs(&workplace), 6);
    workplace.run(&line("undisturbed")).good();
    assert_same(&workplace.files("undisturbed"), &workplace.files("set"));
}

#[test]
fn a_log_that_is_being_replaced_stays_whole() {
    let workplace = Workplace::new();
    let line = |seed: u32| format!("generate --object cube70 --logs 1 --duration 0.3 --seed {seed} --out set");
    workplace.run(&line(0)).good();
    for moment in
        [Moment::Entries(60), Moment::Exists("set/cube70/.00.partial/scene.json"), Moment::Exists("set/cube70/.00.old")]
    {
        killed_at(&workplace, &format!("{} --overwrite", line(1)), &moment);
        check_visible_logs(&workplace);
    }
    workplace.run(&format!("{} --overwrite", line(1))).good();
    workplace.run(&line(1).replace("set", "undisturbed")).good();
    assert_same(&workplace.files("undisturbed"), &workplace.files("set"));
}

/// Two commands of the nightly script: each is killed once, and started twice at once.
#[test]
fn nothing_is_lost_when_commands_are_killed_or_meet() {
    let mut script = Command::new("python3");
    script.arg(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/nightly/kills.py"));
    script.args(["--program", env!("CARGO_BIN_EXE_mambavitact"), "--kills", "2", "--pairs", "2"]);
    match script.output() {
        Ok(output) => assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr)),
        Err(error) => skip(&format!("python3 cannot be started: {error}")),
    }
}
