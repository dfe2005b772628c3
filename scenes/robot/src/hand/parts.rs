//! Bodies of the hand: their masses, and the primitives for collisions and rendering.

use nalgebra as na;

use super::kinematics::{finger_kinematics, world_from_base};
use crate::finger::{Finger, JointAngles};
use crate::side::Side;

/// Rigid body of the hand.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Body {
    /// Palm, fixed in the world.
    Palm,
    /// Link `k` (0 = base) of a finger.
    Link(Finger, usize),
    /// Fingertip with the DIGIT.
    Tip(Finger),
}

impl Body {
    /// Returns all bodies: the palm, then each finger from base to tip.
    pub fn all() -> impl Iterator<Item = Body> {
        let finger = |f| (0..4).map(move |k| Body::Link(f, k)).chain([Body::Tip(f)]);
        std::iter::once(Body::Palm).chain(Finger::ALL.into_iter().flat_map(finger))
    }

    /// Returns the name of the body in the MJCF.
    pub fn name(self) -> String {
        match self {
            Body::Palm => "base".to_owned(),
            Body::Link(finger, k) => format!("{}_{k}", finger.prefix()),
            Body::Tip(finger) => format!("{}_tip", finger.prefix()),
        }
    }

    /// Returns the pose of the body in the world at the given joint angles.
    pub fn pose(self, side: Side, joints: &JointAngles) -> na::Isometry3<f64> {
        let base = world_from_base().untyped();
        match self {
            Body::Palm => base,
            Body::Link(finger, k) => base * finger_kinematics(side, finger, joints).0[k],
            Body::Tip(finger) => base * finger_kinematics(side, finger, joints).1.untyped(),
        }
    }
}

/// Shape of a part in its body's frame, metres. Boxes and ellipsoids are aligned with the body's axes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Primitive {
    /// Box.
    Box {
        /// Centre.
        centre: [f64; 3],
        /// Half extents.
        half: [f64; 3],
    },
    /// All points within `radius` of the segment from `from` to `to`.
    Capsule {
        /// One end of the axis.
        from: [f64; 3],
        /// Other end of the axis.
        to: [f64; 3],
        /// Radius.
        radius: f64,
    },
    /// Ellipsoid.
    Ellipsoid {
        /// Centre.
        centre: [f64; 3],
        /// Semi-axes.
        semi: [f64; 3],
    },
}

/// Material of a part.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PartSurface {
    /// Bare plastic.
    Link,
    /// The housing of a DIGIT.
    Digit,
    /// The gel of a DIGIT.
    Gel,
}

/// Primitive of the hand.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Part {
    /// Body that moves it.
    pub body: Body,
    /// Its material.
    pub surface: PartSurface,
    /// Its shape.
    pub shape: Primitive,
}

/// Mass, centre of mass and diagonal inertia of a body.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Inertial {
    /// Mass, kg.
    pub mass_kg: f64,
    /// Centre of mass in the body's frame, metres.
    pub centre_m: [f64; 3],
    /// Diagonal of the inertia tensor about the centre of mass, kg m^2.
    pub diagonal: [f64; 3],
}

