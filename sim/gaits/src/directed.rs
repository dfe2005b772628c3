//! Controller that plays gaits and obeys directives.

use std::sync::Arc;

use mvt_robot::hand::{Hand, JointAngles};
use nalgebra as na;

use crate::clock::CONTROL_HZ;
use crate::controller::{Controller, Proprioception};
use crate::directive::Directive;
use crate::feedback::{EstimatedPlace, FeedbackController, RehearsedPlace};
use crate::gait::{self, Gait, UnknownGait};
use crate::schedule::{CLOSING_AT_S, blend, smooth};
use crate::stroke::{GaitController, within_reach};

/// Duration of the change from one gait to another, seconds.
const BLEND_S: f64 = 0.5;
/// Durations of a re-grasp, seconds: the fingers open, stay open and close.
const OPENING_S: f64 = 0.3;
const OPEN_S: f64 = 0.2;
const CLOSING_S: f64 = 0.8;
/// Largest shift of the pads, metres, and its rate of change, metres per second.
const SHIFT_M: f64 = 0.012;
const SHIFT_RATE_M_S: f64 = 0.03;
/// Shift per displacement of the object. In trials with boxes and cans displaced by 15 mm, this value brought them
/// nearest to their place; larger values stop the turning without a benefit.
const SHIFT_PER_OFFSET: f64 = 0.5;
/// Damping of the inverse of a pad's Jacobian, metres per radian: much less than a finger's lever of 50 to 100 mm.
const DAMPING_M: f64 = 0.01;

/// Controller that plays gaits and obeys directives. Without directives it equals [`GaitController`] bit for bit. While it holds an
/// object in the air, it obeys [`DirectedController::hold`] and its release alone: anything else would drop the object.
#[derive(Debug, Clone)]
pub struct DirectedController {
    gait: GaitController,
    /// Plays in place of the gait if that has feedback.
    in_air: Option<FeedbackController>,
    open_pose: JointAngles,
    hand: Arc<Hand>,
    /// The last targets, before the shift.
    aimed_at: JointAngles,
    time_s: f64,
    /// Targets that fade out, and the start of the fade, seconds.
    fading: Option<(JointAngles, f64)>,
    /// Opening of the fingers that is under way: its start, and how long they stay open, seconds.
    opening: Option<(f64, f64)>,
    /// Targets that are held.
    held: Option<JointAngles>,
    /// Shift of the fingertips in the world, metres: the current one and its target.
    shift_m: na::Vector2<f64>,
    wanted_m: na::Vector2<f64>,
}

impl DirectedController {
    /// Starts with `gait`, mirrored for a left hand.
    pub fn new(gait: &Gait, hand: &Arc<Hand>) -> Self {
        let open_pose = hand.mirrored(&gait.open_pose);
        Self {
            gait: GaitController::new(gait.clone(), Arc::clone(hand)),
            in_air: FeedbackController::new(gait, hand),
            aimed_at: open_pose.clone(),
            open_pose,
            hand: Arc::clone(hand),
            time_s: 0.0,
            fading: None,
            opening: None,
            held: None,
            shift_m: na::Vector2::zeros(),
            wanted_m: na::Vector2::zeros(),
        }
    }

    /// Changes to another gait.
    pub fn switch(&mut self, gait: &Gait) {
        self.open_pose = self.hand.mirrored(&gait.open_pose);
        self.gait = GaitController::new(gait.clone(), Arc::clone(&self.hand));
        self.fading = Some((self.aimed_at.clone(), self.time_s));
    }

    /// Opens the fingers for a moment. Has no effect during a re-grasp.
    pub fn regrasp(&mut self) {
        self.opening.get_or_insert((self.time_s, OPEN_S));
    }

    /// Keeps the fingers where they are; in the air, those that hold the object.
    pub fn hold(&mut self) {
        if let Some(in_air) = &mut self.in_air {
            in_air.pause(true);
        }
        self.held.get_or_insert_with(|| self.aimed_at.clone());
    }

