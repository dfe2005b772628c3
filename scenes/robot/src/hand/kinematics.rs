//! Joints, limits and forward kinematics.

use mvt_frames::{Camera, HandBase, Isometry, Tip, World};
use nalgebra as na;

use crate::digit;
use crate::finger::{Finger, JOINTS, JOINTS_PER_FINGER, JointAngles};
use crate::side::Side;

/// Revolute joint, relative to its parent link.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Joint {
    /// Position of the joint in the parent link, metres.
    pub origin_m: [f64; 3],
    /// Orientation of the child link at angle 0, quaternion (w, x, y, z).
    pub orientation_wxyz: [f64; 4],
    /// Axis of rotation in the child link.
    pub axis: [f64; 3],
    /// Lower and upper limit, radians.
    pub range_rad: [f64; 2],
}

/// Half of the 5 degrees by which index and ring finger are splayed, radians.
const SPLAY_HALF_RAD: f64 = 0.087_266_462_6 / 2.0;
/// Pitch of the thumb's base, -95 degrees, in radians; roll and yaw are 0 and -90 degrees.
const THUMB_PITCH_RAD: f64 = -1.658_062_788_45;

/// Returns the joint at position `k` (0 = base) of a finger.
pub fn joint(side: Side, finger: Finger, k: usize) -> Joint {
    let mut joint = right_joint(finger, k);
    if side == Side::Left {
        let [w, x, y, z] = joint.orientation_wxyz;
        joint.origin_m[1] = -joint.origin_m[1];
        joint.orientation_wxyz = [w, -x, y, -z];
        // The mirror image of a rotation about (ax, ay, az) is one about (-ax, ay, -az); abduction joints change sign
        // instead.
        if finger == Finger::Thumb {
            joint.axis = [-joint.axis[0], joint.axis[1], -joint.axis[2]].map(|c| c + 0.0);
        }
    }
    joint
}

fn right_joint(finger: Finger, k: usize) -> Joint {
    const STRAIGHT: [f64; 4] = [1.0, 0.0, 0.0, 0.0];
    let (sin, cos) = SPLAY_HALF_RAD.sin_cos();
    let fingers = |origin_m, orientation_wxyz| match k {
        0 => Joint { origin_m, orientation_wxyz, axis: [0.0, 0.0, 1.0], range_rad: [-0.47, 0.47] },
        1 => Joint {
            origin_m: [0.0, 0.0, 0.0164],
            orientation_wxyz: STRAIGHT,
            axis: [0.0, 1.0, 0.0],
            range_rad: [-0.196, 1.61],
        },
        2 => Joint {
            origin_m: [0.0, 0.0, 0.054],
            orientation_wxyz: STRAIGHT,
            axis: [0.0, 1.0, 0.0],
            range_rad: [-0.174, 1.709],
        },
        _ => Joint {
            origin_m: [0.0, 0.0, 0.0384],
            orientation_wxyz: STRAIGHT,
            axis: [0.0, 1.0, 0.0],
            range_rad: [-0.227, 1.618],
        },
    };
    match finger {
        Finger::Index => fingers([0.0, 0.0435, -0.001_542], [cos, -sin, 0.0, 0.0]),
        Finger::Middle => fingers([0.0, 0.0, 0.0007], STRAIGHT),
        Finger::Ring => fingers([0.0, -0.0435, -0.001_542], [cos, sin, 0.0, 0.0]),
        Finger::Thumb => match k {
            0 => {
                let q = na::UnitQuaternion::from_euler_angles(0.0, THUMB_PITCH_RAD, -std::f64::consts::FRAC_PI_2);
                Joint {
                    origin_m: [-0.0182, 0.019_333, -0.045_987],
                    orientation_wxyz: [q.w, q.i, q.j, q.k],
                    axis: [-1.0, 0.0, 0.0],
                    range_rad: [0.263, 1.396],
                }
            }
            1 => Joint {
                origin_m: [-0.027, 0.005, 0.0399],
                orientation_wxyz: STRAIGHT,
                axis: [0.0, 0.0, 1.0],
                range_rad: [-0.105, 1.163],
            },
            2 => Joint {
                origin_m: [0.0, 0.0, 0.0177],
                orientation_wxyz: STRAIGHT,
                axis: [0.0, 1.0, 0.0],
                range_rad: [-0.189, 1.644],
            },
            _ => Joint {
                origin_m: [0.0, 0.0, 0.0514],
                orientation_wxyz: STRAIGHT,
                axis: [0.0, 1.0, 0.0],
                range_rad: [-0.162, 1.719],
            },
        },
    }
}

