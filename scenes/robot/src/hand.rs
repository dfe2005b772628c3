//! A hand as data: a tree of bodies that joints move, with touch pads on some of them.
//!
//! Perception, rendering and physics receive a [`Hand`] and know no special one. [`Hand::allegro`] is built in; others are made from a
//! [`HandDescription`], which serialises.

mod allegro;
mod hull;
mod kinematics;
mod parts;
pub mod solid;

use std::collections::BTreeSet;
use std::sync::{Arc, LazyLock, OnceLock};

use mvt_frames::{Point, World};
use nalgebra as na;
use serde::{Deserialize, Serialize};

use crate::digit::gel::GelView;
use crate::digit::profile::SensorProfile;
pub use crate::joint::{Drive, Joint, JointAngles, JointMotion};
pub use crate::per_pad::PerPad;
pub use crate::side::Side;
pub use allegro::ALLEGRO_DIGIT;
pub use hull::{Hull, HullError};
pub use parts::{Body, Inertial, Part, PartSurface, Placing, Primitive, UPRIGHT};

/// Largest number of joints, bodies and pads of a hand; a file with more is damaged.
const MOST: usize = 128;

/// A touch sensor on a hand.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TouchPad {
    /// Name, also of its folder in logs.
    pub name: String,
    /// Index of the body that carries it.
    pub body: usize,
    /// Where the gel frame of the sensor is on that body: origin at the camera, x out of the gel, z up in the image.
    pub place: Placing,
    /// The sensor.
    #[serde(default, skip_serializing_if = "SensorProfile::is_tacto")]
    pub profile: SensorProfile,
}

/// Point around which a hand holds objects.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GraspPoint {
    /// Index of the body with which it moves; `None` if it is fixed in the world.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub body: Option<usize>,
    /// The point in that body's frame, or in the world, metres.
    pub point_m: [f64; 3],
}

/// All that describes a hand. Lengths are metres, angles radians.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HandDescription {
    /// Name, also in controller files.
    pub name: String,
    /// Side of the hand. Cameras, gaits and gravity of a left hand are mirrored.
    pub side: Side,
    /// Bodies, depth first: each follows its parent and all that its elder siblings carry.
    pub bodies: Vec<Body>,
    /// Joints in the order of the bodies that they move, at most one per body.
    pub joints: Vec<Joint>,
    /// Touch sensors.
    pub pads: Vec<TouchPad>,
    /// Pairs of bodies that do not collide, beside parent and child.
    pub apart: Vec<[usize; 2]>,
    /// Middle of the palm's surface in the world, z up; `None` for a hand that does not carry objects on a palm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub palm_centre_m: Option<[f64; 3]>,
    /// Where it holds objects; `None` without a hand.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub grasp: Option<GraspPoint>,
}

/// Reason that a description is not that of a hand.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("hand {hand}: {reason}")]
pub struct HandError {
    hand: String,
    reason: String,
}

/// A hand, checked. It is immutable and shared.
#[derive(Debug, Clone)]
pub struct Hand {
    description: HandDescription,
    /// Index of the joint of each body.
    joint_of: Vec<Option<usize>>,
    /// Joints that move each body, from the base outwards.
    chains: Vec<Vec<usize>>,
    /// Number of the limb of each body: bodies that follow one another without a branch.
    limbs: Vec<usize>,
    /// Views of the touch sensors' cameras on their gels, computed on first use.
    gel_views: OnceLock<PerPad<GelView>>,
}

/// All else follows from the description.
impl PartialEq for Hand {
    fn eq(&self, other: &Self) -> bool {
        self.description == other.description
    }
}

