//! Strokes: periodic motions of the fingertips around a pose of the hand, as vectors of parameters to search.

use std::collections::BTreeMap;
use std::f64::consts::TAU;

use mvt_gaits::axis::TurnAxis;
use mvt_gaits::gait::Gait;
use mvt_robot::hand::{Finger, JOINTS, JOINTS_PER_FINGER, JointAngles, Side, joint_ranges, world_from_tip};
use nalgebra as na;

/// Number of phases of a gait's table.
const PHASES: usize = 32;
/// Apex of the gel in the fingertip's frame, metres: the point that moves on the stroke.
const APEX_M: [f64; 3] = [0.0201, 0.0, 0.0165];
/// Damping of the inverse of a finger's Jacobian, metres per radian.
const DAMPING_M: f64 = 0.014;
const GRAVITY: f64 = 9.81;
/// Largest tilt of the palm in each direction, radians.
const TILT_RAD: f64 = 0.35;

/// Parameters of a stroke, by name: `period_s`, `tilt_rad`, `roll_rad`, `torque_nm`, `x_m`, `y_m`, one `pose_FINGER_JOINT` per joint
/// (radians), and per finger the sine and cosine of the displacement of its tip (metres): `sin_FINGER_x`, `cos_FINGER_x` and so on.
pub type StrokeParameters = BTreeMap<String, f64>;

/// Names and scales of the parameters, in the order of a search vector. A scale is the step that is tried first.
pub(crate) fn parameters() -> Vec<(String, f64)> {
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
    for finger in Finger::ALL {
        names.extend((0..JOINTS_PER_FINGER).map(|k| (format!("pose_{}_{k}", finger.name()), 0.12)));
    }
    for finger in Finger::ALL {
        for wave in ["sin", "cos"] {
            names.extend(["x", "y", "z"].map(|axis| (format!("{wave}_{}_{axis}", finger.name()), 0.006)));
        }
    }
    names
}

/// Returns the parameters of a stroke around the middle of a gait's table, so that its motion is nearly the gait's.
pub fn parameters_of(gait: &Gait) -> StrokeParameters {
    if gait.params.contains_key("pose_index_0") {
        return gait.params.clone();
    }
    let count = gait.table.len().max(1) as f64;
    let mean: JointAngles = std::array::from_fn(|j| gait.table.iter().map(|row| row[j]).sum::<f64>() / count);
    let [gx, gy, gz] = gait.gravity;
    let mut params = StrokeParameters::from([
        ("period_s".to_owned(), gait.period_s),
        ("tilt_rad".to_owned(), (-gx / GRAVITY).asin()),
        ("roll_rad".to_owned(), (gy / gz).atan()),
        ("torque_nm".to_owned(), gait.torque_limit_nm),
        ("x_m".to_owned(), gait.start_xy_m[0]),
        ("y_m".to_owned(), gait.start_xy_m[1]),
    ]);
    for finger in Finger::ALL {
        for k in 0..JOINTS_PER_FINGER {
            params.insert(format!("pose_{}_{k}", finger.name()), mean[finger.first_joint() + k]);
        }
        // First harmonic of the tip's path.
        let home = apex(finger, &mean);
        for (row, joints) in gait.table.iter().enumerate() {
            let displacement = (apex(finger, joints) - home) * (2.0 / count);
            let phase = TAU * row as f64 / count;
            for (axis, moved) in ["x", "y", "z"].into_iter().zip(displacement.iter()) {
                *params.entry(format!("sin_{}_{axis}", finger.name())).or_default() += moved * phase.sin();
                *params.entry(format!("cos_{}_{axis}", finger.name())).or_default() += moved * phase.cos();
            }
        }
    }
    params
}

/// Returns the parameters of the same stroke played backwards: the tips run along their paths in the opposite direction.
pub fn backwards(mut params: StrokeParameters) -> StrokeParameters {
    for (_, value) in params.iter_mut().filter(|(name, _)| name.starts_with("sin_")) {
        *value = -*value;
    }
    params
}

/// Returns the gait of a stroke, for the right hand.
pub fn gait(params: &StrokeParameters, open_pose: JointAngles, axis: TurnAxis, description: &str) -> Gait {
    // Rounded first, so that the parameters in a file make its table again.
    let params: StrokeParameters = params.iter().map(|(name, value)| (name.clone(), rounded(*value))).collect();
    let p = |name: &str| params.get(name).copied().unwrap_or(0.0);
    let ranges = joint_ranges(Side::Right);
    let mut pose = [0.0; JOINTS];
    for finger in Finger::ALL {
        for k in 0..JOINTS_PER_FINGER {
            let j = finger.first_joint() + k;
            pose[j] = p(&format!("pose_{}_{k}", finger.name())).clamp(ranges[j][0], ranges[j][1]);
        }
    }
    let mut table = vec![pose; PHASES];
    for finger in Finger::ALL {
        let jacobian = jacobian(finger, &pose);
        let damped = jacobian * jacobian.transpose() + na::Matrix3::identity() * DAMPING_M * DAMPING_M;
        let wave = |name: &str| na::Vector3::from(["x", "y", "z"].map(|a| p(&format!("{name}_{}_{a}", finger.name()))));
        let (sine, cosine) = (wave("sin"), wave("cos"));
        for (row, joints) in table.iter_mut().enumerate() {
            let phase = TAU * row as f64 / PHASES as f64;
            let displacement = sine * phase.sin() + cosine * phase.cos();
            // The damping makes the matrix positive definite; a stroke that is not finite does not move the finger.
            let change =
                damped.cholesky().map_or(na::Vector4::zeros(), |c| jacobian.transpose() * c.solve(&displacement));
            for k in 0..JOINTS_PER_FINGER {
                let j = finger.first_joint() + k;
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
        table: table.into_iter().map(|row| row.map(rounded)).collect(),
        params,
        feedback: None,
    }
}

/// Returns the number as a file has it.
pub(crate) fn rounded(value: f64) -> f64 {
    (value * 1e5).round() / 1e5
}

/// Returns the apex of a finger's gel in the world, metres, and the gel's outward normal there.
pub(crate) fn gel(finger: Finger, joints: &JointAngles) -> (na::Point3<f64>, na::Vector3<f64>) {
    let tip = world_from_tip(Side::Right, finger, joints).untyped();
    (tip * na::Point3::from(APEX_M), tip * na::Vector3::x())
}

/// Returns the apex of a finger's gel in the world, metres.
fn apex(finger: Finger, joints: &JointAngles) -> na::Vector3<f64> {
    gel(finger, joints).0.coords
}

/// Returns the change of the gel's apex per radian of each joint of its finger, metres.
pub(crate) fn jacobian(finger: Finger, joints: &JointAngles) -> na::Matrix3x4<f64> {
    const STEP_RAD: f64 = 1e-5;
    let moved = |k: usize, by: f64| {
        let mut joints = *joints;
        joints[finger.first_joint() + k] += by;
        apex(finger, &joints)
    };
    let column = |k| (moved(k, STEP_RAD) - moved(k, -STEP_RAD)) / (2.0 * STEP_RAD);
    na::Matrix3x4::from_columns(&std::array::from_fn::<_, JOINTS_PER_FINGER, _>(column))
}
