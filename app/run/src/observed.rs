//! The part of the true surface that the sensors of a run have measured. Scores alone use it.

use std::collections::HashSet;

use glam::{IVec3, Vec3, Vec3A};
use mvt_frames::{Isometry, Object, World};
use mvt_slam::scan::Scan;

/// Edge of the cells that collect measured points, metres: well below [`REACH_M`].
const CELL_M: f32 = 0.001;
/// A point of the surface this close to a measured one was observed, metres: about three standard deviations of a camera's depth.
pub const REACH_M: f32 = 0.004;
/// Every Nth scan is collected: in 0.1 s an object turns by a few degrees.
const EVERY: usize = 3;

/// Measured points of the object in its true coordinates.
#[derive(Debug, Clone, Default)]
pub struct Observed {
    cells: HashSet<IVec3>,
}

impl Observed {
    /// Adds the hits of a scan, given the true pose.
    pub fn add(&mut self, scan: &Scan, world_from_object: Isometry<Object, World>) {
        if !scan.frame.is_multiple_of(EVERY) {
            return;
        }
        let (rotation, translation) = world_from_object.inverse().to_f32();
        for view in &scan.views {
            let points = view.hits.iter().map(|hit| rotation * Vec3A::from(view.point(hit)) + translation);
            self.cells.extend(points.map(|point| (point / CELL_M).floor().as_ivec3()));
        }
    }

    /// Returns the measured points, at most one per cubic millimetre, in the object's frame, metres.
    pub fn points(&self) -> Vec<Vec3> {
        self.cells.iter().map(|cell| (cell.as_vec3() + 0.5) * CELL_M).collect()
    }
}

#[cfg(test)]
mod tests {
    use mvt_slam::scan::{Detail, Hit, View};

    use super::*;

    #[test]
    fn hits_are_collected_where_they_lie_on_the_object() {
        let mut scan = Scan { frame: 0, time_s: 0.0, obstacles: Vec::new(), views: Vec::new() };
        let hit = Hit { direction: Vec3::Z, range_m: 0.4, normal: Vec3::NEG_Z, cosine: 1.0, sigma_m: 0.001 };
        let detail = Detail::Touch { index: 0, pad: None };
        scan.views.push(View { origin: Vec3::new(0.1, 0.0, 0.0), hits: vec![hit], misses: Vec::new(), detail });
        // Half a turn about z at (0.1, 0.2, 0.3): the hit lies at (0, 0.2, 0.1) on the object.
        let pose = Isometry::from_parts([0.1, 0.2, 0.3], [0.0, 0.0, 0.0, 1.0]);
        let mut observed = Observed::default();
        observed.add(&scan, pose);
        observed.add(&scan, pose);
        let [point] = observed.points()[..] else { panic!("{:?}", observed.points()) };
        assert!(point.distance(Vec3::new(0.0, 0.2, 0.1)) < CELL_M, "{point}");
        scan.frame = 1;
        observed.add(&scan, Isometry::identity());
        assert_eq!(observed.points().len(), 1, "only every third scan is collected");
    }
}
