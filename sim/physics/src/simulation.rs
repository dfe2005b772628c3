//! The hand and one object in MuJoCo: step, read, save and restore.

use mujoco_rs::error::MjDataError;
use mujoco_rs::prelude::*;
use mujoco_rs::wrappers::mj_auxiliary::MjContact;
use mvt_frames::{Isometry, Object as ObjectFrame, World as WorldFrame};
use mvt_objects::object::Object;
use mvt_robot::hand::{Hand, JointAngles, PartSurface, PerPad};
use nalgebra as na;
use serde::{Deserialize, Serialize};

use crate::messages;
use crate::mjcf;
use crate::mjcf::Physics;

/// Contact of a pad with the object.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct PadContact {
    /// Sum of the normal forces between gel and object, newtons.
    pub force_n: f64,
    /// Greatest penetration of the object into the gel's contact surface, metres; 0 without contact.
    pub penetration_m: f64,
    /// Middle of the contact points in the world, weighted with their normal forces, metres.
    pub point_m: [f64; 3],
    /// Friction force of the object on the gel in the world, newtons.
    pub friction_n: [f64; 3],
    /// Friction force at which the object slides, newtons.
    pub friction_limit_n: f64,
    /// Torque about the normal at which the object turns on the gel, Nm.
    pub torsion_limit_nm: f64,
}

impl PadContact {
    /// Returns whether the pad touches the object.
    pub fn is_touching(&self) -> bool {
        self.penetration_m > 0.0
    }

    /// Adds a contact of this gel with its force in the contact's frame: normal, two directions of friction, torsion. The point remains a
    /// sum until all are added.
    pub(crate) fn add(&mut self, contact: &MjContact, force: [f64; 6], gel: usize) {
        self.penetration_m = self.penetration_m.max(-contact.dist);
        self.force_n += force[0];
        // A force of MuJoCo is that of the first geom on the second.
        let is_second = usize::try_from(contact.geom[1]) == Ok(gel);
        let sign = if is_second { 1.0 } else { -1.0 };
        for axis in 0..3 {
            self.point_m[axis] += force[0] * contact.pos[axis];
            self.friction_n[axis] += sign * (force[1] * contact.frame[3 + axis] + force[2] * contact.frame[6 + axis]);
        }
        self.friction_limit_n += contact.friction[0] * force[0];
        self.torsion_limit_nm += contact.friction[2] * force[0];
    }
}

/// Complete state of the integration. A restored simulation continues bit for bit.
#[derive(Debug, Clone, PartialEq)]
pub struct SimulationState(Box<[f64]>);

/// Reason why a simulation cannot be built or restored.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SimulationError {
    /// MuJoCo refuses the model; most often the object's collision shape is flat or its mass is not positive.
    #[error("MuJoCo cannot build the scene with object {object}: {reason}")]
    Model {
        /// The object's name.
        object: String,
        /// Message of MuJoCo.
        reason: String,
    },
    /// The controller cannot move this hand.
    #[error("the controller cannot be simulated: {0}")]
    Controller(String),
    /// Images do not fall on integration steps.
    #[error(
        "{0} integration steps per second are no multiple of 30, the rate of images; choose one such as 150 or 300"
    )]
    Rate(u32),
    /// The state belongs to another model.
    #[error("the saved state does not fit this simulation: {0}")]
    State(String),
}

/// Simulation of the hand and one object in MuJoCo.
pub struct Simulation {
    data: MjData<Box<MjModel>>,
    /// Number of joints of the hand, which stand before that of the object.
    joints: usize,
    /// Bodies of the hand, in their order.
    bodies: Vec<usize>,
    pads: usize,
    /// Geoms of the gels, each with its pad.
    gels: Vec<(usize, usize)>,
    object_body: usize,
    /// Bodies of the fingertips: those that carry pads.
    tips: Vec<i32>,
}

/// Components of the state on which the next step depends, including the warm start.
const STATE: u32 = MjtState::mjSTATE_INTEGRATION as u32;

