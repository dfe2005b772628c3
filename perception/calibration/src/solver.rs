//! The least-squares problem: which calibration puts the measured points on the hand.

use glam::{DVec3, Vec3};
use mvt_robot::hand::solid::{HandSolid, Nearest};
use mvt_robot::hand::{Hand, JointAngles, JointMotion};
use nalgebra as na;

use crate::evidence::{Instant, Motion};

/// Unknowns of a camera: a translation and a rotation about the [`pivot`].
pub(crate) const PER_CAMERA: usize = 6;
/// Height above the base of a hand of the point about which cameras turn, metres: fingers and what they hold are above a palm.
const PIVOT_HEIGHT_M: f64 = 0.03;
/// Joint that nothing measures moves by no more than its prior allows; this keeps the system solvable where a prior is infinitely wide.
const LEAST_INFORMATION: f64 = 1e-9;

/// The estimated quantities.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct State {
    /// Pose of each camera, world from camera.
    pub cameras: Vec<na::Isometry3<f64>>,
    /// True angle minus reading, radians; of sliding joints metres.
    pub joint_offsets_rad: JointAngles,
    /// The reading of a joint at time t + lag is its angle in the image of time t, seconds.
    pub lag_s: f64,
}

impl State {
    /// Number of unknowns: those of the cameras, one per joint, and the lag.
    pub fn unknowns(cameras: usize, joints: usize) -> usize {
        PER_CAMERA * cameras + joints + 1
    }

    /// Returns the joint angles of an image whose joints were read as `motion`.
    pub fn joints(&self, motion: &Motion) -> JointAngles {
        let read = motion.at(self.lag_s);
        read.iter().zip(&self.joint_offsets_rad).map(|(read, offset)| read + offset).collect()
    }

    /// Moves by a step of the solver.
    fn advance(&mut self, pivot: &na::Vector3<f64>, step: &na::DVector<f64>) {
        let pivot = na::Translation3::from(*pivot);
        for (k, camera) in self.cameras.iter_mut().enumerate() {
            let part = |at: usize| step.fixed_rows::<3>(PER_CAMERA * k + at).into_owned();
            let turn = na::UnitQuaternion::from_scaled_axis(part(3));
            *camera = na::Translation3::from(part(0)) * pivot * turn * pivot.inverse() * *camera;
            camera.rotation.renormalize();
        }
        let first = PER_CAMERA * self.cameras.len();
        for (j, offset) in self.joint_offsets_rad.iter_mut().enumerate() {
            *offset += step[first + j];
        }
        self.lag_s += step[first + self.joint_offsets_rad.len()];
    }

    /// The step that leads from `self` to `other`, to first order.
    fn step_to(&self, pivot: &na::Vector3<f64>, other: &Self) -> na::DVector<f64> {
        let mut step = na::DVector::zeros(Self::unknowns(self.cameras.len(), self.joint_offsets_rad.len()));
        for (k, (from, to)) in self.cameras.iter().zip(&other.cameras).enumerate() {
            let motion = to * from.inverse();
            let moved = motion.translation.vector + motion.rotation * pivot - pivot;
            step.fixed_rows_mut::<3>(PER_CAMERA * k).copy_from(&moved);
            step.fixed_rows_mut::<3>(PER_CAMERA * k + 3).copy_from(&motion.rotation.scaled_axis());
        }
        let first = PER_CAMERA * self.cameras.len();
        let offsets = self.joint_offsets_rad.iter().zip(&other.joint_offsets_rad);
        for (j, (from, to)) in offsets.enumerate() {
            step[first + j] = to - from;
        }
        step[first + self.joint_offsets_rad.len()] = other.lag_s - self.lag_s;
        step
    }
}

/// The prior: the given calibration and its error, one standard deviation.
#[derive(Debug, Clone)]
pub(crate) struct Prior {
    pub state: State,
    /// In the order of the unknowns; 0 holds an unknown.
    pub sigmas: na::DVector<f64>,
}

/// How points are weighed.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Weighing {
    /// Points farther from the hand than this are not the hand's, metres. Nearer ones weigh less the farther they are (Tukey's biweight).
    pub gate_m: f64,
    /// Points of a camera in an instant whose errors are independent.
    pub independent: f64,
}

/// Normal equations at a state.
struct Normal {
    information: na::DMatrix<f64>,
    gradient: na::DVector<f64>,
    cost: f64,
}

/// Tukey's biweight: cost and weight of a residual `r` with the gate `c`.
fn biweight(r: f64, c: f64) -> (f64, f64) {
    let rest = 1.0 - (r / c).powi(2);
    if rest <= 0.0 { (c * c / 6.0, 0.0) } else { (c * c / 6.0 * (1.0 - rest.powi(3)), rest * rest) }
}

/// Returns the point in the world about which cameras turn: near the hand, so that rotation and translation are nearly independent of each
/// other.
fn pivot(hand: &Hand) -> na::Vector3<f64> {
    let base = hand.bodies().first().map_or_else(na::Vector3::zeros, |base| base.place.position_m.into());
    base + na::Vector3::new(0.0, 0.0, PIVOT_HEIGHT_M)
}

