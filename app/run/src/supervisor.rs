//! The supervisor: it chooses the next directive to the hand from the tracker's estimate alone.
//!
//! A [`Supervisor`] receives nothing but a [`Belief`], which holds neither the simulator's state nor ground truth.

use std::collections::VecDeque;
use std::f64::consts::TAU;
use std::fmt;
use std::str::FromStr;

use mvt_frames::{Isometry, Model, World};
use mvt_gaits::axis::TurnAxis;
use mvt_gaits::directive::Directive;
use mvt_robot::hand::Side;
use mvt_robot::rig::Placement;
use mvt_settings::{SettingError, settings};
use nalgebra::{Unit, UnitQuaternion, Vector2, Vector3};

/// Goal that ends an episode.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum Goal {
    /// The object has turned by this angle in the gait's direction, radians.
    Turn(f64),
    /// This part of the directions around the object has been observed, 0 to 1.
    Coverage(f64),
    /// The object is turned by this angle about the gait's axis against its start, radians, and held there.
    Pose(f64),
    /// The side of the object that looks at the start to this azimuth and elevation, degrees, is turned to a camera. A supervisor needs
    /// [`Goal::facing`], which makes a pose of it.
    Show([f64; 2]),
    /// The duration of the episode is over.
    Time,
}

impl Goal {
    /// Makes a pose of the goal to show a side to a camera: the turn about the gait's axis that brings the side as near as it can.
    /// Directions are those around a right hand, as cameras have them; around a left hand all of them are mirrored.
    pub fn facing(self, axis: TurnAxis, camera: &Placement) -> Self {
        let Goal::Show([azimuth_deg, elevation_deg]) = self else { return self };
        let axis = axis.direction(Side::Right);
        let side = Placement::direction_of(azimuth_deg, elevation_deg);
        // The parts across the axis; a turn does not change the others.
        let [from, to] = [side, camera.direction()].map(|v| v - axis * axis.dot(&v));
        Goal::Pose(axis.dot(&from.cross(&to)).atan2(from.dot(&to)))
    }
}

impl fmt::Display for Goal {
    /// Writes the goal in the form that is parsed.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Goal::Turn(rad) => write!(f, "turn={rad}rad"),
            Goal::Coverage(part) => write!(f, "coverage={part}"),
            Goal::Pose(rad) => write!(f, "pose={rad}rad"),
            Goal::Show([azimuth, elevation]) => write!(f, "show={azimuth}/{elevation}"),
            Goal::Time => f.write_str("time"),
        }
    }
}

/// Text that is not a goal.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum GoalError {
    /// There is no such goal.
    #[error(
        "unknown goal {0:?}; the goals are turn=360deg, turn=2rev, turn=6.3rad, coverage=0.9, pose=90deg, show=180/0 and time"
    )]
    Unknown(String),
    /// The amount is not a positive number, or a coverage above 1.
    #[error(
        "the goal {0:?} needs a positive amount: turn=360deg, turn=2rev, turn=6.3rad, pose=90deg, or coverage up to 1 as in coverage=0.9"
    )]
    Amount(String),
    /// The side to show is no direction.
    #[error(
        "the goal {0:?} needs azimuth and elevation of a side in degrees, such as show=180/0; elevations are from -90 to 90"
    )]
    Side(String),
}

impl FromStr for Goal {
    type Err = GoalError;

    fn from_str(text: &str) -> Result<Self, GoalError> {
        let number = |amount: &str, most: f64| {
            let value = amount.trim().parse().ok().filter(|v: &f64| *v > 0.0 && *v <= most);
            value.ok_or_else(|| GoalError::Amount(text.to_owned()))
        };
        let angle = |amount: &str| {
            let units = [("deg", TAU / 360.0), ("rev", TAU), ("rad", 1.0)];
            let unit = units.iter().find_map(|(name, rad)| Some((amount.strip_suffix(name)?, rad)));
            let (amount, rad) = unit.ok_or_else(|| GoalError::Amount(text.to_owned()))?;
            Ok(number(amount, f64::MAX)? * rad)
        };
        match text.split_once('=') {
            None if text == "time" => Ok(Goal::Time),
            Some(("turn", amount)) => Ok(Goal::Turn(angle(amount)?)),
            Some(("pose", amount)) => Ok(Goal::Pose(angle(amount)?)),
            Some(("show", side)) => {
                let degrees = |text: &str| text.trim().parse().ok().filter(|v: &f64| v.abs() <= 360.0);
                let side = side.split_once('/').and_then(|(a, e)| Some([degrees(a)?, degrees(e)?]));
                let side = side.filter(|[_, elevation]| elevation.abs() <= 90.0);
                Ok(Goal::Show(side.ok_or_else(|| GoalError::Side(text.to_owned()))?))
            }
            Some(("coverage", amount)) => Ok(Goal::Coverage(number(amount, 1.0)?)),
            _ => Err(GoalError::Unknown(text.to_owned())),
        }
    }
}

