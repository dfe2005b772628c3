//! Confidence of a pose.

use super::{Tracker, ask, ask_measured, sigma};
use crate::tracker::Reference;

/// Evidence for a pose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Assessment {
    /// 0 to 1: the part of the measurements that agrees with the pose.
    pub confidence: f64,
    /// Part of the cameras' points that lie on the surface; `None` without any.
    pub camera_inliers: Option<f64>,
    /// Part of the touched points that lie on the surface; `None` without any.
    pub touch_inliers: Option<f64>,
    /// Part of the places that must be free of the object and are.
    pub free: f64,
}

/// A point farther from the surface than this many standard deviations speaks against the pose.
const INLIER_SIGMAS: f32 = 3.0;
/// A violation of free space below this is noise, metres.
const FREE_TOLERANCE_M: f32 = 0.003;
/// Fewer points than these say nothing about a pose.
const FEWEST_POINTS: usize = 15;

impl Tracker {
    /// Judges the newest pose. Without enough measurements the confidence is 0.
    pub fn assess(&self, shape: &dyn Reference) -> Assessment {
        let nothing = Assessment { confidence: 0.0, camera_inliers: None, touch_inliers: None, free: 1.0 };
        let Some(instant) = self.window.back() else { return nothing };
        let (_, distances, trusted) = ask_measured(shape, &instant.pose, instant.measured.iter().map(|m| m.point));
        // Weighted points, and of these the inliers; camera first.
        let mut sums = [[0.0; 2]; 2];
        let mut count = 0;
        for (i, m) in instant.measured.iter().enumerate().filter(|(i, _)| trusted[*i]) {
            let inlier = distances[i].value_m.abs() < INLIER_SIGMAS * sigma(shape, m.sigma_m);
            let sum = &mut sums[usize::from(m.is_touch)];
            sum[0] += m.share;
            sum[1] += if inlier { m.share } else { 0.0 };
            count += 1;
        }
        let part = |[all, inliers]: [f64; 2]| (all > 0.0).then(|| inliers / all);
        let vacant = instant.occupied.iter().chain(&instant.passed);
        let (_, distances, trusted) = ask(shape, &instant.pose, vacant.clone().map(|v| v.point));
        let asked = trusted.iter().filter(|&&t| t).count();
        let violated = vacant
            .enumerate()
            .filter(|(i, v)| trusted[*i] && distances[*i].value_m < v.clearance_m - FREE_TOLERANCE_M)
            .count();
        // One of one that is violated is chance, not evidence.
        let free = 1.0 - violated as f64 / asked.max(FEWEST_POINTS) as f64;
        if count < FEWEST_POINTS {
            return Assessment { free, ..nothing };
        }
        let all = [sums[0][0] + sums[1][0], sums[0][1] + sums[1][1]];
        Assessment {
            confidence: part(all).unwrap_or(0.0) * free,
            camera_inliers: part(sums[0]),
            touch_inliers: part(sums[1]),
            free,
        }
    }
}