/// Returns the distance from the last joint to the fingertip link along the link's z axis, metres, from the URDF of
/// HORA, whose Allegro hand carries DIGITs.
pub fn tip_offset_m(finger: Finger) -> f64 {
    if finger == Finger::Thumb { 0.0303 } else { 0.0147 }
}

/// Returns the lower and upper limits of all joints, radians.
pub fn joint_ranges(side: Side) -> [[f64; 2]; JOINTS] {
    std::array::from_fn(|j| joint(side, Finger::ALL[j / JOINTS_PER_FINGER], j % JOINTS_PER_FINGER).range_rad)
}

/// Returns the pose of the hand base: palm up, fingers along the world's x axis.
pub fn world_from_base() -> Isometry<HandBase, World> {
    let h = std::f64::consts::FRAC_1_SQRT_2;
    Isometry::from_parts([0.0; 3], [0.0, h, 0.0, h])
}

/// Returns the poses of a finger's four links and of its fingertip in the hand base.
pub fn finger_kinematics(
    side: Side,
    finger: Finger,
    joints: &JointAngles,
) -> ([na::Isometry3<f64>; 4], Isometry<Tip, HandBase>) {
    let mut pose = na::Isometry3::identity();
    let links = std::array::from_fn(|k| {
        let joint = joint(side, finger, k);
        let [w, x, y, z] = joint.orientation_wxyz;
        let orientation = na::UnitQuaternion::from_quaternion(na::Quaternion::new(w, x, y, z));
        let angle = joints[finger.first_joint() + k];
        let rotation = na::UnitQuaternion::from_scaled_axis(na::Vector3::from(joint.axis) * angle);
        pose *= na::Isometry3::from_parts(na::Vector3::from(joint.origin_m).into(), orientation * rotation);
        pose
    });
    (links, Isometry::new(pose * na::Translation3::new(0.0, 0.0, tip_offset_m(finger))))
}

/// Returns the pose of a fingertip in the world.
pub fn world_from_tip(side: Side, finger: Finger, joints: &JointAngles) -> Isometry<Tip, World> {
    world_from_base() * finger_kinematics(side, finger, joints).1
}

/// Returns the pose of a DIGIT's camera in the world.
pub fn world_from_digit_camera(side: Side, finger: Finger, joints: &JointAngles) -> Isometry<Camera, World> {
    world_from_tip(side, finger, joints) * digit::tip_from_gel() * digit::gel_from_camera()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn left_hand_is_the_mirror_image() {
        let right: JointAngles = std::array::from_fn(|j| 0.3 + 0.05 * j as f64);
        let left = Side::Left.mirror_joints(right);
        for finger in Finger::ALL {
            let r = world_from_tip(Side::Right, finger, &right).to_matrix();
            let l = world_from_tip(Side::Left, finger, &left).to_matrix();
            for (row, col) in (0..3).flat_map(|r| (0..4).map(move |c| (r, c))) {
                let flips = (row == 1) != (col == 1);
                let mirrored = if flips { -r[row][col] } else { r[row][col] };
                assert!((l[row][col] - mirrored).abs() < 1e-12, "{finger:?} {row} {col}");
            }
        }
    }
}