/// Returns the inertial of a body. SimLab's URDF puts the centres of mass at the joints and has implausible
/// off-diagonal terms; here the centres lie in the middle of the links and the tensors are diagonal.
pub fn inertial(side: Side, body: Body) -> Inertial {
    let of = |mass_kg, centre_m, diagonal| Inertial { mass_kg, centre_m, diagonal };
    let mut inertial = match body {
        Body::Palm => of(0.4154, [0.0, 0.0, -0.0475], [4e-4, 4e-4, 4e-4]),
        Body::Link(Finger::Thumb, 0) => of(0.0176, [-0.0179, 0.009, 0.0145], [5e-6, 5e-6, 5e-6]),
        Body::Link(Finger::Thumb, 1) => of(0.0119, [0.0, 0.0, 0.00885], [1.1e-6, 1.1e-6, 7e-7]),
        Body::Link(Finger::Thumb, 2) => of(0.038, [0.0, 0.0, 0.0257], [1.1e-5, 1.0e-5, 3e-6]),
        Body::Link(Finger::Thumb, _) => of(0.0388, [0.0, 0.0, 0.015], [8e-6, 8e-6, 3e-6]),
        Body::Link(_, 0) => of(0.0119, [0.0, 0.0, 0.0082], [1.02e-6, 1.02e-6, 6.5e-7]),
        Body::Link(_, 1) => of(0.065, [0.0, 0.0, 0.027], [2.0e-5, 1.8e-5, 5e-6]),
        Body::Link(_, 2) => of(0.0355, [0.0, 0.0, 0.0192], [6.5e-6, 5.6e-6, 2.5e-6]),
        Body::Link(_, _) => of(0.0096, [0.0, 0.0, 0.008], [1.5e-6, 1.5e-6, 1e-6]),
        Body::Tip(_) => of(0.020, [0.005, 0.0, 0.017], [3.5e-6, 3e-6, 2.5e-6]),
    };
    inertial.centre_m[1] *= side.sign();
    inertial
}

/// Radius of the capsules that replace the meshes of the slim links, metres.
const LINK_RADIUS_M: f64 = 0.0105;

/// Returns all primitives of the hand, body by body.
pub fn parts(side: Side) -> Vec<Part> {
    let mut parts = Vec::new();
    for body in Body::all() {
        let mut add = |surface, shape| parts.push(Part { body, surface, shape });
        // A capsule from height `from` to `to` along the link, `x` off its axis.
        let capsule =
            |x, from, to| Primitive::Capsule { from: [x, 0.0, from], to: [x, 0.0, to], radius: LINK_RADIUS_M };
        match body {
            Body::Palm => {
                add(
                    PartSurface::Link,
                    Primitive::Box { centre: [-0.0093, 0.0, -0.0475], half: [0.0204, 0.0565, 0.0475] },
                );
            }
            Body::Link(Finger::Thumb, 0) => add(
                PartSurface::Link,
                Primitive::Box { centre: [-0.0179, 0.009 * side.sign(), 0.0145], half: [0.0179, 0.017, 0.02275] },
            ),
            Body::Link(Finger::Thumb, 1) => add(PartSurface::Link, capsule(-0.0007, 0.004, 0.0137)),
            Body::Link(Finger::Thumb, 2) => add(PartSurface::Link, capsule(-0.0007, 0.004, 0.0474)),
            Body::Link(Finger::Thumb, _) => add(PartSurface::Link, capsule(-0.0007, 0.004, 0.024)),
            Body::Link(_, 0) => add(PartSurface::Link, capsule(-0.001, 0.004, 0.0124)),
            Body::Link(_, 1) => {
                add(PartSurface::Link, Primitive::Box { centre: [0.0, 0.0, 0.027], half: [0.0098, 0.0125, 0.024] });
            }
            Body::Link(_, 2) => add(PartSurface::Link, capsule(-0.0007, 0.004, 0.0344)),
            Body::Link(_, _) => add(PartSurface::Link, capsule(-0.0007, 0.0, 0.008)),
            Body::Tip(_) => {
                // Narrower than the gel; otherwise its hard edge would touch first at 45 degrees.
                add(
                    PartSurface::Digit,
                    Primitive::Box { centre: [0.003_75, 0.0, 0.0168], half: [0.009_75, 0.0115, 0.0155] },
                );
                // More domed than TACTO's gel, so that a touch has one contact point: radii of curvature 18 mm and 30
                // mm, apex at x = 20.1 mm. Its surface lies inside TACTO's gel, so every physical contact is visible in
                // the image.
                add(
                    PartSurface::Gel,
                    Primitive::Ellipsoid { centre: [0.0111, 0.0, 0.0165], semi: [0.009, 0.0128, 0.0165] },
                );
            }
        }
    }
    parts
}
