//! The same weights move the hand alike in an environment and in an episode, to the bit.

#![allow(clippy::unwrap_used, reason = "a failed assumption in a test is a failed test")]

use std::fs;
use std::path::Path;
use std::sync::Arc;

use mvt_environment::{Environments, Readings, Scene, Sense, TurnSettings};
use mvt_gaits::controller::Controller;
use mvt_gaits::controller_file::CORRECTED;
use mvt_gaits::directed::DirectedController;
use mvt_physics::air::PlaceErrors;
use mvt_physics::episode::{End, Episode, EpisodeConfig, Randomisation};
use mvt_policy::{MadePolicy, Policy, PolicyContract, PolicyLayer};
use mvt_robot::hand::Hand;
use mvt_run::controller::choose_controller;
use mvt_run::object::load_object;
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

/// Writes a policy of one layer with random weights.
fn write(path: &Path, contract: &PolicyContract, hand: &Hand) {
    let inputs = contract.observation_size(hand);
    let mut random = ChaCha8Rng::seed_from_u64(5);
    let mut numbers = |count: usize| -> Vec<f32> { (0..count).map(|_| random.random_range(-0.03..0.03)).collect() };
    let layer = PolicyLayer { inputs, weight: numbers(16 * inputs), bias: numbers(16) };
    let (mean, std) = (vec![0.0; inputs], vec![1.0; inputs]);
    let (weights, fields) = MadePolicy { mean, std, clip: 5.0, layers: vec![layer] }.files(contract).unwrap();
    fs::write(path, weights).unwrap();
    fs::write(path.with_extension("toml"), fields).unwrap();
}

#[test]
fn environment_and_run_give_the_same_torques_to_the_bit() {
    let hand = TurnSettings::default().hand;
    compare(Sense::Proprioception, &PolicyContract::turning(&hand, 25));
    compare(Sense::Sighted, &PolicyContract::sighted(&hand, 25));
    compare(Sense::Guided, &PolicyContract::correcting(&hand, 25));
}

fn compare(sense: Sense, contract: &PolicyContract) {
    const SEED: u64 = 7;
    const STEPS: usize = 100;
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("policy.safetensors");
    let settings = TurnSettings { senses: vec![sense], ..TurnSettings::default() };
    let hand = Arc::clone(&settings.hand);
    write(&path, contract, &hand);
    let policy = Policy::read(&path, &hand).unwrap();
    let object = || mvt_objects::catalogue::load("cube70", &mut Vec::new()).unwrap();

    let mut environments =
        Environments::new(Arc::new(Scene::new(object(), settings.clone()).unwrap()), 1, false).unwrap();
    let mut readings = environments.reset(&[SEED]).unwrap();
    let mut state = policy.first_state();
    let mut of_environment = Vec::new();
    for _ in 0..STEPS {
        let Some(Readings::Numbers(observation)) = readings.first() else { unreachable!("they are numbers") };
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
    episode.rehearse(PlaceErrors::default(), SEED);
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

/// Its gait alone turns this shape, which is not among those of the training, by 3.0 rad in 10 s.
#[test]
fn the_policy_that_the_program_carries_turns_a_shape_that_it_never_met() {
    let hand = TurnSettings::default().hand;
    let object = load_object("random:204").unwrap();
    let chosen = choose_controller(CORRECTED, &object, &hand).unwrap();
    let gait: Box<dyn Controller> = Box::new(DirectedController::new(&chosen.gait, &hand));
    let [alone, corrected] = [gait, chosen.mover.unwrap()].map(|mover| {
        let (gait, randomisation) = (chosen.gait.clone(), Randomisation::default());
        let config = EpisodeConfig { hand: Arc::clone(&hand), gait, seed: 3, duration_s: 10.0, randomisation };
        let mut episode = Episode::moved_by(&object, &config, mover).unwrap();
        episode.rehearse(PlaceErrors::default(), 3);
        while episode.end().is_none() {
            episode.advance(12, None);
        }
        assert_eq!(episode.end(), Some(&End::Completed));
        episode.turned_rad()
    });
    assert!(corrected > 2.0 * alone && corrected > 8.0, "{corrected} and {alone} rad");
}
