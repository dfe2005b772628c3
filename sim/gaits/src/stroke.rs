//! Controller that plays one gait.

use std::sync::Arc;

use mvt_robot::hand::{Hand, JointAngles};

use crate::controller::{Controller, Proprioception};
use crate::gait::Gait;

/// Time over which the fingers close from the open pose into the gait, seconds.
const CLOSING_S: f64 = 0.8;
/// Distance by which a target may exceed the torque limit, radians, so that the position controllers reach their full
/// torque.
const CLIP_MARGIN_RAD: f64 = 0.05;

/// Clips targets around the measured angles to the reach of the torque limit, Nm, so that a stopped joint pushes no harder and moves off no
/// faster than the limit allows. Strokes and policies share it.
pub fn within_reach(hand: &Hand, torque_limit_nm: f64, targets: &[f64], measured: &[f64]) -> JointAngles {
    let clipped = targets.iter().zip(measured).zip(hand.joints()).map(|((target, measured), joint)| {
        // A joint without a position controller aims at nothing, so that any reach will do.
        let reach = torque_limit_nm / joint.drive.stiffness.max(f64::MIN_POSITIVE) + CLIP_MARGIN_RAD;
        target.max(measured - reach).min(measured + reach)
    });
    clipped.collect()
}

/// Controller that plays one gait.
#[derive(Debug, Clone)]
pub struct GaitController {
    gait: Gait,
    hand: Arc<Hand>,
}

impl GaitController {
    /// Plays `gait`, mirrored for a left hand.
    pub fn new(gait: Gait, hand: Arc<Hand>) -> Self {
        Self { gait, hand }
    }

    /// Returns the unclipped targets of this hand at a time since the start, radians.
    pub fn targets(&self, time_s: f64) -> JointAngles {
        self.hand.mirrored(&self.target(time_s))
    }

    /// Returns the torque limit of the gait, Nm.
    pub(crate) fn torque_limit_nm(&self) -> f64 {
        self.gait.torque_limit_nm
    }

    /// Returns the right-hand targets at a time since the start, radians.
    fn target(&self, time_s: f64) -> JointAngles {
        let gait = self.gait.row(time_s);
        let t = (time_s / CLOSING_S).clamp(0.0, 1.0);
        let closed = t * t * (3.0 - 2.0 * t);
        self.gait.open_pose.iter().zip(gait).map(|(open, gait)| open * (1.0 - closed) + gait * closed).collect()
    }
}

impl Controller for GaitController {
    fn copy(&self) -> Box<dyn Controller> {
        Box::new(self.clone())
    }

    fn command(&mut self, sensed: &Proprioception) -> JointAngles {
        within_reach(&self.hand, self.gait.torque_limit_nm, &self.targets(sensed.time_s), &sensed.joints)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gait::{AUTO, choose, find};
    use mvt_robot::hand::Side;

    #[test]
    fn targets_stay_within_reach_of_the_measured_angles() {
        let mut controller = GaitController::new(find("bal").unwrap().1.clone(), Hand::allegro(Side::Left));
        let joints = vec![0.2; 16];
        let command = controller.command(&Proprioception::at(3.0, joints));
        let reach = find("bal").unwrap().1.torque_limit_nm / 3.0 + 0.05;
        assert!(command.iter().all(|c| (c - 0.2).abs() <= reach + 1e-12));
        assert!(find("gallop").unwrap_err().to_string().contains("bal, "));
    }

    #[test]
    fn a_stiffer_joint_has_less_reach_and_other_hands_have_no_shipped_gaits() {
        let mut description = Hand::allegro(Side::Right).description().clone();
        description.joints[1].drive.stiffness = 6.0;
        description.joints[2].drive.stiffness = 0.0;
        let hand = Hand::new(description).unwrap();
        let gait = Gait { torque_limit_nm: 0.3, ..find("bal").unwrap().1.clone() };
        let clipped = within_reach(&hand, gait.torque_limit_nm, &[9.0; 16], &[0.0; 16]);
        assert!((clipped[0] - 0.15).abs() < 1e-12 && (clipped[1] - 0.1).abs() < 1e-12 && clipped[2] == 9.0);
        let cube = mvt_objects::catalogue::load("cube70", &mut Vec::new()).unwrap();
        let refused = choose(AUTO, &cube, &hand).unwrap_err().to_string();
        assert!(refused.contains("allegro_digit has no shipped gaits") && refused.contains("hand tune"), "{refused}");
    }
}
