//! The motion of a hand: a controller with its directives, behind the gate. It knows no network.

use mvt_gaits::controller::{Controller, Proprioception};
use mvt_gaits::directive::Directive;
use mvt_gaits::feedback::EstimatedPlace;
use mvt_gaits::gait::Gait;
use mvt_robot::hand::{Hand, JointAngles, PerPad};
use mvt_robot::observation::Press;
use mvt_run::report::CommandRecord;

use crate::gate::{CommandGate, CommandLimits, DriveFault, Passed, SafeTargets};
use crate::targets::OnStop;

/// A controller whose targets pass a gate.
pub(crate) struct Motion {
    controller: Box<dyn Controller>,
    gate: CommandGate,
    on_stop: OnStop,
    /// What the controller senses, with the newest joint angles.
    senses: Proprioception,
    /// Stamp of these, nanoseconds.
    joints_ns: Option<i64>,
    /// Stamp of the joint angles with which the motion began, and of time 0 of the frames, nanoseconds.
    begun_ns: Option<i64>,
    frames_ns: Option<i64>,
    /// When the controller is asked next, seconds since the begin.
    next_s: f64,
    wanted: JointAngles,
    stopped: Option<DriveFault>,
    record: CommandRecord,
}

fn seconds(ns: i64) -> f64 {
    ns as f64 * 1e-9
}

impl Motion {
    /// Prepares a controller, which plays `gait` or a policy that starts as this gait does, within limits.
    pub fn new(
        controller: Box<dyn Controller>,
        gait: &Gait,
        hand: &Hand,
        limits: CommandLimits,
        on_stop: OnStop,
    ) -> Self {
        let open = (on_stop == OnStop::Open).then(|| hand.within_ranges(&hand.mirrored(&gait.open_pose)));
        let senses = Proprioception {
            velocities: vec![0.0; hand.joints().len()],
            forces_n: hand.per_pad(|_| 0.0),
            gravity: gait.gravity_on(hand.side()),
            axis: gait.axis.direction(hand.side()).into(),
            ..Proprioception::default()
        };
        Self {
            controller,
            gate: CommandGate::new(limits, open),
            on_stop,
            senses,
            joints_ns: None,
            begun_ns: None,
            frames_ns: None,
            next_s: 0.0,
            wanted: Vec::new(),
            stopped: None,
            record: CommandRecord::default(),
        }
    }

    /// Returns whether the controller needs the place of the object.
    pub fn needs_place(&self) -> bool {
        self.controller.needs_place()
    }

    /// Takes joint angles and, where they are known, velocities, in the order of the hand, with their stamp.
    pub fn measured(&mut self, stamp_ns: i64, joints: JointAngles, velocities: Option<JointAngles>) {
        self.gate.measured(stamp_ns, &joints);
        if let Some(before_ns) = self.joints_ns.replace(stamp_ns) {
            let passed_ns = stamp_ns.saturating_sub(before_ns);
            if passed_ns < 0 {
                // A clock that was set back: time goes on.
                self.begun_ns = self.begun_ns.map(|begun_ns| begun_ns.saturating_add(passed_ns));
            }
            let between = self.senses.joints.iter().zip(&joints).map(|(a, b)| (b - a) / seconds(passed_ns));
            match velocities {
                Some(velocities) => self.senses.velocities = velocities,
                None if passed_ns > 0 => self.senses.velocities = between.collect(),
                None => {}
            }
        }
        self.senses.joints = joints;
    }

    /// Takes an estimate: the stamp of its image, the time of its frame, and whether the object is lost.
    pub fn estimated(&mut self, stamp_ns: i64, time_s: f64, is_lost: bool) {
        self.frames_ns = Some(stamp_ns.saturating_sub((time_s * 1e9) as i64));
        self.gate.estimated(stamp_ns, is_lost);
    }

    /// Takes the estimated place of the object, whose time is that of its frame.
    pub fn see(&mut self, place: EstimatedPlace) {
        if let Some((begun_ns, frames_ns)) = self.begun_ns.zip(self.frames_ns) {
            self.controller.see(place.counted_from(seconds(begun_ns.saturating_sub(frames_ns))));
        }
    }

    /// Takes how the object presses into each gel.
    pub fn feel(&mut self, presses: &PerPad<Option<Press>>) {
        self.controller.feel(presses);
    }

    /// Obeys a directive, unless the hand is stopped.
    pub fn direct(&mut self, directive: &Directive) -> Result<(), String> {
        match self.begun_ns.is_some() && self.stopped.is_none() {
            true => self.controller.obey(directive).map_err(|unknown| unknown.to_string()),
            false => Ok(()),
        }
    }

    /// Ends the motion for good.
    pub fn end(&mut self, reason: &str) {
        self.gate.end(DriveFault::Ended(reason.to_owned()));
    }

