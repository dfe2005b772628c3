//! Trials in the air against episodes and with shorter steps, and searches for controllers with feedback.

#![expect(clippy::unwrap_used, reason = "a failed assumption is a failed test")]

use mvt_gaits::axis::TurnAxis;
use mvt_gaits::gait::{self, Gait};
use mvt_objects::object::Object;
use mvt_physics::air::{AirOutcome, PlaceErrors};
use mvt_physics::episode::{self, Episode, EpisodeConfig, Randomisation};
use mvt_robot::hand::{Hand, Side};
use mvt_tuning::search::{Search, SearchSettings, measure};
use mvt_tuning::seeds;
use mvt_tuning::trial::{self, EPISODE_STEPS, TrialConditions};

/// Returns a ball of 75 mm and 110 g.
fn ball() -> Object {
    let mut ball = mvt_objects::catalogue::load("ball", &mut Vec::new()).unwrap();
    ball.mesh.vertices.iter_mut().chain(ball.collision.iter_mut().flatten()).for_each(|v| *v *= 75.0 / 65.0);
    (ball.exact, ball.mass_kg) = (None, 0.11);
    ball
}

fn air_ball() -> &'static Gait {
    gait::find("air_large_ball").unwrap().1
}

#[test]
fn a_trial_in_the_air_is_an_episode() {
    let (object, seed) = (ball(), 3);
    let gait = air_ball().clone();
    let randomisation = Randomisation::default();
    let config = EpisodeConfig { hand: Hand::allegro(Side::Left), gait, seed, duration_s: 5.0, randomisation };
    let mut episode = Episode::new(&object, &config).unwrap();
    episode.rehearse(PlaceErrors::default(), seed);
    episode::run(&mut episode);
    let air = episode.in_air().unwrap();
    let conditions = TrialConditions { hand: Hand::allegro(Side::Left), duration_s: 4.0, steps: EPISODE_STEPS };
    let trial = trial::run(air_ball(), &object, seed, &conditions).unwrap();
    assert!(trial.alive && air.least_height_mm >= AirOutcome::IN_AIR_MM, "{trial:?} {air:?}");
    for axis in 0..3 {
        assert!((trial.net_rad[axis] - air.net_rad[axis]).abs() < 0.05, "{trial:?} {air:?}");
    }
}

#[test]
fn steps_of_half_the_length_hold_the_ball_as_well() {
    let score = |steps: u32| {
        let conditions = TrialConditions { hand: Hand::allegro(Side::Right), duration_s: 10.0, steps };
        measure(air_ball(), &ball(), seeds::tuning(), 10, &conditions).unwrap()
    };
    for score in [EPISODE_STEPS, 2 * EPISODE_STEPS].map(score) {
        assert!(score.alive >= 0.7 && score.rate_rad_s >= 0.25, "{score:?}");
    }
}

#[test]
fn a_search_begins_at_the_controller_in_its_file_and_resumes() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("search.state");
    let settings = SearchSettings {
        objects: vec!["ball".to_owned()],
        axis: TurnAxis::MinusX,
        duration_s: 0.4,
        starts: 1,
        sufficient_rate_rad_s: None,
        population: 4,
        sigma: 0.3,
        only: vec![],
        seed: 5,
    };
    let hand = Hand::allegro(Side::Right);
    let mut search = Search::new(settings.clone(), air_ball(), &hand);
    let (begun, file) = (search.gait(""), air_ball());
    let feedback = |gait: &Gait| gait.feedback.as_deref().unwrap().clone();
    assert_eq!((begun.axis, begun.period_s, &begun.open_pose), (file.axis, file.period_s, &file.open_pose));
    assert_eq!(feedback(&begun), feedback(file));
    assert_eq!(begun.table, file.table);
    search.save(&path).unwrap();
    let mut resumed = Search::resume(&path, settings, air_ball(), &hand).unwrap();
    let objects = [ball()];
    assert_eq!(search.advance(&objects).unwrap(), resumed.advance(&objects).unwrap());
    assert_eq!(search, resumed);
    assert_ne!(feedback(&search.gait("")), feedback(file));
}