impl Hand {
    /// Checks a description.
    ///
    /// # Errors
    /// [`HandError`] names the first fault.
    pub fn new(description: HandDescription) -> Result<Arc<Self>, HandError> {
        Self::check(&description).map_err(|reason| HandError { hand: description.name.clone(), reason })?;
        let HandDescription { bodies, joints, .. } = &description;
        let mut joint_of = vec![None; bodies.len()];
        for (j, joint) in joints.iter().enumerate() {
            joint_of[joint.body] = Some(j);
        }
        let mut chains: Vec<Vec<usize>> = Vec::new();
        let mut limbs: Vec<usize> = Vec::new();
        for (body, Body { parent, .. }) in bodies.iter().enumerate() {
            let mut chain = parent.map_or_else(Vec::new, |parent| chains[parent].clone());
            chain.extend(joint_of[body]);
            chains.push(chain);
            let siblings = bodies.iter().filter(|other| other.parent == *parent).count();
            let next = limbs.iter().max().map_or(0, |last| last + 1);
            limbs.push(parent.filter(|_| siblings == 1).map_or(next, |parent| limbs[parent]));
        }
        Ok(Arc::new(Self { description, joint_of, chains, limbs, gel_views: OnceLock::new() }))
    }

    /// Returns the Allegro hand with four DIGITs, palm up, fingers along the world's x axis.
    pub fn allegro(side: Side) -> Arc<Self> {
        static HANDS: LazyLock<[Arc<Hand>; 2]> = LazyLock::new(|| {
            [Side::Left, Side::Right].map(|side| {
                // A test checks both descriptions.
                Hand::new(allegro::describe(side)).unwrap_or_else(|_| Hand::none())
            })
        });
        Arc::clone(&HANDS[usize::from(side == Side::Right)])
    }

    /// Returns the hand of a rig that has none: no bodies, joints and pads.
    pub fn none() -> Arc<Self> {
        let description = HandDescription {
            name: "none".to_owned(),
            side: Side::Right,
            bodies: Vec::new(),
            joints: Vec::new(),
            pads: Vec::new(),
            apart: Vec::new(),
            palm_centre_m: None,
            grasp: None,
        };
        Arc::new(Self {
            description,
            joint_of: Vec::new(),
            chains: Vec::new(),
            limbs: Vec::new(),
            gel_views: OnceLock::new(),
        })
    }

    /// Returns the description.
    pub fn description(&self) -> &HandDescription {
        &self.description
    }

    /// Returns the name.
    pub fn name(&self) -> &str {
        &self.description.name
    }

    /// Returns the side.
    pub fn side(&self) -> Side {
        self.description.side
    }

    /// Returns the hand with this touch sensor on all pads. Its bodies stay.
    #[must_use]
    pub fn with_profile(&self, profile: &SensorProfile) -> Arc<Self> {
        self.with_profiles(|_| profile.clone())
    }

    /// Returns the hand with a touch sensor for each pad. Its bodies stay.
    #[must_use]
    pub fn with_profiles(&self, profile: impl Fn(&TouchPad) -> SensorProfile) -> Arc<Self> {
        let mut hand = self.clone();
        hand.description.pads.iter_mut().for_each(|pad| pad.profile = profile(pad));
        // Those of the sensors before may have been asked for.
        hand.gel_views = OnceLock::new();
        Arc::new(hand)
    }

    /// Returns the hand with other drives, one for each joint. Its bodies stay.
    ///
    /// # Errors
    /// [`HandError`] if a drive is impossible, such as one with a negative stiffness.
    pub fn with_drives(&self, drives: &[Drive]) -> Result<Arc<Self>, HandError> {
        let mut description = self.description.clone();
        description.joints.iter_mut().zip(drives).for_each(|(joint, drive)| joint.drive = *drive);
        Self::new(description)
    }

    /// Returns whether it is the built-in Allegro, whatever the profiles of its touch sensors.
    pub fn is_allegro(&self) -> bool {
        self.with_profile(&SensorProfile::tacto()).description == Self::allegro(self.side()).description
    }

    /// Returns whether there is no hand.
    pub fn is_none(&self) -> bool {
        self.description.bodies.is_empty()
    }

    /// Returns the bodies, each after its parent.
    pub fn bodies(&self) -> &[Body] {
        &self.description.bodies
    }

