//! Hands other than the built-in one: several roots, sliding joints, hulls, two pads, and none.

#![expect(clippy::unwrap_used, reason = "a failed assumption is a failed test")]

use std::sync::Arc;

use mvt_gaits::directive::Directive;
use mvt_gaits::gait::{self, Gait};
use mvt_objects::catalogue;
use mvt_physics::episode::{End, Episode, EpisodeConfig, EpisodeStart, Randomisation, run};
use mvt_physics::mjcf;
use mvt_physics::simulation::Simulation;
use mvt_robot::hand::{
    Body, Drive, GraspPoint, Hand, HandDescription, Hull, Inertial, Joint, JointMotion, Part, PartSurface, Placing,
    Primitive, Side, TouchPad, UPRIGHT,
};
use rand::{RngExt as _, SeedableRng as _};

const SKEW: [f64; 4] = [0.8, 0.0, 0.6, 0.0];

/// Returns two fingers that slide towards each other, one of them with a turning tip, beside a plinth that is a root of its own.
fn gripper() -> Arc<Hand> {
    let body = |name: &str, parent: Option<usize>, place: Placing, parts: Vec<Part>| Body {
        name: name.to_owned(),
        parent,
        place,
        inertial: Some(Inertial {
            mass_kg: 0.05,
            centre_m: [0.0, 0.0, 0.01],
            orientation_wxyz: SKEW,
            diagonal: [2e-5, 3e-5, 4e-5],
        }),
        parts,
    };
    let finger = |pad: usize| {
        let housing =
            Primitive::Box { centre: [0.0, 0.0, 0.02], half: [0.008, 0.012, 0.02], orientation_wxyz: UPRIGHT };
        let gel = Primitive::Ellipsoid {
            centre: [0.008, 0.0, 0.02],
            semi: [0.009, 0.0128, 0.0165],
            orientation_wxyz: UPRIGHT,
        };
        vec![
            Part { surface: PartSurface::Housing, shape: housing },
            Part { surface: PartSurface::Gel(pad), shape: gel },
        ]
    };
    let joint = |name: &str, body: usize, motion: JointMotion, axis: [f64; 3], range: [f64; 2]| Joint {
        name: name.to_owned(),
        body,
        motion,
        axis,
        range,
        mirrors: false,
        drive: Drive { stiffness: 800.0, damping: 20.0, armature: 0.01, friction: 0.1, torque_limit: 20.0 },
    };
    let corner = |k: usize| [k & 1, k >> 1 & 1, k >> 2 & 1].map(|bit| 0.06 * bit as f64 - 0.03);
    let corners: Vec<[f64; 3]> = (0..8).map(corner).collect();
    let hull = Part { surface: PartSurface::Link, shape: Primitive::Hull(Hull::of(&corners).unwrap()) };
    let ball = Primitive::Capsule { from: [0.0; 3], to: [0.0; 3], radius: 0.01 };
    let description = HandDescription {
        name: "gripper".to_owned(),
        side: Side::Right,
        bodies: vec![
            Body { inertial: None, ..body("world", None, Placing::at([0.0, 0.0, 0.1]), vec![hull]) },
            body("left", Some(0), Placing::at([-0.06, 0.0, 0.05]), finger(0)),
            body(
                "right",
                Some(0),
                Placing { position_m: [0.06, 0.0, 0.05], orientation_wxyz: [0.0, 0.0, 0.0, 1.0] },
                vec![],
            ),
            body("tip", Some(2), Placing { position_m: [0.0, 0.0, 0.002], orientation_wxyz: UPRIGHT }, finger(1)),
            body(
                "plinth",
                None,
                Placing { position_m: [0.4, 0.0, 0.0], orientation_wxyz: SKEW },
                vec![Part { surface: PartSurface::Link, shape: ball }],
            ),
        ],
        joints: vec![
            joint("object", 1, JointMotion::Slide, [1.0, 0.0, 0.0], [0.0, 0.04]),
            joint("right", 2, JointMotion::Slide, [1.0, 0.0, 0.0], [0.0, 0.04]),
            joint("tip", 3, JointMotion::Hinge, [0.0, 0.6, 0.8], [-0.5, 0.5]),
            joint("plinth", 4, JointMotion::Hinge, [0.0, 0.0, 1.0], [-1.0, 1.0]),
        ],
        pads: vec![
            TouchPad {
                name: "left".to_owned(),
                body: 1,
                place: Placing::at([0.0, 0.0, 0.02]),
                profile: Default::default(),
            },
            TouchPad {
                name: "right".to_owned(),
                body: 3,
                place: Placing::at([0.0, 0.0, 0.02]),
                profile: Default::default(),
            },
        ],
        apart: vec![[1, 3]],
        palm_centre_m: None,
        grasp: Some(GraspPoint { body: Some(0), point_m: [0.0, 0.0, 0.07] }),
    };
    Hand::new(description).unwrap()
}

