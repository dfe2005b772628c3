//! Joints of a hand and their drives.

use serde::{Deserialize, Serialize};

/// Angles of the joints in radians and displacements of sliding joints in metres, in the order of
/// [`Hand::joints`](crate::hand::Hand::joints). Functions treat missing values as 0 and ignore surplus ones; readers of files check the number.
pub type JointAngles = Vec<f64>;

/// Joint between a body and its parent.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Joint {
    /// Name.
    pub name: String,
    /// Index of the body that it moves against its parent.
    pub body: usize,
    /// How it moves.
    #[serde(default)]
    pub motion: JointMotion,
    /// Axis in the moved body's frame, a unit vector.
    pub axis: [f64; 3],
    /// Lower and upper limit, radians or metres.
    pub range: [f64; 2],
    /// Whether its angle changes sign between a hand and its mirror image.
    #[serde(default)]
    pub mirrors: bool,
    /// Its position controller and friction.
    #[serde(default)]
    pub drive: Drive,
}

/// How a joint moves.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum JointMotion {
    /// Turns about its axis.
    #[default]
    Hinge,
    /// Slides along its axis.
    Slide,
}

/// Position controller of a joint, and what brakes it. Units are those of a hinge; of a sliding joint N/m, N s/m, kg and N.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Drive {
    /// Stiffness of the position controller, Nm/rad.
    pub stiffness: f64,
    /// Damping, Nm s/rad.
    pub damping: f64,
    /// Inertia of the rotor, kg m^2.
    pub armature: f64,
    /// Dry friction, Nm.
    pub friction: f64,
    /// Largest torque, Nm. A gait may set a lower one.
    pub torque_limit: f64,
}

impl Default for Drive {
    /// Returns the drive of the Allegro's joints.
    fn default() -> Self {
        Self { stiffness: 3.0, damping: 0.1, armature: 0.001, friction: 0.01, torque_limit: 0.7 }
    }
}
