//! Where the object is in a frame, before anything is learnt from it: so that its pixels can be found first.

use std::sync::Arc;

use mvt_frames::{Field, Isometry, Model, World};

use super::{Knowledge, Slam, TrackState};
use crate::scan::Scan;
use crate::tracker::Tracker;

impl Slam {
    /// Returns whether the pose of the newest frame is trusted.
    pub fn is_tracking(&self) -> bool {
        self.state == TrackState::Tracking
    }

    /// Returns the pose to which the motion so far leads at a time, seconds; the last trusted one while the object is lost, and `None` before it
    /// was seen.
    pub fn predicted(&self, time_s: f64) -> Option<Isometry<Model, World>> {
        match self.state {
            TrackState::Waiting => None,
            TrackState::Lost => Some(self.model(self.pose)),
            _ => Some(self.model(self.tracker.predicted(time_s).unwrap_or(self.pose))),
        }
    }

    /// Returns the pose of the next frame as the tracker finds it at first, and which part of the measurements agrees with it. The estimator stays
    /// unchanged. `None` unless the object is tracked and measured.
    pub fn glance(&self, scan: &Arc<Scan>) -> Option<(Isometry<Model, World>, f64)> {
        if !self.is_tracking() {
            return None;
        }
        let (mut tracker, reference) = (Tracker::clone(&self.tracker), self.knowledge.reference());
        let start = tracker.predicted(scan.time_s).unwrap_or(self.pose);
        tracker.push(reference, Arc::clone(scan), start, std::iter::empty());
        tracker.align(reference, &|pose| self.knowledge.alike(pose));
        let solution = tracker.solve(reference)?;
        Some((self.model(solution.pose()), tracker.assess(reference).confidence))
    }

    /// Returns a pose of the field as one of the model.
    pub(super) fn model(&self, pose: Isometry<Field, World>) -> Isometry<Model, World> {
        match &self.knowledge {
            Knowledge::Growing(map) => pose * map.field_from_model(),
            Knowledge::Known(_) => Isometry::new(pose.untyped()),
        }
    }
}
