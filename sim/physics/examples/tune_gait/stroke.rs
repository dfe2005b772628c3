//! Strokes: each fingertip moves on an ellipse about a vertical axis through the object. Inverse kinematics turns a
//! stroke into the joint table of a gait.

use std::collections::BTreeMap;
use std::f64::consts::TAU;

use mvt_gaits::gait::Gait;
use mvt_robot::hand::{Finger, JOINTS_PER_FINGER, JointAngles, Side, joint_ranges, world_from_tip};
use nalgebra as na;

/// Apex of the gel in the fingertip's frame, metres: the point that should touch the object.
const APEX_M: [f64; 3] = [0.0201, 0.0, 0.0165];
/// Number of phases of the table.
const PHASES: usize = 32;
/// Distance of the fingers from the stroke at the start, metres.
const OPEN_M: f64 = 0.022;
const GRAVITY: f64 = 9.81;

/// Names, initial standard deviations and bounds of the parameters, in the order of the search vector. Lengths are
/// metres, angles radians, T seconds and fmax Nm.
pub const PARAMETERS: [(&str, f64, f64, f64); 22] = [
    ("T", 0.15, 0.6, 1.6),
    ("cx", 0.008, -0.06, 0.03),
    ("cy", 0.006, -0.03, 0.03),
    ("rin", 0.006, 0.015, 0.06),
    ("lift", 0.004, 0.002, 0.03),
    ("s_f", 0.12, 0.1, 0.9),
    ("s_t", 0.12, 0.1, 0.9),
    ("h_i", 0.008, 0.025, 0.13),
    ("h_m", 0.008, 0.025, 0.13),
    ("h_t", 0.008, 0.025, 0.13),
    ("a_i", 0.15, -2.0, 2.0),
    ("a_m", 0.15, -2.0, 2.0),
    ("a_r", 0.15, -2.0, 2.0),
    ("a_t", 0.2, 2.5, 6.5),
    ("p_i", 0.5, -4.0, 4.0),
    ("p_r", 0.5, -4.0, 4.0),
    ("p_t", 0.5, -4.0, 4.0),
    ("tilt", 0.06, -0.4, 0.1),
    ("troll", 0.06, -0.25, 0.25),
    ("fmax", 0.06, 0.12, 0.6),
    ("hz", 0.004, -0.02, 0.02),
    ("nz", 0.2, -1.5, 1.5),
];

/// Returns the gait of a stroke. `rest` regularises the inverse kinematics where a finger has freedom left.
pub fn gait(params: &BTreeMap<String, f64>, rest: &JointAngles, description: &str) -> Gait {
    let p = |name: &str| params.get(name).copied().unwrap_or(0.0);
    // The shipped gaits turn clockwise seen from above on the right hand.
    let sign = -1.0;
    let by_finger = |finger, index, middle, ring, thumb| match finger {
        Finger::Index => p(index),
        Finger::Middle => p(middle),
        Finger::Ring => p(ring),
        Finger::Thumb => p(thumb),
    };
    let place = |angle: f64, radius: f64, height: f64| {
        let inward = na::Vector3::new(-angle.cos(), -angle.sin(), p("nz")).normalize();
        (na::Vector3::new(p("cx") + radius * angle.cos(), p("cy") + radius * angle.sin(), height), inward)
    };
    let mut table = vec![*rest; PHASES];
    let mut open_pose = *rest;
    for finger in Finger::ALL {
        let angle = by_finger(finger, "a_i", "a_m", "a_r", "a_t");
        let height = by_finger(finger, "h_i", "h_m", "h_i", "h_t");
        let phase = by_finger(finger, "p_i", "", "p_r", "p_t");
        let swing = if finger == Finger::Thumb { p("s_t") } else { p("s_f") };
        let joints = finger.first_joint()..finger.first_joint() + JOINTS_PER_FINGER;
        let mut q = *rest;
        // Two rounds, so that the first phases also start from a close solution.
        for row in (0..2 * PHASES).map(|i| i % PHASES) {
            let w = TAU * row as f64 / PHASES as f64 + phase;
            let radius = p("rin") + p("lift") * (1.0 - w.cos());
            let target = place(angle + sign * swing * w.sin(), radius, height - p("hz") * w.cos());
            reach(finger, &mut q, rest, target);
            table[row][joints.clone()].copy_from_slice(&q[joints.clone()]);
        }
        let mut q = table[0];
        reach(finger, &mut q, rest, place(angle, p("rin") + p("lift") + OPEN_M, height));
        open_pose[joints.clone()].copy_from_slice(&q[joints]);
    }
    let (gx, gy) = (-GRAVITY * p("tilt").sin(), -GRAVITY * p("troll").sin());
    Gait {
        description: description.to_owned(),
        params: params.clone(),
        period_s: p("T"),
        torque_limit_nm: p("fmax"),
        gravity: [gx, gy, -(GRAVITY * GRAVITY - gx * gx - gy * gy).sqrt()],
        feedback: None,
        axis: mvt_gaits::axis::TurnAxis::MinusZ,
        start_xy_m: [p("cx"), p("cy")],
        open_pose,
        table,
    }
}

/// Damped least squares: brings the gel's apex to a place with its normal in a direction, from the current angles.
fn reach(
    finger: Finger,
    q: &mut JointAngles,
    rest: &JointAngles,
    (place, normal): (na::Vector3<f64>, na::Vector3<f64>),
) {
    /// Weight of the error of the normal relative to that of the place, metres per unit.
    const NORMAL_M: f64 = 0.012;
    /// Weight of the distance from the rest pose, metres per radian.
    const REST_M: f64 = 0.004;
    const STEP: f64 = 1e-6;
    let ranges = joint_ranges(Side::Right);
    let first = finger.first_joint();
    let residual = |q: &JointAngles| {
        let tip = world_from_tip(Side::Right, finger, q).untyped();
        let apex = tip * na::Point3::from(APEX_M);
        let direction = tip.rotation * na::Vector3::x();
        let mut r = na::SVector::<f64, 10>::zeros();
        for i in 0..3 {
            r[i] = apex[i] - place[i];
            r[3 + i] = NORMAL_M * (direction[i] - normal[i]);
        }
        for k in 0..JOINTS_PER_FINGER {
            r[6 + k] = REST_M * (q[first + k] - rest[first + k]);
        }
        r
    };
    for _ in 0..12 {
        let r = residual(q);
        let mut jacobian = na::SMatrix::<f64, 10, 4>::zeros();
        for k in 0..JOINTS_PER_FINGER {
            let mut moved = *q;
            moved[first + k] += STEP;
            jacobian.set_column(k, &((residual(&moved) - r) / STEP));
        }
        let normal_matrix = jacobian.transpose() * jacobian + na::Matrix4::identity() * 1e-6;
        let Some(inverse) = normal_matrix.try_inverse() else { return };
        let step = inverse * (jacobian.transpose() * r);
        for k in 0..JOINTS_PER_FINGER {
            let [low, high] = ranges[first + k];
            q[first + k] = (q[first + k] - step[k].clamp(-0.3, 0.3)).clamp(low, high);
        }
    }
}