/// Estimate of the object at one instant.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Belief {
    /// Seconds since the start of the episode.
    pub time_s: f64,
    /// Estimated pose.
    pub pose: Isometry<Model, World>,
    /// Estimated middle of the object, x and y in the world, metres.
    pub centre_m: [f64; 2],
    /// Angles turned so far about x, y and z of the world, radians.
    pub turned_rad: Vector3<f64>,
    /// Confidence in the pose, 0 to 1.
    pub confidence: f64,
    /// Stated deviation of the pose, one standard deviation of the surface, metres; infinite while it is lost.
    pub deviation_m: f64,
    /// The tracker has declared itself lost.
    pub lost: bool,
    /// Part of the directions around the object in which its surface has not been observed, 0 to 1.
    pub unobserved: f64,
}

settings! {
    /// Thresholds of the supervisor.
    #[derive(Copy)]
    #[non_exhaustive]
    pub struct SupervisorRules {
        /// Least confidence with which a goal counts as reached.
        pub confidence: f64 = 0.5, 0.0..=1.0;
        /// Largest stated deviation of the pose with which a goal counts as reached, metres.
        pub deviation_m: f64 = 0.005, 0.0..=1.0;
        /// Angle to a goal orientation at which the fingers are held, radians. They stop a little later than they are told to.
        pub hold_rad: f64 = 0.17, 0.0..=3.2;
        /// Angle to a goal orientation from which on the object has left it, and is turned on, radians.
        pub leave_rad: f64 = 0.26, 0.0..=3.2;
        /// Time for which the object must rest at a goal orientation, seconds.
        pub hold_s: f64 = 2.0, 0.0..=3600.0;
        /// If the object is lost for longer than this, the hand re-grasps, seconds.
        pub lost_s: f64 = 1.0, 0.0..=3600.0;
        /// Distance of the object from its start at which a push back begins, metres.
        pub drift_begin_m: f64 = 0.012, 0.001..=1.0;
        /// Distance of the object from its start at which a push back ends, metres.
        pub drift_end_m: f64 = 0.004, 0.0..=1.0;
        /// Longest push, seconds. Pushed fingers turn the object more slowly.
        pub push_s: f64 = 4.0, 0.0..=3600.0;
        /// If the object does not move for this time, the hand re-grasps, seconds.
        pub still_s: f64 = 4.0, 0.0..=3600.0;
        /// Rotation from which on the object moves, radians.
        pub still_rad: f64 = 0.05, 0.0..=10.0;
        /// Translation from which on the object moves, metres.
        pub still_m: f64 = 0.002, 0.0..=1.0;
        /// Time over which progress is measured, seconds.
        pub progress_s: f64 = 6.0, 0.0..=3600.0;
        /// Rate at which a gait should turn the object, radians per second.
        pub turn_rate_rad_s: f64 = 0.8, 0.0..=100.0;
        /// If the object turns more slowly than this part of that rate, another gait follows.
        pub slow: f64 = 0.25, 0.0..=10.0;
        /// If coverage is the goal and the unobserved part falls by less than this, another gait follows.
        pub coverage_gain: f64 = 0.01, 0.0..=1.0;
        /// Time after a re-grasp, a push or a change of gait in which no other directive but a stop follows, seconds.
        pub settle_s: f64 = 2.5, 0.0..=3600.0;
    }
    rule = a_push_ends_nearer_than_it_begins;
}

