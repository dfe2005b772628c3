//! Left and right.

use serde::{Deserialize, Serialize};

/// Left or right hand. The left Allegro is the mirror image of the right one in the plane y = 0. A gripper is a right hand.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Side {
    /// The hand that FeelSight and its loaders assume.
    Left,
    /// The hand that the shipped gaits were tuned on.
    Right,
}

impl Side {
    /// Returns the factor of every y coordinate: +1 for the right hand, -1 for the left hand.
    pub fn sign(self) -> f64 {
        match self {
            Side::Right => 1.0,
            Side::Left => -1.0,
        }
    }

    /// Returns the name in files and on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Side::Left => "left",
            Side::Right => "right",
        }
    }
}
