//! Finding the hand in an image when the given pose of the camera may be off by centimetres.

use mvt_frames::camera::Intrinsics;
use mvt_frames::{Camera, Occupied, Point};
use mvt_robot::hand::Hand;
use mvt_robot::hand::solid::{HandSamples, HandSolid};
use nalgebra as na;
use ndarray::Array2;

use crate::evidence::{Instant, Motion, Sighted};
use crate::solver::{Prior, State, Weighing, narrow, solve};

/// A point of the hand's inside that an image sees through by more than this is a contradiction, metres.
const THROUGH_M: f64 = 0.008;
/// Points farther from the hand than this are not the hand's, when fits are compared, metres.
const COMPARED_GATE_M: f32 = 0.006;
/// Turns about each axis of the world and shifts along it from which the search starts, radians and metres: half the distance of two
/// fingers, so that one of the starts is nearer to the right finger than to the next.
const TURN_RAD: f64 = 0.06;
const SHIFT_M: f64 = 0.02;
/// Gates from coarse to fine, metres: from a finger's radius to the noise of a point. A wider gate takes the object's points for the
/// hand's and draws even the right pose away.
const GATES_M: [f64; 3] = [0.015, 0.008, 0.004];
/// An image that sees through less than this share of the hand shows it there: at the right pose it is at most 0.005, at wrong ones at
/// least 0.016 (44 images of 11 objects, cameras off by up to 9 degrees and 20 mm). Else the search goes on, with more starts.
const CONVINCING: f64 = 0.01;
/// Points used by the search.
const POINTS: usize = 300;
/// Steps of the solver at each gate.
const STEPS: usize = 8;

/// One camera's image at an instant.
pub(crate) struct Look<'a> {
    pub depth_m: &'a Array2<f32>,
    pub intrinsics: &'a Intrinsics,
    pub sighted: &'a [Sighted],
}

/// How badly a pose of a camera explains its image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Misfit {
    /// Mean cost of a point, from 0 to 1. Points of the object have the full cost.
    pub cost: f64,
    /// Share of the hand that the image sees through. Nothing that lies in front of the hand changes it.
    pub seen_through: f64,
}

impl Misfit {
    /// Both together, by which poses are compared.
    pub fn total(self) -> f64 {
        self.cost + self.seen_through
    }
}

/// Compares a pose of a camera with its image. `inside` are points inside the hand.
pub(crate) fn misfit(
    look: &Look<'_>,
    world_from_camera: &na::Isometry3<f64>,
    hand: &HandSolid,
    inside: &[na::Point3<f64>],
) -> Misfit {
    let cost = |sighted: &Sighted| {
        let p = (world_from_camera * sighted.point).coords;
        let distance = hand.nearest(narrow(&p), COMPARED_GATE_M).map_or(COMPARED_GATE_M, |near| near.distance_m.abs());
        f64::from((distance / COMPARED_GATE_M).powi(2).min(1.0))
    };
    let (height, width) = look.depth_m.dim();
    let camera_from_world = world_from_camera.inverse();
    let (mut looked_at, mut through) = (0, 0);
    for p in inside {
        let p = camera_from_world * p;
        let Some((u, v)) = look.intrinsics.project(Point::<Camera>::new(p.x, p.y, p.z)) else { continue };
        let (u, v) = (u.round(), v.round());
        if u < 0.0 || v < 0.0 || u >= width as f64 || v >= height as f64 {
            continue;
        }
        let depth = f64::from(look.depth_m[(v as usize, u as usize)]);
        looked_at += 1;
        // Where nothing was measured, nothing is near.
        through += usize::from(depth <= 0.0 || depth > -p.z + THROUGH_M);
    }
    Misfit {
        cost: look.sighted.iter().map(cost).sum::<f64>() / look.sighted.len().max(1) as f64,
        seen_through: through as f64 / looked_at.max(1) as f64,
    }
}

/// Points inside the hand at these joint angles.
pub(crate) fn posed(samples: &HandSamples, joints: &[f64]) -> Vec<na::Point3<f64>> {
    let point = |o: Occupied| na::Point3::new(f64::from(o.point.x), f64::from(o.point.y), f64::from(o.point.z));
    samples.posed(joints).map(point).collect()
}

/// Returns the pose of a camera that explains its image best, near `given`, and its misfit.
pub(crate) fn find(
    hand: &Hand,
    look: &Look<'_>,
    given: na::Isometry3<f64>,
    joints: &[f64],
    samples: &HandSamples,
) -> (na::Isometry3<f64>, Misfit) {
    let solid = HandSolid::new(hand, joints);
    let inside = posed(samples, joints);
    let every = look.sighted.len().div_ceil(POINTS).max(1);
    let instant = Instant {
        motion: Motion::still(joints.to_vec()),
        sighted: vec![look.sighted.iter().step_by(every).copied().collect()],
    };
    let state = |camera| State { cameras: vec![camera], joint_offsets_rad: vec![0.0; joints.len()], lag_s: 0.0 };
    // The camera alone is free.
    let mut sigmas = na::DVector::zeros(State::unknowns(1, joints.len()));
    sigmas.rows_mut(0, 6).fill(1.0);
    let prior = Prior { state: state(given), sigmas };
    let fitted = |start: na::Isometry3<f64>| {
        let mut state = state(start);
        for gate_m in GATES_M {
            solve(hand, &mut state, &prior, &[&instant], Weighing { gate_m, independent: f64::INFINITY }, STEPS);
        }
        let pose = state.cameras[0];
        (pose, misfit(look, &pose, &solid, &inside))
    };
    let better = |best: (na::Isometry3<f64>, Misfit), start| {
        let found = fitted(start);
        if found.1.total() < best.1.total() { found } else { best }
    };
    let best = turned(given).chain(shifted(given)).fold(fitted(given), better);
    if best.1.seen_through < CONVINCING {
        return best;
    }
    turned(given).flat_map(shifted).fold(best, better)
}

/// Poses turned about the camera itself, as a bumped mount turns: this moves the image sideways.
fn turned(given: na::Isometry3<f64>) -> impl Iterator<Item = na::Isometry3<f64>> {
    axes().map(move |axis| {
        let turn = na::UnitQuaternion::from_scaled_axis(axis * TURN_RAD);
        na::Isometry3::from_parts(given.translation, turn * given.rotation)
    })
}

/// Poses shifted along the axes of the world.
fn shifted(given: na::Isometry3<f64>) -> impl Iterator<Item = na::Isometry3<f64>> {
    axes().map(move |axis| na::Translation3::from(axis * SHIFT_M) * given)
}

/// The axes in both directions.
fn axes() -> impl Iterator<Item = na::Vector3<f64>> {
    (0..6).map(|k| {
        let mut axis = na::Vector3::zeros();
        axis[k / 2] = if k % 2 == 0 { 1.0 } else { -1.0 };
        axis
    })
}