fn a_push_ends_nearer_than_it_begins(rules: &SupervisorRules) -> Result<(), SettingError> {
    if rules.drift_end_m <= rules.drift_begin_m {
        return Ok(());
    }
    let range = format!("at most drift_begin_m, {}", rules.drift_begin_m);
    Err(SettingError::new("drift_end_m", rules.drift_end_m.to_string(), range))
}

/// Chooses directives from beliefs.
#[derive(Debug, Clone)]
pub struct Supervisor {
    goal: Goal,
    /// Axis about which the gaits turn the object, a unit vector in the world.
    axis: Vector3<f64>,
    rules: SupervisorRules,
    /// All gaits in turn, the current one first.
    gaits: VecDeque<String>,
    /// Trusted beliefs since the last directive, at most one of them older than the time over which progress is measured.
    history: VecDeque<Belief>,
    /// First estimated position of the object.
    home_m: Option<Vector2<f64>>,
    /// First estimated orientation of the object.
    first: Option<UnitQuaternion<f64>>,
    holding_since_s: Option<f64>,
    lost_since_s: Option<f64>,
    pushing_since_s: Option<f64>,
    settled_at_s: f64,
    last_s: f64,
}

impl Supervisor {
    /// Starts with the first gait; when it makes no progress, the others follow in turn. All turn the object about
    /// `axis`, a unit vector in the world.
    pub fn new(goal: Goal, axis: Vector3<f64>, gaits: &[&str], rules: SupervisorRules) -> Self {
        Self {
            goal,
            axis,
            rules,
            gaits: gaits.iter().map(|&name| name.to_owned()).collect(),
            history: VecDeque::new(),
            home_m: None,
            first: None,
            holding_since_s: None,
            lost_since_s: None,
            pushing_since_s: None,
            settled_at_s: 0.0,
            last_s: f64::NEG_INFINITY,
        }
    }

    /// Returns the directive of this frame. Call it once per frame. A belief that is not newer than the last, or whose numbers are not
    /// finite, is skipped.
    pub fn decide(&mut self, belief: &Belief) -> Directive {
        let time_s = belief.time_s;
        if !(is_finite(belief) && time_s > self.last_s) {
            return Directive::Continue;
        }
        self.last_s = time_s;
        if belief.lost {
            // Earlier beliefs say nothing about the object once it is found again.
            self.history.clear();
            self.pushing_since_s = None;
            let since = *self.lost_since_s.get_or_insert(time_s);
            return if time_s - since > self.rules.lost_s {
                self.intervene(time_s, Directive::Regrasp)
            } else {
                Directive::Continue
            };
        }
        self.lost_since_s = None;
        if let Some(directive) = self.hold(belief) {
            return directive;
        }
        if self.is_reached(belief) {
            return Directive::Stop;
        }
        self.history.push_back(*belief);
        let oldest = time_s - self.rules.progress_s.max(self.rules.still_s);
        // One belief that is old enough stays.
        while self.history.get(1).is_some_and(|b| b.time_s <= oldest) {
            self.history.pop_front();
        }
        if self.is_still(belief) {
            return self.intervene(time_s, Directive::Regrasp);
        }
        if let Some(directive) = self.push(belief) {
            return directive;
        }
        if self.gaits.len() > 1 && self.makes_no_progress(belief) {
            self.gaits.rotate_left(1);
            return self.intervene(time_s, Directive::SwitchGait(self.gaits[0].clone()));
        }
        Directive::Continue
    }

    fn is_reached(&self, belief: &Belief) -> bool {
        let reached = match self.goal {
            Goal::Turn(angle_rad) => belief.turned_rad.dot(&self.axis) >= angle_rad,
            Goal::Coverage(part) => 1.0 - belief.unobserved >= part,
            Goal::Pose(_) => self.holding_since_s.is_some_and(|since| belief.time_s - since >= self.rules.hold_s),
            Goal::Show(_) | Goal::Time => false,
        };
        reached && self.is_trusted(belief)
    }

    fn is_trusted(&self, belief: &Belief) -> bool {
        belief.confidence >= self.rules.confidence && belief.deviation_m <= self.rules.deviation_m
    }

