//! The Allegro hand with DIGIT fingertips.
//!
//! The numbers are those of SimLab's URDF (finger order if, mf, rf, th); exceptions name their source. The left hand is
//! the mirror image of the right one in the plane y = 0. Its joint conventions follow SimLab's left URDF, which
//! NeuralFeels' loaders use: the abduction joints keep the axis +z, so their angles change sign under the mirror; the
//! thumb's first two axes are mirrored, so its angles keep their sign.

use nalgebra as na;

use super::parts::{Body, Inertial, Part, PartSurface, Placing, Primitive, UPRIGHT};
use super::{GraspPoint, HandDescription, TouchPad};
use crate::digit::profile::SensorProfile;
use crate::joint::{Drive, Joint, JointMotion};
use crate::side::Side;

/// Name of the hand, also in files.
pub const ALLEGRO_DIGIT: &str = "allegro_digit";

/// The fingers, in the order of the joint blocks of FeelSight's data.pkl.
const FINGERS: [&str; 4] = ["index", "middle", "ring", "thumb"];
const THUMB: usize = 3;
/// Joints of each finger.
const PER_FINGER: usize = 4;

/// Half of the 5 degrees by which index and ring finger are splayed, radians.
const SPLAY_HALF_RAD: f64 = 0.087_266_462_6 / 2.0;
/// Pitch of the thumb's base, -95 degrees, in radians; roll and yaw are 0 and -90 degrees.
const THUMB_PITCH_RAD: f64 = -1.658_062_788_45;
/// Radius of the capsules that replace the meshes of the slim links, metres.
const LINK_RADIUS_M: f64 = 0.0105;
/// Middle of the palm's surface, metres in the world.
const PALM_CENTRE_M: [f64; 3] = [-0.0475, 0.0, 0.0111];
/// Height above the palm at which the hand holds objects and cameras aim, metres.
const GRASP_HEIGHT_M: f64 = 0.045;
/// Place of a DIGIT on its fingertip: the inverse of the matrix in NeuralFeels' hand model, metres.
const TIP_FROM_GEL_M: [f64; 3] = [-0.002_132, 0.000_021, 0.017_545];

/// Returns the description of the hand: palm up, fingers along the world's x axis.
pub(super) fn describe(side: Side) -> HandDescription {
    let h = std::f64::consts::FRAC_1_SQRT_2;
    let palm = Body {
        name: "palm".to_owned(),
        parent: None,
        place: Placing { position_m: [0.0; 3], orientation_wxyz: [0.0, h, 0.0, h] },
        inertial: Some(inertial(0.4154, [0.0, 0.0, -0.0475], [4e-4, 4e-4, 4e-4])),
        parts: vec![link(block([-0.0093, 0.0, -0.0475], [0.0204, 0.0565, 0.0475]))],
    };
    let (mut bodies, mut joints, mut pads, mut apart) = (vec![palm], Vec::new(), Vec::new(), Vec::new());
    for (finger, name) in FINGERS.into_iter().enumerate() {
        for k in 0..PER_FINGER {
            let (place, mut joint) = joint(side, finger, k);
            joint.body = bodies.len();
            bodies.push(Body {
                name: format!("{name}_{k}"),
                parent: Some(if k == 0 { 0 } else { bodies.len() - 1 }),
                place,
                inertial: Some(link_inertial(side, finger, k)),
                parts: vec![link(link_shape(side, finger, k))],
            });
            joints.push(joint);
        }
        let tip = bodies.len();
        bodies.push(Body {
            name: format!("{name}_tip"),
            parent: Some(tip - 1),
            place: Placing::at([0.0, 0.0, tip_offset_m(finger)]),
            inertial: Some(inertial(0.020, [0.005, 0.0, 0.017], [3.5e-6, 3e-6, 2.5e-6])),
            parts: fingertip(finger),
        });
        pads.push(TouchPad {
            name: name.to_owned(),
            body: tip,
            place: Placing::at(TIP_FROM_GEL_M),
            profile: SensorProfile::tacto(),
        });
        // When a finger bends, its tip meets the link before the last.
        apart.push([tip, tip - 2]);
    }
    let [x, y, z] = PALM_CENTRE_M;
    HandDescription {
        name: ALLEGRO_DIGIT.to_owned(),
        side,
        bodies,
        joints,
        pads,
        apart,
        palm_centre_m: Some(PALM_CENTRE_M),
        grasp: Some(GraspPoint { body: None, point_m: [x, y, z + GRASP_HEIGHT_M] }),
    }
}

