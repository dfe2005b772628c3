//! Effects of directives and injected faults on an object in the hand.

#![expect(clippy::unwrap_used, reason = "a failed assumption is a failed test")]

use mvt_frames::{Isometry, World};
use mvt_gaits::clock::FRAME_HZ;
use mvt_gaits::directive::Directive;
use mvt_gaits::gait;
use mvt_objects::catalogue;
use mvt_objects::object::Object;
use mvt_physics::episode::{End, Episode, EpisodeConfig, EpisodeState, Randomisation};
use mvt_physics::simulation::PadContact;
use mvt_robot::hand::{Hand, Side};
use nalgebra as na;

fn episode(object: &Object, seed: u64) -> Episode {
    let hand = Hand::allegro(Side::Left);
    let gait = gait::choose("auto", object, &hand).unwrap().1.clone();
    let config = EpisodeConfig { hand, gait, seed, duration_s: 8.0, randomisation: Randomisation::default() };
    Episode::new(object, &config).unwrap()
}

fn load(name: &str) -> Object {
    catalogue::load(name, &mut Vec::new()).unwrap()
}

fn centre(state: &EpisodeState) -> na::Vector2<f64> {
    state.scene.object_pose.origin().coords().xy()
}

fn play(episode: &mut Episode, seconds: f64) -> Vec<EpisodeState> {
    std::iter::from_fn(|| episode.next_frame()).take((seconds * f64::from(FRAME_HZ)) as usize).collect()
}

/// Returns the mean distance of a displaced object from its place in the gait, metres.
fn distance_from_home(object: &Object, seed: u64, recentre: bool) -> f64 {
    let mut episode = episode(object, seed);
    let before = play(&mut episode, 3.0);
    let home = before[30..].iter().map(centre).sum::<na::Vector2<f64>>() / (before.len() - 30) as f64;
    let (sin, cos) = (0.4 + 1.57 * seed as f64).sin_cos();
    episode.displace_object(Isometry::translation(0.015 * cos, 0.015 * sin, 0.0));
    let mut distances = Vec::new();
    while let Some(state) = episode.next_frame() {
        let offset = centre(&state) - home;
        if recentre {
            episode.direct(Directive::Recentre { offset_m: [offset.x, offset.y] }).unwrap();
        }
        distances.push(offset.norm());
    }
    let settled = &distances[FRAME_HZ as usize..];
    settled.iter().sum::<f64>() / settled.len() as f64
}

#[test]
fn recentring_brings_a_displaced_object_nearer() {
    let (mut left_alone, mut recentred) = (0.0, 0.0);
    for name in ["rubiks_cube_small", "cube70", "soup_can"] {
        let object = load(name);
        for seed in 0..6 {
            left_alone += distance_from_home(&object, seed, false);
            recentred += distance_from_home(&object, seed, true);
        }
    }
    assert!(recentred < 0.92 * left_alone, "{recentred} against {left_alone}");
}

#[test]
fn a_regrasp_lets_go_and_takes_hold_again() {
    let object = load("cube70");
    let mut episode = episode(&object, 1);
    play(&mut episode, 2.0);
    episode.direct(Directive::Regrasp).unwrap();
    let during = play(&mut episode, 1.3);
    let touching =
        |states: &[EpisodeState]| states.iter().filter(|s| s.pads.0.iter().any(PadContact::is_touching)).count();
    // Open from 0.3 to 0.5 s after the directive.
    assert_eq!(touching(&during[10..15]), 0);
    let after = play(&mut episode, 3.0);
    assert!(2 * touching(&after) > after.len(), "{} of {}", touching(&after), after.len());
    assert_eq!(episode.end(), None);
}

#[test]
fn another_gait_and_the_end() {
    let object = load("cube70");
    let mut episode = episode(&object, 2);
    play(&mut episode, 2.0);
    episode.direct(Directive::SwitchGait("shared".into())).unwrap();
    assert!(episode.direct(Directive::SwitchGait("gallop".into())).unwrap_err().to_string().contains("shared"));
    let turned = episode.turned_rad();
    assert_eq!(play(&mut episode, 4.0).len(), 4 * FRAME_HZ as usize);
    assert!(episode.turned_rad() > turned + 0.5, "the other gait also turns the object");
    episode.direct(Directive::Stop).unwrap();
    assert!(episode.next_frame().is_none() && episode.end() == Some(&End::Stopped));
}

#[test]
fn displaced_objects_keep_out_of_the_hand_and_their_fate_is_determined() {
    let object = load("cube70");
    let axis = na::Unit::new_normalize(na::Vector3::new(0.6, -0.3, 0.5));
    let rotation = na::UnitQuaternion::from_axis_angle(&axis, 40f64.to_radians());
    let shift = na::Vector3::new(-0.02, 0.0224, 0.0);
    let change = Isometry::<World, World>::new(na::Isometry3::from_parts(shift.into(), rotation));
    let fate = |seed| {
        let mut episode = episode(&object, seed);
        let before = play(&mut episode, 2.0).pop().unwrap();
        episode.displace_object(change);
        let after = play(&mut episode, 1.0);
        // The first frame comes an instant after the next integration steps.
        let turned = (after[0].scene.object_pose.untyped().rotation
            * before.scene.object_pose.untyped().rotation.inverse())
        .angle();
        assert!((turned.to_degrees() - 40.0).abs() < 8.0, "{}", turned.to_degrees());
        let moved = (centre(&after[0]) - centre(&before)).norm();
        assert!((moved - 0.03).abs() < 0.008, "{moved}");
        let deepest = after[0].pads.0.iter().fold(0.0, |d: f64, pad| d.max(pad.penetration_m));
        // A moving finger may have hit the object in the meantime.
        assert!(deepest < 0.008, "{deepest}");
        assert!(!matches!(episode.end(), Some(End::Unstable(_))));
        after
    };
    for seed in 0..4 {
        assert_eq!(fate(seed), fate(seed));
    }
}