    /// Returns a directive to hold the object where it is, at a goal orientation.
    fn hold(&mut self, belief: &Belief) -> Option<Directive> {
        let Goal::Pose(turn_rad) = self.goal else { return None };
        let rotation = belief.pose.untyped().rotation;
        let first = *self.first.get_or_insert(rotation);
        let goal = UnitQuaternion::from_axis_angle(&Unit::new_normalize(self.axis), turn_rad) * first;
        let left_rad = rotation.angle_to(&goal);
        match self.holding_since_s {
            None if left_rad < self.rules.hold_rad && self.is_trusted(belief) => {
                self.holding_since_s = Some(belief.time_s);
            }
            Some(_) if left_rad > self.rules.leave_rad => {
                self.holding_since_s = None;
                // It needs another round, in which it must not be regarded as still.
                self.history.clear();
            }
            _ => {}
        }
        (self.holding_since_s.is_some() && !self.is_reached(belief)).then_some(Directive::Hold)
    }

    /// Returns the directive, unless the hand still carries out the last one.
    fn intervene(&mut self, time_s: f64, directive: Directive) -> Directive {
        if time_s < self.settled_at_s {
            return Directive::Continue;
        }
        self.settled_at_s = time_s + self.rules.settle_s;
        self.pushing_since_s = None;
        self.history.clear();
        directive
    }

    /// Returns the latest belief that is at least this old.
    fn before(&self, belief: &Belief, seconds: f64) -> Option<&Belief> {
        self.history.iter().rev().find(|b| b.time_s <= belief.time_s - seconds)
    }

    fn is_still(&self, belief: &Belief) -> bool {
        // All beliefs in between count: an object that rocks is not still.
        self.before(belief, self.rules.still_s).is_some()
            && self.history.iter().filter(|b| b.time_s >= belief.time_s - self.rules.still_s).all(|b| {
                let change = b.pose.untyped().inverse() * belief.pose.untyped();
                change.rotation.angle() < self.rules.still_rad && change.translation.vector.norm() < self.rules.still_m
            })
    }

    /// Returns a push back to the start if the object has drifted.
    fn push(&mut self, belief: &Belief) -> Option<Directive> {
        let centre = Vector2::from(belief.centre_m);
        let offset = centre - *self.home_m.get_or_insert(centre);
        let (begin, end) = (self.rules.drift_begin_m, self.rules.drift_end_m);
        match self.pushing_since_s {
            Some(since) if offset.norm() < end || belief.time_s - since > self.rules.push_s => {
                self.pushing_since_s = None;
                // The gait turns the object for a while before the next push.
                self.settled_at_s = belief.time_s + self.rules.settle_s;
                self.history.clear();
            }
            None if offset.norm() > begin && belief.time_s >= self.settled_at_s => {
                self.pushing_since_s = Some(belief.time_s);
            }
            _ => {}
        }
        self.pushing_since_s.map(|_| Directive::Recentre { offset_m: offset.into() })
    }

    fn makes_no_progress(&self, belief: &Belief) -> bool {
        let Some(before) = self.before(belief, self.rules.progress_s) else { return false };
        let elapsed = belief.time_s - before.time_s;
        let turned_rad = (belief.turned_rad - before.turned_rad).dot(&self.axis);
        let is_slow = turned_rad < self.rules.slow * self.rules.turn_rate_rad_s * elapsed;
        let learns_nothing = before.unobserved - belief.unobserved < self.rules.coverage_gain;
        is_slow || (matches!(self.goal, Goal::Coverage(_)) && learns_nothing)
    }
}

fn is_finite(belief: &Belief) -> bool {
    let Belief { time_s, pose, centre_m, turned_rad, confidence, deviation_m: _, lost: _, unobserved } = belief;
    let numbers = [*time_s, *confidence, *unobserved, centre_m[0], centre_m[1]];
    numbers.iter().chain(turned_rad).all(|v| v.is_finite()) && pose.to_matrix().iter().flatten().all(|v| v.is_finite())
}

#[cfg(test)]
mod tests {
    use super::*;

    const GAITS: [&str; 3] = ["cubelet", "shared", "bal"];
    const FRAME_S: f64 = 1.0 / 30.0;

