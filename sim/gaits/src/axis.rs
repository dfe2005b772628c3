//! The axis about which a controller turns an object.

use mvt_robot::hand::Side;
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

/// Axis of the world with its direction, on the right hand. The left hand turns about the mirror image.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub enum TurnAxis {
    /// About x, along the fingers, counter-clockwise seen from the fingertips.
    #[serde(rename = "+x")]
    PlusX,
    /// About x, clockwise.
    #[serde(rename = "-x")]
    MinusX,
    /// About y, across the palm: the top of the object moves towards the fingertips.
    #[serde(rename = "+y")]
    PlusY,
    /// About y: the top of the object moves towards the wrist.
    #[serde(rename = "-y")]
    MinusY,
    /// About the palm's normal, counter-clockwise from above.
    #[serde(rename = "+z")]
    PlusZ,
    /// About the palm's normal, clockwise from above.
    #[default]
    #[serde(rename = "-z")]
    MinusZ,
}

impl TurnAxis {
    /// All axes.
    pub const ALL: [TurnAxis; 6] =
        [TurnAxis::PlusX, TurnAxis::MinusX, TurnAxis::PlusY, TurnAxis::MinusY, TurnAxis::PlusZ, TurnAxis::MinusZ];

    /// Returns the unit vector along the axis in the world, about which this hand turns the object.
    pub fn direction(self, side: Side) -> Vector3<f64> {
        // A mirror keeps the rotation about its own normal, y, and reverses those about x and z.
        let mirror = side.sign();
        match self {
            TurnAxis::PlusX => Vector3::new(mirror, 0.0, 0.0),
            TurnAxis::MinusX => Vector3::new(-mirror, 0.0, 0.0),
            TurnAxis::PlusY => Vector3::new(0.0, 1.0, 0.0),
            TurnAxis::MinusY => Vector3::new(0.0, -1.0, 0.0),
            TurnAxis::PlusZ => Vector3::new(0.0, 0.0, mirror),
            TurnAxis::MinusZ => Vector3::new(0.0, 0.0, -mirror),
        }
    }

    /// Returns the name, such as -z.
    pub fn name(self) -> &'static str {
        ["+x", "-x", "+y", "-y", "+z", "-z"][self as usize]
    }

    /// Whether this is the default, about which the first gaits turn.
    pub(crate) fn is_default(&self) -> bool {
        *self == TurnAxis::default()
    }
}

impl std::fmt::Display for TurnAxis {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name())
    }
}

/// Text that names no axis.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("unknown axis {0:?}; give +x, -x, +y, -y, +z or -z")]
pub struct UnknownAxis(String);

impl std::str::FromStr for TurnAxis {
    type Err = UnknownAxis;

    fn from_str(text: &str) -> Result<Self, UnknownAxis> {
        Self::ALL.into_iter().find(|axis| axis.name() == text).ok_or_else(|| UnknownAxis(text.to_owned()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_those_of_the_files() {
        for axis in TurnAxis::ALL {
            assert_eq!(axis.name().parse(), Ok(axis));
            assert_eq!(serde_json::to_value(axis).unwrap(), axis.name());
        }
        assert!("y".parse::<TurnAxis>().unwrap_err().to_string().contains("-y"));
    }

    #[test]
    fn the_left_hand_turns_about_the_mirror_image() {
        for axis in TurnAxis::ALL {
            let [right, left] = [Side::Right, Side::Left].map(|side| axis.direction(side));
            assert_eq!(left, Vector3::new(-right.x, right.y, -right.z));
        }
    }
}
