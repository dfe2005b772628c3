//! The same weights move the hand alike in an environment and in an episode, to the bit.

#![allow(clippy::unwrap_used, reason = "a failed assumption in a test is a failed test")]

use std::fs;
use std::path::Path;
use std::sync::Arc;

use mvt_environment::{Environments, Readings, Scene, TurnSettings};
use mvt_physics::episode::{Episode, EpisodeConfig};
use mvt_policy::{Policy, PolicyContract};
use mvt_robot::hand::Hand;
use mvt_run::controller::choose_controller;
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use safetensors::tensor::{Dtype, TensorView};

/// Writes a policy of one layer with random weights for the contract of the environments.
fn write(path: &Path, hand: &Hand) {
    let contract = PolicyContract::turning(hand, 25);
    let inputs = contract.observation_size(hand);
    let mut random = ChaCha8Rng::seed_from_u64(5);
    let mut numbers = |count: usize| -> Vec<u8> {
        (0..count).flat_map(|_| random.random_range(-0.03_f32..0.03).to_le_bytes()).collect()
    };
    let (weight, bias) = (numbers(16 * inputs), numbers(16));
    let tensors = [
        ("layers.0.weight", TensorView::new(Dtype::F32, vec![16, inputs], &weight).unwrap()),
        ("layers.0.bias", TensorView::new(Dtype::F32, vec![16], &bias).unwrap()),
    ];
    fs::write(path, safetensors::serialize(tensors, None).unwrap()).unwrap();
    let text = format!(
        "joint_names = {:?}\njoint_stiffness = {:?}\njoint_damping = {:?}\ndefault_joint_pos = {:?}\naction_scale = {:?}\n\
         observation_names = [\"joint_pos_target_unit\"]\nobservation_terms_scale = 1.0\nobservation_terms_clip = [-1.0, 1.0]\n\
         observation_terms_history_length = 3\nhistory_order = \"newest_first\"\naction = \"incremental\"\naction_clip = 1.0\n\
         control_hz = 25\nstart = \"suited\"\nactivation = \"elu\"\nnormaliser = \"none\"\n",
        contract.joint_names,
        contract.joint_stiffness,
        contract.joint_damping,
        contract.default_joint_pos,
        contract.action_scale,
    );
    fs::write(path.with_extension("toml"), text).unwrap();
}

#[test]
fn environment_and_run_give_the_same_torques_to_the_bit() {
    const SEED: u64 = 7;
    const STEPS: usize = 100;
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("policy.safetensors");
    let settings = TurnSettings::default();
    let hand = Arc::clone(&settings.hand);
    write(&path, &hand);
    let policy = Policy::read(&path, &hand).unwrap();
    let object = || mvt_objects::catalogue::load("cube70", &mut Vec::new()).unwrap();

    let mut environments =
        Environments::new(Arc::new(Scene::new(object(), settings.clone()).unwrap()), 1, false).unwrap();
    let mut readings = environments.reset(&[SEED]).unwrap();
    let mut state = policy.first_state();
    let mut of_environment = Vec::new();
    for _ in 0..STEPS {
        let Some(Readings::Numbers(observation)) = readings.first() else { unreachable!("proprioception is numbers") };
        let action = policy.act(observation, &mut state).unwrap();
        let outcome = environments.step(&action).unwrap();
        of_environment.push((outcome.rewards[0].torque.to_bits(), outcome.progress[0][1].to_bits()));
        readings = outcome.observations;
    }

    let chosen = choose_controller(path.to_str().unwrap(), &object(), &hand).unwrap();
    let config = EpisodeConfig {
        hand,
        gait: chosen.gait,
        seed: SEED,
        duration_s: settings.duration_s,
        randomisation: settings.randomisation,
    };
    let mut episode = Episode::moved_by(&object(), &config, chosen.mover.unwrap()).unwrap();
    for (step, (torque, turned)) in of_environment.into_iter().enumerate() {
        episode.advance(12, None);
        // The same sum as in the reward.
        let torques = episode.simulation().joint_torques();
        let penalty = -0.1 * torques.iter().map(|torque| torque.powi(2)).filter(|x| x.is_finite()).sum::<f64>();
        assert_eq!((penalty.to_bits(), episode.turned_rad().to_bits()), (torque, turned), "step {step}");
    }
    assert!(
        episode.turned_rad() != 0.0 && episode.end().is_none(),
        "the object stays in the hand: {:?}",
        episode.end()
    );
}
