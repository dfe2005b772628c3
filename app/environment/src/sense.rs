//! Observations of a policy, as flat arrays.

use std::str::FromStr;

use mvt_frames::camera::PosedCamera;
use mvt_gaits::clock::CONTROL_HZ;
use mvt_policy::PolicyContract;
use mvt_robot::hand::Hand;

use crate::error::TaskError;

/// Numbers of [`Sense::Estimate`].
pub(crate) const ESTIMATE: usize = 11;
/// Numbers of [`Sense::Privileged`] beside the forces on the pads.
pub(crate) const PRIVILEGED: usize = 21;
/// Bound of the numbers of [`Sense::Privileged`], far above those of a hand.
const LARGEST: f32 = 100.0;
/// Bound of a force on a pad, newtons, and of a position in tenths of a metre, as in the contract of sighted policies.
const STRONGEST_N: f32 = 10.0;
/// Bound of a position, metres: the hand is smaller.
const FARTHEST_M: f32 = 1.0;
/// Greatest indentation, millimetres: the distance from a DIGIT's gel to its camera.
const DEEPEST_MM: f32 = 22.0;

/// A quantity that a policy may observe.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Sense {
    /// Joint angles and targets of the last three instants, the latest first, from -1 to 1 over each joint's range.
    Proprioception,
    /// The same, then of the same instants the object's position from the palm's centre (in tenths of a metre) as an estimate would tell it,
    /// with its errors and delay, and the normal force on each pad (N): [`PolicyContract::sighted`]. Zeros before a position was seen.
    Sighted,
    /// The same, then of the same instants the joint angles at which the gait that suits the object aims, from -1 to 1. Actions correct this gait, by
    /// up to 0.2 rad, instead of moving the hand alone: [`PolicyContract::correcting`].
    Guided,
    /// True indentation of each touch sensor, millimetres: pads x height x width.
    TouchDepth,
    /// Image of each touch sensor: pads x height x width x 3.
    TouchImages,
    /// Colours of each camera: cameras x height x width x 3.
    Cameras,
    /// Pose by the estimator that runs inside, from cameras and true indentation: position of the model's frame from the
    /// palm's centre (m), the first two columns of its rotation, confidence, and 1 while the pose is trusted. Zeros before
    /// the object was seen.
    Estimate,
    /// Truth: position of the object from the palm's centre (m), the first two columns of its rotation, its velocity
    /// (m/s) and angular velocity (rad/s), the normal force on each pad (N), friction of gel and links, mass (kg) and
    /// offset of the centre of mass (m).
    Privileged,
}

impl Sense {
    /// All of them.
    pub const ALL: [Self; 8] = [
        Self::Proprioception,
        Self::Sighted,
        Self::Guided,
        Self::TouchDepth,
        Self::TouchImages,
        Self::Cameras,
        Self::Estimate,
        Self::Privileged,
    ];