    /// Lets held fingers move on. Has no effect on others.
    pub fn release(&mut self) {
        if let Some(in_air) = &mut self.in_air {
            in_air.pause(false);
        }
        if let Some(held) = self.held.take() {
            self.fading = Some((held, self.time_s));
        }
    }

    /// Shifts the fingers against the object's displacement from its place (x and y in the world, metres); 0 ends the
    /// shift.
    pub fn recentre(&mut self, offset_m: [f64; 2]) {
        let offset = na::Vector2::from(offset_m);
        // An estimate that is not finite causes no motion.
        let finite = offset.iter().all(|v| v.is_finite());
        self.wanted_m = if finite { (-SHIFT_PER_OFFSET * offset).cap_magnitude(SHIFT_M) } else { na::Vector2::zeros() };
    }

    /// Returns the opening of the fingers at this time, 0 to 1.
    fn openness(&mut self) -> f64 {
        let Some((since, open_s)) = self.opening else { return 0.0 };
        let elapsed = self.time_s - since;
        if elapsed >= OPENING_S + open_s + CLOSING_S {
            self.opening = None;
        }
        smooth(elapsed / OPENING_S) * (1.0 - smooth((elapsed - OPENING_S - open_s) / CLOSING_S))
    }

    /// Returns the targets with all pads moved by the shift, within the joints' limits.
    fn shifted(&self, targets: &[f64]) -> JointAngles {
        let shift = na::Vector3::new(self.shift_m.x, self.shift_m.y, 0.0);
        let mut shifted = targets.to_vec();
        for pad in 0..self.hand.pads().len() {
            let jacobian = jacobian(&self.hand, pad, targets);
            let damped = &jacobian * jacobian.transpose() + na::Matrix3::identity() * DAMPING_M * DAMPING_M;
            // The damping makes it positive definite; angles that are not finite cause no motion.
            let Some(damped) = damped.cholesky() else { continue };
            let change = jacobian.transpose() * damped.solve(&shift);
            for (&j, change) in self.hand.pad_chain(pad).iter().zip(&change) {
                if let Some(angle) = shifted.get_mut(j) {
                    *angle += change;
                }
            }
        }
        self.hand.within_ranges(&shifted)
    }
}

impl Controller for DirectedController {
    fn copy(&self) -> Box<dyn Controller> {
        Box::new(self.clone())
    }

    fn needs_place(&self) -> bool {
        self.in_air.is_some()
    }

    fn see(&mut self, place: EstimatedPlace) {
        if let Some(in_air) = &mut self.in_air {
            in_air.see(place);
        }
    }

    fn rehearse(&mut self, place: RehearsedPlace) {
        if let Some(in_air) = &mut self.in_air {
            in_air.rehearse(place);
        }
    }

    fn obey(&mut self, directive: &Directive) -> Result<(), UnknownGait> {
        let gait = match directive {
            Directive::SwitchGait(name) => Some(gait::find_for(&self.hand, name)?.1),
            _ => None,
        };
        if *directive != Directive::Hold {
            self.release();
        }
        match directive {
            Directive::Continue => self.recentre([0.0; 2]),
            Directive::Hold => self.hold(),
            Directive::Regrasp => self.regrasp(),
            Directive::Recentre { offset_m } => self.recentre(*offset_m),
            Directive::SwitchGait(_) => gait.into_iter().for_each(|gait| self.switch(gait)),
            Directive::ChangeController(_) | Directive::Stop => (),
        }
        Ok(())
    }

    fn change(&mut self, gait: &Gait) -> bool {
        self.switch(gait);
        self.opening = Some((self.time_s, CLOSING_AT_S - OPENING_S));
        true
    }

    fn lowered_at_s(&self) -> Option<f64> {
        self.in_air.as_ref().and_then(FeedbackController::lowered_at_s)
    }

