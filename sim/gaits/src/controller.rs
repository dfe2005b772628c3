//! Controllers, which move the hand.

use std::fmt::Debug;

use mvt_robot::hand::{Drive, JointAngles, PerPad};
use mvt_robot::observation::Press;

use crate::clock::CONTROL_HZ;
use crate::directive::Directive;
use crate::gait::{Gait, UnknownGait};
use crate::place::{EstimatedPlace, RehearsedPlace};

/// Input of a controller: the robot's own senses, never the true pose of the object.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Proprioception {
    /// Seconds since the start of the episode.
    pub time_s: f64,
    /// Measured joint angles, radians; metres of a sliding joint.
    pub joints: JointAngles,
    /// Velocities of the joints, rad/s or m/s.
    pub velocities: JointAngles,
    /// Normal force of the object on each pad, newtons; 0 without contact.
    pub forces_n: PerPad<f64>,
    /// Gravity in the world, m/s^2. The palm's axes are those of the world, so that this is how the palm is tilted.
    pub gravity: [f64; 3],
    /// Axis about which the object is to turn in the world, of length 1.
    pub axis: [f64; 3],
}

impl Proprioception {
    /// Returns the input of a controller that knows only time and joint angles.
    pub fn at(time_s: f64, joints: JointAngles) -> Self {
        Self { time_s, joints, ..Self::default() }
    }
}

/// Whatever moves the hand: a table of strokes, a rule with feedback, or a learnt policy. The caller runs it
/// [`Controller::rate_hz`] times per second.
pub trait Controller: Debug + Send + Sync {
    /// Returns the joint angles to aim at until the next call, radians. The joints' position controllers limit the
    /// torque.
    fn command(&mut self, sensed: &Proprioception) -> JointAngles;

    /// Returns a copy with all that it remembers.
    fn copy(&self) -> Box<dyn Controller>;

    /// Returns the commands per second, a divisor of [`PHYSICS_HZ`](crate::clock::PHYSICS_HZ).
    fn rate_hz(&self) -> u32 {
        CONTROL_HZ
    }

    /// Returns the drives of the joints for which it was made; `None` for those of the hand.
    fn drives(&self) -> Option<Vec<Drive>> {
        None
    }

    /// Returns whether [`Controller::see`] has an effect.
    fn needs_place(&self) -> bool {
        false
    }

    /// Receives the estimated place of the object.
    fn see(&mut self, _: EstimatedPlace) {}

    /// Receives the true place with errors like those of an estimate, in searches and simulations without cameras.
    fn rehearse(&mut self, _: RehearsedPlace) {}

    /// Returns whether it uses the forces on the pads, which few robots measure.
    fn needs_forces(&self) -> bool {
        false
    }

    /// Returns whether [`Controller::feel`] has an effect.
    fn needs_touch(&self) -> bool {
        false
    }

    /// Receives how the object presses into each gel; `None` from a sensor that delivered nothing.
    fn feel(&mut self, _: &PerPad<Option<Press>>) {}

    /// Obeys a directive of a supervisor, as far as it can. The end of an episode and changes of the palm's tilt are the caller's.
    ///
    /// # Errors
    /// [`UnknownGait`], if the directive names a gait that does not exist for this hand; nothing changes.
    fn obey(&mut self, _: &Directive) -> Result<(), UnknownGait> {
        Ok(())
    }

    /// Changes to a gait, also about another axis, as the hand opens and closes, and returns whether it can.
    fn change(&mut self, _: &Gait) -> bool {
        false
    }

    /// Returns why it cannot move the hand any longer; the fingers then stay, and the episode ends. `None` if all is well.
    fn fault(&self) -> Option<String> {
        None
    }

    /// Returns the time at which the hand began to lower the object from the air, seconds; `None` if it did not.
    fn lowered_at_s(&self) -> Option<f64> {
        None
    }
}

impl Clone for Box<dyn Controller> {
    fn clone(&self) -> Self {
        self.as_ref().copy()
    }
}