    /// Returns the name, which [`str::parse`] reads.
    pub fn name(self) -> &'static str {
        match self {
            Self::Proprioception => "proprioception",
            Self::Sighted => "sighted",
            Self::Guided => "guided",
            Self::TouchDepth => "touch_depth",
            Self::TouchImages => "touch_images",
            Self::Cameras => "cameras",
            Self::Estimate => "estimate",
            Self::Privileged => "privileged",
        }
    }

    /// Returns the least and the greatest value.
    pub fn bounds(self) -> [f32; 2] {
        match self {
            Self::Proprioception => [-1.0, 1.0],
            Self::Sighted | Self::Guided => [-STRONGEST_N, STRONGEST_N],
            Self::TouchDepth => [0.0, DEEPEST_MM],
            Self::TouchImages | Self::Cameras => [0.0, 255.0],
            Self::Estimate => [-FARTHEST_M, FARTHEST_M],
            Self::Privileged => [-LARGEST, LARGEST],
        }
    }

    /// Returns whether the values are bytes; else they are 32-bit floating-point numbers.
    pub fn is_bytes(self) -> bool {
        matches!(self, Self::TouchImages | Self::Cameras)
    }

    pub(crate) fn needs_images(self) -> bool {
        !matches!(self, Self::Proprioception | Self::Sighted | Self::Guided | Self::Privileged)
    }

    /// Returns the contract of the policies that observe it; `None` for what is not made of terms of contracts.
    pub(crate) fn contract(self, hand: &Hand, control_hz: u32) -> Option<PolicyContract> {
        match self {
            Self::Proprioception => Some(PolicyContract::turning(hand, control_hz)),
            Self::Sighted => Some(PolicyContract::sighted(hand, control_hz)),
            Self::Guided => Some(PolicyContract::correcting(hand, control_hz)),
            _ => None,
        }
    }

    /// Returns whether the object's place is observed as an estimate would tell it.
    pub(crate) fn needs_place(self) -> bool {
        matches!(self, Self::Sighted | Self::Guided)
    }

    pub(crate) fn needs_cameras(self) -> bool {
        matches!(self, Self::Cameras | Self::Estimate)
    }

    pub(crate) fn shape(self, hand: &Hand, cameras: &[PosedCamera]) -> Vec<usize> {
        // All touch sensors have the same size.
        let [rows, columns] = hand.pads().first().map_or([0, 0], |pad| pad.profile.shape());
        match self {
            Self::Proprioception | Self::Sighted | Self::Guided => {
                let contract = self.contract(hand, CONTROL_HZ);
                vec![contract.map_or(0, |contract| contract.observation_size(hand))]
            }
            Self::TouchDepth => vec![hand.pads().len(), rows, columns],
            Self::TouchImages => vec![hand.pads().len(), rows, columns, 3],
            // All cameras have the same size.
            Self::Cameras => {
                let (height, width) = cameras.first().map_or((0, 0), |c| (c.intrinsics.height, c.intrinsics.width));
                vec![cameras.len(), height, width, 3]
            }
            Self::Estimate => vec![ESTIMATE],
            Self::Privileged => vec![PRIVILEGED + hand.pads().len()],
        }
    }
}

impl FromStr for Sense {
    type Err = TaskError;

    fn from_str(name: &str) -> Result<Self, TaskError> {
        Self::ALL.into_iter().find(|sense| sense.name() == name).ok_or_else(|| {
            let names = Self::ALL.map(Self::name).join(", ");
            TaskError::Setting(format!("unknown observation {name:?}: choose of {names}"))
        })
    }
}

/// Values of one sense, of all environments one after the other.
#[derive(Debug, Clone, PartialEq)]
pub enum Readings {
    /// Numbers.
    Numbers(Vec<f32>),
    /// Colours.
    Bytes(Vec<u8>),
}

impl Readings {
    /// Returns zeros.
    pub(crate) fn zeros(sense: Sense, count: usize) -> Self {
        if sense.is_bytes() { Self::Bytes(vec![0; count]) } else { Self::Numbers(vec![0.0; count]) }
    }

    /// Returns the parts of `parts` environments.
    pub(crate) fn split(&mut self, parts: usize) -> Vec<Part<'_>> {
        let length = |count: usize| (count / parts.max(1)).max(1);
        match self {
            Self::Numbers(values) => {
                let length = length(values.len());
                values.chunks_mut(length).map(Part::Numbers).collect()
            }
            Self::Bytes(values) => {
                let length = length(values.len());
                values.chunks_mut(length).map(Part::Bytes).collect()
            }
        }
    }
}

/// Values of one sense of one environment, to be written.
pub(crate) enum Part<'a> {
    Numbers(&'a mut [f32]),
    Bytes(&'a mut [u8]),
}

impl Part<'_> {
    /// Writes numbers, within the bounds of a sense; values that are not finite become 0.
    pub(crate) fn write(&mut self, sense: Sense, values: impl IntoIterator<Item = f32>) {
        let [low, high] = sense.bounds();
        if let Self::Numbers(to) = self {
            for (to, value) in to.iter_mut().zip(values) {
                *to = if value.is_finite() { value.clamp(low, high) } else { 0.0 };
            }
        }
    }

    /// Writes images one after the other.
    pub(crate) fn write_images<'b>(&mut self, images: impl Iterator<Item = &'b [u8]>) {
        if let Self::Bytes(to) = self {
            let mut rest = &mut **to;
            for image in images {
                let count = image.len().min(rest.len());
                let (here, behind) = rest.split_at_mut(count);
                here.copy_from_slice(image.get(..count).unwrap_or_default());
                rest = behind;
            }
        }
    }
}
