//! Two commands that wrote into one folder at a time left a corrupt log under its final name.

use std::process::Stdio;

use crate::workplace::Workplace;

/// Starts both commands at the same time and returns how many of them succeeded.
fn both(workplace: &Workplace, line: &str) -> usize {
    let start = || workplace.command(line).stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
    let children = [start(), start()];
    let ended = children.map(|child| child.wait_with_output().unwrap());
    for output in ended.iter().filter(|output| !output.status.success()) {
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(said.contains("another mambavitact") || said.contains("already exists"), "{line}: {said}");
    }
    ended.iter().filter(|output| output.status.success()).count()
}

#[test]
fn one_of_two_commands_has_the_folder() {
    let workplace = Workplace::new();
    // The second process may begin when the first one has ended.
    assert!(
        both(&workplace, "generate --object cube70 --logs 2 --duration 0.3 --jobs 1 --cameras side --out set") >= 1
    );
    assert_eq!(workplace.logs("set").len(), 2);
    for log in workplace.logs("set") {
        workplace.run(&format!("inspect {log}")).good();
    }
    assert!(both(&workplace, "run --object cube70 --duration 0.5 --quiet") >= 1);
    workplace.run("score --run out").good();
    assert!(both(&workplace, "evaluate --objects cube70 --seeds 1 --duration 0.3 --modes pose --out e") >= 1);
    let lines = std::fs::read_to_string(workplace.path("e/runs.jsonl")).unwrap();
    assert_eq!(lines.lines().count(), 2, "{lines}");
    assert_eq!(both(&workplace, "mesh --run out --out one.ply"), 1);
    workplace.run("touch render --mesh one.ply --pose absent.json --out x").error();
    assert!(both(&workplace, "touch data --objects mug --images 4 --out data") >= 1);
}