impl Simulation {
    /// Builds the simulation with the hand at joint angles 0 and the object at the origin; see [`Simulation::reset`].
    ///
    /// # Errors
    /// [`SimulationError::Model`] if MuJoCo refuses the model.
    pub fn new(hand: &Hand, object: &Object, physics: &Physics) -> Result<Self, SimulationError> {
        messages::route();
        let refused = |reason: String| SimulationError::Model { object: object.name.clone(), reason };
        let model =
            MjModel::from_xml_string(&mjcf::model(hand, object, physics)).map_err(|e| refused(e.to_string()))?;
        let id = |kind, name: &str| {
            model.name_to_id(kind, name).ok_or_else(|| refused(format!("the model has no element {name}")))
        };
        let body = |body: usize| id(MjtObjBase::mjOBJ_BODY, &mjcf::body_name(hand, body));
        let bodies = (0..hand.bodies().len()).map(body).collect::<Result<Vec<usize>, _>>()?;
        let mut gels = Vec::new();
        for (index, body) in hand.bodies().iter().enumerate() {
            for (k, part) in body.parts.iter().enumerate() {
                if let PartSurface::Gel(pad) = part.surface {
                    gels.push((id(MjtObjBase::mjOBJ_GEOM, &mjcf::geom_name(index, k))?, pad));
                }
            }
        }
        let object_body = id(MjtObjBase::mjOBJ_BODY, mjcf::OBJECT)?;
        let tips = hand.pads().iter().filter_map(|pad| i32::try_from(*bodies.get(pad.body)?).ok()).collect();
        let (joints, pads) = (hand.joints().len(), hand.pads().len());
        Ok(Self { data: MjData::new(Box::new(model)), joints, bodies, pads, gels, object_body, tips })
    }

    /// Puts the hand at rest at `joints`, which its position controllers hold, and the object at rest at `object`. Joints without a value
    /// are at 0.
    pub fn reset(&mut self, joints: &[f64], object: Isometry<ObjectFrame, WorldFrame>) {
        self.data.reset();
        overwrite(&mut self.data.qpos_mut()[..self.joints], joints);
        self.put_object(object);
        overwrite(self.data.ctrl_mut(), joints);
        self.data.forward();
    }

    /// Advances one integration step. The joints' position controllers aim at `targets`, radians; those without a value aim as before.
    pub fn step(&mut self, targets: &[f64]) {
        overwrite(self.data.ctrl_mut(), targets);
        self.data.step();
    }

    /// Puts the object at rest at a pose. Does not change the hand.
    pub fn place_object(&mut self, pose: Isometry<ObjectFrame, WorldFrame>) {
        self.support(pose);
        self.data.forward();
    }

    /// Keeps the object at rest at a pose for the next step, as a support does.
    pub fn support(&mut self, pose: Isometry<ObjectFrame, WorldFrame>) {
        self.put_object(pose);
        self.data.qvel_mut()[self.joints..].fill(0.0);
    }

    fn put_object(&mut self, pose: Isometry<ObjectFrame, WorldFrame>) {
        let qpos = &mut self.data.qpos_mut()[self.joints..];
        qpos[..3].copy_from_slice(pose.origin().coords().as_slice());
        qpos[3..].copy_from_slice(&pose.quaternion_wxyz());
    }

    /// Returns whether anything but the fingertips touches the object: another body of the hand.
    pub fn touches_beside_fingertips(&self) -> bool {
        let model = self.data.model();
        let object = i32::try_from(self.object_body).ok();
        self.object_contacts().any(|(_, contact)| {
            let bodies =
                contact.geom.iter().filter_map(|&g| model.geom_bodyid().get(usize::try_from(g).ok()?).copied());
            bodies.filter(|&b| Some(b) != object).any(|b| !self.tips.contains(&b)) && contact.dist <= 0.0
        })
    }

    /// Returns the seconds since the reset.
    pub fn time_s(&self) -> f64 {
        self.data.time()
    }

    /// Returns the joint angles, radians; metres of sliding joints.
    pub fn joints(&self) -> JointAngles {
        self.data.qpos()[..self.joints].to_vec()
    }

    /// Returns gravity in the world, m/s^2.
    pub fn gravity(&self) -> [f64; 3] {
        self.data.model_opt().gravity
    }

    /// Sets gravity in the world, m/s^2. It is no part of the state that [`Simulation::save`] returns.
    pub fn set_gravity(&mut self, gravity: [f64; 3]) {
        self.data.model_opt_mut().gravity = gravity;
    }

    /// Returns the pose of the object.
    pub fn object_pose(&self) -> Isometry<ObjectFrame, WorldFrame> {
        let q = &self.data.qpos()[self.joints..];
        Isometry::from_parts([q[0], q[1], q[2]], [q[3], q[4], q[5], q[6]])
    }

    /// Returns the angular velocity of the object in the world, rad/s.
    pub fn object_angular_velocity(&self) -> na::Vector3<f64> {
        let v = &self.data.qvel()[self.joints + 3..];
        // In MuJoCo the angular velocity of a free joint is in the body's own frame.
        self.object_pose().untyped().rotation * na::Vector3::new(v[0], v[1], v[2])
    }

