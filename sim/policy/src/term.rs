//! Quantities that a policy can observe.

use std::str::FromStr;

use mvt_robot::hand::Hand;

/// Rows and columns of the grid over which the indentation of a gel is averaged.
pub const TOUCH_GRID: [usize; 2] = [4, 3];

/// Quantity that a policy can observe. Angles of joints are in the order of the contract, values of pads in that of the hand.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum ObservationTerm {
    /// Joint angles less those of `default_joint_pos`, radians.
    JointPos,
    /// Joint velocities, rad/s.
    JointVel,
    /// Joint angles, from -1 to 1 over the range of each joint.
    JointPosUnit,
    /// Joint angles at which the joints aim, less those of `default_joint_pos`, radians.
    JointTarget,
    /// The same, from -1 to 1 over the range of each joint.
    JointTargetUnit,
    /// Joint angles, then the angles at which the joints aim, both from -1 to 1: the proprioception of HORA and of our environments.
    JointPosTargetUnit,
    /// Joint angles at which the gait that a policy corrects aims, from -1 to 1 over the range of each joint.
    GaitTargetUnit,
    /// The action before, as the network gave it.
    Actions,
    /// 1 for each pad that touches the object, else 0.
    PadContact,
    /// Normal force on each pad, newtons.
    PadForce,
    /// Mean indentation in the fields of a grid of 4 x 3 over each gel, millimetres, row by row.
    TouchDepth,
    /// Estimated place of the object's middle from the palm's centre, metres, and the first two columns of its rotation; zeros before an
    /// estimate.
    ObjectPose,
    /// The first three numbers of it: the place alone.
    ObjectPosition,
    /// How far the estimate is to be trusted, 0 to 1; 0 without one or with an old one.
    ObjectConfidence,
    /// Direction of gravity in the palm's axes, of length 1.
    ProjectedGravity,
    /// Axis about which the object is to turn, of length 1.
    Command,
}

/// Terms with their names; those of mjlab and Isaac Lab stand behind the first one.
const NAMES: [(ObservationTerm, &[&str]); 16] = [
    (ObservationTerm::JointPos, &["joint_pos", "joint_pos_rel"]),
    (ObservationTerm::JointVel, &["joint_vel", "joint_vel_rel"]),
    (ObservationTerm::JointPosUnit, &["joint_pos_unit"]),
    (ObservationTerm::JointTarget, &["joint_target"]),
    (ObservationTerm::JointTargetUnit, &["joint_target_unit"]),
    (ObservationTerm::JointPosTargetUnit, &["joint_pos_target_unit"]),
    (ObservationTerm::GaitTargetUnit, &["gait_target_unit"]),
    (ObservationTerm::Actions, &["actions", "last_action"]),
    (ObservationTerm::PadContact, &["pad_contact"]),
    (ObservationTerm::PadForce, &["pad_force"]),
    (ObservationTerm::TouchDepth, &["touch_depth"]),
    (ObservationTerm::ObjectPose, &["object_pose"]),
    (ObservationTerm::ObjectPosition, &["object_pos"]),
    (ObservationTerm::ObjectConfidence, &["object_confidence"]),
    (ObservationTerm::ProjectedGravity, &["projected_gravity"]),
    (ObservationTerm::Command, &["command", "turn_axis"]),
];

impl ObservationTerm {
    /// Returns the name in contracts.
    pub fn name(self) -> &'static str {
        NAMES.iter().find(|(term, _)| *term == self).and_then(|(_, names)| names.first()).copied().unwrap_or_default()
    }

    /// Returns how many numbers it has for a hand, without history.
    pub fn size(self, hand: &Hand) -> usize {
        let (joints, pads) = (hand.joints().len(), hand.pads().len());
        match self {
            Self::JointPos | Self::JointVel | Self::JointPosUnit | Self::JointTarget | Self::JointTargetUnit => joints,
            Self::Actions | Self::GaitTargetUnit => joints,
            Self::JointPosTargetUnit => 2 * joints,
            Self::PadContact | Self::PadForce => pads,
            Self::TouchDepth => pads * TOUCH_GRID[0] * TOUCH_GRID[1],
            Self::ObjectPose => 9,
            Self::ObjectConfidence => 1,
            Self::ObjectPosition | Self::ProjectedGravity | Self::Command => 3,
        }
    }
}

impl FromStr for ObservationTerm {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        NAMES.iter().find(|(_, names)| names.contains(&name)).map(|(term, _)| *term).ok_or_else(|| {
            let known: Vec<&str> = NAMES.iter().filter_map(|(_, names)| names.first()).copied().collect();
            format!("observation_names: there is no observation {name:?}; choose of {}", known.join(", "))
        })
    }
}