    fn command(&mut self, sensed: &Proprioception) -> JointAngles {
        self.time_s = sensed.time_s;
        if let Some(in_air) = &mut self.in_air {
            return in_air.command(sensed);
        }
        let mut targets = self.held.clone().unwrap_or_else(|| self.gait.targets(sensed.time_s));
        if let Some((from, since)) = &self.fading {
            let t = (self.time_s - since) / BLEND_S;
            targets = blend(from, &targets, smooth(t));
            if t >= 1.0 {
                self.fading = None;
            }
        }
        let openness = self.openness();
        if openness > 0.0 {
            targets = blend(&targets, &self.open_pose, openness);
        }
        self.aimed_at.clone_from(&targets);
        self.shift_m += (self.wanted_m - self.shift_m).cap_magnitude(SHIFT_RATE_M_S / f64::from(CONTROL_HZ));
        if self.shift_m != na::Vector2::zeros() {
            targets = self.shifted(&targets);
        }
        within_reach(&self.hand, self.gait.torque_limit_nm(), &targets, &sensed.joints)
    }
}

/// Returns the change of a pad's position in the world per radian of each joint of its chain, metres.
fn jacobian(hand: &Hand, pad: usize, joints: &[f64]) -> na::Matrix3xX<f64> {
    const STEP_RAD: f64 = 1e-4;
    let moved = |j: usize, by: f64| {
        let mut joints = joints.to_vec();
        if let Some(angle) = joints.get_mut(j) {
            *angle += by;
        }
        hand.world_from_pads(&joints).get(pad).map_or_else(na::Vector3::zeros, |pad| pad.origin().coords())
    };
    let chain = hand.pad_chain(pad);
    let column = |&j: &usize| (moved(j, STEP_RAD) - moved(j, -STEP_RAD)) / (2.0 * STEP_RAD);
    let columns: Vec<na::Vector3<f64>> = chain.iter().map(column).collect();
    na::Matrix3xX::from_fn(columns.len(), |axis, k| columns[k][axis])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gait;
    use mvt_robot::hand::Side;

    fn gait_named(name: &str) -> &'static Gait {
        gait::find(name).unwrap().1
    }

    /// Returns the targets over time of a hand that follows them exactly. Calls `direct` before each command.
    fn play(side: Side, seconds: f64, mut direct: impl FnMut(f64, &mut DirectedController)) -> Vec<JointAngles> {
        let mut controller = DirectedController::new(gait_named("bal"), &Hand::allegro(side));
        let mut joints = controller.open_pose.clone();
        (0..(seconds * f64::from(CONTROL_HZ)) as usize)
            .map(|k| {
                let time_s = k as f64 / f64::from(CONTROL_HZ);
                direct(time_s, &mut controller);
                joints = controller.command(&Proprioception::at(time_s, joints.clone()));
                joints.clone()
            })
            .collect()
    }

    fn largest_step(targets: &[JointAngles]) -> f64 {
        let step = |pair: &[JointAngles]| (0..16).map(|j| (pair[1][j] - pair[0][j]).abs()).fold(0.0, f64::max);
        targets.windows(2).map(step).fold(0.0, f64::max)
    }

    #[test]
    fn undirected_it_is_the_gait() {
        let hand = Hand::allegro(Side::Left);
        let mut plain = GaitController::new(gait_named("bal").clone(), Arc::clone(&hand));
        let mut joints = DirectedController::new(gait_named("bal"), &hand).open_pose;
        for (k, targets) in play(Side::Left, 3.0, |_, c| c.recentre([0.0; 2])).iter().enumerate() {
            joints = plain.command(&Proprioception::at(k as f64 / f64::from(CONTROL_HZ), joints));
            assert_eq!(joints, *targets);
        }
    }

    #[test]
    fn switching_ends_in_the_other_gait_without_a_jump() {
        let at = |t: f64, at: f64| (t - at).abs() < 1e-9;
        let plain = play(Side::Right, 4.0, |_, _| ());
        let mut aimed_at = Vec::new();
        let switched = play(Side::Right, 4.0, |t, c| {
            aimed_at.push(c.aimed_at.clone());
            // Switches again in the middle of the change.
            if at(t, 2.0) || at(t, 2.2) {
                c.switch(gait_named("cubelet"));
            }
        });
        assert_eq!(switched[..50], plain[..50]);
        let mut other = GaitController::new(gait_named("cubelet").clone(), Hand::allegro(Side::Right));
        let last = 99;
        let time_s = last as f64 / f64::from(CONTROL_HZ);
        assert_eq!(switched[last], other.command(&Proprioception::at(time_s, switched[last - 1].clone())));
        let jump = largest_step(&[aimed_at[50].clone(), other.targets(2.0)]);
        assert!(largest_step(&aimed_at[1..]) < 0.3 * jump, "{} and {jump}", largest_step(&aimed_at[1..]));
    }

    #[test]
    fn regrasp_opens_and_closes_once() {
        let plain = play(Side::Left, 5.0, |_, _| ());
        // Requests during a re-grasp neither restart nor repeat it.
        let regrasped = play(Side::Left, 5.0, |t, c| {
            if (2.0..2.5).contains(&t) {
                c.regrasp();
            }
        });
        let open = Hand::allegro(Side::Left).mirrored(&gait_named("bal").open_pose);
        let middle = &regrasped[((2.0 + OPENING_S + OPEN_S / 2.0) * f64::from(CONTROL_HZ)) as usize];
        assert!((0..16).all(|j| (middle[j] - open[j]).abs() < 1e-9));
        assert_eq!(regrasped[..50], plain[..50]);
        assert_eq!(regrasped[90..], plain[90..]);
    }

    #[test]
    fn held_fingers_rest_and_then_move_on_without_a_jump() {
        let plain = play(Side::Right, 6.0, |_, _| ());
        let held = play(Side::Right, 6.0, |t, c| if (2.0..3.5).contains(&t) { c.hold() } else { c.release() });
        assert_eq!(held[..50], plain[..50]);
        assert!(held[50..87].iter().all(|targets| *targets == held[50]));
        assert!(largest_step(&held[86..]) < 1.5 * largest_step(&plain[50..]));
        assert_eq!(held[110..], plain[110..]);
    }

    #[test]
    fn shift_moves_the_fingertips_against_the_offset() {
        for side in [Side::Left, Side::Right] {
            let plain = play(side, 4.0, |_, _| ());
            let shifted = play(side, 4.0, |_, c| c.recentre([0.012, -0.016]));
            let hand = Hand::allegro(side);
            for pad in 0..hand.pads().len() {
                let tip = |joints: &[f64]| hand.world_from_pads(joints)[pad].origin().coords();
                let moves = plain.iter().zip(&shifted).skip(50).map(|(p, s)| tip(s) - tip(p));
                let mean = moves.sum::<na::Vector3<f64>>() / (plain.len() - 50) as f64;
                // The damping, the joints' limits and the reach of a finger reduce the shift.
                let wanted = na::Vector3::new(-0.006, 0.008, 0.0);
                assert!(mean.dot(&wanted) > 0.4 * wanted.norm_squared(), "{side:?} {pad}: {mean}");
                assert!(mean.norm() < 1.2 * wanted.norm(), "{side:?} {pad}: {mean}");
            }
        }
    }

    #[test]
    fn offsets_are_bounded_and_broken_ones_do_nothing() {
        let plain = play(Side::Left, 2.0, |_, _| ());
        assert_eq!(play(Side::Left, 2.0, |_, c| c.recentre([f64::NAN, 0.0])), plain);
        let far = play(Side::Left, 2.0, |_, c| c.recentre([1.0, 0.0]));
        assert_eq!(far, play(Side::Left, 2.0, |_, c| c.recentre([SHIFT_M / SHIFT_PER_OFFSET, 0.0])));
    }
    #[test]
    fn a_pad_without_joints_stays_and_the_others_move() {
        let mut description = Hand::allegro(Side::Right).description().clone();
        description.pads[0].body = 0;
        let hand = Hand::new(description).unwrap();
        let mut controller = DirectedController::new(gait_named("bal"), &hand);
        controller.recentre([0.012, 0.0]);
        let joints = hand.within_ranges(&controller.open_pose);
        let targets = controller.command(&Proprioception::at(0.0, joints.clone()));
        assert_eq!(targets[..4], joints[..4]);
        assert_ne!(targets[4..], joints[4..]);
    }
}
