//! Learnt policies: checked, played, and refused before an episode starts.

use mvt_robot::hand::{Hand, Side};
use safetensors::serialize;
use safetensors::tensor::{Dtype, TensorView};
use serde_json::Value;

use crate::workplace::Workplace;

/// A policy that holds the middle of the joints' ranges, at a rate.
pub fn write(workplace: &Workplace, control_hz: &str) {
    let hand = Hand::allegro(Side::Left);
    let zeros = [0_u8; 4 * 16 * 19];
    let tensors = [
        ("layers.0.weight", TensorView::new(Dtype::F32, vec![16, 19], &zeros).unwrap()),
        ("layers.0.bias", TensorView::new(Dtype::F32, vec![16], &zeros[..64]).unwrap()),
    ];
    workplace.write("policy.safetensors", serialize(tensors, None).unwrap());
    let names: Vec<&str> = hand.joints().iter().map(|joint| joint.name.as_str()).collect();
    let middles: Vec<f64> = hand.ranges().iter().map(|[low, high]| 0.5 * (low + high)).collect();
    let contract = format!(
        "joint_names = {names:?}\njoint_stiffness = 2.5\njoint_damping = 0.1\ndefault_joint_pos = {middles:?}\naction_scale = 0.5\n\
         observation_names = [\"joint_pos\", \"command\"]\nobservation_terms_scale = 1.0\nobservation_terms_clip = [-1.0, 1.0]\n\
         observation_terms_history_length = 0\ncontrol_hz = {control_hz}\nactivation = \"elu\"\nnormaliser = \"none\"\n"
    );
    workplace.write("policy.toml", contract);
}

#[test]
fn a_policy_is_checked_and_played_by_simulate_and_run() {
    let workplace = Workplace::new();
    write(&workplace, "50");
    let contract = workplace.run("controllers check policy.safetensors").good();
    for part in ["50 Hz", "19 numbers", "joint_pos ", "thumb_3", "2.500", "played          1.0 s"] {
        assert!(contract.contains(part), "{part}: {contract}");
    }
    let played =
        || workplace.run("simulate --json --object cube70 --duration 2 --controller policy.safetensors").json();
    let outcome = played();
    assert_eq!(outcome["gait"], "policy.safetensors");
    assert_eq!(outcome, played());
    let run = "run --object cube70 --duration 0.2 --quiet --controller policy.safetensors --out out";
    workplace.run(run).good();
    assert!(workplace.path("out/summary.json").exists());
}

#[test]
fn a_policy_is_scored_evaluated_and_recorded() {
    let workplace = Workplace::new();
    write(&workplace, "25");
    let score = "hand score --json --object cube70 --scored-starts 2 --controller policy.safetensors";
    let outcome = workplace.run(score).json();
    assert!(outcome["controller"] == "policy.safetensors" && outcome["starts"] == 2, "{outcome}");
    let steps = workplace.run(&format!("{score} --steps 24")).error();
    assert!(steps.contains("leave --steps out"), "{steps}");

    let evaluate = "evaluate --objects cube70 --seeds 1 --modes pose --modalities tac --duration 0.3 --out tables \
                    --controller policy.safetensors";
    let lines = || workplace.text("tables/runs.jsonl");
    workplace.run(evaluate).good();
    let first = lines();
    workplace.run(evaluate).good();
    assert_eq!(lines(), first, "the run is not repeated");
    // Another policy of the same name is another run.
    write(&workplace, "50");
    workplace.run(evaluate).good();
    assert_eq!(lines().lines().count(), 2);

    workplace.run("generate --object cube70 --logs 1 --duration 0.2 --out set --controller policy.safetensors").good();
    let scene: Value = workplace.json("set/cube70/00/scene.json");
    assert!(scene["gait"] == "policy.safetensors" && scene["control_rate_hz"] == 50.0, "{scene}");
}

#[test]
fn the_torques_of_a_policy_that_presses_the_fingers_together_are_bounded() {
    let workplace = Workplace::new();
    write(&workplace, "25");
    // All joints aim at the ends of their ranges.
    let (weights, bias) = ([0_u8; 4 * 16 * 19], 50.0_f32.to_le_bytes().repeat(16));
    let tensors = [
        ("layers.0.weight", TensorView::new(Dtype::F32, vec![16, 19], &weights).unwrap()),
        ("layers.0.bias", TensorView::new(Dtype::F32, vec![16], &bias).unwrap()),
    ];
    workplace.write("policy.safetensors", serialize(tensors, None).unwrap());
    let said = workplace.run("controllers check policy.safetensors").good();
    let number = |before: &str| -> f64 {
        let rest = said.split(before).nth(1).and_then(|rest| rest.split_whitespace().next());
        rest.and_then(|number| number.parse().ok()).unwrap_or_else(|| panic!("{before}: {said}"))
    };
    let (strongest, limit) = (number("strongest torque "), number("at the limit of "));
    assert!(strongest <= limit + 1e-9 && strongest > 0.5 * limit, "{said}");
}

#[cfg(feature = "train")]
#[test]
fn a_trained_policy_is_a_controller() {
    let workplace = Workplace::new();
    // One block, far too short to learn anything.
    let train = "hand train --object cube70 --environments 4 --steps 1 --scored-starts 1 --out made.safetensors";
    let said = workplace.run(train).good();
    assert!(said.contains("cube70 with made.safetensors") && said.contains("controllers check"), "{said}");
    let curve = workplace.text("made.csv");
    assert!(curve.lines().count() == 2 && !workplace.path("made.safetensors.state").exists(), "{curve}");
    let checked = || workplace.run("controllers check made.safetensors").good();
    let said = checked();
    assert!(said.contains("joint_pos_target_unit") && said.contains("linear layers of 128, 64, 16"), "{said}");
    workplace.run(&format!("{train} --correct --overwrite")).good();
    let said = checked();
    assert!(said.contains("gait_target_unit") && said.contains("target of the gait"), "{said}");
    let refused =
        |arguments: &str| workplace.run(&format!("hand train --environments 2 --steps 1 {arguments}")).error();
    assert!(refused("--object cube70 --out made.safetensors").contains("already exists"));
    assert!(refused("--object cube70 --out made.onnx").contains("ends in .safetensors"));
    assert!(refused("--object random:1003 --out other.safetensors").contains("kept for results"));
}

#[test]
fn what_cannot_be_played_is_refused_in_one_line_and_leaves_nothing() {
    let workplace = Workplace::new();
    let refused = |rest: &str| {
        let said = workplace.run(&format!("run --object cube70 --quiet --out out {rest}")).error();
        assert!(said.lines().count() == 1 && !workplace.path("out").exists(), "{said}");
        said
    };
    assert!(refused("--controller nothing.safetensors").contains("nothing.safetensors"));
    write(&workplace, "35");
    assert!(refused("--controller policy.safetensors").contains("control_hz is 35"));
    write(&workplace, "25");
    let other = refused("--controller policy.safetensors --rig three_fingers");
    assert!(other.contains("joint_names") && other.contains("has no joint"), "{other}");
    let scheduled = refused("--controller policy.safetensors:4,tumble_back:4");
    assert!(scheduled.contains("part of a schedule"), "{scheduled}");
    assert!(refused("--controller policy.pt").contains("policy.pt"));
}
