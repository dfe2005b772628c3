//! Which targets may be sent to a hand, and when: the limits of commands, without input and output.

use mvt_robot::hand::JointAngles;

/// A clock that stands still for longer is that of a simulator that ended, nanoseconds.
const STANDS_NS: i64 = 500_000_000;

/// After a fault, also at the start, all must be well for so long before a hand moves, nanoseconds.
const SETTLED_NS: i64 = 500_000_000;

/// Limits of the targets that are sent.
#[derive(Debug, Clone, PartialEq)]
pub struct CommandLimits {
    /// Least and greatest target of each joint, radians; metres of a sliding joint.
    pub ranges: Vec<[f64; 2]>,
    /// Greatest change of a target from one command to the next, radians.
    pub step_rad: f64,
    /// Least time between two commands, nanoseconds.
    pub period_ns: i64,
    /// Age from which on joint angles and estimates are too old, nanoseconds.
    pub stale_ns: i64,
}

/// Reason why a hand does not follow its controller. Each text is one line.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum DriveFault {
    /// No joint angles have arrived.
    #[error("no joint angles have arrived")]
    NoJoints,
    /// No estimate has been made.
    #[error("there is no estimate of the object")]
    NoEstimate,
    /// The newest joint angles are too old, or of another clock.
    #[error("the joint angles are {0:.2} s old")]
    StaleJoints(f64),
    /// The image of the newest estimate is too old, or of another clock.
    #[error("the image of the newest estimate is {0:.2} s old")]
    StaleEstimate(f64),
    /// The clock of a simulator stands still.
    #[error("/clock stands still")]
    ClockStands,
    /// The tracker does not trust its pose.
    #[error("the object is lost")]
    Lost,
    /// The controller gave a target that is not a number, or too few.
    #[error("the controller gives no valid targets")]
    NotFinite,
    /// The controller cannot go on.
    #[error("{0}")]
    Controller(String),
    /// The run ended, for this reason.
    #[error("{0}")]
    Ended(String),
}

impl DriveFault {
    /// Returns whether it is of the same kind as another fault, whatever their numbers.
    pub fn is_like(&self, other: &Self) -> bool {
        std::mem::discriminant(self) == std::mem::discriminant(other)
    }
}

// Why: notes/decisions/live.md, "Only a gate makes targets that can be sent".
/// Targets that keep the limits: only a [`CommandGate`] makes them.
#[derive(Debug, Clone, PartialEq)]
pub struct SafeTargets(JointAngles);

impl SafeTargets {
    /// Returns the angles in the order of the hand's joints, radians.
    pub fn angles(&self) -> &[f64] {
        &self.0
    }
}

/// Answer of a [`CommandGate`].
#[derive(Debug, Clone, PartialEq)]
pub struct Passed {
    /// Targets to send; `None` if no command is due or allowed.
    pub targets: Option<SafeTargets>,
    /// Why the hand does not follow its controller; `None` if it does.
    pub fault: Option<DriveFault>,
}

/// Lets targets pass within limits. On a fault the last targets are held, or the hand opens; a hand that opens stays open.
///
/// ```
/// use mvt_ros::{CommandGate, CommandLimits};
///
/// const MS: i64 = 1_000_000;
/// let limits = CommandLimits { ranges: vec![[0.0, 1.0]], step_rad: 0.05, period_ns: 10 * MS, stale_ns: 100 * MS };
/// let mut gate = CommandGate::new(limits, None);
/// gate.measured(500 * MS, &[0.2]);
/// gate.estimated(480 * MS, false);
/// // From 0.2 on, a target of 9 is approached in steps.
/// let passed = gate.pass(510 * MS, 0, &[9.0]);
/// assert_eq!(passed.targets.map(|targets| targets.angles().to_vec()), Some(vec![0.25]));
/// ```
#[derive(Debug)]
pub struct CommandGate {
    limits: CommandLimits,
    /// Targets of an open hand; without them the last ones are held.
    open: Option<JointAngles>,
    /// Stamp and angles.
    joints: Option<(i64, JointAngles)>,
    /// Stamp of the image, and whether the object is lost.
    estimate: Option<(i64, bool)>,
    /// When, and what.
    sent: Option<(i64, JointAngles)>,
    /// Newest reading of the clock of stamps, and the steady time at which it last changed.
    clock: Option<(i64, i64)>,
    /// The newest fault that is not yet over, and since when all is well again.
    fault: Option<(DriveFault, Option<i64>)>,
    ended: Option<DriveFault>,
}

