//! Policies as safetensors files with a contract beside them, and the controller that plays them.

#![allow(clippy::unwrap_used, reason = "a failed assumption in a test is a failed test")]

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use mvt_gaits::controller::{Controller, Proprioception};
use mvt_gaits::controller_file::CORRECTED;
use mvt_gaits::directed::DirectedController;
use mvt_gaits::directive::Directive;
use mvt_gaits::gait::{self, Gait};
use mvt_policy::{Policy, PolicyContract, PolicyController, PolicyError};
use mvt_robot::hand::{Hand, Side};
use proptest::prelude::*;
use safetensors::tensor::{Dtype, TensorView};
use tempfile::TempDir;

type Tensors = BTreeMap<String, (Vec<usize>, Vec<f32>)>;

const CONTRACT: &str = r#"
joint_names = [NAMES]
joint_stiffness = 3.0
joint_damping = 0.1
default_joint_pos = [DEFAULTS]
action_scale = 0.5
observation_names = ["joint_pos", "actions"]
observation_terms_scale = 1.0
observation_terms_clip = [-inf, inf]
observation_terms_history_length = 0
control_hz = 25
activation = "tanh"
normaliser = "none"
"#;

fn hand() -> Arc<Hand> {
    Hand::allegro(Side::Left)
}

/// Returns the contract for the joints of the hand in an order of its own.
fn contract(order: &[usize]) -> String {
    let hand = hand();
    let joint = |j: &usize| &hand.joints()[*j];
    let names: Vec<String> = order.iter().map(|j| format!("{:?}", joint(j).name)).collect();
    let defaults: Vec<String> =
        order.iter().map(|j| format!("{:.4}", 0.5 * (joint(j).range[0] + joint(j).range[1]))).collect();
    CONTRACT.replace("NAMES", &names.join(", ")).replace("DEFAULTS", &defaults.join(", "))
}

/// A layer that gives the joint angles back, and a last one that turns them to zero: the hand is drawn to its default pose.
fn tensors() -> Tensors {
    let mut first = vec![0.0; 16 * 32];
    (0..16).for_each(|k| first[k * 32 + k] = 1.0);
    let mut last = vec![0.0; 16 * 16];
    (0..16).for_each(|k| last[k * 16 + k] = -0.1 * (k + 1) as f32);
    BTreeMap::from([
        ("layers.0.weight".to_owned(), (vec![16, 32], first)),
        ("layers.0.bias".to_owned(), (vec![16], vec![0.0; 16])),
        ("layers.1.weight".to_owned(), (vec![16, 16], last)),
        ("layers.1.bias".to_owned(), (vec![16], vec![0.0; 16])),
    ])
}

struct Files {
    _folder: TempDir,
    path: PathBuf,
}

fn write(tensors: &Tensors, contract: &str) -> Files {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("policy.safetensors");
    let bytes: BTreeMap<&String, Vec<u8>> = tensors
        .iter()
        .map(|(name, (_, numbers))| (name, numbers.iter().flat_map(|x| x.to_le_bytes()).collect()))
        .collect();
    let view = |(name, (shape, _)): (&String, &(Vec<usize>, Vec<f32>))| {
        (name.clone(), TensorView::new(Dtype::F32, shape.clone(), &bytes[name]).unwrap())
    };
    let views: Vec<_> = tensors.iter().map(view).collect();
    fs::write(&path, safetensors::serialize(views, None).unwrap()).unwrap();
    fs::write(path.with_extension("toml"), contract).unwrap();
    Files { _folder: folder, path }
}

fn read(tensors: &Tensors, contract: &str) -> Result<Arc<Policy>, PolicyError> {
    Policy::read(&write(tensors, contract).path, &hand())
}

fn refusal(change: impl FnOnce(&mut Tensors), contract: &str) -> String {
    let mut tensors = tensors();
    change(&mut tensors);
    let refused = read(&tensors, contract).unwrap_err().to_string();
    assert_eq!(refused.lines().count(), 1, "{refused}");
    refused
}

fn says(refused: &str, parts: &[&str]) {
    assert!(parts.iter().all(|part| refused.contains(part)), "{refused}");
}

/// The gait of a policy, with a torque limit of 0.5 Nm.
fn limited(policy: &Policy) -> Gait {
    Gait { torque_limit_nm: 0.5, ..policy.start(None, &hand()) }
}

fn in_order() -> Vec<usize> {
    (0..16).collect()
}

#[test]
fn joints_go_by_name_in_any_order() {
    let order: Vec<usize> = (0..16).map(|k| (5 * k + 3) % 16).collect();
    let measured: Vec<f64> =
        hand().joints().iter().map(|joint| joint.range[0] + 0.4 * (joint.range[1] - joint.range[0])).collect();
    let policy = read(&tensors(), &contract(&order)).unwrap();
    let mut controller = PolicyController::new(&policy, &hand(), &limited(&policy)).unwrap();
    let targets = controller.command(&Proprioception::at(0.0, measured.clone()));
    for (k, &j) in order.iter().enumerate() {
        let [low, high] = hand().joints()[j].range;
        let default = 0.5 * (low + high);
        let expected = default - 0.5 * 0.1 * (k + 1) as f64 * (measured[j] - default).tanh();
        let within_reach = expected.clamp(measured[j] - 0.5 / 3.0 - 0.05, measured[j] + 0.5 / 3.0 + 0.05);
        assert!((targets[j] - within_reach).abs() < 1e-4, "joint {j}: {} is not {within_reach}", targets[j]);
    }
    assert_eq!(controller.rate_hz(), 25);
}

