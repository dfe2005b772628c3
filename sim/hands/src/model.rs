//! What an MJCF and a URDF have in common: links in a tree, with joints, masses and shapes.

use mvt_robot::hand::{Inertial, JointMotion, Primitive};
use nalgebra as na;

/// Largest number of links that is read; a hand has at most 128 bodies, but may sit on an arm.
pub(crate) const MOST_LINKS: usize = 1024;

/// Tree of links.
#[derive(Debug, Default)]
pub(crate) struct Model {
    /// Links, each after its parent, depth first.
    pub links: Vec<Link>,
    /// Named places on links.
    pub sites: Vec<Site>,
    /// Pairs of links that the model excludes from collisions.
    pub excluded: Vec<[usize; 2]>,
    /// Pairs of links whose shapes do not collide with one another.
    pub masked: Vec<[usize; 2]>,
    /// Joints that the model couples.
    pub couplings: Vec<Coupling>,
    /// What was left out.
    pub warnings: Vec<String>,
}

/// Rigid body of a model. Its frame, to which all places refer, lies at the anchor of its joint.
#[derive(Debug)]
pub(crate) struct Link {
    pub name: String,
    pub parent: Option<usize>,
    /// Where it is on its parent while its joint is at 0.
    pub place: na::Isometry3<f64>,
    /// Motion from the frame here to the link's frame in the file.
    pub frame: na::Isometry3<f64>,
    pub joint: Option<LinkJoint>,
    pub inertial: Option<Inertial>,
    pub shapes: Vec<LinkShape>,
}

/// Joint between a link and its parent.
#[derive(Debug)]
pub(crate) struct LinkJoint {
    pub name: String,
    pub motion: LinkMotion,
    pub axis: na::Vector3<f64>,
    /// Limits, if the model gives any.
    pub range: Option<[f64; 2]>,
    /// Largest torque or force, if the model gives any.
    pub effort: Option<f64>,
}

/// How a joint moves.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum LinkMotion {
    /// As a joint of a hand.
    Simple(JointMotion),
    /// A hinge without limits.
    Continuous,
    /// In more than one way: its name in the file.
    Complex(&'static str),
}

/// Shape of a link.
#[derive(Debug)]
pub(crate) struct LinkShape {
    pub name: Option<String>,
    pub shape: Primitive,
}

/// Named place on a link.
#[derive(Debug)]
pub(crate) struct Site {
    pub name: String,
    pub link: usize,
    pub place: na::Isometry3<f64>,
}

/// Joints that cannot move independently of one another.
#[derive(Debug)]
pub(crate) struct Coupling {
    /// The element of the file that couples them.
    pub by: String,
    pub joints: Vec<String>,
    /// Whether the hand is refused while more than one of them moves.
    pub refused: bool,
}

impl Model {
    /// Returns the link of a name.
    pub fn link(&self, name: &str) -> Option<usize> {
        self.links.iter().position(|link| link.name == name)
    }

    /// Returns whether a link is another one, or is carried by it.
    pub fn carries(&self, base: usize, link: usize) -> bool {
        std::iter::successors(Some(link), |&link| self.links[link].parent).any(|link| link == base)
    }
}

impl LinkJoint {
    /// Returns the place of the link after the joint has moved it by a value.
    pub fn moved(&self, place: na::Isometry3<f64>, by: f64) -> na::Isometry3<f64> {
        let along = self.axis * by;
        match self.motion {
            LinkMotion::Simple(JointMotion::Slide) => place * na::Translation3::from(along),
            LinkMotion::Simple(JointMotion::Hinge) | LinkMotion::Continuous => {
                place * na::UnitQuaternion::from_scaled_axis(along)
            }
            LinkMotion::Complex(_) => place,
        }
    }

    /// Returns whether it lets the link move freely in space.
    pub fn is_free(&self) -> bool {
        matches!(self.motion, LinkMotion::Complex("a free joint" | "a floating joint"))
    }
}