    /// An object that stays in its place, turns at the right rate and is observed more and more.
    fn turning(time_s: f64) -> Belief {
        let yaw = 0.8 * time_s;
        Belief {
            time_s,
            pose: Isometry::from_parts([0.0, 0.0, 0.05], [(yaw / 2.0).cos(), 0.0, 0.0, (yaw / 2.0).sin()]),
            centre_m: [-0.02, 0.01],
            turned_rad: Vector3::z() * yaw,
            confidence: 0.9,
            deviation_m: 0.001,
            lost: false,
            unobserved: (-time_s / 20.0).exp(),
        }
    }

    /// Returns all directives but `Continue` with their times.
    fn watch(goal: Goal, seconds: f64, believe: impl Fn(f64) -> Belief) -> Vec<(f64, Directive)> {
        let mut supervisor = Supervisor::new(goal, Vector3::z(), &GAITS, SupervisorRules::default());
        let times = (0..(seconds / FRAME_S) as usize).map(|k| k as f64 * FRAME_S);
        times
            .map(|time_s| (time_s, supervisor.decide(&believe(time_s))))
            .filter(|(_, directive)| *directive != Directive::Continue)
            .collect()
    }

    fn first(directives: &[(f64, Directive)], about_s: f64) -> Directive {
        assert!((directives[0].0 - about_s).abs() < 2.5 * FRAME_S, "{:?}", directives[0]);
        directives[0].1.clone()
    }

    #[test]
    fn a_goal_orientation_is_held_and_then_ends_the_episode() {
        // The object turns until the fingers hold it.
        let side = Placement::parse_list("side").unwrap().remove(0);
        let show = |text: &str| text.parse::<Goal>().unwrap().facing(TurnAxis::PlusZ, &side);
        // The camera `side` is at an azimuth of 90 degrees.
        for (goal, at_rad) in
            [(Goal::Pose(1.5), 1.5), (show("show=30/20"), TAU / 6.0), (show("show=150/-10"), TAU * 5.0 / 6.0)]
        {
            let mut supervisor = Supervisor::new(goal, Vector3::z(), &GAITS, SupervisorRules::default());
            let (mut yaw, mut held, mut stopped_s) = (0.0_f64, 0, None);
            for k in 0..600 {
                let time_s = f64::from(k) * FRAME_S;
                let pose = Isometry::from_parts([0.0, 0.0, 0.05], [(yaw / 2.0).cos(), 0.0, 0.0, (yaw / 2.0).sin()]);
                match supervisor.decide(&Belief { pose, ..turning(time_s) }) {
                    Directive::Hold => held += 1,
                    Directive::Stop => stopped_s = stopped_s.or(Some(time_s)),
                    _ => yaw += 0.8 * FRAME_S,
                }
                if stopped_s.is_some() {
                    break;
                }
            }
            assert!((yaw - at_rad).abs() < 0.2, "{goal}: {yaw}");
            assert!((58..=62).contains(&held) && stopped_s.is_some(), "{goal}: {held}");
        }
    }

    #[test]
    fn an_object_that_leaves_its_goal_is_turned_on() {
        let mut supervisor = Supervisor::new(Goal::Pose(1.0), Vector3::z(), &GAITS, SupervisorRules::default());
        let mut directives = Vec::new();
        for (k, yaw) in [0.0_f64, 0.9, 1.1, 1.3, 1.5].into_iter().enumerate() {
            let pose = Isometry::from_parts([0.0, 0.0, 0.05], [(yaw / 2.0).cos(), 0.0, 0.0, (yaw / 2.0).sin()]);
            directives.push(supervisor.decide(&Belief { pose, ..turning(k as f64 * FRAME_S) }));
        }
        let [hold, go] = [Directive::Hold, Directive::Continue];
        assert_eq!(directives, [go.clone(), hold.clone(), hold, go.clone(), go]);
        // An estimate that is not trusted holds nothing.
        let mut supervisor = Supervisor::new(Goal::Pose(1e-3), Vector3::z(), &GAITS, SupervisorRules::default());
        assert_eq!(supervisor.decide(&Belief { confidence: 0.3, ..turning(0.0) }), Directive::Continue);
    }

