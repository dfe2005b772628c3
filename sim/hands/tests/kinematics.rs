//! Poses of links and places of pads, compared with MuJoCo's.

#![allow(clippy::unwrap_used, reason = "a failed assumption in a test is a failed test")]

use crate::common;
use mujoco_rs::prelude::*;
use mvt_hands::HandFile;
use mvt_robot::hand::{Hand, PartSurface, Primitive, Side};
use mvt_robot::nalgebra as na;
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

#[test]
fn links_of_an_mjcf_are_where_mujoco_puts_them() {
    let loaded = HandFile::load("tests/data/pincer.toml").unwrap();
    let model = MjModel::from_xml("tests/data/pincer.xml").unwrap();
    let mut random = ChaCha8Rng::seed_from_u64(1);
    let worst = common::greatest_difference(&loaded, &model, Some("palm"), || random.random());
    assert!(worst < 1e-9, "{worst}");
}

#[test]
fn links_of_a_urdf_are_where_mujoco_puts_them() {
    let loaded = HandFile::load("tests/data/claw.toml").unwrap();
    let model = MjModel::from_xml("tests/data/claw.urdf").unwrap();
    let mut random = ChaCha8Rng::seed_from_u64(2);
    let worst = common::greatest_difference(&loaded, &model, None, || random.random());
    assert!(worst < 1e-9, "{worst}");
}

#[test]
fn masses_are_those_that_mujoco_computes() {
    for (file, model) in
        [("tests/data/claw.toml", "tests/data/claw.urdf"), ("tests/data/pincer.toml", "tests/data/pincer.xml")]
    {
        let loaded = HandFile::load(file).unwrap();
        let model = MjModel::from_xml(model).unwrap();
        let mut compared = 0;
        for body in loaded.hand.bodies() {
            let Some(id) = model.name_to_id(MjtObjBase::mjOBJ_BODY, &body.name) else { continue };
            // The mass of this link is estimated.
            let Some(inertial) = body.inertial.filter(|_| body.name != "b_tip") else { continue };
            let (mut ours, mut theirs) = (inertial.diagonal, model.body_inertia()[id]);
            assert!((inertial.mass_kg - model.body_mass()[id]).abs() < 1e-12, "{}", body.name);
            ours.sort_by(f64::total_cmp);
            theirs.sort_by(f64::total_cmp);
            for (ours, theirs) in ours.iter().zip(theirs) {
                assert!((ours / theirs - 1.0).abs() < 1e-6, "{}: {ours} {theirs}", body.name);
            }
            compared += 1;
        }
        assert!(compared >= 3, "{file}: {compared}");
    }
}

#[test]
fn the_pincer_is_as_its_file_says() {
    let loaded = HandFile::load("tests/data/pincer.toml").unwrap();
    let hand = &loaded.hand;
    assert_eq!((hand.name(), hand.side()), ("pincer", Side::Right));
    let names: Vec<&str> = hand.bodies().iter().map(|body| body.name.as_str()).collect();
    assert_eq!(names, ["palm", "left_base", "left_frame", "left_tip", "left_sensor", "right_tip", "right_sensor"]);
    assert_eq!(loaded.fingers["left"], [0, 1]);
    assert_eq!(hand.joints()[2].name, "right_turn");
    let drives: Vec<[f64; 3]> =
        hand.joints().iter().map(|joint| joint.drive).map(|d| [d.stiffness, d.damping, d.torque_limit]).collect();
    // The limits of torque are the model's: of the joint itself, none, and of an actuator with a gear.
    assert_eq!(drives, [[3.0, 0.2, 0.6], [3.0, 0.2, 0.7], [5.0, 0.2, 0.45]]);
    assert_eq!(hand.joints().iter().map(|joint| joint.mirrors).collect::<Vec<_>>(), [false, false, true]);
    assert_eq!(hand.ranges(), [[-0.8, 1.2], [-0.01, 0.02], [-0.5, 1.5]]);
    // The base stands where the file says, and its free joint and visual geom are gone.
    let base = hand.body_poses(&[])[0];
    assert!((base.translation.vector - na::Vector3::new(0.0, 0.01, 0.02)).norm() < 1e-15);
    assert_eq!(hand.bodies()[0].parts.len(), 2);
    // Of the fingertip remains the mesh; its replaced box is gone, and both have gels.
    assert!(matches!(hand.bodies()[3].parts[0].shape, Primitive::Hull(_)));
    assert!(hand.bodies()[5].parts.is_empty());
    for (pad, body) in hand.pads().iter().zip([4, 6]) {
        assert_eq!(pad.body, body);
        assert_eq!(hand.bodies()[body].parts.len(), 2);
    }
    // The palm is excluded from the fingertip, and so from its sensor.
    assert!(hand.description().apart.contains(&[0, 3]) && hand.description().apart.contains(&[0, 4]));
    assert_eq!(loaded.cameras.len(), 2);
    assert_eq!((loaded.cameras[1].intrinsics.width, loaded.cameras[1].intrinsics.fy), (320, 300.0));
    let warned = |words: &str| loaded.warnings.iter().any(|warning| warning.contains(words));
    assert!(warned("1 links that do not hang on palm are left out"), "{:?}", loaded.warnings);
    assert!(warned("the equality constraint both couples left_turn and right_turn"), "{:?}", loaded.warnings);
    assert!(warned("pad left lies in"), "{:?}", loaded.warnings);
}

