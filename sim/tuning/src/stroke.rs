//! Strokes: periodic motions of the fingertips around a pose of the hand, as vectors of parameters to search.

use std::collections::BTreeMap;
use std::f64::consts::TAU;

use mvt_gaits::axis::TurnAxis;
use mvt_gaits::gait::{Gait, right_ranges};
use mvt_robot::hand::{Hand, JointAngles};
use nalgebra as na;

use crate::pads::{gel, jacobian, named_joints, own_joints};

/// Number of phases of a gait's table.
const PHASES: usize = 32;
/// Damping of the inverse of a pad's Jacobian, metres per radian.
const DAMPING_M: f64 = 0.014;
const GRAVITY: f64 = 9.81;
/// Largest tilt of the palm in each direction, radians.
const TILT_RAD: f64 = 0.35;

/// Parameters of a stroke, by name: `period_s`, `tilt_rad`, `roll_rad`, `torque_nm`, `x_m`, `y_m`, one `pose_PAD_JOINT` per joint
/// of a pad's chain (radians), and per pad the sine and cosine of its displacement (metres): `sin_PAD_x`, `cos_PAD_x` and so on.
pub type StrokeParameters = BTreeMap<String, f64>;

/// Names and scales of the parameters, in the order of a search vector. A scale is the step that is tried first.
pub(crate) fn parameters(hand: &Hand) -> Vec<(String, f64)> {
    let mut names: Vec<(String, f64)> = [
        ("period_s", 0.15),
        ("tilt_rad", 0.08),
        ("roll_rad", 0.08),
        ("torque_nm", 0.08),
        ("x_m", 0.006),
        ("y_m", 0.006),
    ]
    .map(|(name, scale)| (name.to_owned(), scale))
    .into();
    names.extend(named_joints(hand).map(|(name, _)| (format!("pose_{name}"), 0.12)));
    for pad in hand.pads() {
        for wave in ["sin", "cos"] {
            names.extend(["x", "y", "z"].map(|axis| (format!("{wave}_{}_{axis}", pad.name), 0.006)));
        }
    }
    names
}

/// Returns the parameters of a stroke around the middle of a gait's table, so that its motion is nearly the gait's.
pub fn parameters_of(gait: &Gait, hand: &Hand) -> StrokeParameters {
    if named_joints(hand).next().is_some_and(|(name, _)| gait.params.contains_key(&format!("pose_{name}"))) {
        return gait.params.clone();
    }
    let (count, mean) = (gait.table.len().max(1) as f64, mean_pose(gait, hand));
    let [gx, gy, gz] = gait.gravity;
    let mut params = StrokeParameters::from([
        ("period_s".to_owned(), gait.period_s),
        ("tilt_rad".to_owned(), (-gx / GRAVITY).asin()),
        ("roll_rad".to_owned(), (gy / gz).atan()),
        ("torque_nm".to_owned(), gait.torque_limit_nm),
        ("x_m".to_owned(), gait.start_xy_m[0]),
        ("y_m".to_owned(), gait.start_xy_m[1]),
    ]);
    params.extend(named_joints(hand).map(|(name, j)| (format!("pose_{name}"), mean[j])));
    for (pad, touch) in hand.pads().iter().enumerate() {
        // First harmonic of the pad's path.
        let home = gel(hand, pad, &mean).0;
        for (row, joints) in gait.table.iter().enumerate() {
            let displacement = (gel(hand, pad, joints).0 - home) * (2.0 / count);
            let phase = TAU * row as f64 / count;
            for (axis, moved) in ["x", "y", "z"].into_iter().zip(displacement.iter()) {
                *params.entry(format!("sin_{}_{axis}", touch.name)).or_default() += moved * phase.sin();
                *params.entry(format!("cos_{}_{axis}", touch.name)).or_default() += moved * phase.cos();
            }
        }
    }
    params
}

/// Returns the mean of a gait's table.
pub(crate) fn mean_pose(gait: &Gait, hand: &Hand) -> JointAngles {
    let count = gait.table.len().max(1) as f64;
    let angle = |row: &JointAngles, j: usize| row.get(j).copied().unwrap_or(0.0);
    let joints = 0..hand.joints().len();
    joints.map(|j| gait.table.iter().map(|row| angle(row, j)).sum::<f64>() / count).collect()
}

/// Returns the parameters of the same stroke played backwards: the pads run along their paths in the opposite direction.
pub fn backwards(mut params: StrokeParameters) -> StrokeParameters {
    for (_, value) in params.iter_mut().filter(|(name, _)| name.starts_with("sin_")) {
        *value = -*value;
    }
    params
}

/// Returns the gait of a stroke. A joint that moves no pad stays as in the open pose.
pub fn gait(params: &StrokeParameters, hand: &Hand, open_pose: JointAngles, axis: TurnAxis, description: &str) -> Gait {
    // Rounded first, so that the parameters in a file make its table again.
    let params: StrokeParameters = params.iter().map(|(name, value)| (name.clone(), rounded(*value))).collect();
    let p = |name: &str| params.get(name).copied().unwrap_or(0.0);
    let ranges = right_ranges(hand);
    let mut pose = open_pose.clone();
    pose.resize(ranges.len(), 0.0);
    for (name, j) in named_joints(hand) {
        pose[j] = p(&format!("pose_{name}")).clamp(ranges[j][0], ranges[j][1]);
    }
    let mut table = vec![pose.clone(); PHASES];
    for (pad, touch) in hand.pads().iter().enumerate() {
        let jacobian = jacobian(hand, pad, &pose);
        let damped = &jacobian * jacobian.transpose() + na::Matrix3::identity() * DAMPING_M * DAMPING_M;
        // The damping makes the matrix positive definite; a stroke that is not finite does not move the pad.
        let Some(damped) = damped.cholesky() else { continue };
        let wave = |name: &str| na::Vector3::from(["x", "y", "z"].map(|a| p(&format!("{name}_{}_{a}", touch.name))));
        let (sine, cosine) = (wave("sin"), wave("cos"));
        for (row, joints) in table.iter_mut().enumerate() {
            let phase = TAU * row as f64 / PHASES as f64;
            let displacement = sine * phase.sin() + cosine * phase.cos();
            let change = jacobian.transpose() * damped.solve(&displacement);
            for (k, j) in own_joints(hand, pad) {
                joints[j] = (pose[j] + change[k]).clamp(ranges[j][0], ranges[j][1]);
            }
        }
    }
    let (tilt, roll) = (p("tilt_rad").clamp(-TILT_RAD, TILT_RAD), p("roll_rad").clamp(-TILT_RAD, TILT_RAD));
    let gravity = [-GRAVITY * tilt.sin(), -GRAVITY * roll.sin() * tilt.cos(), -GRAVITY * tilt.cos() * roll.cos()];
    Gait {
        description: description.to_owned(),
        period_s: rounded(p("period_s").clamp(0.4, 3.0)),
        torque_limit_nm: rounded(p("torque_nm").clamp(0.12, 0.5)),
        gravity: gravity.map(rounded),
        axis,
        start_xy_m: [rounded(p("x_m").clamp(-0.06, 0.04)), rounded(p("y_m").clamp(-0.03, 0.03))],
        open_pose,
        table: table.into_iter().map(|row| row.into_iter().map(rounded).collect()).collect(),
        params,
        feedback: None,
    }
}

/// Returns the number as a file has it.
pub(crate) fn rounded(value: f64) -> f64 {
    (value * 1e5).round() / 1e5
}