    #[test]
    fn goals() {
        let parse = |text: &str| text.parse::<Goal>();
        assert_eq!(parse("turn=360deg"), Ok(Goal::Turn(TAU)));
        assert_eq!(parse("turn=2rev"), Ok(Goal::Turn(2.0 * TAU)));
        assert_eq!(parse("turn=1.5rad"), Ok(Goal::Turn(1.5)));
        assert_eq!(parse("coverage=0.9"), Ok(Goal::Coverage(0.9)));
        assert_eq!(parse("pose=90deg"), Ok(Goal::Pose(TAU / 4.0)));
        assert_eq!(parse("show=180/-30").unwrap().to_string(), "show=180/-30");
        assert_eq!(parse("time"), Ok(Goal::Time));
        for text in ["show=180", "show=0/91", "show=NaN/0", "show=side"] {
            assert_eq!(parse(text), Err(GoalError::Side(text.to_owned())));
        }
        for text in [
            "pose=90",
            "turn=360",
            "turn=-1rev",
            "turn=deg",
            "turn=NaNdeg",
            "turn=infrad",
            "coverage=1.1",
            "coverage=0",
        ] {
            assert_eq!(parse(text), Err(GoalError::Amount(text.to_owned())));
        }
        for text in ["", "spin=3rev", "time=3", "turn", "Time"] {
            let error = parse(text).unwrap_err().to_string();
            assert!(error.contains("the goals are turn=360deg") && error.contains("show=180/0 and time"), "{error}");
        }
    }

    #[test]
    fn an_episode_that_goes_well_is_left_alone() {
        assert_eq!(watch(Goal::Time, 40.0, turning), []);
    }

    #[test]
    fn stops_at_the_goal() {
        assert_eq!(first(&watch(Goal::Turn(TAU), 20.0, turning), TAU / 0.8), Directive::Stop);
        assert_eq!(first(&watch(Goal::Coverage(0.5), 20.0, turning), 20.0 * 2f64.ln()), Directive::Stop);
        // A guess does not end the episode.
        let unsure = |time_s| Belief { confidence: 0.4, ..turning(time_s) };
        assert_eq!(watch(Goal::Turn(TAU), 20.0, unsure), []);
        let drifted = |time_s| Belief { deviation_m: 0.006, ..turning(time_s) };
        assert_eq!(watch(Goal::Turn(TAU), 20.0, drifted), []);
        let lost = |time_s| Belief { lost: time_s > 5.0, ..turning(time_s) };
        assert!(watch(Goal::Turn(TAU), 20.0, lost).iter().all(|(_, d)| *d == Directive::Regrasp));
    }

    #[test]
    fn regrasps_when_lost_for_long_and_not_all_the_time() {
        let lost = |from: f64, to: f64| move |time_s| Belief { lost: (from..to).contains(&time_s), ..turning(time_s) };
        assert_eq!(watch(Goal::Time, 20.0, lost(5.0, 5.9)), []);
        let directives = watch(Goal::Time, 20.0, lost(5.0, 10.0));
        assert_eq!(first(&directives, 6.0), Directive::Regrasp);
        assert_eq!(directives.len(), 2, "again after it has settled: {directives:?}");
        assert!(directives[1].0 - directives[0].0 >= SupervisorRules::default().settle_s);
    }

    #[test]
    fn regrasps_when_nothing_moves() {
        let stuck = |time_s: f64| Belief { time_s, ..turning(time_s.min(3.0)) };
        assert_eq!(first(&watch(Goal::Time, 9.0, stuck), 7.0), Directive::Regrasp);
        let rocking = |time_s: f64| Belief { pose: turning((4.0 * time_s).sin()).pose, ..turning(time_s) };
        assert_eq!(watch(Goal::Time, 20.0, rocking), []);
    }

    #[test]
    fn pushes_a_drifted_object_until_it_is_back() {
        // 16 mm off from 2 s on, back by 4 s.
        let offset = |time_s: f64| match time_s {
            t if t < 2.0 => 0.0,
            t => (0.016 - 0.008 * (t - 2.0)).max(0.0),
        };
        let drifting = |time_s| Belief { centre_m: [-0.02, 0.01 + offset(time_s)], ..turning(time_s) };
        let directives = watch(Goal::Time, 12.0, drifting);
        let Directive::Recentre { offset_m } = first(&directives, 2.0) else { panic!("{:?}", directives[0]) };
        assert!(offset_m[0].abs() < 1e-12 && (offset_m[1] - 0.016).abs() < 1e-3, "{offset_m:?}");
        let (last, _) = directives[directives.len() - 1];
        assert!((last - 3.5).abs() < 2.0 * FRAME_S, "{last}");
        assert!(directives.iter().all(|(_, d)| matches!(d, Directive::Recentre { .. })));
    }