impl CommandGate {
    /// Starts. On a fault the hand moves to `open`; without it the last targets are held.
    pub fn new(limits: CommandLimits, open: Option<JointAngles>) -> Self {
        Self { limits, open, joints: None, estimate: None, sent: None, clock: None, fault: None, ended: None }
    }

    /// Takes joint angles with their stamp. Angles that are not finite or of another number are ignored.
    pub fn measured(&mut self, stamp_ns: i64, joints: &[f64]) {
        if joints.len() == self.limits.ranges.len() && joints.iter().all(|angle| angle.is_finite()) {
            self.joints = Some((stamp_ns, joints.to_vec()));
        }
    }

    /// Takes an estimate: the stamp of its image, and whether the object is lost.
    pub fn estimated(&mut self, stamp_ns: i64, is_lost: bool) {
        self.estimate = Some((stamp_ns, is_lost));
    }

    /// Ends the motion for good. The first reason holds.
    pub fn end(&mut self, reason: DriveFault) {
        self.ended.get_or_insert(reason);
    }

    /// Returns the targets that were sent last.
    pub fn sent(&self) -> Option<&[f64]> {
        self.sent.as_ref().map(|(_, targets)| targets.as_slice())
    }

    /// Returns whether an ended motion has come to rest.
    pub fn is_at_rest(&self) -> bool {
        let near = |(a, b): (&f64, &f64)| (a - b).abs() <= f64::EPSILON;
        let aim = self.open.as_ref().map(|open| self.within(open));
        self.sent().is_none_or(|sent| aim.is_none_or(|aim| sent.iter().zip(&aim).all(near)))
    }

    fn within(&self, angles: &[f64]) -> JointAngles {
        angles.iter().zip(&self.limits.ranges).map(|(angle, [low, high])| angle.max(*low).min(*high)).collect()
    }

    fn fault(&mut self, now_ns: i64, steady_ns: i64, wanted: &[f64]) -> Option<DriveFault> {
        let changed_ns = self.clock.filter(|(reading, _)| *reading == now_ns).map_or(steady_ns, |(_, since)| since);
        self.clock = Some((now_ns, changed_ns));
        if self.ended.is_some() {
            return self.ended.clone();
        }
        let old = |stamp_ns: i64| {
            let age_ns = now_ns.saturating_sub(stamp_ns);
            (age_ns.saturating_abs() > self.limits.stale_ns).then_some(age_ns as f64 * 1e-9)
        };
        let joints = match &self.joints {
            None => Some(DriveFault::NoJoints),
            Some((stamp_ns, _)) => old(*stamp_ns).map(DriveFault::StaleJoints),
        };
        let estimate = || match self.estimate {
            None => Some(DriveFault::NoEstimate),
            Some((_, true)) => Some(DriveFault::Lost),
            Some((stamp_ns, false)) => old(stamp_ns).map(DriveFault::StaleEstimate),
        };
        let stands = (steady_ns.saturating_sub(changed_ns) > STANDS_NS).then_some(DriveFault::ClockStands);
        let is_valid = wanted.len() == self.limits.ranges.len() && wanted.iter().all(|angle| angle.is_finite());
        let fault = stands.or(joints).or_else(estimate).or((!is_valid).then_some(DriveFault::NotFinite));
        if self.open.is_some() && self.sent.is_some() {
            // An object that an open hand let go does not come back by itself.
            self.ended.clone_from(&fault);
        }
        self.settled(now_ns, fault)
    }