    /// Returns whether an ended motion has come to rest.
    pub fn is_at_rest(&self) -> bool {
        self.gate.is_at_rest()
    }

    /// Returns whether the motion has begun.
    pub fn has_begun(&self) -> bool {
        self.begun_ns.is_some()
    }

    /// Returns why the hand does not follow its controller.
    pub fn stopped(&self) -> Option<&DriveFault> {
        self.stopped.as_ref()
    }

    /// Returns the counts.
    pub fn record(&self) -> &CommandRecord {
        &self.record
    }

    /// Asks the controller if it is its turn.
    fn think(&mut self) {
        let Some((begun_ns, joints_ns)) = self.begun_ns.zip(self.joints_ns) else {
            // The first targets are where the joints are.
            self.wanted.clone_from(&self.senses.joints);
            return;
        };
        /// Stamps are rounded, seconds.
        const ROUNDING_S: f64 = 1e-4;
        let time_s = seconds(joints_ns.saturating_sub(begun_ns));
        if time_s + ROUNDING_S < self.next_s {
            return;
        }
        let period_s = 1.0 / f64::from(self.controller.rate_hz().max(1));
        self.next_s = if time_s < self.next_s + period_s { self.next_s + period_s } else { time_s + period_s };
        self.senses.time_s = time_s;
        self.wanted = self.controller.command(&self.senses);
        if let Some(reason) = self.controller.fault() {
            self.gate.end(DriveFault::Controller(reason));
        }
    }

