//! Rigs that the program brings along.

#![allow(clippy::unwrap_used, reason = "a failed assumption in a test is a failed test")]

use crate::common;
use mujoco_rs::prelude::*;
use mvt_hands::{HandFile, LoadedHand};
use mvt_robot::hand::{Hand, HandDescription, Primitive, Side};
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

/// Returns all numbers of a description, in its order. Of a quaternion and its negative, the same rotation, it has the one that begins with a
/// positive number.
fn numbers(description: &HandDescription) -> Vec<f64> {
    fn collect(value: &toml::Value, into: &mut Vec<f64>) {
        match value {
            toml::Value::Float(number) => into.push(*number),
            toml::Value::Integer(number) => into.push(*number as f64),
            toml::Value::Array(values) => {
                let begin = into.len();
                values.iter().for_each(|value| collect(value, into));
                let numbers = &mut into[begin..];
                let is_quaternion =
                    numbers.len() == 4 && (numbers.iter().map(|q| q * q).sum::<f64>() - 1.0).abs() < 1e-9;
                if is_quaternion && numbers.iter().find(|q| q.abs() > 1e-9).is_some_and(|q| *q < 0.0) {
                    numbers.iter_mut().for_each(|q| *q = -*q);
                }
            }
            toml::Value::Table(table) => table.values().for_each(|value| collect(value, into)),
            _ => (),
        }
    }
    let mut all = Vec::new();
    collect(&toml::Value::try_from(description).unwrap(), &mut all);
    all
}

#[test]
fn the_built_in_allegro_is_that_of_its_file() {
    let loaded = HandFile::load("tests/data/allegro.toml").unwrap();
    assert!(loaded.warnings.is_empty(), "{:?}", loaded.warnings);
    let built_in = Hand::allegro(Side::Right);
    let names = |hand: &Hand| hand.bodies().iter().map(|body| body.name.clone()).collect::<Vec<_>>();
    assert_eq!(names(&loaded.hand), names(&built_in));
    let [ours, theirs] = [&loaded.hand, &built_in].map(|hand| {
        let mut description = hand.description().clone();
        // A pair of bodies has no order, nor have the ends of a capsule.
        description.apart.iter_mut().for_each(|pair| pair.sort_unstable());
        for part in description.bodies.iter_mut().flat_map(|body| &mut body.parts) {
            if let Primitive::Capsule { from, to, .. } = &mut part.shape
                && from[2] > to[2]
            {
                std::mem::swap(from, to);
            }
        }
        numbers(&description)
    });
    assert_eq!(ours.len(), theirs.len());
    let worst = ours.iter().zip(&theirs).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    assert!(worst < 1e-9, "{worst}");
    let model = MjModel::from_xml("rigs/allegro_right.xml").unwrap();
    let mut random = ChaCha8Rng::seed_from_u64(3);
    let worst = common::greatest_difference(&loaded, &model, Some("palm"), || random.random());
    assert!(worst < 1e-9, "{worst}");
}

#[test]
fn three_fingers_are_the_allegro_without_its_ring_finger() {
    let loaded = LoadedHand::rig("three_fingers", None).unwrap();
    assert!(loaded.warnings.is_empty(), "{:?}", loaded.warnings);
    let (hand, allegro) = (&loaded.hand, Hand::allegro(Side::Right));
    assert_eq!((hand.joints().len(), hand.pads().len(), hand.bodies().len()), (12, 3, 16));
    let mut random = ChaCha8Rng::seed_from_u64(4);
    let joints: Vec<f64> = allegro.ranges().iter().map(|[low, high]| random.random_range(*low..*high)).collect();
    let kept: Vec<f64> = (0..16).filter(|j| !(8..12).contains(j)).map(|j| joints[j]).collect();
    let [ours, theirs] = [hand.world_from_gels(&kept), allegro.world_from_gels(&joints)];
    for (ours, theirs) in [(0, 0), (1, 1), (2, 3)].map(|(a, b)| (ours[a].untyped(), theirs[b].untyped())) {
        assert!((ours.to_homogeneous() - theirs.to_homogeneous()).abs().max() < 1e-9);
    }
}

#[test]
fn the_gripper_closes_its_gels_on_one_another_wherever_the_arm_is() {
    let loaded = LoadedHand::rig("gripper_gelsight", None).unwrap();
    assert!(loaded.warnings.is_empty(), "{:?}", loaded.warnings);
    let hand = &loaded.hand;
    let names: Vec<&str> = hand.joints().iter().map(|joint| joint.name.as_str()).collect();
    assert_eq!(names, ["lift", "swing", "nod", "roll", "left", "right"]);
    let apex = |joints: &[f64], pad: usize| {
        let pose = hand.world_from_gels(joints)[pad].untyped();
        (pose * mvt_robot::nalgebra::Point3::new(0.022, 0.0, 0.0)).coords
    };
    for arm in [[0.0; 4], [0.05, 0.3, -0.2, 2.0]] {
        let joints = |opening: f64| [arm.as_slice(), &[opening, opening]].concat();
        let centre = hand.grasp_centre(&joints(0.0)).unwrap().coords();
        assert!((0..2).all(|pad| (apex(&joints(0.0), pad) - centre).norm() < 1e-12), "{arm:?}");
        let apart = (apex(&joints(0.03), 0) - apex(&joints(0.03), 1)).norm();
        assert!((apart - 0.06).abs() < 1e-12, "{apart}");
    }
    let model = MjModel::from_xml("rigs/gripper.xml").unwrap();
    let mut random = ChaCha8Rng::seed_from_u64(5);
    let worst = common::greatest_difference(&loaded, &model, Some("post"), || random.random());
    assert!(worst < 1e-9, "{worst}");
}
