//! The reward of turning.

use mvt_physics::episode::EpisodeStart;
use mvt_physics::simulation::Simulation;

/// Weights of the reward. The turn rate counts up to a limit, rad/s, so that a spinning object brings no more.
const TURNING: f64 = 1.25;
const TURN_LIMIT: f64 = 1.0;
const DRIFT: f64 = -0.3;
const POSTURE: f64 = -0.05;
const TORQUE: f64 = -0.1;
const WORK: f64 = -0.05;
const DROP: f64 = -10.0;
const PLACE: f64 = -0.5;
/// Distance from its first place at which an object costs [`PLACE`], metres. It grows with the square, up to twice this distance.
const AWAY_M: f64 = 0.02;

/// Reward of a step and its parts.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Reward {
    /// Rate of turning in the gait's direction about the palm's normal, up to 1 rad/s.
    pub turning: f64,
    /// Penalty of the object's speed, m/s.
    pub drift: f64,
    /// Penalty of the object's distance from its first place along the palm: it falls from the edges.
    pub place: f64,
    /// Penalty of joint angles away from those of the start.
    pub posture: f64,
    /// Penalty of torques.
    pub torque: f64,
    /// Penalty of mechanical power.
    pub work: f64,
    /// Penalty of an object that fell off the hand.
    pub drop: f64,
}

impl Reward {
    /// Names of the parts, in the order of [`Reward::parts`].
    pub const NAMES: [&'static str; 7] = ["turning", "drift", "place", "posture", "torque", "work", "drop"];

    /// Returns the parts.
    pub fn parts(&self) -> [f64; 7] {
        [self.turning, self.drift, self.place, self.posture, self.torque, self.work, self.drop]
    }

    /// Returns the reward of a step after which the simulation stands as given; `rate` is that of turning, rad/s.
    pub(crate) fn of(simulation: &Simulation, start: &EpisodeStart, rate: f64, has_dropped: bool) -> Self {
        let away_m = (simulation.object_pose().origin().coords() - start.object.origin().coords()).xy().norm();
        let joints = simulation.joints();
        let (torques, velocities) = (simulation.joint_torques(), simulation.joint_velocities());
        let sum = |terms: &mut dyn Iterator<Item = f64>| terms.filter(|x| x.is_finite()).sum::<f64>();
        let speed = simulation.object_velocity().norm();
        Self {
            turning: TURNING * rate.clamp(-TURN_LIMIT, TURN_LIMIT),
            drift: DRIFT * if speed.is_finite() { speed.min(1.0) } else { 0.0 },
            place: PLACE * if away_m.is_finite() { (away_m / AWAY_M).min(2.0).powi(2) } else { 0.0 },
            posture: POSTURE * sum(&mut joints.iter().zip(&start.joints).map(|(angle, start)| (angle - start).powi(2))),
            torque: TORQUE * sum(&mut torques.iter().map(|torque| torque.powi(2))),
            work: WORK * sum(&mut torques.iter().zip(&velocities).map(|(torque, velocity)| (torque * velocity).abs())),
            drop: if has_dropped { DROP } else { 0.0 },
        }
    }

    /// Returns the sum of the parts.
    pub fn total(&self) -> f64 {
        self.parts().iter().sum()
    }
}
