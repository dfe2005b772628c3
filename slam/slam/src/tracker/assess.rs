//! Confidence and variance of a pose.

use nalgebra as na;

use super::query::{ask_measured, ask_values, in_model, surface, trust_empty};
use super::{ROBUST_SIGMAS, Tracker, sigma, to_na};
use crate::deviation::Variance;
use crate::tracker::Reference;
use mvt_graph::system::Loss;

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

/// Size of the objects, at which a rotation and a translation move the surface alike, metres.
pub(super) const LEVER_M: f64 = 0.04;
/// Error of the normals of a learnt surface, radians. It makes faces look uneven and round things cornered, as if they held a pose.
const NORMAL_SIGMA_RAD: f64 = 0.1;
/// Prior of a pose without measurements: one standard deviation of translation, metres, and rotation, radians. About the motion
/// from one keyframe to the next.
const PRIOR: [f64; 2] = [0.02, 0.5];

impl Tracker {
    /// The variance of the newest pose against the shape: the inverse of the information of its points, J J^T of each distance, and of
    /// the places whose colours earlier views show, weighted as in the solver.
    pub(crate) fn variance(&self, shape: &dyn Reference) -> Variance {
        let mut information = na::Matrix6::<f64>::zeros();
        // The information that wrong normals alone would give. An object of revolution does not tell its rotation, but a learnt one seems to.
        let mut spurious = na::Matrix6::<f64>::zeros();
        if let Some(instant) = self.window.back() {
            let (points, distances, trusted) =
                ask_measured(shape, &instant.pose, instant.measured.iter().map(|m| m.point));
            for (i, m) in instant.measured.iter().enumerate().filter(|(i, _)| trusted[*i]) {
                let (residual, mut by_pose) = surface(points[i], distances[i]);
                by_pose.fixed_rows_mut::<3>(3).scale_mut(1.0 / LEVER_M);
                let precision = 1.0 / f64::from(sigma(shape, m.sigma_m));
                let weight = m.share * precision.powi(2) * Loss::Cauchy(ROBUST_SIGMAS).at(residual * precision).1;
                let mut by_normal = na::Matrix6x3::zeros();
                by_normal.fixed_view_mut::<3, 3>(0, 0).fill_with_identity();
                by_normal.fixed_view_mut::<3, 3>(3, 0).copy_from(&(to_na(points[i]) / LEVER_M).cross_matrix());
                information += weight * by_pose * by_pose.transpose();
                spurious += weight * NORMAL_SIGMA_RAD.powi(2) * by_normal * by_normal.transpose();
            }
        }
        let mut lever = na::Vector6::repeat(1.0);
        lever.fixed_rows_mut::<3>(3).fill(1.0 / LEVER_M);
        let lever = na::Matrix6::from_diagonal(&lever);
        information += lever * self.colour_information() * lever;
        let largest = |information: na::Matrix6<f64>, at: usize| {
            let covariance = covariance(information);
            covariance.fixed_view::<3, 3>(at, at).into_owned().symmetric_eigenvalues().max()
        };
        Variance {
            translation_m2: largest(information, 0),
            rotation_rad2: largest(information - spurious, 3) / LEVER_M.powi(2),
        }
    }

    /// Judges the newest pose. Without enough measurements the confidence is 0.
    pub fn assess(&self, shape: &dyn Reference) -> Assessment {
        let nothing = Assessment { confidence: 0.0, camera_inliers: None, touch_inliers: None, free: 1.0 };
        let Some(instant) = self.window.back() else { return nothing };
        let points = in_model(&instant.pose, instant.measured.iter().map(|m| m.point));
        let (distances_m, mut trusted) = ask_values(shape, &points);
        trust_empty(shape, &points, &mut trusted);
        // Weighted points, and of these the inliers; camera first.
        let mut sums = [[0.0; 2]; 2];
        let mut count = 0;
        for (i, m) in instant.measured.iter().enumerate().filter(|(i, _)| trusted[*i]) {
            let inlier = distances_m[i].abs() < INLIER_SIGMAS * sigma(shape, m.sigma_m);
            let sum = &mut sums[usize::from(m.is_touch)];
            sum[0] += m.share;
            sum[1] += if inlier { m.share } else { 0.0 };
            count += 1;
        }
        let part = |[all, inliers]: [f64; 2]| (all > 0.0).then(|| inliers / all);
        let vacant = instant.occupied.iter().chain(&instant.passed);
        let (distances_m, trusted) = ask_values(shape, &in_model(&instant.pose, vacant.clone().map(|v| v.point)));
        let asked = trusted.iter().filter(|&&t| t).count();
        let violated = vacant
            .enumerate()
            .filter(|(i, v)| trusted[*i] && distances_m[*i] < v.clearance_m - FREE_TOLERANCE_M)
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

/// The covariance of a pose, rotations times [`LEVER_M`], of which this is known beside [`PRIOR`].
fn covariance(information: na::Matrix6<f64>) -> na::Matrix6<f64> {
    let eigen = information.symmetric_eigen();
    let known = eigen.eigenvectors * na::Matrix6::from_diagonal(&eigen.eigenvalues.map(|value| value.max(0.0)));
    let prior = na::Vector6::from_fn(|i, _| if i < 3 { PRIOR[0] } else { PRIOR[1] * LEVER_M }.powi(-2));
    let all = known * eigen.eigenvectors.transpose() + na::Matrix6::from_diagonal(&prior);
    // It is positive definite, but numbers that are not finite may get in.
    all.try_inverse().unwrap_or_else(na::Matrix6::identity)
}
