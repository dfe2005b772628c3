//! The true surface, and scores of poses and shapes against it.

use glam::Vec3;
use mvt_frames::{Frame, Isometry, Object};
use mvt_mesh::Mesh;
use serde::Serialize;

use super::cloud::Cloud;
use super::sample::sample_surface_even;

/// True surface of an object as points in the object's frame. It is made once per object.
#[derive(Debug)]
pub struct TrueSurface(Cloud);

/// Average distance of closest points between an object at its true and at its estimated pose (Hinterstoisser et al. 2012; Xiang et
/// al. 2018), metres.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct AddS {
    /// Mean distance of the points at the estimated pose to the nearest point at the true pose: NeuralFeels' drift.
    pub one_directional_m: f64,
    /// Mean of `one_directional_m` and of the same in the other direction.
    pub symmetric_m: f64,
}

/// Shares of an estimated and of a true surface that lie within a threshold of one another, from 0 to 1.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[non_exhaustive]
pub struct FScore {
    /// The threshold, metres.
    pub threshold_m: f64,
    /// Share of the estimated points that are nearer than the threshold to a true one.
    pub precision: f64,
    /// Share of the true points that are nearer than the threshold to an estimated one.
    pub recall: f64,
}

impl FScore {
    /// Returns the harmonic mean of precision and recall, and 0 where both are 0: shapes that share nothing are a failure, not a gap in
    /// the data (NeuralFeels divides 0 by 0, and its means then skip the run).
    pub fn f(&self) -> f64 {
        let sum = self.precision + self.recall;
        if sum > 0.0 { 2.0 * self.precision * self.recall / sum } else { 0.0 }
    }
}

/// Comparison of an estimated surface with the true one.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct ShapeScore {
    /// One entry per threshold, in the given order.
    pub f_scores: Vec<FScore>,
    /// Mean distance of the estimated points to the nearest true one, metres: NeuralFeels' mesh error. Infinite without points.
    pub mesh_error_m: f64,
    /// Mean distance of the true points to the nearest estimated one, metres. It grows where parts are missing. Infinite without points.
    pub completeness_m: f64,
}

impl TrueSurface {
    /// Samples a mesh in the object's frame at `count` evenly spaced points: [`super::POINTS`] for figures that are reported, fewer for a
    /// display. A mesh without area has no points, and every error against it is infinite.
    pub fn new(mesh: &Mesh, count: usize, seed: u64) -> Self {
        Self::of_points(sample_surface_even(mesh, count, seed))
    }

    /// Takes these points, in the object's frame, metres. They must be finite.
    pub fn of_points(points: Vec<Vec3>) -> Self {
        Self(Cloud::new(points))
    }

    /// Returns the points, in the object's frame, metres. Neighbours stand close to one another.
    pub fn points(&self) -> &[Vec3] {
        self.0.points()
    }

    /// Returns the part of the points that is lowest along z, as a surface of its own: its recall tells whether the foot of an object was
    /// found. `share` is from 0 to 1.
    pub fn lowest(&self, share: f64) -> Self {
        let mut points = self.points().to_vec();
        points.sort_by(|a, b| a.z.total_cmp(&b.z));
        points.truncate((share.clamp(0.0, 1.0) * points.len() as f64).round() as usize);
        Self::of_points(points)
    }

    /// Divides the points into those within `reach_m` of one of these points, metres, in the object's frame, and the rest.
    pub fn divided(&self, near: &[Vec3], reach_m: f32) -> [Self; 2] {
        let distances = distances_m(&self.0, Isometry::<Object, Object>::identity(), &Cloud::new(near.to_vec()));
        let part = |is_near: bool| {
            let points = self.points().iter().zip(&distances).filter(|&(_, &d)| (d <= reach_m) == is_near);
            Self::of_points(points.map(|(&p, _)| p).collect())
        };
        [part(true), part(false)]
    }

    /// Returns the error of a pose, given the motion from the object at its estimated pose to the object at its true pose: the inverse of
    /// the true pose times the estimated pose. Infinite if the motion is not finite.
    pub fn add_s(&self, truth_from_estimate: Isometry<Object, Object>) -> AddS {
        self.add_s_of(self, truth_from_estimate)
    }

