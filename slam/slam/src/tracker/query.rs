//! Questions to a shape about many points at once.

use glam::Vec3;
use mvt_field::shape::Distance;
use nalgebra as na;

use super::{Reference, apply};
use mvt_frames::se3::Twist;
use mvt_graph::system::along;

/// Points of the world in the model's frame, their distances, and whether they can be trusted.
pub(super) fn ask(
    shape: &dyn Reference,
    pose: &na::Isometry3<f64>,
    points: impl Iterator<Item = Vec3>,
) -> (Vec<Vec3>, Vec<Distance>, Vec<bool>) {
    let points = in_model(pose, points);
    let mut distances = vec![Distance::default(); points.len()];
    shape.distances_and_gradients(&points, &mut distances);
    let mut trusted = vec![false; points.len()];
    shape.trusted(&points, &mut trusted);
    (points, distances, trusted)
}

/// Distances of points in the model's frame without gradients, metres, and whether they can be trusted.
pub(super) fn ask_values(shape: &dyn Reference, points: &[Vec3]) -> (Vec<f32>, Vec<bool>) {
    let mut distances_m = vec![0.0; points.len()];
    shape.distances(points, &mut distances_m);
    let mut trusted = vec![false; points.len()];
    shape.trusted(points, &mut trusted);
    (distances_m, trusted)
}

/// As [`ask`] for points that were measured on the surface: one where no surface can be speaks against the pose, too.
pub(super) fn ask_measured(
    shape: &dyn Reference,
    pose: &na::Isometry3<f64>,
    points: impl Iterator<Item = Vec3>,
) -> (Vec<Vec3>, Vec<Distance>, Vec<bool>) {
    let (points, distances, mut trusted) = ask(shape, pose, points);
    trust_empty(shape, &points, &mut trusted);
    (points, distances, trusted)
}

/// Also trusts points where no surface can be.
pub(super) fn trust_empty(shape: &dyn Reference, points: &[Vec3], trusted: &mut [bool]) {
    // Why: notes/decisions/estimation.md, "A measured point in space that was seen empty counts against a pose, and one in unseen space costs as much as 2 mm".
    let mut empty = vec![false; points.len()];
    shape.seen_empty(points, &mut empty);
    trusted.iter_mut().zip(empty).for_each(|(trusted, empty)| *trusted |= empty);
}

/// Points of the world in the model's frame.
pub(super) fn in_model(pose: &na::Isometry3<f64>, points: impl Iterator<Item = Vec3>) -> Vec<Vec3> {
    let model_from_world = pose.inverse();
    points.map(|p| apply(&model_from_world, p)).collect()
}

/// Distance of a measured point from the surface: the value of the shape at T^-1 p, and its derivative by the disturbance of T.
pub(crate) fn surface(point: Vec3, distance: Distance) -> (f64, Twist) {
    let gradient = na::Vector3::from(distance.gradient.to_array().map(f64::from));
    let point = na::Vector3::from(point.to_array().map(f64::from));
    (f64::from(distance.value_m), -along(gradient, point))
}
