//! The hand's kinematics against MuJoCo, exact continuation from a saved state, and the mirrored hand.

#![expect(clippy::unwrap_used, reason = "a failed assumption is a failed test")]

use glam::Vec3;
use mvt_frames::Isometry;
use mvt_gaits::clock::PHYSICS_HZ;
use mvt_gaits::gait;
use mvt_mesh::Mesh;
use mvt_objects::object::Object;
use mvt_physics::episode::{End, Episode, EpisodeConfig, EpisodeStart, Randomisation, run};
use mvt_physics::simulation::Simulation;
use mvt_robot::hand::{Hand, JointAngles, Side};
use rand::{RngExt as _, SeedableRng as _};

fn cube(edge_m: f32) -> Object {
    let corner = |i: u32| (Vec3::new((i & 1) as f32, (i >> 1 & 1) as f32, (i >> 2) as f32) - 0.5) * edge_m;
    let vertices: Vec<Vec3> = (0..8).map(corner).collect();
    let quads = [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];
    let faces = quads.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect();
    let mesh = Mesh { vertices: vertices.clone(), faces };
    Object {
        name: "cube".into(),
        mesh,
        exact: None,
        object_from_file: Isometry::identity(),
        collision: vec![vertices],
        mass_kg: 0.15,
    }
}

fn config(side: Side, seed: u64) -> EpisodeConfig {
    let gait = gait::find("bal").unwrap().1.clone();
    EpisodeConfig { hand: Hand::allegro(side), gait, seed, duration_s: 20.0, randomisation: Randomisation::default() }
}

#[test]
fn forward_kinematics_agree_with_mujoco_on_random_joints() {
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(1);
    for side in [Side::Left, Side::Right] {
        let hand = Hand::allegro(side);
        let start = EpisodeStart::draw(&cube(0.07), gait::find("bal").unwrap().1, &hand, &Randomisation::none(), 0);
        let mut simulation = Simulation::new(&hand, &cube(0.07), &start.physics).unwrap();
        for _ in 0..200 {
            let drawn = hand.ranges().into_iter().map(|[low, high]| rng.random_range(low..=high));
            let joints: JointAngles = drawn.collect();
            simulation.reset(&joints, start.object);
            for (body, ours) in hand.body_poses(&joints).into_iter().enumerate() {
                let theirs = simulation.body_pose(body).unwrap();
                let distance = (ours.to_homogeneous() - theirs.to_homogeneous()).abs().max();
                assert!(distance < 1e-9, "{side:?} {}: {distance:e}", hand.bodies()[body].name);
            }
        }
    }
}

#[test]
fn a_restored_simulation_continues_bit_for_bit() {
    let object = cube(0.07);
    let hand = Hand::allegro(Side::Left);
    let start = EpisodeStart::draw(&object, gait::find("bal").unwrap().1, &hand, &Randomisation::default(), 3);
    let mut simulation = Simulation::new(&hand, &object, &start.physics).unwrap();
    simulation.reset(&start.joints, start.object);
    let run = |simulation: &mut Simulation, steps| (0..steps).for_each(|_| simulation.step(&start.joints));
    run(&mut simulation, 150);
    let saved = simulation.save();
    run(&mut simulation, 300);
    let (pose, joints, contacts) = (simulation.object_pose(), simulation.joints(), simulation.contacts());
    simulation.restore(&saved).unwrap();
    run(&mut simulation, 300);
    assert_eq!((pose, joints, contacts), (simulation.object_pose(), simulation.joints(), simulation.contacts()));
}

/// Steps of any number play the episode that frames play, and a saved state goes on in the middle of it.
#[test]
fn an_episode_is_the_same_in_steps_and_in_frames() {
    let object = cube(0.07);
    let new = || Episode::new(&object, &config(Side::Left, 5)).unwrap();
    let (mut frames, mut steps) = (new(), new());
    let mut saved = None;
    for k in 0..20 {
        let frame = frames.next_frame().unwrap();
        assert_eq!(frame, steps.state(), "frame {k}");
        if k == 10 {
            saved = Some((steps.save(), frame));
        }
        steps.advance(3, None);
        steps.advance(7, None);
    }
    let (snapshot, frame) = saved.unwrap();
    let after = steps.state();
    steps.restore(&snapshot).unwrap();
    assert_eq!(steps.state(), frame);
    steps.advance(100, None);
    assert_eq!(steps.state(), after);

    let mut other = Episode::new(&object, &config(Side::Left, 6)).unwrap();
    assert!(other.restore(&snapshot).unwrap_err().to_string().contains("another object, seed"));
    let target: JointAngles = other.start().joints.iter().map(|angle| angle + 0.05).collect();
    other.advance(30, Some(&target));
    assert_eq!(other.target(), target);
    other.advance(1_000_000, None);
    assert!(other.end().is_some());
}

/// Both hands play mirrored episodes. MuJoCo's choice of contact points is not symmetric, so they agree closely, not
/// exactly.
#[test]
fn the_left_hand_plays_the_mirror_image() {
    let object = cube(0.07);
    let mut left = Episode::new(&object, &config(Side::Left, 5)).unwrap();
    let mut right = Episode::new(&object, &config(Side::Right, 5)).unwrap();
    for _ in 0..20 {
        let (l, r) = (left.next_frame().unwrap(), right.next_frame().unwrap());
        let (lp, rp) = (l.scene.object_pose.origin().coords(), r.scene.object_pose.origin().coords());
        let mirrored = nalgebra::Vector3::new(rp.x, -rp.y, rp.z);
        assert!((lp - mirrored).norm() < 5e-4, "at {} s: {lp} against {mirrored}", l.scene.time_s);
        let joints = Hand::allegro(Side::Left).mirrored(&r.scene.joints);
        assert!((0..16).all(|j| (joints[j] - l.scene.joints[j]).abs() < 0.01), "at {} s", l.scene.time_s);
    }
}

#[test]
fn frames_come_at_thirty_hertz_and_the_episode_ends_on_time() {
    let mut config = config(Side::Left, 5);
    config.duration_s = 1.0;
    let mut episode = Episode::new(&cube(0.07), &config).unwrap();
    let times: Vec<f64> = std::iter::from_fn(|| episode.next_frame().map(|frame| frame.scene.time_s)).collect();
    assert_eq!(times.len(), 30);
    assert!(times.iter().enumerate().all(|(i, t)| (t - i as f64 / 30.0).abs() < 1e-12));
    assert_eq!(PHYSICS_HZ, 300);
    assert!((episode.time_s() - 1.0).abs() < 1e-12);
}

#[test]
fn exploding_physics_ends_the_episode_with_the_reason() {
    let mut config = config(Side::Left, 5);
    config.gait.gravity = [0.0, 0.0, -1e7];
    let outcome = run(&mut Episode::new(&cube(0.07), &config).unwrap());
    assert!(matches!(&outcome.end, End::Unstable(reason) if reason.contains("became unstable")), "{:?}", outcome.end);
    assert!(outcome.survived_s < 1.0);
}
