//! All sensors of a hand together: any number of pads, also none.

use std::sync::Arc;

use mvt_frames::depth::Label;
use mvt_frames::{Isometry, Object as ObjectFrame, World};
use mvt_objects::object::Object;
use mvt_render::observer::{Observer, ObserverOptions, ObserverScratch};
use mvt_render::tessellation::tessellate;
use mvt_render::touch::{TouchConfig, TouchError, TouchOptions};
use mvt_robot::hand::{Hand, PerPad, Primitive, Side, UPRIGHT};
use mvt_robot::observation::{GroundTruth, Observation, SceneState};
use mvt_robot::rig::PLACEMENTS;

fn ball() -> Object {
    let shape = Primitive::Ellipsoid { centre: [0.0; 3], semi: [0.02; 3], orientation_wxyz: UPRIGHT };
    Object {
        name: "ball".into(),
        mesh: tessellate(&shape, 64),
        exact: None,
        object_from_file: Isometry::identity(),
        collision: Vec::new(),
        mass_kg: 0.1,
    }
}

type Observed = (Observation, GroundTruth);

fn observed(
    hand: &Arc<Hand>,
    joints: Vec<f64>,
    object_pose: Isometry<ObjectFrame, World>,
) -> Result<Observed, TouchError> {
    let options = ObserverOptions {
        hand: Arc::clone(hand),
        cameras: vec![PLACEMENTS[3].camera(hand)],
        touch: hand.per_pad(|_| TouchOptions::new(TouchConfig::Fork)),
        touch_noise: true,
        camera_depth_noise: None,
        seed: 7,
    };
    let observer = Observer::new(&ball(), options)?;
    assert_eq!(observer.untouched_images().len(), hand.pads().len());
    let state = SceneState { time_s: 0.5, joints, object_pose, shear: PerPad::default() };
    Ok(observer.observe(3, &state, &mut ObserverScratch::default()))
}

#[test]
fn a_hand_may_have_two_pads() {
    let allegro = Hand::allegro(Side::Right);
    let mut description = allegro.description().clone();
    description.bodies.truncate(11);
    description.joints.truncate(8);
    description.pads.truncate(2);
    description.apart.clear();
    let hand = Hand::new(description).unwrap();
    let joints = vec![0.3; 16];
    // In front of the gel of the middle finger.
    let gel = allegro.world_from_gels(&joints)[1];
    let object_pose = gel * Isometry::translation(0.022 + 0.02 - 0.001, 0.0, 0.0);
    let (observation, truth) = observed(&hand, joints[..8].to_vec(), object_pose).unwrap();
    let touches: Vec<bool> = truth.touch.iter().map(|touch| touch.contact.iter().any(|touches| *touches)).collect();
    assert_eq!(touches, [false, true]);
    // The pads that both hands have deliver the same.
    let (of_all, _) = observed(&allegro, joints, object_pose).unwrap();
    assert_eq!(observation.touch[..], of_all.touch[..2]);
    assert_ne!(observation.cameras, of_all.cameras);
}

#[test]
fn there_may_be_no_hand() {
    let (observation, truth) = observed(&Hand::none(), Vec::new(), Isometry::translation(0.0, 0.0, 0.01)).unwrap();
    assert!(observation.touch.is_empty() && truth.touch.is_empty());
    assert_eq!(truth.labels[0][[240, 320]], Label::Object);
    assert!(!truth.labels[0].iter().any(|label| *label == Label::Hand));
}