/// Returns the place of a link at angle 0 of its joint, and the joint at position `k` (0 = base) of a finger.
fn joint(side: Side, finger: usize, k: usize) -> (Placing, Joint) {
    let (mut place, mut joint) = right_joint(finger, k);
    joint.name = format!("{}_{k}", FINGERS[finger]);
    joint.mirrors = finger != THUMB && k == 0;
    if side == Side::Left {
        let [w, x, y, z] = place.orientation_wxyz;
        place.position_m[1] = -place.position_m[1];
        place.orientation_wxyz = [w, -x, y, -z];
        // The mirror image of a rotation about (ax, ay, az) is one about (-ax, ay, -az); abduction joints change sign
        // instead.
        if finger == THUMB {
            joint.axis = [-joint.axis[0], joint.axis[1], -joint.axis[2]].map(|c| c + 0.0);
        }
    }
    (place, joint)
}

fn right_joint(finger: usize, k: usize) -> (Placing, Joint) {
    const X_BACK: [f64; 3] = [-1.0, 0.0, 0.0];
    const Y: [f64; 3] = [0.0, 1.0, 0.0];
    const Z: [f64; 3] = [0.0, 0.0, 1.0];
    let (sin, cos) = SPLAY_HALF_RAD.sin_cos();
    let of = |place, axis, range| {
        let (name, drive) = (String::new(), Drive::default());
        (place, Joint { name, body: 0, motion: JointMotion::Hinge, axis, range, mirrors: false, drive })
    };
    let straight = |z_m| Placing::at([0.0, 0.0, z_m]);
    let knuckle = |position_m, orientation_wxyz| Placing { position_m, orientation_wxyz };
    match (finger, k) {
        (THUMB, 0) => {
            let q = na::UnitQuaternion::from_euler_angles(0.0, THUMB_PITCH_RAD, -std::f64::consts::FRAC_PI_2);
            of(knuckle([-0.0182, 0.019_333, -0.045_987], [q.w, q.i, q.j, q.k]), X_BACK, [0.263, 1.396])
        }
        (THUMB, 1) => of(Placing::at([-0.027, 0.005, 0.0399]), Z, [-0.105, 1.163]),
        (THUMB, 2) => of(straight(0.0177), Y, [-0.189, 1.644]),
        (THUMB, _) => of(straight(0.0514), Y, [-0.162, 1.719]),
        (0, 0) => of(knuckle([0.0, 0.0435, -0.001_542], [cos, -sin, 0.0, 0.0]), Z, [-0.47, 0.47]),
        (1, 0) => of(straight(0.0007), Z, [-0.47, 0.47]),
        (_, 0) => of(knuckle([0.0, -0.0435, -0.001_542], [cos, sin, 0.0, 0.0]), Z, [-0.47, 0.47]),
        (_, 1) => of(straight(0.0164), Y, [-0.196, 1.61]),
        (_, 2) => of(straight(0.054), Y, [-0.174, 1.709]),
        (_, _) => of(straight(0.0384), Y, [-0.227, 1.618]),
    }
}

/// Returns the distance from the last joint to the fingertip along the link's z axis, metres, from the URDF of HORA, whose Allegro hand
/// carries DIGITs.
fn tip_offset_m(finger: usize) -> f64 {
    if finger == THUMB { 0.0303 } else { 0.0147 }
}

