//! A frame that is kept, to be replayed and refined.

use std::sync::Arc;

use glam::{Mat3A, Vec3, Vec3A};
use mvt_frames::{Field, Isometry, Occupied, World};

use crate::scan::Scan;

/// Points inside the hand that a keyframe keeps.
const OCCUPIED_KEPT: usize = 1500;

/// A scan with the pose of the object.
#[derive(Debug, Clone)]
pub struct Keyframe {
    scan: Arc<Scan>,
    pose: Isometry<Field, World>,
    /// Points inside the hand and within the box, field frame.
    occupied: Vec<Occupied>,
    rotation: Mat3A,
    translation: Vec3A,
}

impl Keyframe {
    /// `occupied` are points inside the hand, world frame; those in the box are kept.
    pub(super) fn new(
        scan: Arc<Scan>,
        pose: Isometry<Field, World>,
        occupied: impl Iterator<Item = Occupied>,
        half_extent_m: f32,
    ) -> Self {
        let mut keyframe =
            Self { scan, pose, occupied: Vec::new(), rotation: Mat3A::IDENTITY, translation: Vec3A::ZERO };
        keyframe.set_pose(pose);
        let to_field = |o: Occupied| Occupied { point: keyframe.to_field(o.point), ..o };
        keyframe.occupied = occupied.map(to_field).filter(|o| o.point.abs().max_element() < half_extent_m).collect();
        keyframe
    }

    /// The measured rays.
    pub fn scan(&self) -> &Scan {
        &self.scan
    }

    /// The measured rays, shared.
    pub(crate) fn shared_scan(&self) -> Arc<Scan> {
        Arc::clone(&self.scan)
    }

    /// The current estimate of the object's pose.
    pub fn pose(&self) -> Isometry<Field, World> {
        self.pose
    }

    pub(super) fn set_pose(&mut self, pose: Isometry<Field, World>) {
        self.pose = pose;
        (self.rotation, self.translation) = pose.inverse().to_f32();
    }

    /// A point of the world in the field's frame.
    pub(super) fn to_field(&self, p: Vec3) -> Vec3 {
        (self.rotation * Vec3A::from(p) + self.translation).into()
    }

    /// A direction of the world in the field's frame.
    pub(super) fn turn_to_field(&self, d: Vec3) -> Vec3 {
        (self.rotation * Vec3A::from(d)).into()
    }

    /// Keeps a part of the points inside the hand: enough to draw samples from, at a tenth of the memory.
    pub(super) fn thin_occupied(&mut self) {
        let stride = self.occupied.len().div_ceil(OCCUPIED_KEPT).max(1);
        self.occupied = self.occupied.iter().copied().step_by(stride).collect();
    }

    /// Keeps of the scan what later frames are compared with.
    pub(super) fn become_earlier(&mut self) {
        self.scan = Arc::new(self.scan.earlier());
    }

    /// Points inside the hand, field frame.
    pub(super) fn occupied(&self) -> &[Occupied] {
        &self.occupied
    }
}
