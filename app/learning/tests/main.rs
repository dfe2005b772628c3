//! Tests of the crate as others use it.

#![allow(clippy::unwrap_used, reason = "a failed assumption in a test is a failed test")]

use std::fs;
use std::sync::Arc;

use mvt_environment::Scene;
use mvt_learning::{Curriculum, LearningConfig, LearningError, PolicyTraining, in_sizes, training_settings};
use mvt_policy::Policy;
use mvt_robot::hand::{Hand, Side};

fn scenes() -> Vec<Arc<Scene>> {
    let cube = mvt_objects::catalogue::load("cube70", &mut Vec::new()).unwrap();
    let settings = training_settings(&Hand::allegro(Side::Left), false);
    let scene = |object| Arc::new(Scene::new(object, settings.clone()).unwrap());
    in_sizes(&cube, 2, 0.05).into_iter().map(scene).collect()
}

fn small() -> LearningConfig {
    LearningConfig {
        environments: 6,
        steps: 8,
        block: 2,
        passes: 2,
        minibatch: 20,
        hidden: vec![8],
        ..LearningConfig::default()
    }
}

fn trained(updates: u64, threads: usize) -> PolicyTraining {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
    pool.install(|| {
        let mut training = PolicyTraining::new(scenes(), small(), 5).unwrap();
        (0..updates).for_each(|_| training.advance().unwrap());
        training
    })
}

#[test]
fn the_number_of_threads_and_interruptions_change_nothing() {
    let whole = trained(4, 3);
    let first = trained(2, 1);
    let state = first.state("cubes").unwrap().unwrap();
    let mut resumed = PolicyTraining::resume(scenes(), small(), 5, "cubes", &state).unwrap();
    assert!(resumed.state("cubes").unwrap() == Some(state.clone()));
    (0..2).for_each(|_| resumed.advance().unwrap());
    assert_eq!(resumed.curve(), whole.curve());
    assert!(resumed.state("cubes").unwrap() == whole.state("cubes").unwrap());
    assert!(resumed.policy_files().unwrap() == whole.policy_files().unwrap());
    assert!(trained(3, 1).state("cubes").unwrap().is_none(), "inside a block");

    let refused = |names: &str, seed, bytes: &[u8]| match PolicyTraining::resume(scenes(), small(), seed, names, bytes)
    {
        Err(LearningError::State(reason)) => reason,
        _ => String::new(),
    };
    assert!(refused("balls", 5, &state).contains("other objects"));
    assert!(refused("cubes", 6, &state).contains("other objects"));
    assert!(!refused("cubes", 5, &state[..state.len() / 2]).is_empty());
    let mut damaged = state;
    let last = damaged.len() - 4;
    damaged[last..].fill(0xff);
    assert!(!refused("cubes", 5, &damaged).is_empty());
}

#[test]
fn later_scenes_join_when_the_first_are_learnt() {
    let [first, later] = [0, 1].map(|k| vec![scenes().swap_remove(k)]);
    let config = |later_rad_s| LearningConfig { later_rad_s, later_falls_per_minute: 1000.0, ..small() };
    let begun = |config| PolicyTraining::new(Curriculum { first: first.clone(), later: later.clone() }, config, 5);
    let curve = |mut training: PolicyTraining| {
        (0..6).for_each(|_| training.advance().unwrap());
        training.curve().to_vec()
    };
    let alone = curve(PolicyTraining::new(first.clone(), config(0.0), 5).unwrap());
    // No rate is reached, or each is.
    assert_eq!(curve(begun(config(10.0)).unwrap()), alone);
    let joined = curve(begun(config(-10.0)).unwrap());
    assert_eq!(joined[0], alone[0]);
    assert!(joined[1] != alone[1] && joined[2] != alone[2]);

    let mut training = begun(config(-10.0)).unwrap();
    (0..2).for_each(|_| training.advance().unwrap());
    let state = training.state("cubes").unwrap().unwrap();
    let curriculum = Curriculum { first: first.clone(), later: later.clone() };
    let mut resumed = PolicyTraining::resume(curriculum, config(-10.0), 5, "cubes", &state).unwrap();
    (0..4).for_each(|_| resumed.advance().unwrap());
    assert_eq!(resumed.curve(), joined);
}

#[test]
fn the_files_are_those_of_a_policy() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("policy.safetensors");
    let (weights, contract) = trained(2, 2).policy_files().unwrap();
    fs::write(&path, weights).unwrap();
    fs::write(path.with_extension("toml"), contract).unwrap();
    let policy = Policy::read(&path, &Hand::allegro(Side::Left)).unwrap();
    let action = policy.act(&[0.1; 96], &mut policy.first_state()).unwrap();
    assert!(action.len() == 16 && action.iter().all(|action| action.abs() < 0.5), "{action:?}");
    let other = Policy::read(&path, &Hand::allegro(Side::Right)).unwrap_err().to_string();
    assert!(other.contains("other hand"), "{other}");
}

#[test]
fn settings_out_of_range_are_refused() {
    let config = LearningConfig { minibatch: 0, ..small() };
    let error = PolicyTraining::new(scenes(), config, 0).err().unwrap().to_string();
    assert!(error.contains("minibatch"), "{error}");
}