    /// Returns the joints, in the order of [`JointAngles`].
    pub fn joints(&self) -> &[Joint] {
        &self.description.joints
    }

    /// Returns the touch sensors, in the order of [`PerPad`].
    pub fn pads(&self) -> &[TouchPad] {
        &self.description.pads
    }

    /// Returns the parts of all bodies, body by body, each with the index of its body.
    pub fn parts(&self) -> impl Iterator<Item = (usize, &Part)> {
        self.bodies().iter().enumerate().flat_map(|(body, of)| of.parts.iter().map(move |part| (body, part)))
    }

    /// Returns the index of the joint between a body and its parent.
    pub fn joint_of(&self, body: usize) -> Option<usize> {
        self.joint_of.get(body).copied().flatten()
    }

    /// Returns the joints that move a body, from the base outwards.
    pub fn chain(&self, body: usize) -> &[usize] {
        self.chains.get(body).map_or(&[], Vec::as_slice)
    }

    /// Returns the joints that move a pad, from the base outwards.
    pub fn pad_chain(&self, pad: usize) -> &[usize] {
        self.pads().get(pad).map_or(&[], |pad| self.chain(pad.body))
    }

    /// Returns the view of the camera of each touch sensor on its undeformed gel.
    pub fn gel_views(&self) -> &PerPad<GelView> {
        self.gel_views.get_or_init(|| self.pads().iter().map(|pad| pad.profile.gel_view()).collect())
    }

    /// Returns the limits of all joints, radians or metres.
    pub fn ranges(&self) -> Vec<[f64; 2]> {
        self.joints().iter().map(|joint| joint.range).collect()
    }

    /// Returns one value per pad.
    pub fn per_pad<T>(&self, f: impl FnMut(usize) -> T) -> PerPad<T> {
        PerPad::from_fn(self.pads().len(), f)
    }

    /// Returns the angles of this hand in the mirror image of the pose that a right hand has at `right`. Its own inverse.
    pub fn mirrored(&self, right: &[f64]) -> JointAngles {
        // Why: notes/decisions/simulation.md, "The left hand is the mirror image, with its scene".
        let flips = |j: usize| self.side() == Side::Left && self.joints().get(j).is_some_and(|joint| joint.mirrors);
        right.iter().enumerate().map(|(j, angle)| if flips(j) { -angle } else { *angle }).collect()
    }

    /// Returns the angles within the limits of the joints.
    pub fn within_ranges(&self, angles: &[f64]) -> JointAngles {
        angles.iter().zip(self.joints()).map(|(angle, joint)| angle.clamp(joint.range[0], joint.range[1])).collect()
    }

    /// Returns the middle of the palm's surface in the world, metres.
    pub fn palm_centre_m(&self) -> Option<[f64; 3]> {
        self.description.palm_centre_m
    }

    /// Returns the point around which the hand holds objects.
    pub fn grasp_centre(&self, joints: &[f64]) -> Option<Point<World>> {
        let GraspPoint { body, point_m: [x, y, z] } = self.description.grasp?;
        let Some(body) = body else { return Some(Point::new(x, y, z)) };
        let pose = *self.body_poses(joints).get(body)?;
        Some(Point::from((pose * na::Point3::new(x, y, z)).coords))
    }

