//! The supervisor: it chooses the next directive to the hand from the tracker's estimate alone.
//!
//! A [`Supervisor`] receives nothing but a [`Belief`] and, to explore, an [`Outlook`]. Neither holds the simulator's state or ground truth.

use std::collections::VecDeque;
use std::f64::consts::TAU;
use std::fmt;
use std::str::FromStr;

use mvt_gaits::axis::TurnAxis;
use mvt_gaits::directive::Directive;
use mvt_robot::hand::Side;
use mvt_robot::rig::Placement;
use mvt_settings::{SettingError, settings};
use nalgebra::{Unit, UnitQuaternion, Vector2, Vector3};

pub use crate::belief::Belief;
use crate::explorer::{Explorer, ExplorerChoice, Outlook};

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
    /// No controller is expected to show clearly more unseen surface. Only a supervisor that explores reaches it.
    Explored,
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
            Goal::Explored => f.write_str("explored"),
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
        "unknown goal {0:?}; the goals are turn=360deg, turn=2rev, turn=6.3rad, coverage=0.9, pose=90deg, show=180/0, explored and time"
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
            None if text == "explored" => Ok(Goal::Explored),
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

impl SupervisorRules {
    /// Returns these rules without pushes and re-grasps, which would drop an object that is held in the air.
    pub fn in_air(self) -> Self {
        let never = f64::INFINITY;
        Self { drift_begin_m: never, lost_s: never, still_s: never, ..self }
    }
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
    explorer: Option<Explorer>,
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
            explorer: None,
        }
    }

    /// Lets an explorer choose the controllers.
    pub fn exploring(self, explorer: Explorer) -> Self {
        Self { explorer: Some(explorer), ..self }
    }

    /// Returns the choice of the explorer that led to the last directive, once.
    pub fn take_choice(&mut self) -> Option<ExplorerChoice> {
        self.explorer.as_mut().and_then(Explorer::take_choice)
    }

    /// Returns the directive of this frame as [`Supervisor::decide`], with an outlook for the explorer where there is a map.
    pub fn decide_seeing(&mut self, belief: &Belief, outlook: Option<&Outlook<'_>>) -> Directive {
        let directive = self.decide(belief);
        let may_explore =
            directive == Directive::Continue && self.is_trusted(belief) && belief.time_s >= self.settled_at_s;
        let (Some(explorer), Some(outlook)) = (self.explorer.as_mut().filter(|_| may_explore), outlook) else {
            return directive;
        };
        match explorer.decide(belief, outlook) {
            Some(Directive::Stop) => Directive::Stop,
            Some(directive) => self.intervene(belief.time_s, directive),
            None => directive,
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
            Goal::Show(_) | Goal::Explored | Goal::Time => false,
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
mod tests;
