//! Gaits: periodic strokes of the four fingertips that turn an object standing on the palm.
//!
//! A gait is a table of joint angles over its phase. The controller clips the targets around the measured angles, so
//! that a finger that meets the object pushes with a bounded force. One table therefore fits objects of a range of
//! sizes. Gaits are written for the right hand; the left hand plays the mirror image.

use std::collections::BTreeMap;
use std::sync::LazyLock;

use mvt_objects::object::Object;
use mvt_robot::hand::{JointAngles, Side};
use serde::{Deserialize, Serialize};

use crate::axis::TurnAxis;
use crate::controller::{Controller, Proprioception};
use crate::place::PlaceFeedback;
use crate::shape::ObjectShape;

/// Gait for the right hand.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Gait {
    /// Purpose and origin.
    pub description: String,
    /// Parameters of the stroke from which inverse kinematics made the table. Tuning starts from them.
    pub params: BTreeMap<String, f64>,
    /// Duration of one cycle, seconds.
    pub period_s: f64,
    /// Joint torque limit, Nm.
    pub torque_limit_nm: f64,
    /// Gravity in the world, m/s^2: the palm is tilted towards the fingertips, so that the object returns to them.
    pub gravity: [f64; 3],
    /// Axis about which the gait turns an object on the right hand.
    // Left out where it is the default: the checksums of earlier logs contain the gait as text.
    #[serde(default, skip_serializing_if = "TurnAxis::is_default")]
    pub axis: TurnAxis,
    /// Start of the object on the palm, x and y in the world, metres.
    pub start_xy_m: [f64; 2],
    /// Joint angles with the fingers away from the object, radians.
    pub open_pose: JointAngles,
    /// Joint angles at equally spaced phases, radians.
    pub table: Vec<JointAngles>,
    /// Feedback on the object's place, of a controller that holds it in the air; `None` for a gait on the palm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub feedback: Option<Box<PlaceFeedback>>,
}

impl Gait {
    /// Returns whether this gait can take over from another one that makes no progress: both turn objects on the palm about one axis.
    pub fn follows(&self, other: &Gait) -> bool {
        self.axis == other.axis && self.feedback.is_none() && other.feedback.is_none()
    }

    /// Returns the joint angles of the table at a time since its start, radians, for the right hand.
    pub(crate) fn row(&self, time_s: f64) -> JointAngles {
        if self.table.is_empty() {
            return self.open_pose;
        }
        let phase = (time_s / self.period_s).rem_euclid(1.0) * self.table.len() as f64;
        let (row, fraction) = (phase as usize % self.table.len(), phase.fract());
        let (a, b) = (&self.table[row], &self.table[(row + 1) % self.table.len()]);
        std::array::from_fn(|j| a[j] * (1.0 - fraction) + b[j] * fraction)
    }
}

/// The shipped controllers that are files: name and text.
pub(crate) const CONTROLLER_FILES: &[(&str, &str)] = &[
    ("air_ball", include_str!("../assets/controllers/air_ball.toml")),
    ("air_block", include_str!("../assets/controllers/air_block.toml")),
    ("air_large_ball", include_str!("../assets/controllers/air_large_ball.toml")),
    ("roll_ball", include_str!("../assets/controllers/roll_ball.toml")),
    ("roll_ball_back", include_str!("../assets/controllers/roll_ball_back.toml")),
    ("roll_cube", include_str!("../assets/controllers/roll_cube.toml")),
    ("turn_brick", include_str!("../assets/controllers/turn_brick.toml")),
    ("turn_pepper", include_str!("../assets/controllers/turn_pepper.toml")),
    ("turn_small_cup", include_str!("../assets/controllers/turn_small_cup.toml")),
    ("turn_stick", include_str!("../assets/controllers/turn_stick.toml")),
    ("turn_wide_cup", include_str!("../assets/controllers/turn_wide_cup.toml")),
    ("turn_cup", include_str!("../assets/controllers/turn_cup.toml")),
    ("turn_post", include_str!("../assets/controllers/turn_post.toml")),
    ("turn_slender", include_str!("../assets/controllers/turn_slender.toml")),
    ("turn_duck", include_str!("../assets/controllers/turn_duck.toml")),
    ("tumble_small_block", include_str!("../assets/controllers/tumble_small_block.toml")),
    ("turn_bowl", include_str!("../assets/controllers/turn_bowl.toml")),
    ("tumble_pear", include_str!("../assets/controllers/tumble_pear.toml")),
    ("turn_bottle", include_str!("../assets/controllers/turn_bottle.toml")),
    ("turn_berry", include_str!("../assets/controllers/turn_berry.toml")),
    ("turn_elephant", include_str!("../assets/controllers/turn_elephant.toml")),
    ("turn_disc", include_str!("../assets/controllers/turn_disc.toml")),
    ("turn_large_ball", include_str!("../assets/controllers/turn_large_ball.toml")),
    ("turn_small", include_str!("../assets/controllers/turn_small.toml")),
    ("tumble_back", include_str!("../assets/controllers/tumble_back.toml")),
    ("tumble_ball", include_str!("../assets/controllers/tumble_ball.toml")),
    ("tumble_ball_forth", include_str!("../assets/controllers/tumble_ball_forth.toml")),
    ("tumble_block", include_str!("../assets/controllers/tumble_block.toml")),
    ("tumble_brick", include_str!("../assets/controllers/tumble_brick.toml")),
    ("tumble_can", include_str!("../assets/controllers/tumble_can.toml")),
];

