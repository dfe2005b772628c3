//! Scan to scan: the surface that one frame shows lies on the one that another shows (point to plane, matched by where a camera
//! that stands still sees them).

use glam::Vec3;
use nalgebra as na;

use super::{Instant, apply, to_na};
use crate::scan::Scan;
use mvt_graph::system::{Loss, System, along};

/// How two frames are matched.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Matching {
    /// At most so many points are matched.
    pub points: usize,
    /// All together weigh as much as so many independent points.
    pub independent: f64,
    /// Points farther apart than this are no match, metres.
    pub reach_m: f32,
}

/// Points of frames whose poses are known well that are farther apart than this are no match, metres.
pub(crate) const REACH_M: f32 = 0.006;
/// Within [`REACH_M`] cost grows with the logarithm from this many standard deviations on; within a wider reach from so much more.
const ROBUST_SIGMAS: f64 = 2.0;

/// A scan and the pose that the object has in it.
#[derive(Clone, Copy)]
pub(crate) struct Posed<'a> {
    pub scan: &'a Scan,
    pub pose: &'a na::Isometry3<f64>,
}

impl<'a> Posed<'a> {
    pub(super) fn new(instant: &'a Instant) -> Self {
        Self { scan: &instant.scan, pose: &instant.pose }
    }
}

/// Adds the matches of two frames: points of `b` are matched against `a`. Returns how many points were tried and how many found a match.
pub(crate) fn add(
    system: &mut System,
    a: (Option<usize>, Posed<'_>),
    b: (Option<usize>, Posed<'_>),
    matching: Matching,
) -> [usize; 2] {
    let Matching { points, independent, reach_m } = matching;
    let robust = Loss::Cauchy(ROBUST_SIGMAS * f64::from(reach_m / REACH_M));
    let ((index_a, a), (index_b, b)) = (a, b);
    let back = [a.pose, b.pose].map(na::Isometry3::inverse);
    let b_to_a = a.pose * back[1];
    let (mut tried, mut matched) = (0, 0);
    for view_b in &b.scan.views {
        let Some(view_a) = a.scan.views.iter().find(|view| view.sensor() == view_b.sensor()) else { continue };
        let Some(lookup) = view_a.lookup() else { continue };
        let used = view_b.hits.len().min(points);
        let share = (independent / used.max(1) as f64).min(1.0);
        tried += used;
        for hit in &view_b.hits[..used] {
            let point = view_b.point(hit);
            let moved = apply(&b_to_a, point);
            let Some(other) = lookup.at(moved).and_then(|i| view_a.hits.get(i)) else { continue };
            let gap = moved - view_a.point(other);
            if other.normal == Vec3::ZERO || gap.length_squared() > reach_m * reach_m {
                continue;
            }
            matched += 1;
            let s = 1.0 / f64::from(hit.sigma_m.hypot(other.sigma_m));
            let inside = back[0].rotation * to_na(other.normal);
            let material = back[1] * na::Point3::from(to_na(point));
            let j = along(inside, material.coords) * s;
            let r = f64::from(other.normal.dot(gap)) * s;
            system.add(r, &[(index_a, j), (index_b, -j)], share, robust);
        }
    }
    [tried, matched]
}