#[test]
fn a_held_hand_rests_and_a_copy_continues_alike() {
    let policy = read(&tensors(), &contract(&in_order())).unwrap();
    let mut controller = PolicyController::new(&policy, &hand(), &limited(&policy)).unwrap();
    let at = |time_s: f64| Proprioception::at(time_s, vec![0.3; 16]);
    let first = controller.command(&at(0.0));
    controller.obey(&Directive::Hold).unwrap();
    assert_eq!(controller.command(&Proprioception::at(0.04, vec![0.3; 16])), first);
    controller.obey(&Directive::Continue).unwrap();
    let mut copy = controller.copy();
    assert_eq!(controller.command(&at(0.08)), copy.command(&at(0.08)));
}

#[test]
fn corrections_are_added_to_the_gait() {
    let contract = contract(&in_order()).replace("[\"joint_pos\", \"actions\"]", "[\"gait_target_unit\", \"actions\"]")
        + "action = \"correction\"\naction_clip = 1.0\nstart = \"suited\"\n";
    // The second joint is corrected by more than the clip, the first by half of it; the others are not.
    let mut tensors = tensors();
    tensors.get_mut("layers.1.weight").unwrap().1.fill(0.0);
    tensors.get_mut("layers.1.bias").unwrap().1[..2].copy_from_slice(&[0.1, -7.0]);
    let policy = read(&tensors, &contract).unwrap();
    let (_, gait) = gait::find("bal").unwrap();
    assert!(policy.corrects() && policy.start(Some(gait), &hand()) == *gait);
    let mut corrected = PolicyController::new(&policy, &hand(), gait).unwrap();
    let mut alone = DirectedController::new(gait, &hand());
    let mut joints = hand().mirrored(&gait.open_pose);
    for k in 0..100 {
        let sensed = Proprioception::at(f64::from(k) / 25.0, joints);
        let (with, without) = (corrected.command(&sensed), alone.command(&sensed));
        let reach = gait.torque_limit_nm / 3.0 + 0.05;
        for (j, correction) in [0.05, -0.5].into_iter().chain([0.0; 14]).enumerate() {
            let [low, high] = hand().joints()[j].range;
            let expected = (without[j] + correction).clamp(low, high);
            let expected = expected.clamp(sensed.joints[j] - reach, sensed.joints[j] + reach);
            assert!((with[j] - expected).abs() < 1e-7, "joint {j} at {k}: {} is not {expected}", with[j]);
        }
        joints = without;
    }

    let refused = |from: &str, to: &str| refusal(|_| (), &contract.replace(from, to));
    says(&refused("\"correction\"", "\"absolute\""), &["gait_target_unit", "correct a gait"]);
    says(&refused("control_hz = 25", "control_hz = 50"), &["control_hz is 50", "25"]);
    says(&refused("\"suited\"", "\"default\""), &["start", "leave them out"]);
    says(&refused("control_hz", "axis = \"+z\"\ncontrol_hz"), &["axis", "leave them out"]);
    says(&refused("\"correction\"", "\"correcting\""), &["absolute or incremental or correction"]);
}

#[test]
fn the_policy_that_the_program_carries_is_for_the_left_allegro() {
    let read = |hand: &Hand| Policy::read(Path::new(CORRECTED), hand);
    let policy = read(&hand()).unwrap();
    let mut expected = PolicyContract::correcting(&hand(), 25);
    expected.side = Some(Side::Left);
    assert_eq!(*policy.contract(), expected);
    says(&read(&Hand::allegro(Side::Right)).unwrap_err().to_string(), &["corrected: side", "other hand"]);
}

