//! `simulate`, and the use of standard output.

use std::io::pipe;
use std::process::Stdio;

use serde_json::Value;

use crate::workplace::{Ended, Workplace};

fn outcome(arguments: &str) -> Value {
    let text = Workplace::new().run(&format!("simulate --json {arguments}")).good();
    assert_eq!(text.lines().count(), 1, "{text}");
    serde_json::from_str(&text).unwrap()
}

#[test]
fn one_json_object_contains_the_outcome() {
    let outcome = outcome("--object cube70 --duration 2 --seed 3");
    for (field, low, high) in [
        ("survived_s", 2.0, 2.0),
        ("turned_rad", 0.5, 4.0),
        ("turn_rate_rad_s", 0.25, 2.0),
        ("any_contact_fraction", 0.3, 1.0),
        ("mean_pads_in_contact", 0.5, 4.0),
        ("penetration_mm", 0.0, 3.0),
        ("tilt_deg", 0.0, 45.0),
    ] {
        let value = outcome[field].as_f64().unwrap_or(f64::NAN);
        assert!((low..=high).contains(&value), "{field} is {value}");
    }
    let pads: Vec<f64> = outcome["per_pad_contact"].as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect();
    assert!(pads.len() == 4 && pads.iter().all(|fraction| (0.0..=1.0).contains(fraction)), "{pads:?}");
    let mean = outcome["mean_pads_in_contact"].as_f64().unwrap();
    assert!((pads.iter().sum::<f64>() - mean).abs() < 1e-9, "{pads:?} are {mean} on average");
    let rate = outcome["turned_rad"].as_f64().unwrap() / 2.0;
    assert!((outcome["turn_rate_rad_s"].as_f64().unwrap() - rate).abs() < 1e-9);
}

#[test]
fn the_seed_decides_everything() {
    let workplace = Workplace::new();
    let run = |seed: u32, threads: &str| {
        let line = format!("simulate --json --object rubiks_cube_small --duration 2 --seed {seed}");
        Ended::of(workplace.command(&line).env("RAYON_NUM_THREADS", threads)).good()
    };
    let first = run(7, "1");
    assert_eq!(first, run(7, "1"));
    assert_eq!(first, run(7, "2"));
    assert_eq!(first, run(7, "5"));
    assert_ne!(first, run(8, "1"));
}

#[test]
fn left_and_right_are_alike() {
    let mean = |side: &str, field: &str| {
        let runs = (0..6).map(|seed| outcome(&format!("--object cube70 --duration 4 --seed {seed} --side {side}")));
        runs.map(|run| run[field].as_f64().unwrap()).sum::<f64>() / 6.0
    };
    for (field, tolerance) in
        [("survived_s", 0.2), ("turned_rad", 0.5), ("any_contact_fraction", 0.1), ("mean_pads_in_contact", 0.3)]
    {
        let (left, right) = (mean("left", field), mean("right", field));
        assert!((left - right).abs() <= tolerance, "{field}: left {left}, right {right}");
    }
}

#[test]
fn wrong_arguments_are_explained() {
    let workplace = Workplace::new();
    assert!(workplace.run("simulate --object cub").error().contains("cube70"));
    assert!(workplace.run("simulate --object cube70 --gait walk").error().contains("walk"));
    for wrong in ["--seed -1", "--seed x", "--duration 0", "--duration inf", "--side both"] {
        workplace.run(&format!("simulate --object cube70 {wrong}")).usage();
    }
    workplace.run("simulate").usage();
    workplace.run("dance").usage();
}

#[test]
fn a_closed_standard_output_is_not_an_error() {
    let workplace = Workplace::new();
    for arguments in ["assets list", "simulate --object cube70 --duration 0.2", "--help"] {
        let (reader, writer) = pipe().unwrap();
        drop(reader);
        let output = workplace.command(arguments).stdout(writer).stderr(Stdio::piped()).output().unwrap();
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success() && said.is_empty(), "{arguments}: {:?} {said}", output.status);
    }
    // An error whose message cannot be written still sets the exit code.
    let (reader, writer) = pipe().unwrap();
    drop(reader);
    let status = workplace.command("simulate --object nothing").stderr(writer).status().unwrap();
    assert_eq!(status.code(), Some(1));
}

#[test]
fn every_object_is_listed() {
    let list = Workplace::new().run("assets list").good();
    assert!(list.lines().filter(|line| line.contains("YCB")).count() == 78, "{list}");
    assert!(list.lines().filter(|line| line.ends_with("procedural")).count() >= 8, "{list}");
    assert!(list.lines().any(|line| line.starts_with("random:SEED")), "{list}");
}
