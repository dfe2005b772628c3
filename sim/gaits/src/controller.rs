//! Controllers, which move the hand.

use mvt_robot::hand::JointAngles;

/// Input of a controller: the robot's own senses, never the pose of the object.
#[derive(Debug, Clone, PartialEq)]
pub struct Proprioception {
    /// Seconds since the start of the episode.
    pub time_s: f64,
    /// Measured joint angles, radians; metres of a sliding joint.
    pub joints: JointAngles,
}

/// Policy for the hand. The caller runs it at [`CONTROL_HZ`](crate::clock::CONTROL_HZ).
pub trait Controller: Send {
    /// Returns the joint angles to aim at until the next call, radians. The joints' position controllers limit the
    /// torque.
    fn command(&mut self, sensed: &Proprioception) -> JointAngles;
}