    /// Returns the targets to send now, and what is worth saying. `now_ns` is the clock of the stamps, `steady_ns` one that never jumps.
    pub fn step(&mut self, now_ns: i64, steady_ns: i64) -> (Option<SafeTargets>, Option<String>) {
        self.think();
        let Passed { targets, fault } = self.gate.pass(now_ns, steady_ns, &self.wanted);
        let had_begun = self.has_begun();
        if targets.is_some() {
            self.record.sent += 1;
            self.begun_ns = self.begun_ns.or(self.joints_ns);
        }
        if !had_begun {
            self.stopped = fault;
            return (targets, self.has_begun().then(|| "the hand is driven".to_owned()));
        }
        let is_new = match (&fault, &self.stopped) {
            (Some(fault), Some(stopped)) => !fault.is_like(stopped),
            (fault, stopped) => fault.is_some() != stopped.is_some(),
        };
        if !is_new {
            return (targets, None);
        }
        let note = match &fault {
            Some(fault) => {
                // Later the fingers go on softly from where they are.
                let _ = self.controller.obey(&Directive::Hold);
                let what = if self.on_stop == OnStop::Open { "opens" } else { "holds" };
                if !matches!(fault, DriveFault::Ended(_)) {
                    self.record.stops.push(fault.to_string());
                }
                format!("the hand {what}: {fault}")
            }
            None => {
                let _ = self.controller.obey(&Directive::Continue);
                "the hand moves again".to_owned()
            }
        };
        self.stopped = fault;
        (targets, Some(note))
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use mvt_gaits::directed::DirectedController;
    use mvt_gaits::gait;
    use mvt_robot::hand::Side;
    use proptest::prelude::*;

    use super::*;

    const MS: i64 = 1_000_000;

    fn hand() -> Arc<Hand> {
        Hand::allegro(Side::Right)
    }

    fn motion(on_stop: OnStop) -> Motion {
        let (_, gait) = gait::find("cube").unwrap();
        let limits = CommandLimits { ranges: hand().ranges(), step_rad: 0.05, period_ns: 10 * MS, stale_ns: 100 * MS };
        Motion::new(Box::new(DirectedController::new(gait, &hand())), gait, &hand(), limits, on_stop)
    }

    /// Plays a hand that follows exactly, at 100 Hz with frames at 25 Hz; returns all targets and notes. `change` may spoil an instant.
    fn play(
        motion: &mut Motion,
        from_ms: i64,
        to_ms: i64,
        joints: &mut JointAngles,
        is_lost: impl Fn(i64) -> bool,
    ) -> (Vec<JointAngles>, Vec<String>) {
        let (mut all, mut notes) = (Vec::new(), Vec::new());
        for now_ms in (from_ms..to_ms).step_by(10) {
            motion.measured(now_ms * MS, joints.clone(), None);
            if now_ms % 40 == 0 {
                motion.estimated((now_ms - 40) * MS, (now_ms - 40) as f64 * 1e-3 - 5.0, is_lost(now_ms));
            }
            let (targets, note) = motion.step(now_ms * MS, now_ms * MS);
            notes.extend(note);
            if let Some(targets) = targets {
                *joints = targets.angles().to_vec();
                all.push(joints.clone());
            }
        }
        (all, notes)
    }

    #[test]
    fn the_hand_follows_its_gait_from_where_it_is_and_holds_while_the_object_is_lost() {
        let mut motion = motion(OnStop::Hold);
        let first: JointAngles = hand().ranges().iter().map(|[low, high]| (low + high) / 2.0).collect();
        let mut joints = first.clone();
        let (targets, notes) =
            play(&mut motion, 10_000, 16_000, &mut joints, |now_ms| (13_000..14_000).contains(&now_ms));
        assert_eq!(targets[0], first);
        assert_eq!(notes, ["the hand is driven", "the hand holds: the object is lost", "the hand moves again"]);
        let step = |pair: &[JointAngles]| (0..16).map(|j| (pair[1][j] - pair[0][j]).abs()).fold(0.0, f64::max);
        assert!(targets.windows(2).all(|pair| step(pair) <= 0.05 + 1e-9));
        let moved = |from_ms: i64, to_ms: i64| {
            let at = |ms: i64| ((ms - 10_000) / 10) as usize;
            targets[at(from_ms)..at(to_ms)].windows(2).map(step).fold(0.0, f64::max)
        };
        // It goes on half a second after all is well.
        assert!(moved(12_000, 12_900) > 1e-3 && moved(13_050, 14_400) == 0.0 && moved(14_600, 15_900) > 1e-3);
        assert_eq!(motion.record().stops, ["the object is lost"]);
    }

    #[test]
    fn an_ended_motion_opens_the_hand_if_it_shall() {
        let mut motion = motion(OnStop::Open);
        let mut joints = hand().within_ranges(&[0.4; 16]);
        play(&mut motion, 10_000, 12_000, &mut joints, |_| false);
        motion.end("the run ended");
        let (_, notes) = play(&mut motion, 12_000, 14_000, &mut joints, |_| false);
        assert_eq!(notes, ["the hand opens: the run ended"]);
        let open = hand().within_ranges(&gait::find("cube").unwrap().1.open_pose);
        assert!(motion.is_at_rest() && (0..16).all(|j| (joints[j] - open[j]).abs() < 1e-9));
        assert_eq!(motion.direct(&Directive::SwitchGait("none".to_owned())), Ok(()));
    }

    #[test]
    fn directives_reach_the_controller() {
        let mut motion = motion(OnStop::Hold);
        let mut joints = hand().within_ranges(&[0.4; 16]);
        play(&mut motion, 10_000, 12_000, &mut joints, |_| false);
        assert!(motion.direct(&Directive::SwitchGait("gallop".to_owned())).unwrap_err().contains("gallop"));
        motion.direct(&Directive::Hold).unwrap();
        let (targets, _) = play(&mut motion, 12_000, 13_000, &mut joints, |_| false);
        assert_eq!(targets[20], targets[99]);
    }

    /// Gives anything.
    #[derive(Debug, Clone)]
    struct WildController(Vec<Vec<f64>>, usize);

    impl Controller for WildController {
        fn command(&mut self, _: &Proprioception) -> JointAngles {
            self.1 += 1;
            self.0.get(self.1 % self.0.len()).cloned().unwrap_or_default()
        }

        fn copy(&self) -> Box<dyn Controller> {
            Box::new(self.clone())
        }
    }

    fn wild_row() -> impl Strategy<Value = Vec<f64>> {
        let any = prop_oneof![6 => -3.0..3.0, 1 => prop::num::f64::ANY];
        prop_oneof![8 => prop::collection::vec(any, 16), 1 => prop::collection::vec(-1.0..1.0f64, 0..20)]
    }

    proptest! {
        #[test]
        fn a_wild_policy_leaves_no_limit(
            rows in prop::collection::vec(wild_row(), 1..20), opens in any::<bool>(), lost_ms in 10_000i64..14_000
        ) {
            let (_, gait) = gait::find("cube").unwrap();
            let limits =
                CommandLimits { ranges: hand().ranges(), step_rad: 0.05, period_ns: 10 * MS, stale_ns: 100 * MS };
            let on_stop = if opens { OnStop::Open } else { OnStop::Hold };
            let mut motion = Motion::new(Box::new(WildController(rows, 0)), gait, &hand(), limits, on_stop);
            let mut joints = hand().within_ranges(&[0.4; 16]);
            let is_lost = |now_ms: i64| (lost_ms..lost_ms + 300).contains(&now_ms);
            let (targets, _) = play(&mut motion, 10_000, 14_000, &mut joints, is_lost);
            for pair in targets.windows(2) {
                for (j, [low, high]) in hand().ranges().into_iter().enumerate() {
                    prop_assert!((low..=high).contains(&pair[1][j]) && (pair[1][j] - pair[0][j]).abs() <= 0.05 + 1e-12);
                }
            }
        }
    }
}
