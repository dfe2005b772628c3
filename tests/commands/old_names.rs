//! The command names of version 0.1.0 are hidden, and do the same as the new ones.

use serde_json::Value;

use crate::workplace::{Workplace, assert_same};

fn weights() -> String {
    format!("{}/perception/touch/tests/fixtures/default.safetensors", env!("CARGO_MANIFEST_DIR"))
}

#[test]
fn old_names_are_not_shown() {
    let help = Workplace::new().run("--help").good();
    let is_listed = |name: &str| help.lines().any(|line| line.trim_start().starts_with(&format!("{name} ")));
    assert!(["run", "view", "touch", "assets", "bench"].into_iter().all(is_listed), "{help}");
    assert!(!["train", "contacts", "eval-touch", "render-touch", "network"].into_iter().any(is_listed), "{help}");
}

#[test]
fn contacts_renders_the_same_images_as_touch_data() {
    let workplace = Workplace::new();
    let line = "--objects large_dice --images 2 --seed 7 --out";
    workplace.run(&format!("contacts {line} old")).good();
    workplace.run(&format!("touch data {line} new")).good();
    assert_same(&workplace.files("old"), &workplace.files("new"));
}

#[test]
fn eval_touch_prints_the_same_scores_as_touch_evaluate() {
    let workplace = Workplace::new();
    workplace.run("touch data --objects large_dice --images 2 --out images").good();
    let scores = |command: &str, subtraction: &str| -> Value {
        let line = format!("{command} --weights {} --data images --json {subtraction}", weights());
        let mut scores = workplace.run(&line).json();
        assert!(scores["ms_per_image"].take().as_f64().unwrap() > 0.0);
        scores
    };
    assert_eq!(scores("eval-touch", ""), scores("touch evaluate", ""));
    assert_eq!(scores("eval-touch", "--as-they-are"), scores("touch evaluate", "--no-subtraction"));
}

#[test]
fn render_touch_writes_the_same_arrays_as_touch_render() {
    let workplace = Workplace::new();
    workplace.write("wedge.obj", "v 0 0 0\nv 0.01 0 0\nv 0 0.01 0\nv 0 0 0.01\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n");
    workplace.write("pose.json", "[[1,0,0,0.021],[0,1,0,0],[0,0,1,0],[0,0,0,1]]");
    workplace.run("render-touch --mesh wedge.obj --pose pose.json --out old/press").good();
    workplace.run("touch render --mesh wedge.obj --pose pose.json --out new/press").good();
    assert_eq!(workplace.files("old").len(), 3);
    assert_same(&workplace.files("old"), &workplace.files("new"));
}

#[test]
fn network_describe_prints_the_same_counts_as_touch_describe() {
    let workplace = Workplace::new();
    for line in ["describe vit --input 224", "describe default --json"] {
        let old = workplace.run(&format!("network {line}")).good();
        assert_eq!(old, workplace.run(&format!("touch {line}")).good());
    }
}

#[test]
fn train_fails_with_the_same_message_as_touch_train() {
    let workplace = Workplace::new();
    let line = "train --network default --config nowhere.toml --out training";
    let old = workplace.run(line).error();
    assert_eq!(old, workplace.run(&format!("touch {line}")).error());
    let reason = if cfg!(feature = "train") { "nowhere.toml" } else { "cargo build --release --features train" };
    assert!(old.contains(reason), "{old}");
}