#[test]
fn a_site_and_a_link_carry_a_pad_where_mujoco_has_them() {
    let loaded = HandFile::load("tests/data/pincer.toml").unwrap();
    let model = MjModel::from_xml("tests/data/pincer.xml").unwrap();
    let mut data = MjData::new(&model);
    let joints = [0.3, 0.004, -0.2];
    for (joint, value) in ["left_turn", "left_slide", "right_turn"].iter().zip(joints) {
        let id = model.name_to_id(MjtObjBase::mjOBJ_JOINT, joint).unwrap();
        data.qpos_mut()[usize::try_from(model.jnt_qposadr()[id]).unwrap()] = value;
    }
    data.forward();
    let palm = model.name_to_id(MjtObjBase::mjOBJ_BODY, "palm").unwrap();
    let pose = |[x, y, z]: [f64; 3], m: [f64; 9]| {
        let turn = na::Rotation3::from_matrix_unchecked(na::Matrix3::from_row_slice(&m));
        na::Isometry3::from_parts(na::Translation3::new(x, y, z), na::UnitQuaternion::from_rotation_matrix(&turn))
    };
    let world_from_palm = pose(data.xpos()[palm], data.xmat()[palm]);
    let site = model.name_to_id(MjtObjBase::mjOBJ_SITE, "left_pad").unwrap();
    let tip = model.name_to_id(MjtObjBase::mjOBJ_BODY, "right_tip").unwrap();
    let of_file = na::Isometry3::from_parts(
        na::Translation3::new(0.04, 0.0, -0.012),
        na::UnitQuaternion::from_scaled_axis(na::Vector3::y() * -std::f64::consts::FRAC_PI_2),
    );
    let expected = [
        pose(data.site_xpos()[site], data.site_xmat()[site]) * na::Translation3::new(0.001, 0.0, 0.0),
        pose(data.xpos()[tip], data.xmat()[tip]) * of_file,
    ];
    let base = loaded.hand.body_poses(&joints)[0];
    for (expected, found) in expected.iter().zip(loaded.hand.world_from_gels(&joints)) {
        let difference = (world_from_palm.inverse() * expected).inverse() * (base.inverse() * found.untyped());
        assert!(difference.translation.vector.norm() < 1e-9 && difference.rotation.angle() < 1e-7, "{difference}");
    }
}

#[test]
fn the_claw_is_as_its_file_says() {
    let loaded = HandFile::load("tests/data/claw.toml").unwrap();
    let hand = &loaded.hand;
    assert_eq!((hand.name(), hand.side()), ("claw", Side::Left));
    // The tip without a mass is weighed.
    assert!(loaded.warnings.iter().any(|warning| warning.contains("link b_tip has no mass")), "{:?}", loaded.warnings);
    assert_eq!(hand.ranges()[1], [-0.3, 1.6]);
    let limits: Vec<f64> = hand.joints().iter().map(|joint| joint.drive.torque_limit).collect();
    assert_eq!(limits, [0.8, 0.7, 20.0, 1.0]);
    // A shape of the link is the gel, without a housing.
    let tip = hand.pads()[1].body;
    assert_eq!(hand.bodies()[tip].name, "b_tip");
    assert_eq!(hand.bodies()[tip].parts.iter().map(|part| part.surface).collect::<Vec<_>>(), [PartSurface::Gel(1)]);
    // The visual ball of half a metre is not in the way.
    assert_eq!(hand.bodies()[tip].parts.len(), 1);
    let [x, y, z] = hand.grasp_centre(&[]).unwrap().coords().into();
    assert!((x - 0.05).abs() < 1e-12 && y.abs() < 1e-12 && (z - 0.14).abs() < 1e-12);
    // The camera looks at the point of grasp.
    let (u, v) = loaded.cameras[0]
        .intrinsics
        .project(loaded.cameras[0].pose.inverse() * hand.grasp_centre(&[]).unwrap())
        .unwrap();
    assert!((u - 319.5).abs() < 1e-6 && (v - 239.5).abs() < 1e-6);
}

#[test]
fn a_held_joint_leaves_the_hand() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["pincer.xml", "meshes/wedge.stl"] {
        std::fs::create_dir_all(folder.path().join("meshes")).unwrap();
        std::fs::copy(format!("tests/data/{name}"), folder.path().join(name)).unwrap();
    }
    let path = folder.path().join("held.toml");
    let text = std::fs::read_to_string("tests/data/pincer.toml").unwrap();
    let text = text.replace("[\"left_turn\", \"left_slide\"]", "[\"left_slide\"]");
    std::fs::write(&path, format!("{text}\n[joint.left_turn]\nheld_at = 0.7\n")).unwrap();
    let (held, free) = (HandFile::load(&path).unwrap(), HandFile::load("tests/data/pincer.toml").unwrap());
    assert_eq!(held.hand.joints().len(), 2);
    let (a, b) = (held.hand.body_poses(&[0.01, 0.4]), free.hand.body_poses(&[0.7, 0.01, 0.4]));
    for (a, b) in a.iter().zip(&b) {
        assert!((a.inverse() * b).translation.vector.norm() < 1e-12);
    }
    // The equality constraint ties one joint to one that is held.
    assert!(!held.warnings.iter().any(|warning| warning.contains("couples")), "{:?}", held.warnings);
}

#[test]
fn a_hand_comes_back_from_its_text() {
    for file in ["tests/data/pincer.toml", "tests/data/claw.toml"] {
        let loaded = HandFile::load(file).unwrap();
        let text = toml::to_string(loaded.hand.description()).unwrap();
        let again = Hand::new(toml::from_str(&text).unwrap()).unwrap();
        assert_eq!(again.description(), loaded.hand.description(), "{file}");
        // And so does the file itself.
        let file = HandFile::read(file).unwrap();
        assert_eq!(toml::from_str::<HandFile>(&toml::to_string(&file).unwrap()).unwrap(), file);
    }
}
