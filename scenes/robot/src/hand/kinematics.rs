//! Forward kinematics.

use mvt_frames::{Camera, Gel, Isometry, Pad, World};
use nalgebra as na;

use super::{Hand, JointMotion, Placing};
use crate::digit;

impl Hand {
    /// Returns the poses of all bodies in the world.
    pub fn body_poses(&self, joints: &[f64]) -> Vec<na::Isometry3<f64>> {
        // The poses in the frame of the root, whose own pose multiplies them last.
        let mut chained: Vec<(na::Isometry3<f64>, na::Isometry3<f64>)> = Vec::with_capacity(self.bodies().len());
        for (k, body) in self.bodies().iter().enumerate() {
            let place = untyped(&body.place);
            let pose = match body.parent {
                None => (place, self.moved(k, na::Isometry3::identity(), joints)),
                Some(parent) => {
                    let (root, pose) = chained[parent];
                    (root, pose * self.moved(k, place, joints))
                }
            };
            chained.push(pose);
        }
        chained.into_iter().map(|(root, pose)| root * pose).collect()
    }

    /// Returns the place of a body as its joint moves it.
    fn moved(&self, body: usize, place: na::Isometry3<f64>, joints: &[f64]) -> na::Isometry3<f64> {
        let Some(j) = self.joint_of(body) else { return place };
        let (joint, value) = (&self.joints()[j], joints.get(j).copied().unwrap_or(0.0));
        let along = na::Vector3::from(joint.axis) * value;
        match joint.motion {
            JointMotion::Hinge => {
                let rotation = na::UnitQuaternion::from_scaled_axis(along);
                na::Isometry3::from_parts(place.translation, place.rotation * rotation)
            }
            JointMotion::Slide => place * na::Translation3::from(along),
        }
    }

    /// Returns the poses of the bodies that carry the pads, in the order of the pads.
    pub fn world_from_pads(&self, joints: &[f64]) -> Vec<Isometry<Pad, World>> {
        let poses = self.body_poses(joints);
        self.pads().iter().map(|pad| Isometry::new(poses[pad.body])).collect()
    }

    /// Returns the poses of the gel frames of all pads.
    pub fn world_from_gels(&self, joints: &[f64]) -> Vec<Isometry<Gel, World>> {
        let carried = self.pads().iter().zip(self.world_from_pads(joints));
        carried.map(|(pad, body)| body * pad.place.isometry::<Gel, Pad>()).collect()
    }

    /// Returns the poses of the cameras of all touch sensors.
    pub fn world_from_touch_cameras(&self, joints: &[f64]) -> Vec<Isometry<Camera, World>> {
        self.world_from_gels(joints).into_iter().map(|gel| gel * digit::gel_from_camera()).collect()
    }
}

fn untyped(place: &Placing) -> na::Isometry3<f64> {
    place.isometry::<Pad, World>().untyped()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hand::Side;

    #[test]
    fn left_hand_is_the_mirror_image() {
        let right: Vec<f64> = (0..16).map(|j| 0.3 + 0.05 * f64::from(j)).collect();
        let left = Hand::allegro(Side::Left).mirrored(&right);
        let poses = |side, joints: &[f64]| Hand::allegro(side).world_from_pads(joints);
        for (pad, (r, l)) in poses(Side::Right, &right).into_iter().zip(poses(Side::Left, &left)).enumerate() {
            let (r, l) = (r.to_matrix(), l.to_matrix());
            for (row, col) in (0..3).flat_map(|r| (0..4).map(move |c| (r, c))) {
                let flips = (row == 1) != (col == 1);
                let mirrored = if flips { -r[row][col] } else { r[row][col] };
                assert!((l[row][col] - mirrored).abs() < 1e-12, "{pad} {row} {col}");
            }
        }
    }

    #[test]
    fn a_sliding_joint_moves_along_its_axis() {
        let mut description = Hand::allegro(Side::Right).description().clone();
        description.joints[0].motion = JointMotion::Slide;
        let hand = Hand::new(description).unwrap();
        let at = |metres: f64| hand.body_poses(&[metres])[1].translation.vector;
        let axis = hand.body_poses(&[0.0])[1].rotation * na::Vector3::from(hand.joints()[0].axis);
        assert!((at(0.02) - at(0.0) - axis * 0.02).norm() < 1e-15);
    }
}
