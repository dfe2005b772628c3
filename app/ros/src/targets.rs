//! The command topic of a hand: its table in the user's file, and targets of joints as messages there and back.

use std::collections::{BTreeMap, BTreeSet};

use mvt_bag::{CdrError, CdrReader};
use mvt_robot::hand::{Hand, JointAngles};
use serde::Deserialize;

use crate::cdr_writer::CdrWriter;
use crate::gate::{CommandLimits, SafeTargets};

/// Type of the messages of a command topic.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
pub enum CommandType {
    /// Angles in a stated order.
    #[serde(rename = "std_msgs/msg/Float64MultiArray")]
    Float64MultiArray,
    /// Angles with the names of their joints.
    #[serde(rename = "trajectory_msgs/msg/JointTrajectory")]
    JointTrajectory,
}

impl CommandType {
    /// Returns its name in ROS.
    pub fn name(self) -> &'static str {
        match self {
            Self::Float64MultiArray => "std_msgs/msg/Float64MultiArray",
            Self::JointTrajectory => "trajectory_msgs/msg/JointTrajectory",
        }
    }
}

/// What a hand does when it must not follow its controller.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum OnStop {
    /// It keeps the last targets, and goes on when the fault is over.
    #[default]
    Hold,
    /// It opens, and stays open.
    Open,
}

/// The command topic, as the table `[ros.command]` states it; docs/live.md describes the keys.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CommandSetup {
    /// Topic of the targets.
    pub topic: String,
    /// Type of its messages.
    #[serde(rename = "type")]
    pub kind: CommandType,
    /// Names of the joints in ROS in the order of the messages; without them the joints of the rig in their order.
    #[serde(default)]
    pub order: Vec<String>,
    /// Commands per second at most.
    #[serde(default = "rate_hz")]
    pub rate_hz: f64,
    /// Greatest change of a target from one command to the next, radians; metres of a sliding joint.
    #[serde(default = "step_rad")]
    pub step_rad: f64,
    /// Least and greatest target by the joint's name in the rig, radians, where they are narrower than those of the rig.
    #[serde(default)]
    pub ranges: BTreeMap<String, [f64; 2]>,
    /// Age from which on joint angles and estimates are too old, seconds.
    #[serde(default = "stale_s")]
    pub stale_s: f64,
    /// What the hand does when joint angles or estimates are too old, the object is lost, or the run ends.
    #[serde(default)]
    pub on_stop: OnStop,
}

fn rate_hz() -> f64 {
    100.0
}

fn step_rad() -> f64 {
    // 5 rad/s at 100 Hz, somewhat below the speed of an Allegro's joints.
    0.05
}

fn stale_s() -> f64 {
    0.1
}

impl CommandSetup {
    /// Checks the numbers that need no hand.
    ///
    /// # Errors
    /// A sentence if a number is out of range.
    pub(crate) fn check(&self) -> Result<(), String> {
        let numbers = [
            ("rate_hz", self.rate_hz, 1.0..=1000.0),
            ("step_rad", self.step_rad, 1e-4..=0.5),
            ("stale_s", self.stale_s, 0.01..=10.0),
        ];
        for (key, number, range) in numbers {
            if !range.contains(&number) {
                let (least, most) = (range.start(), range.end());
                return Err(format!("command.{key} must lie between {least} and {most} (it is {number})"));
            }
        }
        Ok(())
    }

    /// Returns the limits of a hand's targets.
    ///
    /// # Errors
    /// A sentence if a range names no joint, or is not within that of the hand.
    pub fn limits(&self, hand: &Hand) -> Result<CommandLimits, String> {
        let mut ranges = hand.ranges();
        for (name, [low, high]) in &self.ranges {
            let joint = hand.joints().iter().position(|joint| joint.name == *name);
            let Some(range) = joint.and_then(|joint| ranges.get_mut(joint)) else {
                return Err(format!(
                    "command.ranges.{name} is no joint of {}; `mambavitact hand check` lists them",
                    hand.name()
                ));
            };
            let [least, most] = *range;
            if !(least <= *low && low <= high && *high <= most) {
                return Err(format!(
                    "command.ranges.{name} must be two rising angles within those of the hand, {least:.3} to {most:.3}"
                ));
            }
            *range = [*low, *high];
        }
        Ok(CommandLimits {
            ranges,
            step_rad: self.step_rad,
            period_ns: (1e9 / self.rate_hz) as i64,
            stale_ns: (self.stale_s * 1e9) as i64,
        })
    }
}

/// Targets of a hand as messages of a command topic.
#[derive(Debug, Clone, PartialEq)]
pub struct CommandCodec {
    kind: CommandType,
    /// Names in ROS in the order of the messages, and the number of each joint in the hand.
    order: Vec<(String, usize)>,
    /// Time that a hand has to reach the targets, nanoseconds.
    period_ns: i64,
}

