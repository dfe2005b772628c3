//! A frame that is kept, to be replayed and refined.

use std::sync::Arc;

use glam::{Mat3A, Vec3, Vec3A};
use mvt_frames::{Isometry, Model, World};
use mvt_robot::hand::solid::Occupied;
use nalgebra as na;

use crate::scan::Scan;

/// Points inside the hand that a keyframe keeps.
const OCCUPIED_KEPT: usize = 1500;

/// A scan with the pose that the object had.
#[derive(Debug, Clone)]
pub struct Keyframe {
    scan: Arc<Scan>,
    pose: na::Isometry3<f64>,
    /// Points inside the hand and within the box, model frame.
    occupied: Vec<Occupied>,
    rotation: Mat3A,
    translation: Vec3A,
}

impl Keyframe {
    /// `occupied` are points inside the hand, world frame; those in the box are kept.
    pub(super) fn new(
        scan: Arc<Scan>,
        pose: na::Isometry3<f64>,
        occupied: impl Iterator<Item = Occupied>,
        half_extent_m: f32,
    ) -> Self {
        let mut keyframe =
            Self { scan, pose, occupied: Vec::new(), rotation: Mat3A::IDENTITY, translation: Vec3A::ZERO };
        keyframe.set_pose(pose);
        let to_model = |o: Occupied| Occupied { point: keyframe.to_model(o.point), ..o };
        keyframe.occupied = occupied.map(to_model).filter(|o| o.point.abs().max_element() < half_extent_m).collect();
        keyframe
    }

    /// What was measured.
    pub fn scan(&self) -> &Scan {
        &self.scan
    }

    /// The pose of the object, as far as it is known now.
    pub fn pose(&self) -> &na::Isometry3<f64> {
        &self.pose
    }

    pub(super) fn set_pose(&mut self, pose: na::Isometry3<f64>) {
        self.pose = pose;
        (self.rotation, self.translation) = Isometry::<World, Model>::new(pose.inverse()).to_f32();
    }

    /// A point of the world in the model's frame.
    pub(super) fn to_model(&self, p: Vec3) -> Vec3 {
        (self.rotation * Vec3A::from(p) + self.translation).into()
    }

    /// A direction of the world in the model's frame.
    pub(super) fn turn_to_model(&self, d: Vec3) -> Vec3 {
        (self.rotation * Vec3A::from(d)).into()
    }

    /// Keeps a part of the points inside the hand: enough to draw samples from, at a tenth of the memory.
    pub(super) fn thin_occupied(&mut self) {
        let stride = self.occupied.len().div_ceil(OCCUPIED_KEPT).max(1);
        self.occupied = self.occupied.iter().copied().step_by(stride).collect();
    }

    /// Points inside the hand, model frame.
    pub(super) fn occupied(&self) -> &[Occupied] {
        &self.occupied
    }
}
