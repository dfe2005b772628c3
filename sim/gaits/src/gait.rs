//! Gaits: periodic strokes of the fingertips that turn an object standing on the palm.
//!
//! A gait is a table of joint angles over its phase. The controller clips the targets around the measured angles, so
//! that a finger that meets the object pushes with a bounded force. One table therefore fits objects of a range of
//! sizes. Gaits are written for the right hand; the left hand plays the mirror image.

use std::collections::BTreeMap;
use std::sync::LazyLock;

use mvt_objects::object::Object;
use mvt_robot::hand::{Hand, JointAngles, Side};
use serde::{Deserialize, Serialize};

use crate::axis::TurnAxis;
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

    /// Returns gravity in the world of a hand of this side, m/s^2.
    pub fn gravity_on(&self, side: Side) -> [f64; 3] {
        let [gx, gy, gz] = self.gravity;
        [gx, side.sign() * gy, gz]
    }

    /// Returns the joint angles of the table at a time since its start, radians, for the right hand.
    pub(crate) fn row(&self, time_s: f64) -> JointAngles {
        if self.table.is_empty() {
            return self.open_pose.clone();
        }
        let phase = (time_s / self.period_s).rem_euclid(1.0) * self.table.len() as f64;
        let (row, fraction) = (phase as usize % self.table.len(), phase.fract());
        let (a, b) = (&self.table[row], &self.table[(row + 1) % self.table.len()]);
        a.iter().zip(b).map(|(a, b)| a * (1.0 - fraction) + b * fraction).collect()
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

/// The shipped controllers of other hands than the Allegro: hand, name and text. The first one of a hand is its choice for `auto`.
pub(crate) const RIG_CONTROLLERS: &[(&str, &str, &str)] = &[
    ("gripper_gelsight", "carry", include_str!("../assets/controllers/gripper_gelsight/carry.toml")),
    ("leap_digit", "turn", include_str!("../assets/controllers/leap_digit/turn.toml")),
    ("leap_gelsight", "turn", include_str!("../assets/controllers/leap_gelsight/turn.toml")),
    ("three_fingers", "turn", include_str!("../assets/controllers/three_fingers/turn.toml")),
];

/// Returns the shipped gaits by name, among them those of controllers that are files.
pub fn shipped() -> &'static BTreeMap<String, Gait> {
    #[derive(Deserialize)]
    struct File {
        gait: Gait,
    }
    // Why: notes/decisions/settings.md, "Gaits".
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
pub const SUITED: &str = "suited";
/// Stands for the same where a gait is needed. Where any controller may play, a policy may take its place.
pub const AUTO: &str = "auto";

/// Returns whether this name leaves the choice of the gait to the object.
pub fn is_left_open(name: &str) -> bool {
    [SUITED, AUTO].contains(&name)
}

/// Reason that there is no such gait.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum UnknownGait {
    /// Name that no shipped gait has.
    #[error("unknown gait {0:?}; choose one of {names}", names = shipped().keys().map(String::as_str).collect::<Vec<_>>().join(", "))]
    Name(String),
    /// Name that no shipped controller of another hand than the Allegro has.
    #[error("the hand {hand} has no controller {name:?}; choose {names} or auto, or give a controller file")]
    OfHand {
        /// Name of the hand.
        hand: String,
        /// Name that was given.
        name: String,
        /// Names of the controllers of this hand.
        names: String,
    },
    /// Name of a hand for which no gaits are shipped.
    #[error("the hand {0} has no shipped gaits: give a controller file that `hand tune` made for it")]
    Hand(String),
}

/// Returns whether the shipped gaits were made for this hand.
pub fn suits(hand: &Hand) -> bool {
    hand.is_allegro()
}

/// Returns the limits of a hand's joints in the coordinates of gaits, which are those of the right hand.
pub fn right_ranges(hand: &Hand) -> Vec<[f64; 2]> {
    let [low, high] = [0, 1].map(|end| hand.mirrored(&hand.joints().iter().map(|j| j.range[end]).collect::<Vec<_>>()));
    low.into_iter().zip(high).map(|(a, b)| [a.min(b), a.max(b)]).collect()
}

/// Returns a shipped gait with its name, whichever hand plays it.
///
/// # Errors
/// [`UnknownGait`], which lists the names.
pub fn find(name: &str) -> Result<(&'static str, &'static Gait), UnknownGait> {
    shipped()
        .get_key_value(name)
        .map(|(name, gait)| (name.as_str(), gait))
        .ok_or_else(|| UnknownGait::Name(name.to_owned()))
}

/// Returns the shipped gait of this name with its name, for this hand.
///
/// # Errors
/// [`UnknownGait`], which lists the names, or says that the hand has no shipped gaits.
pub fn find_for(hand: &Hand, name: &str) -> Result<(&'static str, &'static Gait), UnknownGait> {
    if suits(hand) { find(name) } else { Err(UnknownGait::Hand(hand.name().to_owned())) }
}

/// Returns the shipped gait of this name for this hand, or the gait that suits the object ([`is_left_open`]), with its name.
///
/// # Errors
/// [`UnknownGait`], which lists the names, or says that the hand has no shipped gaits.
pub fn choose(name: &str, object: &Object, hand: &Hand) -> Result<(&'static str, &'static Gait), UnknownGait> {
    find_for(hand, if is_left_open(name) { suited_to(object) } else { name })
}

/// Returns the name of the shipped gait that suits an object, by its size and by whether it rolls. Each choice is the one that
/// turned, or at least kept, most objects of its kind in a survey of the catalogue with all controllers.
pub fn suited_to(object: &Object) -> &'static str {
    // Why: notes/decisions/simulation.md, "Gaits are chosen by shape, not by name".
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shipped_gaits_are_whole_and_within_the_joint_limits() {
        let gaits: BTreeMap<String, Gait> = serde_json::from_str(include_str!("../assets/gaits.json")).unwrap();
        assert!(gaits.len() >= 5);
        let ranges = right_ranges(&Hand::allegro(Side::Left));
        assert_eq!(ranges, Hand::allegro(Side::Right).ranges());
        for (name, gait) in gaits {
            assert_eq!(gait.table.len(), 32, "{name}");
            for row in gait.table.iter().chain([&gait.open_pose]) {
                assert_eq!(row.len(), ranges.len(), "{name}");
                for (j, (angle, [low, high])) in row.iter().zip(&ranges).enumerate() {
                    assert!((low - 1e-3..=high + 1e-3).contains(angle), "{name}: joint {j} at {angle}");
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
}
