//! Controllers that follow one another in an episode.

#![expect(clippy::unwrap_used, reason = "a failed assumption is a failed test")]

use mvt_frames::{Isometry, Object as ObjectFrame, World};
use mvt_gaits::controller_file::{ChosenController, choose_all};
use mvt_gaits::directive::Directive;
use mvt_gaits::gait;
use mvt_gaits::safe::safe_controllers;
use mvt_objects::catalogue;
use mvt_physics::episode::{End, Episode, EpisodeConfig, Randomisation};
use mvt_robot::hand::{Hand, Side};
use nalgebra as na;

/// Seconds of a part.
const PART_S: f64 = 6.0;
const PARTS: usize = 4;

fn episode(side: Side, seed: u64) -> Episode {
    let object = catalogue::load("rubiks_cube_small", &mut Vec::new()).unwrap();
    let text = format!("tumble_back:{PART_S},cubelet:{PART_S}");
    let hand = Hand::allegro(side);
    let ChosenController { gait, schedule, .. } = choose_all(&text, &object, &hand).unwrap();
    let duration_s = PART_S * PARTS as f64;
    let config = EpisodeConfig { hand, gait, seed, duration_s, randomisation: Randomisation::default() };
    let mut episode = Episode::new(&object, &config).unwrap();
    episode.follow(schedule);
    episode
}

fn turn(from: Isometry<ObjectFrame, World>, to: Isometry<ObjectFrame, World>) -> na::Vector3<f64> {
    (to.untyped().rotation * from.untyped().rotation.inverse()).scaled_axis()
}

#[test]
fn a_cube_survives_three_changes_and_turns_about_both_axes() {
    for (side, seed) in [(Side::Left, 0), (Side::Right, 1), (Side::Left, 2)] {
        let mut episode = episode(side, seed);
        let mut turned = [na::Vector3::zeros(); PARTS];
        let mut last = None;
        let mut gravity = na::Vector3::from(episode.simulation().gravity());
        while let Some(state) = episode.next_frame() {
            let pose = state.scene.object_pose;
            let part = ((state.scene.time_s - 1e-9) / PART_S).max(0.0) as usize;
            turned[part] += turn(last.unwrap_or(pose), pose);
            last = Some(pose);
            // The palm tilts by half a radian in half a second, not at once.
            let now = na::Vector3::from(episode.simulation().gravity());
            assert!(now.angle(&gravity) < 0.06, "{} at {}", now.angle(&gravity), state.scene.time_s);
            gravity = now;
        }
        assert_eq!(episode.end(), Some(&End::Completed), "seed {seed}");
        let z = side.sign();
        for part in 0..PARTS {
            let about = if part % 2 == 0 { -turned[part].y } else { -z * turned[part].z };
            assert!(about > 1.0, "{side:?}, seed {seed}, part {part}: {:?}", turned[part]);
        }
    }
}

#[test]
fn directed_changes_keep_a_cube_for_20_s() {
    let object = catalogue::load("rubiks_cube_small", &mut Vec::new()).unwrap();
    let hand = Hand::allegro(Side::Left);
    let safe: Vec<&str> = safe_controllers(&object, &hand).iter().map(|safe| safe.name.as_str()).collect();
    assert!(safe.len() >= 2, "{safe:?}");
    for seed in 0..3 {
        let gait = gait::find(safe[0]).unwrap().1.clone();
        let (hand, randomisation) = (hand.clone(), Randomisation::default());
        let config = EpisodeConfig { hand, gait, seed, duration_s: 20.0, randomisation };
        let mut episode = Episode::new(&object, &config).unwrap();
        for part in 1..=4 {
            episode.advance(1500, None);
            let name = safe[part % safe.len()];
            episode.direct(Directive::ChangeController(name.to_owned())).unwrap();
            let (before, wanted) = (episode.simulation().gravity(), gait::find(name).unwrap().1);
            episode.advance(0, None);
            assert_eq!(episode.simulation().gravity(), before, "the palm does not tilt at once");
            let mut watched = Episode::new(&object, &config).unwrap();
            watched.restore(&episode.save()).unwrap();
            watched.advance(700, None);
            let [gx, gy, gz] = wanted.gravity;
            assert!(watched.end().is_some() || watched.simulation().gravity() == [gx, -gy, gz], "{name}");
        }
        assert_eq!(episode.end(), Some(&End::Completed), "seed {seed}");
        assert!(episode.direct(Directive::ChangeController("gallop".to_owned())).is_err());
    }
}

#[test]
fn a_state_saved_during_a_change_continues_bit_for_bit() {
    let mut whole = episode(Side::Left, 0);
    let steps = (300.0 * (PART_S + 0.8)) as u32;
    whole.advance(steps, None);
    let saved = whole.save();
    whole.advance(900, None);
    let mut again = episode(Side::Left, 0);
    again.restore(&saved).unwrap();
    again.advance(900, None);
    assert_eq!(again.state(), whole.state());
    assert_eq!((again.turned_rad(), again.simulation().gravity()), (whole.turned_rad(), whole.simulation().gravity()));
}
