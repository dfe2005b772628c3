//! Metric depth: what perception makes of an [`Observation`](mvt_robot::observation::Observation) and the tracker receives.

use image::GrayImage;
use ndarray::Array2;

use crate::camera::Intrinsics;
use crate::{Camera, Isometry, World};

/// Depth of one camera with what each pixel shows. Arrays are indexed (row, column).
#[derive(Debug, Clone, PartialEq)]
pub struct CameraDepth {
    /// Pinhole model.
    pub intrinsics: Intrinsics,
    /// Pose of the camera.
    pub world_from_camera: Isometry<Camera, World>,
    /// Depth along the optical axis, metres, positive in front of the camera; 0 where nothing was measured.
    pub depth_m: Array2<f32>,
    /// What every pixel shows: [`BACKGROUND`], [`HAND`],
    /// [`OBJECT`] or [`UNSURE`]. Background is also what was not measured.
    pub segmentation: GrayImage,
}

/// Depth and contact of one DIGIT. Arrays are 320 rows by 240 columns, seen by the camera of [`mvt_robot::digit`].
#[derive(Debug, Clone, PartialEq)]
pub struct TouchDepth {
    /// Pose of the DIGIT's camera.
    pub world_from_camera: Isometry<Camera, World>,
    /// Depth along the DIGIT camera's axis to the nearer of gel and object, metres.
    pub depth_m: Array2<f32>,
    /// 255 where the object presses into the gel, else 0.
    pub contact: GrayImage,
    /// Standard deviation of the depth where the object touches, metres.
    pub sigma_m: f32,
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