#[test]
fn a_gru_remembers_as_pytorch_computes_it() {
    let mut tensors = tensors();
    tensors.retain(|name, _| name.starts_with("layers.1"));
    let rename = |name: &str| name.replace("layers.1", "layers.0");
    let mut tensors: Tensors = tensors.into_iter().map(|(name, tensor)| (rename(&name), tensor)).collect();
    // All gates see only the state and their addends, so that one number follows from the formulas of torch.nn.GRU.
    tensors.insert("gru.weight_ih_l0".to_owned(), (vec![48, 32], vec![0.0; 48 * 32]));
    tensors.insert(
        "gru.weight_hh_l0".to_owned(),
        (vec![48, 16], (0..48 * 16).map(|k| if k / 16 % 16 == k % 16 { 0.5 } else { 0.0 }).collect()),
    );
    tensors.insert("gru.bias_ih_l0".to_owned(), (vec![48], vec![0.3; 48]));
    tensors.insert("gru.bias_hh_l0".to_owned(), (vec![48], vec![0.2; 48]));
    let policy = read(&tensors, &contract(&in_order())).unwrap();
    let mut state = policy.first_state();
    let mut h = 0.0_f64;
    for _ in 0..5 {
        let actions = policy.act(&[0.0; 32], &mut state).unwrap();
        let sigmoid = |x: f64| 1.0 / (1.0 + (-x).exp());
        let gate = sigmoid(0.3 + 0.5 * h + 0.2);
        let new = (0.3 + gate * (0.5 * h + 0.2)).tanh();
        h = (1.0 - gate) * new + gate * h;
        assert!((f64::from(actions[2]) + 0.3 * h).abs() < 1e-6, "{} and {h}", actions[2]);
    }
}

#[test]
fn what_does_not_fit_is_refused_with_its_field() {
    let fine = contract(&in_order());
    let without = |field: &str| fine.lines().filter(|line| !line.starts_with(field)).collect::<Vec<_>>().join("\n");
    for field in
        ["joint_names", "joint_stiffness", "default_joint_pos", "action_scale", "observation_names", "control_hz"]
    {
        says(&refusal(|_| (), &without(field)), &[field, "missing"]);
    }
    says(&refusal(|_| (), &without("activation")), &["activation", "missing"]);
    says(&refusal(|_| (), &without("normaliser")), &["normaliser", "none"]);
    says(&refusal(|_| (), &fine.replace("\"tanh\"", "\"swish\"")), &["activation", "swish"]);
    says(&refusal(|_| (), &fine.replace("control_hz = 25", "control_hz = 70")), &["control_hz is 70"]);
    says(&refusal(|_| (), &fine.replace("length = 0", "length = 2.5")), &["observation_terms_history_length", "2.5"]);
    says(&refusal(|_| (), &fine.replace("length = 0", "length = 2")), &["observation_names", "64", "32"]);
    says(&refusal(|_| (), &fine.replace("[-inf, inf]", "[1, -1]")), &["observation_terms_clip"]);
    says(&refusal(|_| (), &fine.replace("stiffness = 3.0", "stiffness = -3.0")), &["joint_stiffness"]);
    says(&refusal(|_| (), &fine.replace("stiffness = 3.0", "stiffness = nan")), &["joint_stiffness"]);
    says(&refusal(|t| drop(t.remove("layers.0.bias")), &fine), &["layers.0.bias", "missing"]);
    says(&refusal(|t| t.get_mut("layers.1.weight").unwrap().1[3] = f32::NAN, &fine), &["layers.1.weight", "NaN"]);
    let wide = |t: &mut Tensors| {
        t.insert("layers.1.weight".to_owned(), (vec![17, 16], vec![0.0; 17 * 16]));
        t.insert("layers.1.bias".to_owned(), (vec![17], vec![0.0; 17]));
    };
    says(&refusal(wide, &fine), &["joint_names", "16 joints", "17 actions"]);
    let narrow = |t: &mut Tensors| drop(t.insert("layers.1.weight".to_owned(), (vec![16, 15], vec![0.0; 240])));
    says(&refusal(narrow, &fine), &["layers.1.weight", "15", "16"]);
    says(&refusal(|t| drop(t.insert("critic.weight".to_owned(), (vec![1], vec![0.0]))), &fine), &["critic.weight"]);
    let huge = |t: &mut Tensors| t.get_mut("layers.1.bias").unwrap().1[0] = 1e9;
    says(&refusal(huge, &fine), &["1000000000", "within 100"]);
}

/// An action that no sound policy gives ends the control with a reason; the fingers stay.
#[test]
fn a_policy_that_runs_away_is_stopped() {
    let mut tensors = tensors();
    tensors.get_mut("layers.1.weight").unwrap().1[0] = 1e9;
    let policy = read(&tensors, &contract(&in_order())).unwrap();
    let mut controller = PolicyController::new(&policy, &hand(), &limited(&policy)).unwrap();
    let measured = vec![0.35; 16];
    let targets = controller.command(&Proprioception::at(0.0, measured.clone()));
    assert!(targets.iter().zip(&measured).all(|(target, measured)| (target - measured).abs() < 0.3));
    says(&controller.fault().unwrap(), &["the policy gave the action", "within 100"]);
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn damaged_files_are_refused_in_one_line(at in 0_usize..4000, byte in any::<u8>(), in_contract in any::<bool>()) {
        let files = write(&tensors(), &contract(&in_order()));
        let path = if in_contract { files.path.with_extension("toml") } else { files.path.clone() };
        let mut bytes = fs::read(&path).unwrap();
        let at = at % bytes.len();
        bytes[at] = byte;
        fs::write(&path, bytes).unwrap();
        if let Err(error) = Policy::read(&files.path, &hand()) {
            prop_assert_eq!(error.to_string().lines().count(), 1);
        }
    }
}
