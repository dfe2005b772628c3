//! Random objects stay in the hand.

use mvt_gaits::gait;
use mvt_objects::random::RandomObject;
use mvt_physics::episode::{End, Episode, EpisodeConfig, Randomisation, run};
use mvt_robot::hand::{Hand, Side};

/// The first seeds contain every family of shapes.
#[test]
fn random_objects_stay_in_the_hand_for_two_seconds() {
    for seed in 0..16 {
        let object = RandomObject::new(seed).load().unwrap();
        let hand = Hand::allegro(Side::Left);
        let (_, gait) = gait::choose("auto", &object, &hand).unwrap();
        let randomisation = Randomisation::default();
        let config = EpisodeConfig { hand, gait: gait.clone(), seed: 0, duration_s: 2.0, randomisation };
        let outcome = run(&mut Episode::new(&object, &config).unwrap());
        assert_eq!(outcome.end, End::Completed, "{}: {outcome:?}", object.name);
    }
}
