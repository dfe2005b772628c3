//! MuJoCo's own poses of the links of a hand.

use mujoco_rs::prelude::*;
use mvt_hands::LoadedHand;
use mvt_robot::nalgebra as na;

/// Returns the greatest distance between the poses of the hand's bodies and MuJoCo's for the same joint values, metres and radians, over
/// random values. `base` is the name of the body that is the base, if it is not the world. The joints and bodies have the same names; a body
/// with a joint is compared at the joint's anchor.
pub fn greatest_difference(
    loaded: &LoadedHand,
    model: &MjModel,
    base: Option<&str>,
    mut random: impl FnMut() -> f64,
) -> f64 {
    let hand = &loaded.hand;
    let mut data = MjData::new(model);
    let mut worst = 0.0f64;
    for _ in 0..100 {
        let joints: Vec<f64> = hand.ranges().iter().map(|[low, high]| low + (high - low) * random()).collect();
        for (joint, value) in hand.joints().iter().zip(&joints) {
            let id = model.name_to_id(MjtObjBase::mjOBJ_JOINT, &joint.name).unwrap();
            data.qpos_mut()[usize::try_from(model.jnt_qposadr()[id]).unwrap()] = *value;
        }
        data.forward();
        let pose = |body: usize, [x, y, z]: [f64; 3]| {
            let [w, i, j, k] = data.xquat()[body];
            let turn = na::UnitQuaternion::from_quaternion(na::Quaternion::new(w, i, j, k));
            na::Isometry3::from_parts(na::Translation3::new(x, y, z), turn)
        };
        let poses = hand.body_poses(&joints);
        let theirs = base.map_or_else(na::Isometry3::identity, |base| {
            let body = model.name_to_id(MjtObjBase::mjOBJ_BODY, base).unwrap();
            pose(body, data.xpos()[body])
        });
        let mut compared = 0;
        for (k, body) in hand.bodies().iter().enumerate() {
            let Some(id) = model.name_to_id(MjtObjBase::mjOBJ_BODY, &body.name) else { continue };
            let joint = hand.joint_of(k).map(|joint| &hand.joints()[joint].name);
            let [x, y, z] = joint
                .map_or([0.0; 3], |name| model.jnt_pos()[model.name_to_id(MjtObjBase::mjOBJ_JOINT, name).unwrap()]);
            let expected = theirs.inverse() * pose(id, data.xpos()[id]) * na::Translation3::new(x, y, z);
            let found = poses[0].inverse() * poses[k];
            let difference = expected.inverse() * found;
            worst = worst.max(difference.translation.vector.norm()).max(difference.rotation.angle());
            compared += 1;
        }
        assert!(compared > hand.joints().len(), "{compared} bodies compared");
    }
    worst
}