impl CommandCodec {
    /// Returns the messages of a topic for a hand; `joint_names` holds the names of joints in ROS where they differ from those of the hand.
    ///
    /// # Errors
    /// A sentence if the stated order is not one of all joints.
    pub fn new(setup: &CommandSetup, hand: &Hand, joint_names: &BTreeMap<String, String>) -> Result<Self, String> {
        let names: Vec<String> = hand
            .joints()
            .iter()
            .map(|joint| joint_names.get(&joint.name).cloned().unwrap_or_else(|| joint.name.clone()))
            .collect();
        let stated = if setup.order.is_empty() { &names } else { &setup.order };
        let mut order = Vec::with_capacity(names.len());
        for name in stated {
            let Some(joint) = names.iter().position(|known| known == name) else {
                return Err(format!(
                    "command.order names {name}, which is none of the joints: {}; state joint_names",
                    names.join(", ")
                ));
            };
            order.push((name.clone(), joint));
        }
        let distinct: BTreeSet<usize> = order.iter().map(|(_, joint)| *joint).collect();
        if distinct.len() != names.len() || order.len() != names.len() {
            return Err(format!("command.order must name each of the {} joints once", names.len()));
        }
        Ok(Self { kind: setup.kind, order, period_ns: (1e9 / setup.rate_hz) as i64 })
    }

    /// Returns the message of targets.
    pub fn encode(&self, targets: &SafeTargets) -> Vec<u8> {
        // Targets of a gate have an angle for each joint.
        let angles: Vec<f64> =
            self.order.iter().map(|(_, joint)| targets.angles().get(*joint).copied().unwrap_or(f64::NAN)).collect();
        let mut writer = CdrWriter::new();
        match self.kind {
            // No dimensions, nothing before the data.
            CommandType::Float64MultiArray => writer.count(0).u32(0).f64s(&angles),
            CommandType::JointTrajectory => {
                // A stamp of 0 asks for the motion at once.
                writer.i32(0).u32(0).text("").count(self.order.len());
                for (name, _) in &self.order {
                    writer.text(name);
                }
                writer.count(1).f64s(&angles).f64s(&[]).f64s(&[]).f64s(&[]);
                let seconds = self.period_ns.div_euclid(1_000_000_000);
                writer.i32(seconds as i32).u32(self.period_ns.rem_euclid(1_000_000_000) as u32)
            }
        };
        writer.into_message()
    }

    /// Reads a message: the targets in the order of the hand's joints, of a trajectory those of its last point.
    ///
    /// # Errors
    /// A sentence if it is damaged, or does not have a number for each joint.
    pub fn decode(&self, message: &[u8]) -> Result<JointAngles, String> {
        let named = match self.kind {
            CommandType::Float64MultiArray => {
                let angles = array(message).map_err(|reason| reason.to_string())?;
                if angles.len() != self.order.len() {
                    return Err(format!("it has {} targets; the hand has {} joints", angles.len(), self.order.len()));
                }
                self.order.iter().zip(angles).map(|((_, joint), angle)| (*joint, angle)).collect()
            }
            CommandType::JointTrajectory => {
                let (names, angles) = last_point(message).map_err(|reason| reason.to_string())?;
                let mut named = Vec::with_capacity(self.order.len());
                for (name, joint) in &self.order {
                    let found = names.iter().position(|known| known == name).and_then(|k| angles.get(k));
                    named.push((*joint, *found.ok_or_else(|| format!("it has no target of {name}"))?));
                }
                named
            }
        };
        let mut targets = vec![f64::NAN; self.order.len()];
        for (joint, angle) in named {
            if let Some(target) = targets.get_mut(joint) {
                *target = angle;
            }
        }
        match targets.iter().all(|angle| angle.is_finite()) {
            true => Ok(targets),
            false => Err("a target is not a number".to_owned()),
        }
    }
}

/// Reads the numbers of a `Float64MultiArray`, whatever its dimensions.
fn array(message: &[u8]) -> Result<Vec<f64>, CdrError> {
    let mut reader = CdrReader::new(message)?;
    // A dimension has a label, a size and a stride.
    for _ in 0..reader.count(12)? {
        reader.text()?;
        reader.u32()?;
        reader.u32()?;
    }
    let skipped = reader.u32()? as usize;
    Ok(reader.f64s()?.into_iter().skip(skipped).collect())
}

