//! What a robot would record at one instant, and, apart from it, what only a simulator knows.

use image::{GrayImage, RgbImage};
use ndarray::Array2;

use crate::frame::{Isometry, Object, World};
use crate::hand::{JointAngles, PerFinger};

/// Colour and depth of one camera at one instant. Arrays are indexed (row, column).
#[derive(Debug, Clone, PartialEq)]
pub struct Rgbd {
    /// Colour image.
    pub color: RgbImage,
    /// Depth along the optical axis, metres, positive in front of the camera; 0 where nothing was measured.
    pub depth_m: Array2<f32>,
}

/// What a robot would record at one instant.
#[derive(Debug, Clone, PartialEq)]
pub struct Observation {
    /// Seconds since the start of the episode.
    pub time_s: f64,
    /// Joint angles as the encoders give them.
    pub joints: JointAngles,
    /// One DIGIT image per finger, 240 wide and 320 high.
    pub touch: PerFinger<RgbImage>,
    /// One colour and depth image per camera, in the order of the log's cameras.
    pub cameras: Vec<Rgbd>,
}

/// What only a simulator knows. Deliberately not a part of [`Observation`]: perception and tracking never receive it.
#[derive(Debug, Clone, PartialEq)]
pub struct GroundTruth {
    /// Pose of the object.
    pub object_pose: Isometry<Object, World>,
    /// True depth and contact of each DIGIT.
    pub touch: PerFinger<TouchTruth>,
    /// For each camera what every pixel shows: [`BACKGROUND`], [`HAND`] or [`OBJECT`].
    pub segmentation: Vec<GrayImage>,
}

/// What a perfect DIGIT would measure. Arrays are 320 rows by 240 columns.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct TouchTruth {
    /// Depth along the DIGIT camera's axis to the nearer of gel and object, metres.
    pub depth_m: Array2<f32>,
    /// 255 where the object presses into the gel, else 0.
    pub contact: GrayImage,
}

/// Segmentation level of the background.
pub const BACKGROUND: u8 = 0;
/// Segmentation level of the hand (FeelSight's middle level).
pub const HAND: u8 = 127;
/// Segmentation level of the object.
pub const OBJECT: u8 = 255;
/// Segmentation level of pixels that may show the object or not: neither its surface nor free space is to be read from them.
/// Only a measured segmentation has it.
pub const UNSURE: u8 = 64;