/// Returns the shipped gaits by name, among them those of controllers that are files.
pub fn shipped() -> &'static BTreeMap<String, Gait> {
    #[derive(Deserialize)]
    struct File {
        gait: Gait,
    }
    static GAITS: LazyLock<BTreeMap<String, Gait>> = LazyLock::new(|| {
        // Tests parse these files. If one were invalid, its names would be reported as unknown gaits.
        let mut gaits: BTreeMap<String, Gait> =
            serde_json::from_str(include_str!("../assets/gaits.json")).unwrap_or_default();
        let parse = |(name, text): &(&str, &str)| Some(((*name).to_owned(), toml::from_str::<File>(text).ok()?.gait));
        gaits.extend(CONTROLLER_FILES.iter().filter_map(parse));
        gaits
    });
    &GAITS
}

/// Stands for the gait that suits the object.
pub const AUTO: &str = "auto";

/// Name that no shipped gait has.
#[derive(Debug, thiserror::Error)]
#[error("unknown gait {name:?}; choose one of {}", shipped().keys().map(String::as_str).collect::<Vec<_>>().join(", "))]
pub struct UnknownGait {
    /// The unknown name.
    pub name: String,
}

/// Returns a shipped gait with its name.
///
/// # Errors
/// [`UnknownGait`], which lists the names.
pub fn find(name: &str) -> Result<(&'static str, &'static Gait), UnknownGait> {
    shipped()
        .get_key_value(name)
        .map(|(name, gait)| (name.as_str(), gait))
        .ok_or_else(|| UnknownGait { name: name.to_owned() })
}

/// Returns the shipped gait of this name, or for `auto` the gait that suits the object, with its name.
///
/// # Errors
/// [`UnknownGait`], which lists the names.
pub fn choose(name: &str, object: &Object) -> Result<(&'static str, &'static Gait), UnknownGait> {
    find(if name == AUTO { suited_to(object) } else { name })
}

/// Returns the name of the shipped gait that suits an object, by its size and by whether it rolls. Each choice is the one that
/// turned, or at least kept, most objects of its kind in a survey of the catalogue with all controllers.
pub fn suited_to(object: &Object) -> &'static str {
    let shape = ObjectShape::of(object);
    let ObjectShape { length_mm: length, width_mm: width, height_mm: height, fill, .. } = shape;
    let is_round = length < 1.1 * width;
    if let Some(controller) = shape.special_controller() {
        return controller;
    }
    match shape.unsuited() {
        // Nothing turns them. These gaits keep them in the hand.
        Some(unsuited) if unsuited.is_small => "shared",
        Some(_) => "bal",
        // Balls and fruit.
        None if fill < 0.58 && width > 78.0 => "cube",
        None if fill < 0.58 && length > 1.3 * width => "bal",
        None if fill < 0.58 => "ball",
        // Cups, apples and bottles.
        None if fill < 0.7 && is_round && (63.0..68.0).contains(&width) => "cube",
        None if fill < 0.7 && is_round && width > 88.0 => "cube",
        None if fill < 0.7 => "shared",
        // Boxes and cans.
        None if length < 51.0 && height < 51.0 => "tumble_brick",
        None if height < 66.0 => "cubelet",
        None if length > 1.25 * width && height < length => "tumble_can",
        None if length > 1.25 * width => "shared",
        None if width > 85.0 => "can",
        None if height < 1.2 * length => "cube",
        None => "bal",
    }
}