    #[test]
    fn pushes_end_even_without_success() {
        let off = |time_s| Belief { centre_m: [if time_s > 3.0 { 0.0 } else { -0.02 }, 0.01], ..turning(time_s) };
        let pushes: Vec<f64> = watch(Goal::Time, 12.0, off).iter().map(|(time_s, _)| *time_s).collect();
        let pauses: Vec<f64> = pushes.windows(2).map(|w| w[1] - w[0]).filter(|gap| *gap > 2.0 * FRAME_S).collect();
        assert_eq!(pauses.len(), 1, "{pauses:?}");
        assert!((pauses[0] - SupervisorRules::default().settle_s).abs() < 3.0 * FRAME_S);
    }

    #[test]
    fn tries_the_gaits_in_turn_when_turning_is_slow() {
        let slow = |time_s: f64| Belief { turned_rad: Vector3::z() * 0.1 * time_s, ..turning(time_s) };
        let directives = watch(Goal::Time, 26.0, slow);
        assert_eq!(first(&directives, 6.0), Directive::SwitchGait("shared".to_owned()));
        let names: Vec<Directive> = directives.iter().map(|(_, d)| d.clone()).collect();
        assert_eq!(names, ["shared", "bal", "cubelet", "shared"].map(|name| Directive::SwitchGait(name.to_owned())));
    }

    #[test]
    fn tries_another_gait_when_nothing_new_is_seen_and_that_is_the_goal() {
        let blind = |time_s: f64| Belief { unobserved: turning(time_s.min(4.0)).unobserved, ..turning(time_s) };
        assert_eq!(watch(Goal::Time, 20.0, blind), []);
        assert_eq!(watch(Goal::Coverage(0.99), 11.0, blind)[0].1, Directive::SwitchGait("shared".to_owned()));
    }

    #[test]
    fn broken_and_old_beliefs_change_nothing() {
        let mut supervisor = Supervisor::new(Goal::Turn(1.0), Vector3::z(), &GAITS, SupervisorRules::default());
        assert_eq!(supervisor.decide(&turning(1.0)), Directive::Continue);
        for broken in [
            Belief { turned_rad: Vector3::z() * f64::INFINITY, ..turning(1.1) },
            Belief { centre_m: [f64::NAN, 0.0], ..turning(2.0) },
            Belief { pose: Isometry::translation(f64::NAN, 0.0, 0.0), ..turning(2.0) },
            Belief { turned_rad: Vector3::z() * 2.0, ..turning(0.9) },
        ] {
            assert_eq!(supervisor.decide(&broken), Directive::Continue, "{broken:?}");
        }
        assert_eq!(supervisor.decide(&turning(2.0)), Directive::Stop);
    }

    #[test]
    fn a_turn_about_another_axis_is_no_progress() {
        let mut supervisor = Supervisor::new(Goal::Turn(1.0), -Vector3::y(), &GAITS, SupervisorRules::default());
        let mut tumbled = supervisor.clone();
        for k in 0..150 {
            let belief = turning(f64::from(k) * FRAME_S);
            assert_eq!(supervisor.decide(&belief), Directive::Continue);
            let belief = Belief { turned_rad: -Vector3::y() * belief.turned_rad.norm(), ..belief };
            let stops = tumbled.decide(&belief) == Directive::Stop;
            assert_eq!(stops, belief.turned_rad.norm() >= 1.0);
        }
    }

    #[test]
    fn a_single_gait_is_kept() {
        let mut supervisor = Supervisor::new(Goal::Time, Vector3::z(), &["bal"], SupervisorRules::default());
        for k in 0..600 {
            let belief = Belief { turned_rad: Vector3::zeros(), ..turning(f64::from(k) * FRAME_S) };
            assert_eq!(supervisor.decide(&belief), Directive::Continue);
        }
    }
}
