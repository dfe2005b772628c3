//! `run --explore` and `evaluate --explore`.

use serde_json::Value;

use crate::run::summary;
use crate::workplace::Workplace;

/// Returns the explorer's choices, and the summary without times of computation.
fn explored(workplace: &Workplace, folder: &str, arguments: &str) -> (Vec<Value>, Value) {
    workplace
        .run(&format!("run --object rubiks_cube_small --seed 1 --explore --quiet --out {folder} {arguments}"))
        .good();
    let summary = summary(workplace, folder);
    let choices = summary["choices"].as_array().cloned().unwrap_or_default();
    (choices, summary["f_score"].clone())
}

#[test]
fn the_hand_changes_the_axis_to_see_the_foot() {
    let workplace = Workplace::new();
    let (choices, score) = explored(&workplace, "1", "--duration 5 --touch-depth truth --threads 1");
    let mut changes = choices.iter().filter(|choice| choice["chosen"] != "regrasp");
    let first = changes.next().expect("a cube on the palm hides its foot from turns about z");
    let gains = first["gains_cm2_s"].as_object().unwrap();
    let gain = |name: &str| gains[name].as_f64().unwrap();
    let chosen = first["chosen"].as_str().unwrap();
    assert!(chosen != "cubelet" && gain(chosen) > gain("cubelet") && gains.contains_key("regrasp"), "{first}");
    let events = workplace.text("1/recording/events.jsonl");
    assert!(events.contains(&format!("changes to controller {chosen} (expected to show, cm^2/s: ")), "{events}");
    assert_eq!(explored(&workplace, "2", "--duration 5 --touch-depth truth --threads 2"), (choices, score));
    assert!(workplace.text("1/config.toml").lines().next().unwrap().contains(" --explore"));
}

#[test]
fn an_object_with_one_safe_controller_is_played_with_it() {
    let workplace = Workplace::new();
    let line = "run --object pepper_grinder --explore --duration 0.3 --json";
    let said = workplace.run(line);
    let text = said.stdout.clone();
    assert!(said.warned().contains("no change from "), "one controller plays alone");
    let summary: Value = serde_json::from_str(&text).unwrap();
    assert_eq!((&summary["frames"], summary.get("choices")), (&Value::from(9), None));
}

#[test]
fn ways_to_choose_are_compared_from_the_same_start() {
    let workplace = Workplace::new();
    let line = |modes: &str| {
        format!(
            "evaluate --objects rubiks_cube_small --seeds 1 --duration 1 --explore {modes} --touch-depth truth --out e"
        )
    };
    let table = workplace.run(&line("frontier;oracle;fixed=cubelet")).good();
    let text = workplace.text("e/explore.jsonl");
    let lines: Vec<Value> = text.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert_eq!(lines.len(), 3, "{text}");
    for (line, mode) in lines.iter().zip(["frontier", "oracle", "fixed=cubelet"]) {
        assert!(table.contains(&format!("| {mode} | 1 |")), "{table}");
        assert_eq!((&line["variant"], &line["dropped"]), (&Value::from(mode), &Value::from(false)));
        assert!(line["area_f5"].as_f64().unwrap() > 0.05, "{line}");
    }
    // Before the first choice both play the same controller; a fixed one is also pushed back to its place.
    assert_eq!((&lines[1]["area_f5"], &lines[1]["shape"]), (&lines[0]["area_f5"], &lines[0]["shape"]));
    assert_eq!(workplace.run(&line("frontier")).good().lines().filter(|line| line.contains("| 1 |")).count(), 1);
    assert_eq!(workplace.text("e/explore.jsonl"), text, "a finished episode is not repeated");
    assert!(workplace.run(&line("truth")).usage().contains("oracle or fixed=CONTROLLER"));
    assert!(workplace.run(&format!("{} --faults", line("frontier"))).usage().contains("--faults"));
}