    fn check(description: &HandDescription) -> Result<(), String> {
        let HandDescription { bodies, joints, pads, apart, palm_centre_m, grasp, .. } = description;
        for (what, count) in [("bodies", bodies.len()), ("joints", joints.len()), ("pads", pads.len())] {
            if count > MOST {
                return Err(format!("it has {count} {what}; at most {MOST} are possible"));
            }
        }
        let mut path: Vec<usize> = Vec::new();
        for (k, body) in bodies.iter().enumerate() {
            while body.parent.is_some() && path.last() != body.parent.as_ref() {
                if path.pop().is_none() {
                    return Err(format!("body {}: its parent must stand before it, depth first", body.name));
                }
            }
            if body.parent.is_none() {
                path.clear();
            }
            path.push(k);
            check_placing(&body.place).map_err(|fault| format!("body {}: {fault}", body.name))?;
            check_body(body, pads.len()).map_err(|fault| format!("body {}: {fault}", body.name))?;
        }
        unique("body", bodies.iter().map(|body| &body.name))?;
        unique("joint", joints.iter().map(|joint| &joint.name))?;
        unique("pad", pads.iter().map(|pad| &pad.name))?;
        for pair in joints.windows(2) {
            if pair[0].body >= pair[1].body {
                return Err(format!("joint {}: joints stand in the order of their bodies, one per body", pair[1].name));
            }
        }
        for joint in joints {
            check_joint(joint, bodies.len()).map_err(|fault| format!("joint {}: {fault}", joint.name))?;
            if bodies[joint.body].inertial.is_none() {
                return Err(format!(
                    "body {}: joint {} moves it, so it needs a mass",
                    bodies[joint.body].name, joint.name
                ));
            }
        }
        for pad in pads {
            if pad.body >= bodies.len() {
                return Err(format!("pad {}: there is no body {}", pad.name, pad.body));
            }
            check_placing(&pad.place).map_err(|fault| format!("pad {}: {fault}", pad.name))?;
            pad.profile.validate().map_err(|fault| format!("pad {}: {fault}", pad.name))?;
        }
        if apart
            .iter()
            .flatten()
            .chain(grasp.iter().filter_map(|grasp| grasp.body.as_ref()))
            .any(|&b| b >= bodies.len())
        {
            return Err("apart or grasp names a body that does not exist".to_owned());
        }
        let points = palm_centre_m.iter().chain(grasp.iter().map(|grasp| &grasp.point_m));
        if points.flatten().any(|v| !v.is_finite()) {
            return Err("palm_centre_m or grasp is not finite".to_owned());
        }
        Ok(())
    }
}

fn unique<'a>(what: &str, names: impl Iterator<Item = &'a String>) -> Result<(), String> {
    let mut seen = BTreeSet::new();
    for name in names {
        // Names become those of folders, and attributes in XML.
        let plain = |c: char| c.is_alphanumeric() || "_-./ ".contains(c);
        if name.is_empty() || name.starts_with(['.', '/', ' ']) || name.contains("..") || !name.chars().all(plain) {
            return Err(format!("{what} {name:?}: a name has letters, digits and _-. and does not begin with a dot"));
        }
        if !seen.insert(name) {
            return Err(format!("{what} {name} occurs twice"));
        }
    }
    Ok(())
}

fn check_placing(place: &Placing) -> Result<(), String> {
    let finite = place.position_m.iter().chain(&place.orientation_wxyz).all(|v| v.is_finite());
    let norm = place.orientation_wxyz.iter().map(|q| q * q).sum::<f64>().sqrt();
    match finite && (norm - 1.0).abs() < 1e-3 {
        true => Ok(()),
        false => Err("its place needs finite numbers and a quaternion of length 1".to_owned()),
    }
}

fn check_joint(joint: &Joint, bodies: usize) -> Result<(), String> {
    let [low, high] = joint.range;
    let Drive { stiffness, damping, armature, friction, torque_limit } = joint.drive;
    let norm = joint.axis.iter().map(|a| a * a).sum::<f64>().sqrt();
    if joint.body >= bodies {
        return Err(format!("there is no body {}", joint.body));
    }
    if !(norm - 1.0).abs().le(&1e-6) {
        return Err("its axis needs length 1".to_owned());
    }
    if !(low.is_finite() && high.is_finite() && low < high) {
        return Err(format!("its range [{low}, {high}] is empty or not finite: write lower and upper limit"));
    }
    let holds = |value: f64| value.is_finite() && value >= 0.0;
    if ![stiffness, damping, armature, friction, torque_limit].into_iter().all(holds) {
        return Err("its drive needs finite numbers that are not negative".to_owned());
    }
    Ok(())
}

