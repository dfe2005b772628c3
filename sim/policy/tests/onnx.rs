//! Policies as ONNX files, compared with ONNX Runtime; and files that are refused.
//!
//! data/ was made by `oracle.py data 40 12`: networks, observations, and the actions of ONNX Runtime.

#![cfg(feature = "onnx")]
#![allow(clippy::unwrap_used, clippy::print_stdout, reason = "a failed assumption in a test is a failed test")]

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Arc;

use mvt_policy::{Policy, PolicyError};
use mvt_robot::hand::{Hand, Side};

/// Says that a test is skipped, and fails where every test must run. Written past the test harness, which hides what passing tests say.
fn skip(reason: impl std::fmt::Display) {
    use std::io::Write as _;
    let _ = writeln!(std::io::stderr(), "SKIPPED: {reason}");
    assert!(
        std::env::var_os("REQUIRE_ALL").is_none_or(|value| value != "1"),
        "REQUIRE_ALL=1 allows no skipped test: {reason}"
    );
}

fn data() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data")
}

fn read(path: &Path) -> Result<Arc<Policy>, PolicyError> {
    Policy::read(path, &Hand::allegro(Side::Left))
}

fn floats(path: &Path) -> Vec<f32> {
    fs::read(path).unwrap().chunks_exact(4).map(|bytes| f32::from_le_bytes(bytes.try_into().unwrap())).collect()
}

/// Returns the greatest difference between our actions and those of ONNX Runtime, and the number of steps.
fn difference(folder: &Path, name: &str) -> (f32, usize) {
    let policy = read(&folder.join(format!("{name}.onnx"))).unwrap();
    let observations = floats(&folder.join(format!("{name}.observations")));
    let expected = floats(&folder.join(format!("{name}.actions")));
    let size = policy.contract().observation_size(&Hand::allegro(Side::Left));
    let mut state = policy.first_state();
    let actions: Vec<f32> =
        observations.chunks_exact(size).flat_map(|observation| policy.act(observation, &mut state).unwrap()).collect();
    assert_eq!(actions.len(), expected.len());
    assert!(actions.iter().any(|action| action.abs() > 0.1), "{name} does something");
    let off = actions.iter().zip(&expected).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    (off, actions.len() / 16)
}

#[test]
fn stored_policies_act_as_in_onnx_runtime() {
    for name in ["mlp", "gru"] {
        let (off, steps) = difference(&data(), name);
        assert!(off < 1e-5 && steps == 40, "{name}: {off} over {steps} steps");
    }
}

#[test]
fn fresh_policies_act_as_in_onnx_runtime_over_a_thousand_steps() {
    let folder = tempfile::tempdir().unwrap();
    let script = data().with_file_name("oracle.py");
    let output = Command::new("python3").arg(script).arg(folder.path()).args(["1000", "128"]).output();
    match output {
        Ok(output) if output.status.success() => (),
        Ok(output) => {
            let said = String::from_utf8_lossy(&output.stderr);
            assert!(said.contains("No module named"), "{said}");
            return skip(format!("no ONNX Runtime: {}", said.lines().last().unwrap_or_default()));
        }
        Err(error) => return skip(format!("no Python: {error}")),
    }
    for name in ["mlp", "gru"] {
        let (off, steps) = difference(folder.path(), name);
        println!("{name}: greatest difference {off:e} over {steps} steps");
        assert!(off < 1e-5 && steps == 1000, "{name}: {off} over {steps} steps");
    }
}

#[test]
fn metadata_of_mjlab_are_the_contract() {
    let policy = read(&data().join("mlp.onnx")).unwrap();
    let contract = policy.contract();
    assert_eq!(contract.joint_names[..2], ["thumb_0", "thumb_1"]);
    assert_eq!((contract.control_hz, contract.action_scale[15]), (25, 0.3));
    let [velocity, angle] = [1, 0].map(|k| &contract.observation[k]);
    assert_eq!((velocity.scale.as_slice(), velocity.clip, velocity.history), (&[0.2][..], [-10.0, 10.0], 1));
    assert_eq!((angle.history, angle.clip), (3, [f64::NEG_INFINITY, f64::INFINITY]));
    assert!(!contract.newest_first && policy.notes().is_empty());
    assert_eq!(read(&data().join("gru.onnx")).unwrap().first_state(), [vec![0.0; 12]]);
}

/// Copies a stored policy with changed bytes and a file beside it, and returns why it is refused.
fn refusal(name: &str, change: impl FnOnce(&mut Vec<u8>), beside: Option<&str>) -> String {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("policy.onnx");
    let mut bytes = fs::read(data().join(format!("{name}.onnx"))).unwrap();
    change(&mut bytes);
    fs::write(&path, bytes).unwrap();
    if let Some(text) = beside {
        fs::write(path.with_extension("toml"), text).unwrap();
    }
    let refused = read(&path).unwrap_err().to_string();
    assert_eq!(refused.lines().count(), 1, "{refused}");
    refused
}

/// Replaces a text by one of the same length.
fn replace(bytes: &mut [u8], from: &str, to: &str) {
    assert_eq!(from.len(), to.len());
    let at = bytes.windows(from.len()).position(|window| window == from.as_bytes()).unwrap();
    bytes[at..at + from.len()].copy_from_slice(to.as_bytes());
}

fn says(refused: &str, parts: &[&str]) {
    assert!(parts.iter().all(|part| refused.contains(part)), "{refused}");
}

