//! Objects that are held in the air, over whole episodes.

#![expect(clippy::unwrap_used, reason = "a failed assumption is a failed test")]

use mvt_frames::{Isometry, Model, Point, World};
use mvt_gaits::feedback::{EstimatedPlace, HANDED_OVER_S, STALE_S};
use mvt_gaits::gait;
use mvt_objects::catalogue;
use mvt_physics::air::{AirOutcome, PlaceErrors};
use mvt_physics::episode::{Episode, EpisodeConfig, EpisodeState, Randomisation};
use mvt_robot::hand::{Hand, Side};
use nalgebra as na;

/// Returns an episode with a ball of 75 mm and 110 g.
fn episode(side: Side, duration_s: f64) -> Episode {
    let mut ball = catalogue::load("ball", &mut Vec::new()).unwrap();
    ball.mesh.vertices.iter_mut().chain(ball.collision.iter_mut().flatten()).for_each(|v| *v *= 75.0 / 65.0);
    (ball.exact, ball.mass_kg) = (None, 0.11);
    let gait = gait::find("air_ball").unwrap().1.clone();
    let randomisation = Randomisation { yaw_rad: 1.0, ..Randomisation::none() };
    Episode::new(&ball, &EpisodeConfig { hand: Hand::allegro(side), gait, seed: 3, duration_s, randomisation }).unwrap()
}

fn play(episode: &mut Episode) -> Vec<EpisodeState> {
    std::iter::from_fn(|| episode.next_frame()).collect()
}

#[test]
fn a_ball_stays_on_the_fingertips_and_turns() {
    for side in [Side::Left, Side::Right] {
        let mut episode = episode(side, 20.0);
        episode.rehearse(PlaceErrors::default(), 3);
        let states = play(&mut episode);
        let air = episode.in_air().unwrap();
        assert!(air.least_height_mm >= AirOutcome::IN_AIR_MM, "{side:?}: {air:?}");
        assert!(air.touched_beside_tips < 0.01, "{side:?}: {air:?}");
        assert_eq!(air.lowered_at_s, None);
        let turned_rad = na::Vector3::from(air.net_rad).dot(&gait::find("air_ball").unwrap().1.axis.direction(side));
        assert!(turned_rad > 0.25 * 19.0, "{side:?}: {air:?}");
        // Up to the hand-over the ball does not move.
        let start = episode.start().object.origin().coords();
        let moved_m = |state: &EpisodeState| (state.scene.object_pose.origin().coords() - start).norm();
        assert!(states.iter().filter(|state| state.scene.time_s < HANDED_OVER_S).all(|state| moved_m(state) < 5e-4));
    }
}

#[test]
fn a_restored_episode_continues_bit_for_bit() {
    let mut episode = episode(Side::Left, 4.0);
    episode.rehearse(PlaceErrors::default(), 3);
    for _ in 0..60 {
        episode.next_frame().unwrap();
    }
    let saved = episode.save();
    let first = (play(&mut episode), episode.in_air());
    episode.restore(&saved).unwrap();
    assert_eq!((play(&mut episode), episode.in_air()), first);
}

#[test]
fn an_object_whose_estimate_is_lost_is_lowered_to_the_palm_and_kept() {
    const LOST_S: f64 = 4.0;
    for side in [Side::Left, Side::Right] {
        let mut episode = episode(side, 20.0);
        let mut last = None;
        while let Some(state) = episode.next_frame() {
            let EpisodeState { scene, .. } = &state;
            if scene.time_s < LOST_S {
                // An estimator without errors, whose model frame is the object's.
                let pose = Isometry::<Model, World>::new(scene.object_pose.untyped());
                episode.see(EstimatedPlace::new(scene.time_s, pose, Point::from(na::Vector3::zeros())));
            }
            last = Some(state);
        }
        let air = episode.in_air().unwrap();
        assert!((air.lowered_at_s.unwrap() - LOST_S - STALE_S).abs() < 0.1, "{side:?}: {air:?}");
        let centre = last.unwrap().scene.object_pose.origin().coords();
        assert!(centre.z < 0.07, "{side:?}: it is {:.0} mm high", 1e3 * centre.z);
        assert!(episode.simulation().object_velocity().norm() < 0.02, "{side:?}: it does not rest");
        assert!(episode.time_s() >= 20.0, "{side:?}: it fell after {:.1} s", episode.time_s());
    }
}
