//! Bodies of the hand: masses and the primitives that collide and are rendered.

use super::{Finger, JointAngles, Side, finger_kinematics, world_from_base};
use nalgebra as na;

/// A rigid body of the hand.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Body {
    /// The palm, fixed in the world.
    Palm,
    /// Link `k` (0 = base) of a finger.
    Link(Finger, usize),
    /// The fingertip that carries the DIGIT.
    Tip(Finger),
}

impl Body {
    /// All bodies: the palm, then each finger from base to tip.
    pub fn all() -> impl Iterator<Item = Body> {
        let finger = |f| (0..4).map(move |k| Body::Link(f, k)).chain([Body::Tip(f)]);
        std::iter::once(Body::Palm).chain(Finger::ALL.into_iter().flat_map(finger))
    }

    /// Name of the body in the MJCF.
    pub fn name(self) -> String {
        match self {
            Body::Palm => "base".to_owned(),
            Body::Link(finger, k) => format!("{}_{k}", finger.prefix()),
            Body::Tip(finger) => format!("{}_tip", finger.prefix()),
        }
    }

    /// Pose of the body in the world at the given joint angles.
    pub fn pose(self, side: Side, joints: &JointAngles) -> na::Isometry3<f64> {
        let base = world_from_base().untyped();
        match self {
            Body::Palm => base,
            Body::Link(finger, k) => base * finger_kinematics(side, finger, joints).0[k],
            Body::Tip(finger) => base * finger_kinematics(side, finger, joints).1.untyped(),
        }
    }
}

/// Shape of a part, in its body's frame, metres. Boxes and ellipsoids are aligned with the body's axes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Primitive {
    /// A box with these half extents.
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
    /// An ellipsoid with these semi-axes.
    Ellipsoid {
        /// Centre.
        centre: [f64; 3],
        /// Semi-axes.
        semi: [f64; 3],
    },
}

/// What a part is made of.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Surface {
    /// Bare plastic.
    Link,
    /// The housing of a DIGIT.
    Digit,
    /// The gel of a DIGIT.
    Gel,
}

/// A primitive of the hand.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Part {
    /// The body that it belongs to.
    pub body: Body,
    /// Its surface.
    pub surface: Surface,
    /// Its shape.
    pub shape: Primitive,
}

/// Mass, centre of mass and diagonal inertia of a body about it, kg, m and kg m^2.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Inertial {
    /// Mass, kg.
    pub mass_kg: f64,
    /// Centre of mass in the body's frame, metres.
    pub centre_m: [f64; 3],
    /// Diagonal of the inertia tensor, kg m^2.
    pub diagonal: [f64; 3],
}

/// Inertial of a body. The URDF puts centres of mass at the joints and has odd off-diagonal terms; these sit mid-link with plain
/// diagonals instead (in-hand spike, section 1).
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

/// Radius of the capsules that stand for the slim links, metres.
const LINK_RADIUS_M: f64 = 0.0105;

/// All primitives of the hand, body by body.
pub fn parts(side: Side) -> Vec<Part> {
    let mut parts = Vec::new();
    for body in Body::all() {
        let mut add = |surface, shape| parts.push(Part { body, surface, shape });
        // A capsule from height `from` to `to` along the link, `x` off its axis.
        let capsule =
            |x, from, to| Primitive::Capsule { from: [x, 0.0, from], to: [x, 0.0, to], radius: LINK_RADIUS_M };
        match body {
            Body::Palm => {
                add(Surface::Link, Primitive::Box { centre: [-0.0093, 0.0, -0.0475], half: [0.0204, 0.0565, 0.0475] });
            }
            Body::Link(Finger::Thumb, 0) => add(
                Surface::Link,
                Primitive::Box { centre: [-0.0179, 0.009 * side.sign(), 0.0145], half: [0.0179, 0.017, 0.02275] },
            ),
            Body::Link(Finger::Thumb, 1) => add(Surface::Link, capsule(-0.0007, 0.004, 0.0137)),
            Body::Link(Finger::Thumb, 2) => add(Surface::Link, capsule(-0.0007, 0.004, 0.0474)),
            Body::Link(Finger::Thumb, _) => add(Surface::Link, capsule(-0.0007, 0.004, 0.024)),
            Body::Link(_, 0) => add(Surface::Link, capsule(-0.001, 0.004, 0.0124)),
            Body::Link(_, 1) => {
                add(Surface::Link, Primitive::Box { centre: [0.0, 0.0, 0.027], half: [0.0098, 0.0125, 0.024] });
            }
            Body::Link(_, 2) => add(Surface::Link, capsule(-0.0007, 0.004, 0.0344)),
            Body::Link(_, _) => add(Surface::Link, capsule(-0.0007, 0.0, 0.008)),
            Body::Tip(_) => {
                // Narrower than the gel, or its hard edge would touch first at 45 degrees.
                add(
                    Surface::Digit,
                    Primitive::Box { centre: [0.003_75, 0.0, 0.0168], half: [0.009_75, 0.0115, 0.0155] },
                );
                // More domed than TACTO's gel, so that a touch has one clean contact point: curvature radius 18 mm by 30 mm,
                // apex at x = 20.1 mm. Its surface lies inside TACTO's gel, so every physical contact shows in the image.
                add(
                    Surface::Gel,
                    Primitive::Ellipsoid { centre: [0.0111, 0.0, 0.0165], semi: [0.009, 0.0128, 0.0165] },
                );
            }
        }
    }
    parts
}