/// Time over which the fingers close from the open pose into the gait, seconds.
const CLOSING_S: f64 = 0.8;
/// Joint stiffness that the compliance clip assumes, Nm/rad.
const STIFFNESS_NM_RAD: f64 = 3.0;
/// Distance by which a target may exceed the torque limit, radians, so that the position controllers reach their full
/// torque.
const CLIP_MARGIN_RAD: f64 = 0.05;

/// Controller that plays one gait.
#[derive(Debug, Clone)]
pub struct GaitController {
    gait: Gait,
    side: Side,
}

impl GaitController {
    /// Plays `gait`, mirrored for the left hand.
    pub fn new(gait: Gait, side: Side) -> Self {
        Self { gait, side }
    }

    /// Returns the unclipped targets of this hand at a time since the start, radians.
    pub fn targets(&self, time_s: f64) -> JointAngles {
        self.side.mirror_joints(self.target(time_s))
    }

    /// Clips targets around the measured angles to the reach of the torque limit.
    pub fn within_reach(&self, targets: &JointAngles, measured: &JointAngles) -> JointAngles {
        let reach = self.gait.torque_limit_nm / STIFFNESS_NM_RAD + CLIP_MARGIN_RAD;
        std::array::from_fn(|j| targets[j].clamp(measured[j] - reach, measured[j] + reach))
    }

    /// Returns the right-hand targets at a time since the start, radians.
    fn target(&self, time_s: f64) -> JointAngles {
        let gait = self.gait.row(time_s);
        let t = (time_s / CLOSING_S).clamp(0.0, 1.0);
        let closed = t * t * (3.0 - 2.0 * t);
        std::array::from_fn(|j| self.gait.open_pose[j] * (1.0 - closed) + gait[j] * closed)
    }
}

impl Controller for GaitController {
    fn command(&mut self, sensed: &Proprioception) -> JointAngles {
        self.within_reach(&self.targets(sensed.time_s), &sensed.joints)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use mvt_robot::hand::{JOINTS, joint_ranges};

    #[test]
    fn shipped_gaits_are_whole_and_within_the_joint_limits() {
        let gaits: BTreeMap<String, Gait> = serde_json::from_str(include_str!("../assets/gaits.json")).unwrap();
        assert!(gaits.len() >= 5);
        let ranges = joint_ranges(Side::Right);
        for (name, gait) in gaits {
            assert_eq!(gait.table.len(), 32, "{name}");
            for row in gait.table.iter().chain([&gait.open_pose]) {
                for j in 0..JOINTS {
                    let [low, high] = ranges[j];
                    assert!((low - 1e-3..=high + 1e-3).contains(&row[j]), "{name}: joint {j} at {}", row[j]);
                }
            }
        }
    }

    #[test]
    fn the_default_axis_is_not_in_the_text_of_a_gait() {
        // Checksums of logs contain this text.
        let text = |name: &str| serde_json::to_value(find(name).unwrap().1).unwrap();
        assert_eq!(text("bal").get("axis"), None);
        assert_eq!(text("tumble_back")["axis"], "-y");
    }

    #[test]
    fn every_object_has_a_shipped_gait() {
        for entry in mvt_objects::catalogue::entries().filter(mvt_objects::catalogue::Entry::is_procedural) {
            let object = entry.load(&mut Vec::new()).unwrap();
            assert!(find(suited_to(&object)).is_ok(), "{}", object.name);
        }
    }

    #[test]
    fn targets_stay_within_reach_of_the_measured_angles() {
        let mut controller = GaitController::new(find("bal").unwrap().1.clone(), Side::Left);
        let joints = [0.2; JOINTS];
        let command = controller.command(&Proprioception { time_s: 3.0, joints });
        let reach = find("bal").unwrap().1.torque_limit_nm / 3.0 + 0.05;
        assert!(command.iter().all(|c| (c - 0.2).abs() <= reach + 1e-12));
        assert!(find("gallop").unwrap_err().to_string().contains("bal, "));
    }
}