#[test]
fn what_does_not_fit_is_refused_with_its_field() {
    let changed = |from: &'static str, to: &'static str| refusal("mlp", move |bytes| replace(bytes, from, to), None);
    says(&changed("control_hz", "control_hx"), &["control_hz", "missing"]);
    says(&changed("joint_damping", "joint_dumping"), &["joint_damping", "missing"]);
    says(&changed("thumb_0,thumb_1", "thumb_0,thumb_9"), &["joint_names", "no joint \"thumb_9\""]);
    says(&changed("thumb_0,thumb_1", "thumb_0,thumb_0"), &["joint_names", "twice"]);
    says(&changed("joint_vel", "joint_vex"), &["observation_names", "joint_vex"]);
    says(&changed("projected_gravity", "object_confidence"), &["observation_names", "86", "84"]);
    says(
        &changed("3.000,0.000,0.000,0.000,0.000", "2.000,0.000,0.000,0.000,0.000"),
        &["observation_names", "86", "70"],
    );
    says(&changed("3.000,3.000,3.000,", "3.000,3.000 3.000,"), &["joint_stiffness"]);
    says(&changed("0.100,0.100,0.100,", "0.100,0.100;0.1000"), &["joint_damping"]);
    says(&changed("0.900,", "9.900,"), &["default_joint_pos", "thumb_0"]);
    says(&changed("Elu", "Foo"), &["operator Foo"]);
    says(&changed("Gemm", "Loop"), &["operator Loop"]);
    let rate = |hz: &str| {
        refusal("mlp", |bytes| replace(bytes, "control_hz", "control_hx"), Some(&format!("control_hz = {hz}")))
    };
    says(&rate("40"), &["control_hz is 40", "divisor"]);
    says(&rate("12.5"), &["control_hz is 12.5"]);
    says(&refusal("mlp", |_| (), Some("control_hz = 50")), &["control_hz", "another value"]);
    says(&refusal("mlp", |_| (), Some("hand = \"leap\"")), &["hand", "leap"]);
    says(&refusal("mlp", |_| (), Some("side = \"right\"")), &["side", "other hand"]);
    says(&refusal("mlp", |_| (), Some("contol_hz = 25")), &["policy.toml", "contol_hz"]);
    let bad = f32::NAN.to_le_bytes();
    let spoil = |value: [u8; 4]| {
        move |bytes: &mut Vec<u8>| {
            // A weight of the last layer, whose name follows its numbers or stands before them.
            let at = bytes.windows(2).position(|window| window == b"w2").unwrap();
            let raw = bytes.len() - at;
            assert!(raw > 400);
            for k in 0..12 {
                let to = at + 12 + 4 * k;
                bytes[to..to + 4].copy_from_slice(&value);
            }
        }
    };
    let refused = refusal("mlp", spoil(bad), None);
    assert!(refused.contains("not finite") || refused.contains("damaged"), "{refused}");
    says(&refusal("mlp", |bytes| bytes.truncate(700), None), &["damaged"]);
    says(&refusal("mlp", |bytes| *bytes = b"\x80\x04pickle".to_vec(), None), &["policy.onnx"]);
}

#[test]
fn exact_numbers_beside_the_file_replace_rounded_ones() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("policy.onnx");
    fs::copy(data().join("mlp.onnx"), &path).unwrap();
    fs::write(path.with_extension("toml"), "action_scale = 0.3003").unwrap();
    assert_eq!(read(&path).unwrap().contract().action_scale, [0.3003; 16]);
}

#[test]
fn files_that_hold_code_or_are_too_large_are_not_opened() {
    let folder = tempfile::tempdir().unwrap();
    let written = |name: &str, length: u64| {
        let path = folder.path().join(name);
        fs::File::create(&path).unwrap().set_len(length).unwrap();
        read(&path).unwrap_err().to_string()
    };
    says(&written("policy.pth", 10), &["pickle", "not opened"]);
    says(&written("large.onnx", 1 << 30), &["large.onnx"]);
    says(&written("large.safetensors", 1 << 30), &["large.safetensors"]);
}

/// Damaged files are refused or read, and never end the process.
#[test]
fn mutated_files_do_no_harm() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("policy.onnx");
    let mut random = 0x9e37_79b9_7f4a_7c15_u64;
    let mut next = move |below: usize| {
        random ^= random << 13;
        random ^= random >> 7;
        random ^= random << 17;
        (random % below as u64) as usize
    };
    let (mut read_ones, mut refused) = (0, 0);
    for name in ["mlp", "gru"] {
        let original = fs::read(data().join(format!("{name}.onnx"))).unwrap();
        for _ in 0..300 {
            let mut bytes = original.clone();
            for _ in 0..=next(3) {
                let at = next(bytes.len());
                match next(3) {
                    0 => bytes[at] = next(256) as u8,
                    1 => bytes[at] ^= 1 << next(8),
                    _ => drop(bytes.splice(at..(at + next(9)).min(bytes.len()), (0..next(9)).map(|k| k as u8 * 31))),
                }
            }
            fs::write(&path, &bytes).unwrap();
            match read(&path) {
                Ok(_) => read_ones += 1,
                Err(error) => {
                    assert_eq!(error.to_string().lines().count(), 1, "{error}");
                    refused += 1;
                }
            }
        }
    }
    assert!(read_ones > 10 && refused > 10, "{read_ones} and {refused}");
}
