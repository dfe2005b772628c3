//! The least-squares problem: which calibration puts the measured points on the hand.

use glam::{DVec3, Vec3};
use mvt_robot::hand::solid::{HandSolid, Nearest};
use mvt_robot::hand::{Body, Finger, JOINTS, JOINTS_PER_FINGER, JointAngles, Side, finger_kinematics, world_from_base};
use nalgebra as na;

use crate::evidence::{Instant, Motion};

/// Unknowns of a camera: a translation and a rotation about [`PIVOT_M`].
pub(crate) const PER_CAMERA: usize = 6;
/// Point in the world about which cameras turn, metres: the middle of the fingers, so that rotation and translation are nearly
/// independent of each other.
const PIVOT_M: [f64; 3] = [0.0, 0.0, 0.03];
/// Joint that nothing measures moves by no more than its prior allows; this keeps the system solvable where a prior is infinitely wide.
const LEAST_INFORMATION: f64 = 1e-9;

/// The estimated quantities.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct State {
    /// Pose of each camera, world from camera.
    pub cameras: Vec<na::Isometry3<f64>>,
    /// True angle minus reading, radians.
    pub joint_offsets_rad: JointAngles,
    /// The reading of a joint at time t + lag is its angle in the image of time t, seconds.
    pub lag_s: f64,
}

impl State {
    /// Number of unknowns with `cameras` cameras.
    pub fn unknowns(cameras: usize) -> usize {
        PER_CAMERA * cameras + JOINTS + 1
    }

    /// Returns the joint angles of an image whose joints were read as `motion`.
    pub fn joints(&self, motion: &Motion) -> JointAngles {
        let read = motion.at(self.lag_s);
        std::array::from_fn(|j| read[j] + self.joint_offsets_rad[j])
    }

    /// Moves by a step of the solver.
    fn advance(&mut self, step: &na::DVector<f64>) {
        for (k, camera) in self.cameras.iter_mut().enumerate() {
            let part = |at: usize| step.fixed_rows::<3>(PER_CAMERA * k + at).into_owned();
            let pivot = na::Translation3::from(na::Vector3::from(PIVOT_M));
            let turn = na::UnitQuaternion::from_scaled_axis(part(3));
            *camera = na::Translation3::from(part(0)) * pivot * turn * pivot.inverse() * *camera;
            camera.rotation.renormalize();
        }
        let first = PER_CAMERA * self.cameras.len();
        for (j, offset) in self.joint_offsets_rad.iter_mut().enumerate() {
            *offset += step[first + j];
        }
        self.lag_s += step[first + JOINTS];
    }

