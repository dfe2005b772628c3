//! Learnt policies: checked, played, and refused before an episode starts.

use mvt_robot::hand::{Hand, Side};
use safetensors::serialize;
use safetensors::tensor::{Dtype, TensorView};
use serde_json::Value;

use crate::workplace::Workplace;

/// A policy that holds the middle of the joints' ranges, at a rate.
fn write(workplace: &Workplace, control_hz: &str) {
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
        || workplace.run("simulate --json --object cube70 --duration 2 --controller policy.safetensors").good();
    let outcome: Value = serde_json::from_str(&played()).unwrap();
    assert_eq!(outcome["gait"], "policy.safetensors");
    assert_eq!(outcome, serde_json::from_str::<Value>(&played()).unwrap());
    let run = "run --object cube70 --duration 0.2 --quiet --controller policy.safetensors --out out";
    workplace.run(run).good();
    assert!(workplace.path("out/summary.json").exists());
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