/// Reads the names and the last positions of a `JointTrajectory`.
fn last_point(message: &[u8]) -> Result<(Vec<&str>, Vec<f64>), CdrError> {
    let mut reader = CdrReader::new(message)?;
    reader.i32()?;
    reader.u32()?;
    reader.text()?;
    let names = (0..reader.count(4)?).map(|_| reader.text()).collect::<Result<Vec<_>, _>>()?;
    let mut last = Vec::new();
    // A point has at least four counts and a duration.
    for _ in 0..reader.count(24)? {
        last = reader.f64s()?;
        for _ in 0..3 {
            reader.f64s()?;
        }
        reader.i32()?;
        reader.u32()?;
    }
    Ok((names, last))
}

#[cfg(test)]
mod tests {
    use mvt_robot::hand::Side;
    use proptest::prelude::*;

    use super::*;
    use crate::gate::CommandGate;

    const KINDS: [CommandType; 2] = [CommandType::Float64MultiArray, CommandType::JointTrajectory];

    fn setup(more: &str) -> CommandSetup {
        toml::from_str(&format!("topic = \"/c\"\ntype = \"std_msgs/msg/Float64MultiArray\"\n{more}")).unwrap()
    }

    /// Targets that a gate let pass.
    fn safe(hand: &Hand, angles: &[f64]) -> SafeTargets {
        let limits = CommandLimits { step_rad: 9.0, ..setup("").limits(hand).unwrap() };
        let mut gate = CommandGate::new(limits, None);
        gate.measured(5, angles);
        gate.estimated(5, false);
        gate.pass(5, 5, angles).targets.unwrap()
    }

    #[test]
    fn targets_come_back_in_any_order() {
        let hand = Hand::allegro(Side::Right);
        let angles: Vec<f64> = hand.ranges().iter().enumerate().map(|(j, [low, _])| low + 0.01 * j as f64).collect();
        let names: BTreeMap<String, String> =
            hand.joints().iter().map(|joint| (joint.name.clone(), format!("ah_{}", joint.name))).collect();
        let order: Vec<String> = hand.joints().iter().rev().map(|joint| format!("ah_{}", joint.name)).collect();
        for kind in KINDS {
            let setup = CommandSetup { order: order.clone(), kind, ..setup("") };
            let codec = CommandCodec::new(&setup, &hand, &names).unwrap();
            let message = codec.encode(&safe(&hand, &angles));
            assert_eq!(codec.decode(&message).unwrap(), angles);
            if kind == CommandType::Float64MultiArray {
                let reversed: Vec<f64> = angles.iter().rev().copied().collect();
                assert_eq!(array(&message).unwrap(), reversed);
            }
        }
    }

    #[test]
    fn orders_and_ranges_that_do_not_fit_the_hand_are_refused_in_one_line() {
        let hand = Hand::allegro(Side::Left);
        let codec = |more: &str| CommandCodec::new(&setup(more), &hand, &BTreeMap::new()).unwrap_err();
        let limits = |more: &str| setup(more).limits(&hand).unwrap_err();
        let number = |more: &str| setup(more).check().unwrap_err();
        for (error, words) in [
            (codec("order = [\"ah_joint00\"]"), "none of the joints"),
            (codec("order = [\"thumb_0\"]"), "each of the 16 joints once"),
            (limits("ranges = { wrist = [0.0, 1.0] }"), "no joint of"),
            (limits("ranges = { thumb_0 = [1.0, 0.5] }"), "two rising angles"),
            (limits("ranges = { thumb_0 = [-9.0, 0.5] }"), "within those of the hand"),
            (limits("ranges = { thumb_0 = [nan, 0.5] }"), "two rising angles"),
            (number("rate_hz = 0.0"), "rate_hz must lie"),
            (number("step_rad = nan"), "step_rad must lie"),
            (number("stale_s = 60.0"), "stale_s must lie"),
        ] {
            assert!(error.contains(words) && !error.contains('\n'), "{error}");
        }
        assert_eq!(setup("ranges = { thumb_0 = [0.5, 0.9] }").limits(&hand).unwrap().ranges[12], [0.5, 0.9]);
    }

    proptest! {
        #[test]
        fn any_bytes_are_targets_or_a_reason(
            changes in prop::collection::vec((0usize..900, any::<u8>()), 0..8), cut in 0usize..900, kind in 0usize..2
        ) {
            let hand = Hand::allegro(Side::Left);
            let setup = CommandSetup { kind: KINDS[kind], ..setup("") };
            let codec = CommandCodec::new(&setup, &hand, &BTreeMap::new()).unwrap();
            let middle: Vec<f64> = hand.ranges().iter().map(|[low, high]| (low + high) / 2.0).collect();
            let mut message = codec.encode(&safe(&hand, &middle));
            for (at, byte) in changes {
                if let Some(changed) = message.get_mut(at) {
                    *changed = byte;
                }
            }
            message.truncate(cut.max(4));
            if let Ok(targets) = codec.decode(&message) {
                prop_assert!(targets.len() == 16 && targets.iter().all(|angle| angle.is_finite()));
            }
        }
    }
}
