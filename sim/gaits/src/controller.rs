//! What moves the hand.

use mvt_robot::hand::JointAngles;

/// What a controller may know: the robot's own senses, never the object's true pose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Proprioception {
    /// Seconds since the start of the episode.
    pub time_s: f64,
    /// Measured joint angles.
    pub joints: JointAngles,
}

/// A policy for the hand, called at [`CONTROL_HZ`](crate::clock::CONTROL_HZ).
pub trait Controller: Send {
    /// The joint angles to aim at until the next call, radians. The joints' position controllers limit the torque.
    fn command(&mut self, sensed: &Proprioception) -> JointAngles;
}