    /// Returns the fault, or the last one until all has been well for a while.
    fn settled(&mut self, now_ns: i64, fault: Option<DriveFault>) -> Option<DriveFault> {
        if fault.is_some() {
            self.fault = fault.clone().map(|fault| (fault, None));
        }
        let Some((last, well_ns)) = self.fault.as_mut().filter(|_| fault.is_none()) else { return fault };
        let since_ns = *well_ns.get_or_insert(now_ns);
        if !(0..SETTLED_NS).contains(&now_ns.saturating_sub(since_ns)) {
            self.fault = None;
            return None;
        }
        Some(last.clone())
    }

    /// Returns what may be sent now in place of the wanted targets. `now_ns` is the clock of the stamps, `steady_ns` one that never jumps.
    pub fn pass(&mut self, now_ns: i64, steady_ns: i64, wanted: &[f64]) -> Passed {
        let fault = self.fault(now_ns, steady_ns, wanted);
        let not_now = |fault| Passed { targets: None, fault };
        let from = match (&mut self.sent, &self.joints) {
            (Some((at_ns, sent)), _) => {
                if now_ns < *at_ns {
                    // The clock was set back: the pause begins anew.
                    *at_ns = now_ns;
                }
                if now_ns.saturating_sub(*at_ns) < self.limits.period_ns {
                    return not_now(fault);
                }
                sent.clone()
            }
            (None, Some((_, joints))) if fault.is_none() => joints.clone(),
            // A hand that was never moved is not moved by a fault.
            _ => return not_now(fault),
        };
        let from = self.within(&from);
        let aim = match (&fault, &self.open) {
            (None, _) => wanted,
            (Some(_), Some(open)) => open,
            (Some(_), None) => &from,
        };
        let step = self.limits.step_rad;
        let aim = self.within(aim);
        let targets: JointAngles =
            from.iter().zip(&aim).map(|(from, aim)| from + (aim - from).max(-step).min(step)).collect();
        let targets = self.within(&targets);
        self.sent = Some((now_ns, targets.clone()));
        Passed { targets: Some(SafeTargets(targets)), fault }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const MS: i64 = 1_000_000;
    const RANGES: [[f64; 2]; 2] = [[-0.3, 1.0], [0.2, 0.9]];

    fn gate(open: Option<Vec<f64>>) -> CommandGate {
        let limits = CommandLimits { ranges: RANGES.to_vec(), step_rad: 0.05, period_ns: 10 * MS, stale_ns: 100 * MS };
        CommandGate::new(limits, open)
    }

    /// Runs a gate for some commands while joints and estimates are fresh.
    fn drive(gate: &mut CommandGate, from_ms: i64, commands: i64, wanted: &[f64]) -> Vec<Option<Vec<f64>>> {
        let one = |k: i64| {
            let now_ns = (from_ms + 10 * k) * MS;
            gate.measured(now_ns, &[0.0, 0.5]);
            gate.estimated(now_ns - 50 * MS, false);
            gate.pass(now_ns, now_ns, wanted).targets.map(|targets| targets.angles().to_vec())
        };
        (0..commands).map(one).collect()
    }

    #[test]
    fn nothing_passes_before_joints_and_an_estimate() {
        let mut gate = gate(Some(vec![0.0, 0.5]));
        assert_eq!(gate.pass(MS, MS, &[0.0, 0.5]), Passed { targets: None, fault: Some(DriveFault::NoJoints) });
        gate.measured(20 * MS, &[0.0, 0.5]);
        assert_eq!(gate.pass(21 * MS, MS, &[0.0, 0.5]).fault, Some(DriveFault::NoEstimate));
        gate.end(DriveFault::Ended("it is over".to_owned()));
        assert_eq!((gate.pass(50 * MS, MS, &[0.0, 0.5]).targets, gate.is_at_rest()), (None, true));
    }

    #[test]
    fn a_far_target_is_approached_in_steps_and_the_range_ends_it() {
        let mut gate = gate(None);
        let sent = drive(&mut gate, 1000, 30, &[9.0, -9.0]);
        assert!(sent.iter().all(Option::is_some));
        assert_eq!(sent[0].as_ref().unwrap()[0], 0.05);
        assert_eq!(sent[29].as_ref().unwrap(), &[1.0, 0.2]);
        // Twice as often is not sent twice as often.
        assert_eq!(gate.pass(1295 * MS, 1295 * MS, &[9.0, 9.0]).targets, None);
    }

    #[test]
    fn old_joints_an_old_estimate_a_lost_object_and_broken_targets_hold_the_last_targets() {
        let mut gate = gate(None);
        let last = drive(&mut gate, 1000, 3, &[1.0, 0.9]).pop().flatten().unwrap();
        let mut faults = Vec::new();
        let mut pass = |gate: &mut CommandGate, now_ms: i64, wanted: &[f64]| {
            let Passed { targets, fault } = gate.pass(now_ms * MS, now_ms * MS, wanted);
            assert_eq!(targets.unwrap().angles(), last);
            faults.push(fault.unwrap().to_string());
        };
        gate.estimated(1100 * MS, false);
        pass(&mut gate, 1130, &[1.0, 0.9]);
        gate.measured(1200 * MS, &[0.0, 0.5]);
        pass(&mut gate, 1210, &[1.0, 0.9]);
        gate.estimated(1200 * MS, true);
        pass(&mut gate, 1220, &[1.0, 0.9]);
        gate.estimated(1200 * MS, false);
        pass(&mut gate, 1230, &[f64::NAN, 0.9]);
        pass(&mut gate, 1240, &[0.9]);
        assert_eq!(
            faults,
            [
                "the joint angles are 0.11 s old",
                "the image of the newest estimate is 0.11 s old",
                "the object is lost",
                "the controller gives no valid targets",
                "the controller gives no valid targets"
            ]
        );
        // All is well again: it goes on after a while.
        let sent = drive(&mut gate, 1250, 52, &[1.0, 0.9]);
        assert!(sent[..50].iter().all(|sent| sent.as_ref() == Some(&last)) && sent[51].as_ref() != Some(&last));
    }

    #[test]
    fn a_hand_that_opens_stays_open() {
        let mut gate = gate(Some(vec![-0.3, 0.2]));
        drive(&mut gate, 1000, 5, &[0.5, 0.9]);
        gate.estimated(1040 * MS, true);
        assert_eq!(gate.pass(1050 * MS, 0, &[0.5, 0.9]).fault, Some(DriveFault::Lost));
        assert!(!gate.is_at_rest());
        let sent = drive(&mut gate, 1060, 40, &[0.5, 0.9]);
        assert_eq!(sent.last().unwrap().as_ref().unwrap(), &[-0.3, 0.2]);
        assert!(gate.is_at_rest());
    }

    #[test]
    fn a_clock_that_stands_is_a_fault_although_nothing_grows_old() {
        let mut gate = gate(None);
        drive(&mut gate, 1000, 2, &[0.5, 0.9]);
        assert_eq!(gate.pass(1020 * MS, 1020 * MS, &[0.5, 0.9]).fault, None);
        assert_eq!(gate.pass(1020 * MS, 1600 * MS, &[0.5, 0.9]).fault, Some(DriveFault::ClockStands));
        assert_eq!(drive(&mut gate, 1030, 60, &[0.5, 0.9]).last().unwrap().as_ref().unwrap(), &[0.5, 0.9]);
    }

    #[derive(Debug, Clone)]
    enum Call {
        Measured(i64, Vec<f64>),
        Estimated(i64, bool),
        Pass(i64, Vec<f64>),
        End,
    }

    fn number() -> impl Strategy<Value = f64> {
        prop_oneof![4 => -2.0..2.0, 1 => prop::num::f64::ANY]
    }

    fn call() -> impl Strategy<Value = Call> {
        let angles = || prop::collection::vec(number(), 0..4);
        let pair = || prop::collection::vec(-1.0..2.0f64, 2);
        prop_oneof![
            2 => (-150i64..150, prop_oneof![pair(), angles()]).prop_map(|(age, joints)| Call::Measured(age, joints)),
            2 => (-150i64..150, prop::bool::weighted(0.1)).prop_map(|(age, lost)| Call::Estimated(age, lost)),
            8 => (-5i64..40, prop_oneof![pair(), angles()]).prop_map(|(after, wanted)| Call::Pass(after, wanted)),
            1 => Just(Call::End),
        ]
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(2000))]
        /// A policy that gives anything at any time: no target leaves the range, steps too far, comes too soon, or follows it on a fault.
        #[test]
        fn no_target_leaves_the_limits(calls in prop::collection::vec(call(), 1..120), opens in any::<bool>()) {
            let open = [0.9, 0.3];
            let mut gate = gate(opens.then(|| open.to_vec()));
            let (mut now_ms, mut last) = (10_000, None::<(i64, Vec<f64>)>);
            let (mut joints, mut estimate) = (None::<(i64, Vec<f64>)>, None);
            let mut is_over = false;
            for call in calls {
                match call {
                    Call::Measured(age_ms, angles) => {
                        gate.measured((now_ms - age_ms) * MS, &angles);
                        if angles.len() == 2 && angles.iter().all(|angle| angle.is_finite()) {
                            joints = Some((now_ms - age_ms, angles));
                        }
                    }
                    Call::Estimated(age_ms, lost) => {
                        gate.estimated((now_ms - age_ms) * MS, lost);
                        estimate = Some((now_ms - age_ms, lost));
                    }
                    Call::End => {
                        gate.end(DriveFault::Ended(String::new()));
                        is_over = true;
                    }
                    Call::Pass(after_ms, wanted) => {
                        now_ms += after_ms;
                        if after_ms < 0
                            && let Some((at_ms, _)) = &mut last
                        {
                            *at_ms = now_ms.min(*at_ms);
                        }
                        let Passed { targets, fault } = gate.pass(now_ms * MS, now_ms * MS, &wanted);
                        let is_fresh = |at_ms: i64| (now_ms - at_ms).abs() <= 100;
                        let is_well = joints.as_ref().is_some_and(|(at_ms, _)| is_fresh(*at_ms))
                            && estimate.is_some_and(|(at_ms, lost)| !lost && is_fresh(at_ms))
                            && wanted.len() == 2
                            && wanted.iter().all(|angle| angle.is_finite());
                        is_over |= opens && last.is_some() && !is_well;
                        prop_assert!(fault.is_some() || (is_well && !is_over));
                        let Some(targets) = targets else { continue };
                        let targets = targets.angles().to_vec();
                        prop_assert_eq!(targets.len(), 2);
                        for (angle, [low, high]) in targets.iter().zip(RANGES) {
                            prop_assert!((low..=high).contains(angle), "{angle}");
                        }
                        let before = match &last {
                            Some((at_ms, before)) => {
                                prop_assert!(now_ms - at_ms >= 10, "after {} ms", now_ms - at_ms);
                                before.clone()
                            }
                            None => {
                                prop_assert!(fault.is_none());
                                let measured = joints.as_ref().map(|(_, joints)| joints.clone()).unwrap_or_default();
                                measured.iter().zip(RANGES).map(|(angle, [low, high])| angle.clamp(low, high)).collect()
                            }
                        };
                        for j in 0..2 {
                            let step = targets[j] - before[j];
                            prop_assert!(step.abs() <= 0.05 + 1e-12, "step of {step}");
                            if fault.is_some() && !opens {
                                prop_assert_eq!(step, 0.0);
                            }
                            if fault.is_some() && opens {
                                prop_assert!(step * (open[j] - before[j]) >= 0.0);
                            }
                        }
                        last = Some((now_ms, targets));
                    }
                }
            }
        }
    }
}