/// Returns the joints that move the body of a surface `nearest`, each with the derivative by its angle of the distance from that surface of
/// the point `p` of the world. `solid` is the hand at these angles.
pub(crate) fn by_joints(
    hand: &Hand,
    solid: &HandSolid,
    p: na::Vector3<f64>,
    nearest: &Nearest,
) -> impl Iterator<Item = (usize, f64)> {
    let normal = wide(nearest.normal);
    hand.chain(nearest.body).iter().map(move |&j| {
        let joint = &hand.joints()[j];
        let pose = &solid.body_poses()[joint.body];
        let axis = pose.rotation * na::Vector3::from(joint.axis);
        let motion = match joint.motion {
            JointMotion::Hinge => axis.cross(&(p - pose.translation.vector)),
            JointMotion::Slide => axis,
        };
        // The surface moves with the joint, which is as if the point moved the other way.
        (j, -normal.dot(&motion))
    })
}

fn wide(v: Vec3) -> na::Vector3<f64> {
    let DVec3 { x, y, z } = v.as_dvec3();
    na::Vector3::new(x, y, z)
}

pub(crate) fn narrow(v: &na::Vector3<f64>) -> Vec3 {
    Vec3::new(v.x as f32, v.y as f32, v.z as f32)
}

fn linearise(hand: &Hand, state: &State, prior: &Prior, instants: &[&Instant], weighing: Weighing) -> Normal {
    let (cameras, joint_count) = (state.cameras.len(), state.joint_offsets_rad.len());
    let unknowns = State::unknowns(cameras, joint_count);
    let first_joint = PER_CAMERA * cameras;
    let mut information = na::DMatrix::zeros(unknowns, unknowns);
    let mut gradient = na::DVector::zeros(unknowns);
    let mut cost = 0.0;
    let pivot = pivot(hand);
    // Few unknowns bear on a point: those of its camera, of the joints that move the body there, and the lag.
    let mut touched: Vec<(usize, f64)> = Vec::with_capacity(unknowns);
    for instant in instants {
        let joints = state.joints(&instant.motion);
        let rates = instant.motion.rate_at(state.lag_s);
        let solid = HandSolid::new(hand, &joints);
        for (camera, points) in instant.sighted.iter().enumerate() {
            let share = (weighing.independent / points.len().max(1) as f64).min(1.0);
            for sighted in points {
                let p = (state.cameras[camera] * sighted.point).coords;
                let Some(nearest) = solid.nearest(narrow(&p), weighing.gate_m as f32) else {
                    cost += share * biweight(2.0 * weighing.gate_m, weighing.gate_m).0 / sighted.sigma_m.powi(2);
                    continue;
                };
                let (r, normal) = (f64::from(nearest.distance_m), wide(nearest.normal));
                let (loss, weight) = biweight(r, weighing.gate_m);
                let scale = share / sighted.sigma_m.powi(2);
                cost += scale * loss;
                if weight == 0.0 {
                    continue;
                }
                touched.clear();
                let turning = (p - pivot).cross(&normal);
                for axis in 0..3 {
                    touched.push((PER_CAMERA * camera + axis, normal[axis]));
                    touched.push((PER_CAMERA * camera + 3 + axis, turning[axis]));
                }
                let mut by_lag = 0.0;
                for (j, slope) in by_joints(hand, &solid, p, &nearest) {
                    touched.push((first_joint + j, slope));
                    by_lag += slope * rates[j];
                }
                touched.push((first_joint + joint_count, by_lag));
                for &(a, slope_a) in &touched {
                    gradient[a] += weight * scale * r * slope_a;
                    for &(b, slope_b) in &touched {
                        information[(a, b)] += weight * scale * slope_a * slope_b;
                    }
                }
            }
        }
    }
    let off = prior.state.step_to(&pivot, state);
    for (a, sigma) in prior.sigmas.iter().enumerate() {
        if *sigma > 0.0 {
            let weight = sigma.powi(-2).max(LEAST_INFORMATION);
            information[(a, a)] += weight;
            gradient[a] += weight * off[a];
            cost += 0.5 * weight * off[a] * off[a];
        } else {
            information.column_mut(a).fill(0.0);
            information.row_mut(a).fill(0.0);
            information[(a, a)] = 1.0;
            gradient[a] = 0.0;
        }
    }
    Normal { information, gradient, cost }
}

/// Moves `state` to the least cost nearby, in at most `steps` steps (Levenberg and Marquardt). Returns the standard deviation of each
/// unknown, as the measurements and the prior give it.
pub(crate) fn solve(
    hand: &Hand,
    state: &mut State,
    prior: &Prior,
    instants: &[&Instant],
    weighing: Weighing,
    steps: usize,
) -> na::DVector<f64> {
    let mut normal = linearise(hand, state, prior, instants, weighing);
    let mut damping = 1e-6;
    for _ in 0..steps {
        let mut damped = normal.information.clone();
        for a in 0..damped.nrows() {
            damped[(a, a)] *= 1.0 + damping;
        }
        let Some(factor) = damped.cholesky() else { break };
        let step = -factor.solve(&normal.gradient);
        let mut next = state.clone();
        next.advance(&pivot(hand), &step);
        let trial = linearise(hand, &next, prior, instants, weighing);
        if trial.cost < normal.cost {
            let gained = (normal.cost - trial.cost) / normal.cost;
            (*state, normal, damping) = (next, trial, (damping / 10.0_f64).max(1e-9));
            if gained < 1e-4 {
                break;
            }
        } else {
            damping = (damping * 100.0).max(1e-3);
            if damping > 1e3 {
                break;
            }
        }
    }
    let unknowns = normal.information.nrows();
    match normal.information.cholesky() {
        Some(factor) => factor.inverse().diagonal().map(f64::sqrt),
        None => na::DVector::repeat(unknowns, f64::INFINITY),
    }
}