    /// Returns ADD (Hinterstoisser et al. 2012): the mean distance of each point at the estimated pose to the same point at the true pose, metres,
    /// given the motion of [`Self::add_s`]. Infinite if the motion is not finite, or without points.
    pub fn add_m(&self, truth_from_estimate: Isometry<Object, Object>) -> f64 {
        let (rotation, translation) = truth_from_estimate.to_f32();
        if !(rotation.is_finite() && translation.is_finite()) {
            return f64::INFINITY;
        }
        let apart = |&p: &Vec3| (Vec3::from(rotation * glam::Vec3A::from(p) + translation) - p).length();
        mean(&self.points().iter().map(apart).collect::<Vec<f32>>())
    }

    /// Estimates [`Self::add_s`] as the mean over the points of a sparser sample of the surface, in proportionally less time. The nearest
    /// points are still searched among all points.
    pub fn add_s_of(&self, sample: &Self, truth_from_estimate: Isometry<Object, Object>) -> AddS {
        let one_directional_m = mean(&distances_m(&sample.0, truth_from_estimate, &self.0));
        // Seen from the estimate the truth has moved by the inverse, so the same tree serves.
        let other_m = mean(&distances_m(&sample.0, truth_from_estimate.inverse(), &self.0));
        AddS { one_directional_m, symmetric_m: 0.5 * (one_directional_m + other_m) }
    }

    /// Scores a shape, given finite points on its surface, metres, in any frame `F`, and the motion from that frame to the object's: the
    /// inverse of the true pose times the estimated pose. [`super::sample_surface`] makes points of a mesh.
    ///
    /// A point exactly at a threshold is outside, as in NeuralFeels.
    pub fn score<F: Frame>(
        &self,
        estimate: &[Vec3],
        object_from_estimate: Isometry<F, Object>,
        thresholds_m: &[f64],
    ) -> ShapeScore {
        self.score_beside(&Self::of_points(Vec::new()), estimate, object_from_estimate, thresholds_m)
    }

    /// Scores a shape as [`Self::score`] does, where this is a part of a true surface and `rest` is the other part: estimated points that
    /// lie nearer to the rest do not count.
    pub fn score_beside<F: Frame>(
        &self,
        rest: &Self,
        estimate: &[Vec3],
        object_from_estimate: Isometry<F, Object>,
        thresholds_m: &[f64],
    ) -> ShapeScore {
        let estimate = Cloud::new(estimate.to_vec());
        // Infinite without a rest, so that all points count.
        let to_rest = distances_m(&estimate, object_from_estimate, &rest.0);
        let to_truth = distances_m(&estimate, object_from_estimate, &self.0).into_iter().zip(to_rest);
        let to_truth: Vec<f32> = to_truth.filter(|(own, rest)| own <= rest).map(|(own, _)| own).collect();
        let to_estimate = distances_m(&self.0, object_from_estimate.inverse(), &estimate);
        let f_score = |&threshold_m: &f64| FScore {
            threshold_m,
            precision: share_within(&to_truth, threshold_m),
            recall: share_within(&to_estimate, threshold_m),
        };
        ShapeScore {
            f_scores: thresholds_m.iter().map(f_score).collect(),
            mesh_error_m: mean(&to_truth),
            completeness_m: mean(&to_estimate),
        }
    }
}

/// Returns the distances of moved points to the nearest point of a cloud, metres; infinite if the motion is not finite.
fn distances_m<From: Frame, To: Frame>(points: &Cloud, motion: Isometry<From, To>, to: &Cloud) -> Vec<f32> {
    let (rotation, translation) = motion.to_f32();
    if rotation.is_finite() && translation.is_finite() {
        points.distances((rotation, translation), to)
    } else {
        vec![f32::INFINITY; points.points().len()]
    }
}

fn mean(distances_m: &[f32]) -> f64 {
    if distances_m.is_empty() {
        return f64::INFINITY;
    }
    distances_m.iter().copied().map(f64::from).sum::<f64>() / distances_m.len() as f64
}

fn share_within(distances_m: &[f32], threshold_m: f64) -> f64 {
    if distances_m.is_empty() {
        return 0.0;
    }
    distances_m.iter().filter(|&&d| f64::from(d) < threshold_m).count() as f64 / distances_m.len() as f64
}
