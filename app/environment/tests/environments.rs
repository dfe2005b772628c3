//! Environments: autoreset, seeds, observations, threads, and settings that are refused.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a failed assumption in a test is a failed test")]

use std::sync::Arc;

use mvt_environment::{Environments, Readings, Reward, Scene, Sense, StepOutcome, TurnSettings};
use mvt_objects::catalogue;

fn scene(senses: &[Sense], change: impl FnOnce(&mut TurnSettings)) -> Result<Scene, mvt_environment::TaskError> {
    let mut settings = TurnSettings { senses: senses.to_vec(), duration_s: 0.4, ..TurnSettings::default() };
    change(&mut settings);
    Scene::new(catalogue::load("cube70", &mut Vec::new()).unwrap(), settings)
}

fn environments(senses: &[Sense], count: usize) -> Environments {
    Environments::new(Arc::new(scene(senses, |_| ()).unwrap()), count, true).unwrap()
}

/// Actions that move all joints to and fro.
fn actions(step: usize, count: usize) -> Vec<f32> {
    (0..16 * count).map(|k| ((step + k) as f32 * 0.7).sin()).collect()
}

#[test]
fn an_environment_does_not_depend_on_the_others() {
    let play = |seeds: &[u64]| {
        let mut environments = environments(&[Sense::Privileged, Sense::Proprioception], seeds.len());
        let first = environments.reset(seeds).unwrap();
        let own = |step| actions(step, 1).repeat(seeds.len());
        (first, (0..14).map(|step| environments.step(&own(step)).unwrap()).collect::<Vec<_>>())
    };
    let of_last = |readings: &Readings, count: usize| match readings {
        Readings::Numbers(values) => values[values.len() / count * (count - 1)..].to_vec(),
        Readings::Bytes(_) => panic!("numbers were expected"),
    };
    let ((first, alone), (firsts, together)) = (play(&[9]), play(&[3, 4, 9]));
    assert_eq!(of_last(&first[0], 1), of_last(&firsts[0], 3));
    for (a, b) in alone.iter().zip(&together) {
        for (x, y) in a.observations.iter().zip(&b.observations) {
            assert_eq!(of_last(x, 1), of_last(y, 3));
        }
        assert_eq!(a.rewards[0], b.rewards[2]);
    }
    assert_ne!(of_last(&firsts[0], 3), of_last(&firsts[0], 1)[..25], "seeds differ");
}

#[test]
fn the_step_after_the_end_begins_an_episode() {
    let mut environments = environments(&[Sense::Proprioception], 2);
    environments.reset(&[1, 2]).unwrap();
    let outcomes: Vec<StepOutcome> = (0..12).map(|step| environments.step(&actions(step, 2)).unwrap()).collect();
    let truncated: Vec<bool> = outcomes.iter().map(|outcome| outcome.truncated[0]).collect();
    // 0.4 s are ten steps; the eleventh resets.
    assert_eq!(truncated.iter().position(|&is| is), Some(9));
    assert_eq!((outcomes[10].rewards[0], outcomes[10].progress[0]), (Reward::default(), [0.0; 2]));
    assert!(!outcomes[10].truncated[0] && outcomes[11].progress[0][0] > 0.0);
    assert!(outcomes.iter().all(|outcome| outcome.terminated == [false; 2]));
}

#[test]
fn observations_have_their_shapes_and_bounds() {
    let mut environments = environments(&Sense::ALL, 1);
    let first = environments.reset(&[5]).unwrap();
    let outcome = environments.step(&actions(0, 1)).unwrap();
    for (sense, (before, after)) in Sense::ALL.into_iter().zip(first.iter().zip(&outcome.observations)) {
        let count: usize = environments.scene().shape(sense).iter().product();
        let [low, high] = sense.bounds();
        match after {
            Readings::Numbers(values) => {
                assert!(!sense.is_bytes() && values.len() == count, "{}", sense.name());
                assert!(values.iter().all(|value| (low..=high).contains(value)), "{}", sense.name());
            }
            Readings::Bytes(values) => assert!(sense.is_bytes() && values.len() == count, "{}", sense.name()),
        }
        assert!(sense == Sense::TouchDepth || before != after, "{} stands still", sense.name());
        assert_eq!(sense.name().parse::<Sense>().unwrap(), sense);
    }
}

