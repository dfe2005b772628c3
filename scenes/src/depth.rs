//! Metric depth: what perception makes of an [`Observation`](crate::observation::Observation) and the tracker receives.

use image::GrayImage;
use ndarray::Array2;

use crate::camera::Intrinsics;
use crate::frame::{Camera, Isometry, World};
use crate::hand::{JointAngles, PerFinger};

/// What all sensors measured at one instant.
#[derive(Debug, Clone, PartialEq)]
pub struct DepthFrame {
    /// Seconds since the start of the episode.
    pub time_s: f64,
    /// Joint angles of the hand, which give its surface and the poses of the fingertips.
    pub joints: JointAngles,
    /// One depth image per camera; `None` from a camera that delivered nothing.
    pub cameras: Vec<Option<CameraDepth>>,
    /// One touch per finger; `None` from a sensor that delivered nothing.
    pub touch: PerFinger<Option<TouchDepth>>,
}

/// Depth of one camera with what each pixel shows. Arrays are indexed (row, column).
#[derive(Debug, Clone, PartialEq)]
pub struct CameraDepth {
    /// Pinhole model.
    pub intrinsics: Intrinsics,
    /// Pose of the camera.
    pub world_from_camera: Isometry<Camera, World>,
    /// Depth along the optical axis, metres, positive in front of the camera; 0 where nothing was measured.
    pub depth_m: Array2<f32>,
    /// What every pixel shows: [`BACKGROUND`](crate::observation::BACKGROUND), [`HAND`](crate::observation::HAND),
    /// [`OBJECT`](crate::observation::OBJECT) or [`UNSURE`](crate::observation::UNSURE). Background is also what was not measured.
    pub segmentation: GrayImage,
}

/// Depth and contact of one DIGIT. Arrays are 320 rows by 240 columns, seen by the camera of [`crate::digit`].
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