fn inertial(mass_kg: f64, centre_m: [f64; 3], diagonal: [f64; 3]) -> Inertial {
    Inertial { mass_kg, centre_m, orientation_wxyz: UPRIGHT, diagonal }
}

/// Returns the inertial of a link. SimLab's URDF puts the centres of mass at the joints and has implausible off-diagonal terms; here the
/// centres lie in the middle of the links and the tensors are diagonal.
fn link_inertial(side: Side, finger: usize, k: usize) -> Inertial {
    match (finger, k) {
        (THUMB, 0) => inertial(0.0176, [-0.0179, 0.009 * side.sign(), 0.0145], [5e-6, 5e-6, 5e-6]),
        (THUMB, 1) => inertial(0.0119, [0.0, 0.0, 0.00885], [1.1e-6, 1.1e-6, 7e-7]),
        (THUMB, 2) => inertial(0.038, [0.0, 0.0, 0.0257], [1.1e-5, 1.0e-5, 3e-6]),
        (THUMB, _) => inertial(0.0388, [0.0, 0.0, 0.015], [8e-6, 8e-6, 3e-6]),
        (_, 0) => inertial(0.0119, [0.0, 0.0, 0.0082], [1.02e-6, 1.02e-6, 6.5e-7]),
        (_, 1) => inertial(0.065, [0.0, 0.0, 0.027], [2.0e-5, 1.8e-5, 5e-6]),
        (_, 2) => inertial(0.0355, [0.0, 0.0, 0.0192], [6.5e-6, 5.6e-6, 2.5e-6]),
        (_, _) => inertial(0.0096, [0.0, 0.0, 0.008], [1.5e-6, 1.5e-6, 1e-6]),
    }
}

fn block(centre: [f64; 3], half: [f64; 3]) -> Primitive {
    Primitive::Box { centre, half, orientation_wxyz: UPRIGHT }
}

fn link(shape: Primitive) -> Part {
    Part { surface: PartSurface::Link, shape }
}

fn link_shape(side: Side, finger: usize, k: usize) -> Primitive {
    // A capsule from height `from` to `to` along the link, `x` off its axis.
    let capsule = |x, from, to| Primitive::Capsule { from: [x, 0.0, from], to: [x, 0.0, to], radius: LINK_RADIUS_M };
    match (finger, k) {
        (THUMB, 0) => block([-0.0179, 0.009 * side.sign(), 0.0145], [0.0179, 0.017, 0.02275]),
        (THUMB, 1) => capsule(-0.0007, 0.004, 0.0137),
        (THUMB, 2) => capsule(-0.0007, 0.004, 0.0474),
        (THUMB, _) => capsule(-0.0007, 0.004, 0.024),
        (_, 0) => capsule(-0.001, 0.004, 0.0124),
        (_, 1) => block([0.0, 0.0, 0.027], [0.0098, 0.0125, 0.024]),
        (_, 2) => capsule(-0.0007, 0.004, 0.0344),
        (_, _) => capsule(-0.0007, 0.0, 0.008),
    }
}

/// Returns the housing and the gel of a DIGIT.
fn fingertip(pad: usize) -> Vec<Part> {
    vec![
        // Narrower than the gel; otherwise its hard edge would touch first at 45 degrees.
        Part { surface: PartSurface::Housing, shape: block([0.003_75, 0.0, 0.0168], [0.009_75, 0.0115, 0.0155]) },
        // More domed than TACTO's gel, so that a touch has one contact point: radii of curvature 18 mm and 30
        // mm, apex at x = 20.1 mm. Its surface lies inside TACTO's gel, so every physical contact is visible in
        // the image.
        Part {
            surface: PartSurface::Gel(pad),
            shape: Primitive::Ellipsoid {
                centre: [0.0111, 0.0, 0.0165],
                semi: [0.009, 0.0128, 0.0165],
                orientation_wxyz: UPRIGHT,
            },
        },
    ]
}