fn check_body(body: &Body, pads: usize) -> Result<(), String> {
    if let Some(Inertial { mass_kg, centre_m, orientation_wxyz, diagonal }) = &body.inertial {
        let positive = |v: &f64| v.is_finite() && *v > 0.0;
        if !(positive(mass_kg) && diagonal.iter().all(positive)) {
            return Err("its mass and inertia must be positive".to_owned());
        }
        check_placing(&Placing { position_m: *centre_m, orientation_wxyz: *orientation_wxyz })?;
    }
    for part in &body.parts {
        if let PartSurface::Gel(pad) = part.surface
            && pad >= pads
        {
            return Err(format!("a part is the gel of pad {pad}, which does not exist"));
        }
        let numbers: Vec<f64> = match &part.shape {
            Primitive::Box { centre, half, orientation_wxyz } => {
                check_placing(&Placing { position_m: *centre, orientation_wxyz: *orientation_wxyz })?;
                half.to_vec()
            }
            Primitive::Ellipsoid { centre, semi, orientation_wxyz } => {
                check_placing(&Placing { position_m: *centre, orientation_wxyz: *orientation_wxyz })?;
                semi.to_vec()
            }
            Primitive::Capsule { from, to, radius } => {
                if from.iter().chain(to).any(|v| !v.is_finite()) {
                    return Err("a capsule's ends are not finite".to_owned());
                }
                vec![*radius]
            }
            Primitive::Hull(_) => Vec::new(),
        };
        if !numbers.iter().all(|v| v.is_finite() && *v > 0.0) {
            return Err("the sizes of its parts must be positive".to_owned());
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_allegro_is_a_hand() {
        for side in [Side::Left, Side::Right] {
            let description = allegro::describe(side);
            assert_eq!(Hand::check(&description), Ok(()));
            let hand = Hand::allegro(side);
            assert_eq!((hand.joints().len(), hand.pads().len(), hand.bodies().len()), (16, 4, 21));
            assert_eq!(hand.side(), side);
            assert_eq!(hand.pad_chain(3), [12, 13, 14, 15]);
            assert_eq!(hand.limbs[0..7], [0, 1, 1, 1, 1, 1, 2]);
        }
    }

    #[test]
    fn other_sensors_have_views_of_their_own() {
        let hand = Hand::allegro(Side::Left);
        assert_eq!(hand.gel_views()[0], SensorProfile::tacto().gel_view());
        let other = SensorProfile::load("gelsight_mini").unwrap();
        assert_eq!(hand.with_profile(&other).gel_views()[0], other.gel_view());
    }

    #[test]
    fn a_description_comes_back_from_its_text() {
        let description = allegro::describe(Side::Left);
        let text = toml::to_string(&description).unwrap();
        assert_eq!(toml::from_str::<HandDescription>(&text).unwrap(), description);
    }

    #[test]
    fn faults_are_named() {
        let refused = |spoil: fn(&mut HandDescription)| {
            let mut description = allegro::describe(Side::Right);
            spoil(&mut description);
            Hand::new(description).unwrap_err().to_string()
        };
        assert!(refused(|d| d.bodies[3].parent = Some(9)).contains("index_2: its parent"));
        assert!(refused(|d| d.joints[2].name = "index_1".to_owned()).contains("joint index_1 occurs twice"));
        assert!(refused(|d| d.joints[5].range = [1.0, 0.0]).contains("middle_1: its range"));
        assert!(refused(|d| d.joints[5].axis = [0.0; 3]).contains("middle_1: its axis"));
        assert!(refused(|d| d.pads[1].body = 99).contains("pad middle"));
        assert!(refused(|d| d.pads[1].name = "../up".to_owned()).contains("does not begin with a dot"));
        assert!(refused(|d| d.bodies[2].place.position_m[1] = f64::NAN).contains("body index_1"));
        assert!(refused(|d| d.joints.swap(1, 2)).contains("in the order of their bodies"));
    }
}
