//! Left and right.

use serde::{Deserialize, Serialize};

use crate::finger::{Finger, JointAngles};

/// Left or right hand. The left hand is the mirror image of the right hand in the plane y = 0.
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

    /// Returns the angles of this hand in the mirror image of the pose that a right hand has at `right`. Its own
    /// inverse.
    pub fn mirror_joints(self, mut right: JointAngles) -> JointAngles {
        if self == Side::Left {
            for finger in [Finger::Index, Finger::Middle, Finger::Ring] {
                let abduction = &mut right[finger.first_joint()];
                *abduction = -*abduction;
            }
        }
        right
    }
}