    /// The step that leads from `self` to `other`, to first order.
    fn step_to(&self, other: &Self) -> na::DVector<f64> {
        let pivot = na::Vector3::from(PIVOT_M);
        let mut step = na::DVector::zeros(Self::unknowns(self.cameras.len()));
        for (k, (from, to)) in self.cameras.iter().zip(&other.cameras).enumerate() {
            let motion = to * from.inverse();
            let moved = motion.translation.vector + motion.rotation * pivot - pivot;
            step.fixed_rows_mut::<3>(PER_CAMERA * k).copy_from(&moved);
            step.fixed_rows_mut::<3>(PER_CAMERA * k + 3).copy_from(&motion.rotation.scaled_axis());
        }
        let first = PER_CAMERA * self.cameras.len();
        for j in 0..JOINTS {
            step[first + j] = other.joint_offsets_rad[j] - self.joint_offsets_rad[j];
        }
        step[first + JOINTS] = other.lag_s - self.lag_s;
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

/// Derivatives of the distance of a point, which lies `p` in the world, from the surface `nearest` of the hand by the joint angles: the
/// joints of one finger, of which the first is returned.
pub(crate) fn by_joints(
    side: Side,
    joints: &JointAngles,
    p: na::Vector3<f64>,
    nearest: &Nearest,
) -> Option<(usize, [f64; JOINTS_PER_FINGER])> {
    let (finger, links) = moved_by(nearest.body)?;
    let base = world_from_base().untyped();
    let (poses, _) = finger_kinematics(side, finger, joints);
    let normal = wide(nearest.normal);
    let slopes = std::array::from_fn(|k| {
        if k >= links {
            return 0.0;
        }
        let link = base * poses[k];
        let axis = link.rotation * na::Vector3::from(mvt_robot::hand::joint(side, finger, k).axis);
        // The surface moves with the joint, which is as if the point moved the other way.
        -normal.dot(&axis.cross(&(p - link.translation.vector)))
    });
    Some((finger.first_joint(), slopes))
}

/// The finger of a body, and how many of its joints move it.
fn moved_by(body: Body) -> Option<(Finger, usize)> {
    match body {
        Body::Palm => None,
        Body::Link(finger, k) => Some((finger, k + 1)),
        Body::Tip(finger) => Some((finger, JOINTS_PER_FINGER)),
    }
}

fn wide(v: Vec3) -> na::Vector3<f64> {
    let DVec3 { x, y, z } = v.as_dvec3();
    na::Vector3::new(x, y, z)
}

pub(crate) fn narrow(v: &na::Vector3<f64>) -> Vec3 {
    Vec3::new(v.x as f32, v.y as f32, v.z as f32)
}

fn linearise(side: Side, state: &State, prior: &Prior, instants: &[&Instant], weighing: Weighing) -> Normal {
    let cameras = state.cameras.len();
    let unknowns = State::unknowns(cameras);
    let first_joint = PER_CAMERA * cameras;
    let mut information = na::DMatrix::zeros(unknowns, unknowns);
    let mut gradient = na::DVector::zeros(unknowns);
    let mut cost = 0.0;
    let pivot = na::Vector3::from(PIVOT_M);
    // Few unknowns bear on a point: those of its camera, of one finger, and the lag.
    let mut touched: Vec<(usize, f64)> = Vec::with_capacity(PER_CAMERA + JOINTS_PER_FINGER + 1);
    for instant in instants {
        let joints = state.joints(&instant.motion);
        let rates = instant.motion.rate_at(state.lag_s);
        let hand = HandSolid::new(side, &joints);
        for (camera, points) in instant.sighted.iter().enumerate() {
            let share = (weighing.independent / points.len().max(1) as f64).min(1.0);
            for sighted in points {
                let p = (state.cameras[camera] * sighted.point).coords;
                let Some(nearest) = hand.nearest(narrow(&p), weighing.gate_m as f32) else {
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
                if let Some((first, slopes)) = by_joints(side, &joints, p, &nearest) {
                    let mut by_lag = 0.0;
                    for (k, slope) in slopes.into_iter().enumerate() {
                        touched.push((first_joint + first + k, slope));
                        by_lag += slope * rates[first + k];
                    }
                    touched.push((first_joint + JOINTS, by_lag));
                }
                for &(a, slope_a) in &touched {
                    gradient[a] += weight * scale * r * slope_a;
                    for &(b, slope_b) in &touched {
                        information[(a, b)] += weight * scale * slope_a * slope_b;
                    }
                }
            }
        }
    }
    let off = prior.state.step_to(state);
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
    side: Side,
    state: &mut State,
    prior: &Prior,
    instants: &[&Instant],
    weighing: Weighing,
    steps: usize,
) -> na::DVector<f64> {
    let mut normal = linearise(side, state, prior, instants, weighing);
    let mut damping = 1e-6;
    for _ in 0..steps {
        let mut damped = normal.information.clone();
        for a in 0..damped.nrows() {
            damped[(a, a)] *= 1.0 + damping;
        }
        let Some(factor) = damped.cholesky() else { break };
        let step = -factor.solve(&normal.gradient);
        let mut next = state.clone();
        next.advance(&step);
        let trial = linearise(side, &next, prior, instants, weighing);
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