/// Returns a gait that closes the fingers of the gripper.
fn closing() -> Gait {
    let shut = vec![0.03, 0.03, 0.0, 0.0];
    Gait {
        torque_limit_nm: 20.0,
        open_pose: vec![0.0; 4],
        table: vec![shut; 2],
        ..gait::find("bal").unwrap().1.clone()
    }
}

#[test]
fn kinematics_of_any_tree_agree_with_mujoco() {
    let (hand, cube) = (gripper(), catalogue::load("cube70", &mut Vec::new()).unwrap());
    let start = EpisodeStart::draw(&cube, &closing(), &hand, &Randomisation::none(), 0);
    let mut simulation = Simulation::new(&hand, &cube, &start.physics).unwrap();
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(2);
    for _ in 0..100 {
        let joints: Vec<f64> = hand.ranges().into_iter().map(|[low, high]| rng.random_range(low..=high)).collect();
        simulation.reset(&joints, start.object);
        assert_eq!((simulation.joints(), simulation.object_pose()), (joints.clone(), start.object));
        for (body, ours) in hand.body_poses(&joints).into_iter().enumerate() {
            let distance = (ours.to_homogeneous() - simulation.body_pose(body).unwrap().to_homogeneous()).abs().max();
            assert!(distance < 1e-9, "{}: {distance:e}", hand.bodies()[body].name);
        }
    }
}

#[test]
fn drives_are_those_of_each_joint() {
    let (hand, cube) = (gripper(), catalogue::load("cube70", &mut Vec::new()).unwrap());
    let mut physics = EpisodeStart::draw(&cube, &closing(), &hand, &Randomisation::none(), 0).physics;
    (physics.stiffness_factor, physics.torque_limit) = (1.5, 30.0);
    let text = mjcf::model(&hand, &cube, &physics);
    assert!(text.contains(r#"name="hand:tip" joint="hand:tip" kp="1200" forcerange="-20 20""#), "{text}");
    assert!(text.contains(r#"damping="20" armature="0.01" frictionloss="0.1""#), "{text}");
    physics.torque_limit = 3.0;
    assert!(mjcf::model(&hand, &cube, &physics).contains(r#"forcerange="-3 3""#));
}

#[test]
fn two_pads_hold_a_cube_at_the_grasp() {
    let (hand, cube) = (gripper(), catalogue::load("cube70", &mut Vec::new()).unwrap());
    let randomisation = Randomisation::none();
    let mut gait = closing();
    (gait.start_xy_m, gait.gravity) = ([0.0, 0.0], [0.0, 0.0, -0.01]);
    let config = EpisodeConfig { hand: Arc::clone(&hand), gait, seed: 1, duration_s: 2.0, randomisation };
    let mut episode = Episode::new(&cube, &config).unwrap();
    assert!((episode.start().object.origin().coords().z - 0.17).abs() < 1e-3, "its middle is at the grasp");
    assert_eq!(episode.state().scene.shear.len(), 2);
    let refused = episode.direct(Directive::SwitchGait("bal".to_owned())).unwrap_err().to_string();
    assert!(refused.contains("gripper has no shipped gaits"), "{refused}");
    let outcome = run(&mut episode);
    assert_eq!((outcome.end, outcome.per_pad_contact.len()), (End::Completed, 2));
    assert!(outcome.per_pad_contact.iter().all(|share| *share > 0.5), "{:?}", outcome.per_pad_contact);
}

#[test]
fn a_gait_for_another_number_of_joints_and_no_hand_at_all_are_no_faults() {
    let cube = catalogue::load("cube70", &mut Vec::new()).unwrap();
    for hand in [gripper(), Hand::none()] {
        for gait in ["bal", "air_ball"] {
            let gait = gait::find(gait).unwrap().1.clone();
            let config = EpisodeConfig {
                hand: Arc::clone(&hand),
                gait,
                seed: 1,
                duration_s: 1.5,
                randomisation: Randomisation::default(),
            };
            let outcome = run(&mut Episode::new(&cube, &config).unwrap());
            assert_eq!(outcome.per_pad_contact.len(), hand.pads().len());
        }
    }
}