#[test]
fn a_sighted_policy_sees_the_place_with_errors_and_feels_the_forces() {
    let mut environments = environments(&[Sense::Sighted, Sense::Privileged], 1);
    environments.reset(&[4]).unwrap();
    let outcome = (0..9).map(|step| environments.step(&actions(step, 1)).unwrap()).last().unwrap();
    let [Readings::Numbers(sighted), Readings::Numbers(truth)] = outcome.observations.as_slice() else {
        panic!("numbers were expected")
    };
    // Behind the proprioception: the newest place, two before it, and the newest forces.
    let (place, forces) = (&sighted[96..99], &sighted[105..109]);
    let off_m = place.iter().zip(&truth[..3]).map(|(seen, truth)| (0.1 * seen - truth).abs()).fold(0.0, f32::max);
    assert!((1e-5..0.01).contains(&off_m), "{off_m} m: an estimate is near, and not exact");
    assert!(forces.iter().any(|force_n| *force_n > 0.0) && forces == &truth[15..19], "{forces:?} {truth:?}");
}

#[test]
fn settings_and_actions_that_are_wrong_are_refused() {
    let refused = |change: fn(&mut TurnSettings)| scene(&[Sense::Cameras], change).err().unwrap().to_string();
    assert!(refused(|s| s.control_hz = 7).contains("divide 300"));
    assert!(refused(|s| s.control_hz = 0).contains("divide 300"));
    assert!(refused(|s| s.physics_hz = 100).contains("physics_hz"));
    assert!(refused(|s| (s.physics_hz, s.control_hz) = (150, 20)).contains("divide 150"));
    assert!(refused(|s| s.latency_s = 1.0).contains("latency_s"));
    assert!(refused(|s| s.duration_s = f64::NAN).contains("duration_s"));
    assert!(refused(|s| s.cameras.clear()).contains("camera"));
    assert!(refused(|s| s.senses.clear()).contains("observe"));
    assert!("smell".parse::<Sense>().unwrap_err().to_string().contains("touch_depth"));
    let mut environments = environments(&[Sense::Proprioception], 2);
    assert!(environments.step(&[0.0; 16]).unwrap_err().to_string().contains("32 expected"));
    assert!(environments.step(&[f32::NAN; 32]).unwrap_err().to_string().contains("finite"));
    assert!(environments.reset(&[1]).unwrap_err().to_string().contains("1 seeds for 2"));
}

/// Rewards and progress of some steps with the same actions.
fn played(change: impl FnOnce(&mut TurnSettings)) -> Vec<(Reward, [f64; 2])> {
    let scene = Arc::new(scene(&[Sense::Proprioception], change).unwrap());
    let mut environments = Environments::new(scene, 1, true).unwrap();
    environments.reset(&[5]).unwrap();
    let step = |step| {
        let outcome = environments.step(&actions(step, 1)).unwrap();
        (outcome.rewards[0], outcome.progress[0])
    };
    (0..10).map(step).collect()
}

#[test]
fn with_fewer_integration_steps_time_passes_alike_and_the_hand_moves_nearly_alike() {
    let (of_run, faster) = (played(|_| ()), played(|s| s.physics_hz = 150));
    assert_ne!(of_run, faster);
    for ((a, [at_a, _]), (b, [at_b, _])) in of_run.iter().zip(&faster) {
        assert!((at_a - at_b).abs() < 1e-9);
        assert!((a.posture - b.posture).abs() < 0.1 * a.posture.abs() + 2e-4, "{a:?} {b:?}");
    }
}

#[test]
fn latency_delays_actions() {
    let (prompt, late) = (played(|_| ()), played(|s| s.latency_s = 0.04));
    assert_ne!(prompt, late);
    assert_eq!(prompt, played(|s| s.latency_s = 0.001), "less than an integration step");
}

#[test]
fn the_seed_chooses_the_scene() {
    let of = |name: &str| {
        let settings = TurnSettings { senses: vec![Sense::Privileged], duration_s: 0.2, ..TurnSettings::default() };
        Arc::new(Scene::new(catalogue::load(name, &mut Vec::new()).unwrap(), settings).unwrap())
    };
    let (cube, ball) = (of("cube70"), of("ball"));
    let firsts = |scenes: Vec<Arc<Scene>>| {
        let mut environments = Environments::of_scenes(scenes, 8, true).unwrap();
        let first = environments.reset(&[0, 1, 2, 3, 4, 5, 6, 7]).unwrap();
        let Some(Readings::Numbers(numbers)) = first.into_iter().next() else { panic!("numbers were expected") };
        numbers.chunks(numbers.len() / 8).map(<[f32]>::to_vec).collect::<Vec<_>>()
    };
    let (cubes, balls, both) = (firsts(vec![cube.clone()]), firsts(vec![ball.clone()]), firsts(vec![cube, ball]));
    let is_cube: Vec<bool> = both.iter().zip(&cubes).map(|(a, b)| a == b).collect();
    assert!(is_cube.contains(&true) && is_cube.contains(&false), "{is_cube:?}");
    assert!(both.iter().zip(cubes.iter().zip(&balls)).all(|(a, (cube, ball))| a == cube || a == ball));
    assert!(Environments::of_scenes(Vec::new(), 1, true).err().unwrap().to_string().contains("no scene"));
}
