//! Trials against episodes, searches that resume and do not depend on threads, and the shipped controllers.

#![expect(clippy::unwrap_used, reason = "a failed assumption is a failed test")]

use std::sync::Arc;

use mvt_gaits::axis::TurnAxis;
use mvt_gaits::gait::{self, Gait};
use mvt_objects::object::Object;
use mvt_physics::episode::{self, End, Episode, EpisodeConfig, Randomisation};
use mvt_robot::hand::{Hand, Side};
use mvt_tuning::search::{Search, SearchError, SearchSettings, measure};
use mvt_tuning::trial::{EPISODE_STEPS, TrialConditions};
use mvt_tuning::{seeds, stroke, trial};

fn object(name: &str) -> Object {
    mvt_objects::catalogue::load(name, &mut Vec::new()).unwrap()
}

fn gait_named(name: &str) -> &'static Gait {
    gait::find(name).unwrap().1
}

fn right() -> Arc<Hand> {
    Hand::allegro(Side::Right)
}

fn conditions(duration_s: f64) -> TrialConditions {
    TrialConditions { hand: Hand::allegro(Side::Left), duration_s, steps: EPISODE_STEPS }
}

fn settings() -> SearchSettings {
    SearchSettings {
        objects: vec!["cube70".to_owned()],
        axis: TurnAxis::MinusY,
        duration_s: 1.0,
        starts: 1,
        sufficient_rate_rad_s: None,
        population: 4,
        sigma: 0.3,
        only: vec![],
        seed: 5,
    }
}

#[test]
fn a_trial_is_an_episode() {
    for (name, seed) in [("bal", 3), ("tumble_back", 4)] {
        let (gait, object) = (gait_named(name), object("cube70"));
        let config = EpisodeConfig {
            hand: Hand::allegro(Side::Left),
            gait: gait.clone(),
            seed,
            duration_s: 4.0,
            randomisation: Randomisation::default(),
        };
        let episode = episode::run(&mut Episode::new(&object, &config).unwrap());
        let trial = trial::run(gait, &object, seed, &conditions(4.0)).unwrap();
        assert_eq!(episode.end, End::Completed);
        assert!(trial.alive && trial.survived_s == 4.0);
        // The episode adds up angular velocities, the trial rotations between commands.
        let difference = (episode.turned_rad - trial.turned_rad).abs();
        assert!(episode.turned_rad.abs() > 1.0, "{name}: {}", episode.turned_rad);
        assert!(difference < 0.1 * episode.turned_rad.abs(), "{name}: {difference}");
    }
}

#[test]
fn a_search_does_not_depend_on_threads_and_resumes_bit_for_bit() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("search.state");
    let objects = [object("cube70")];
    let from = gait_named("tumble_back");
    let on = |threads: usize, search: &mut Search| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| search.advance(&objects)).unwrap()
    };
    let mut whole = Search::new(settings(), from, &right());
    let scores = [on(1, &mut whole), on(1, &mut whole)];

    let mut first = Search::resume(&path, settings(), from, &right()).unwrap();
    assert_eq!(on(3, &mut first), scores[0]);
    first.save(&path).unwrap();
    let mut second = Search::resume(&path, settings(), from, &right()).unwrap();
    assert_eq!(on(2, &mut second), scores[1]);
    assert_eq!(second, whole);
    assert_eq!(second.generation(), 2);

    let other = SearchSettings { starts: 2, ..settings() };
    assert!(matches!(Search::resume(&path, other, from, &right()), Err(SearchError::Other { .. })));
    assert!(matches!(Search::resume(&path, settings(), gait_named("bal"), &right()), Err(SearchError::Other { .. })));
    std::fs::write(&path, "mean = 1").unwrap();
    assert!(Search::resume(&path, settings(), from, &right()).unwrap_err().to_string().contains("remove it"));
}

#[test]
fn a_search_beats_its_start() {
    // Strokes of 0.6 of the length hardly turn a cube.
    let mut from = gait_named("tumble_back").clone();
    for (_, value) in from.params.iter_mut().filter(|(name, _)| name.starts_with("sin_") || name.starts_with("cos_")) {
        *value *= 0.6;
    }
    let objects = [object("cube70")];
    let settings = SearchSettings { duration_s: 8.0, population: 14, ..settings() };
    let mut search = Search::new(settings, &from, &right());
    let rate = |search: &Search| {
        measure(&search.gait(""), &objects[0], seeds::held_out(), 6, &conditions(8.0)).unwrap().rate_rad_s
    };
    let before = rate(&search);
    for _ in 0..8 {
        search.advance(&objects).unwrap();
    }
    let after = rate(&search);
    assert!(after > before + 0.2, "{before} and {after} rad/s");
}

#[test]
fn strokes_are_gaits_and_back() {
    let from = gait_named("tumble_back");
    let params = |gait: &Gait| stroke::parameters_of(gait, &right());
    let again = stroke::gait(&params(from), &right(), from.open_pose.clone(), from.axis, &from.description);
    assert_eq!(&again, from);
    // A gait without a stroke becomes the nearest one.
    let near = stroke::gait(&params(gait_named("low")), &right(), vec![0.3; 16], TurnAxis::MinusZ, "");
    let rows = near.table.iter().zip(&gait_named("low").table);
    let difference = rows.flat_map(|(a, b)| (0..16).map(|j| (a[j] - b[j]).abs()).collect::<Vec<_>>()).sum::<f64>();
    assert!(difference / (32.0 * 16.0) < 0.2, "{}", difference / (32.0 * 16.0));
    assert!((near.gravity[0] - gait_named("low").gravity[0]).abs() < 1e-3);
    assert!((near.gravity[1] - gait_named("low").gravity[1]).abs() < 1e-3);
    let backwards = stroke::backwards(stroke::backwards(from.params.clone()));
    assert_eq!(backwards, from.params);
}

/// Half the step, with which the solver finds other contacts, must not change the result.
#[test]
fn shipped_controllers_turn_objects_also_with_half_the_step() {
    // Balls have no face on which to stand, so that they also turn about other axes.
    let cases = [
        ("tumble_back", "cube70", 1.0, 0.3),
        ("tumble_ball", "ball", 0.5, f64::INFINITY),
        ("roll_ball", "ball", 0.3, 0.5),
        ("roll_cube", "large_dice", 0.3, f64::INFINITY),
    ];
    for (name, turned, rate_rad_s, other_share) in cases {
        for steps in [EPISODE_STEPS, 2 * EPISODE_STEPS] {
            let conditions = TrialConditions { steps, ..conditions(10.0) };
            let score = measure(gait_named(name), &object(turned), seeds::held_out(), 6, &conditions).unwrap();
            assert_eq!(score.alive, 1.0, "{name} {score:?}");
            assert!(score.rate_rad_s > rate_rad_s && score.other_share < other_share, "{name} {score:?}");
        }
    }
}

#[test]
fn only_the_named_parameters_change() {
    let from = gait_named("tumble_back");
    let settings = SearchSettings { only: vec!["pose_thumb".to_owned()], ..settings() };
    let mut search = Search::new(settings, from, &right());
    let begun = search.gait("").params;
    search.advance(&[object("cube70")]).unwrap();
    let changed: Vec<String> = search
        .gait("")
        .params
        .into_iter()
        .filter(|(name, value)| begun[name] != *value)
        .map(|(name, _)| name)
        .collect();
    assert_eq!(changed, ["pose_thumb_0", "pose_thumb_1", "pose_thumb_2", "pose_thumb_3"]);
    assert!(Search::has_parameter(from, &right(), "sin_") && !Search::has_parameter(from, &right(), "lift_"));
}