    /// Returns the velocity of the object's origin in the world, m/s.
    pub fn object_velocity(&self) -> na::Vector3<f64> {
        let v = &self.data.qvel()[self.joints..];
        na::Vector3::new(v[0], v[1], v[2])
    }

    /// Returns the joint velocities, rad/s.
    pub fn joint_velocities(&self) -> JointAngles {
        self.data.qvel()[..self.joints].to_vec()
    }

    /// Returns the torques with which the position controllers drive the joints, Nm, from the last step.
    pub fn joint_torques(&self) -> JointAngles {
        self.data.qfrc_actuator()[..self.joints].to_vec()
    }

    /// Returns the contact of each pad with the object.
    pub fn contacts(&self) -> PerPad<PadContact> {
        let mut pads = PerPad::from_fn(self.pads, |_| PadContact::default());
        for (i, contact) in self.object_contacts() {
            let touches = |gel: usize| contact.geom.iter().any(|&geom| usize::try_from(geom) == Ok(gel));
            if let Some(&(gel, pad)) = self.gels.iter().find(|(gel, _)| touches(*gel))
                && let Some(pad) = pads.get_mut(pad)
            {
                pad.add(contact, self.data.try_contact_force(i).unwrap_or_default(), gel);
            }
        }
        for pad in pads.iter_mut() {
            let weight = if pad.force_n > 0.0 { 1.0 / pad.force_n } else { 0.0 };
            pad.point_m = pad.point_m.map(|sum| weight * sum);
        }
        pads
    }

    /// Returns the greatest penetration of the object into the hand, metres; 0 without contact.
    pub fn penetration_m(&self) -> f64 {
        self.object_contacts().fold(0.0, |deepest, (_, contact)| (-contact.dist).max(deepest))
    }

    /// Returns the contacts of the object, with their indices.
    fn object_contacts(&self) -> impl Iterator<Item = (usize, &MjContact)> {
        let model = self.data.model();
        let body_of = |geom: i32| usize::try_from(geom).ok().and_then(|g| model.geom_bodyid().get(g)).copied();
        let object = i32::try_from(self.object_body).ok();
        let touches = move |contact: &MjContact| contact.geom.iter().any(|&g| body_of(g) == object);
        self.data.contact().iter().enumerate().filter(move |(_, contact)| touches(contact))
    }

    /// Returns the reason why the simulation is unstable; `None` if it is stable.
    pub fn fault(&self) -> Option<String> {
        /// Speed that joints and object exceed only if the integration is unstable, m/s and rad/s.
        const FASTEST: f64 = 1e3;
        let broken = |name: &str, values: &[f64], limit: f64| {
            values
                .iter()
                .find(|v| !v.is_finite() || v.abs() > limit)
                .map(|v| format!("the physics became unstable at {:.3} s: {name} reached {v}", self.time_s()))
        };
        broken("a position", self.data.qpos(), 1e2).or_else(|| broken("a velocity", self.data.qvel(), FASTEST))
    }

    /// Returns the state for [`Simulation::restore`].
    pub fn save(&self) -> SimulationState {
        SimulationState(self.data.state(STATE))
    }

    /// Sets the state to a saved one of the same model.
    ///
    /// # Errors
    /// [`SimulationError::State`] if the state belongs to another model.
    pub fn restore(&mut self, state: &SimulationState) -> Result<(), SimulationError> {
        let foreign = |e: MjDataError| SimulationError::State(e.to_string());
        self.data.set_state(&state.0, STATE).map_err(foreign)?;
        // `forward` computes contacts and body poses from the state, but changes the solver's warm start, which is part
        // of the state.
        self.data.forward();
        self.data.set_state(&state.0, STATE).map_err(foreign)
    }

    /// Returns the pose of a body of the hand, from the last step; `None` if the hand has no such body. Serves the test that
    /// compares the kinematics of the hand with MuJoCo's.
    pub fn body_pose(&self, body: usize) -> Option<na::Isometry3<f64>> {
        let id = *self.bodies.get(body)?;
        let (p, q) = (self.data.xpos().get(id)?, self.data.xquat().get(id)?);
        let rotation = na::UnitQuaternion::from_quaternion(na::Quaternion::new(q[0], q[1], q[2], q[3]));
        Some(na::Isometry3::from_parts(na::Vector3::from(*p).into(), rotation))
    }
}

/// Overwrites the first numbers.
fn overwrite(numbers: &mut [f64], with: &[f64]) {
    numbers.iter_mut().zip(with).for_each(|(number, with)| *number = *with);
}
