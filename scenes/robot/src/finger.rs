//! Fingers, values per finger, and joint angles.

use std::ops::{Index, IndexMut};

use serde::{Deserialize, Serialize};

/// Number of actuated joints.
pub const JOINTS: usize = 16;
/// Joints of one finger.
pub const JOINTS_PER_FINGER: usize = 4;

/// Joint angles in radians, in the blocks index, middle, ring, thumb, base joint first: the order of FeelSight's
/// data.pkl.
pub type JointAngles = [f64; JOINTS];

/// Finger, in the order of the joint blocks.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Finger {
    /// Joints 0 to 3.
    Index,
    /// Joints 4 to 7.
    Middle,
    /// Joints 8 to 11.
    Ring,
    /// Joints 12 to 15.
    Thumb,
}

impl Finger {
    /// All fingers, in order.
    pub const ALL: [Finger; 4] = [Finger::Index, Finger::Middle, Finger::Ring, Finger::Thumb];

    /// Returns the name in file paths.
    pub fn name(self) -> &'static str {
        ["index", "middle", "ring", "thumb"][self as usize]
    }

    /// Returns the prefix of the finger's joints, bodies and geoms in the MJCF.
    pub fn prefix(self) -> &'static str {
        ["if", "mf", "rf", "th"][self as usize]
    }

    /// Returns the index of the finger's base joint in [`JointAngles`].
    pub fn first_joint(self) -> usize {
        self as usize * JOINTS_PER_FINGER
    }
}

/// One value per finger.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct PerFinger<T>(pub [T; 4]);

impl<T> PerFinger<T> {
    /// Calls a function for each finger, in order.
    pub fn from_fn(mut f: impl FnMut(Finger) -> T) -> Self {
        Self(Finger::ALL.map(&mut f))
    }

    /// Returns fingers and values, in order.
    pub fn iter(&self) -> impl Iterator<Item = (Finger, &T)> {
        Finger::ALL.into_iter().zip(&self.0)
    }
}

impl<T> Index<Finger> for PerFinger<T> {
    type Output = T;
    fn index(&self, finger: Finger) -> &T {
        &self.0[finger as usize]
    }
}

impl<T> IndexMut<Finger> for PerFinger<T> {
    fn index_mut(&mut self, finger: Finger) -> &mut T {
        &mut self.0[finger as usize]
    }
}
