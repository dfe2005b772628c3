//! What a layout says of a folder.

use std::path::PathBuf;

use mvt_frames::{Camera, Isometry, MeshFile, World};

use crate::pixels::DepthCode;

/// The files of a frame and what is known of it.
#[derive(Debug, Clone)]
pub(crate) struct FrameFiles {
    /// Its name in the data set.
    pub name: String,
    pub time_s: f64,
    /// `None` in a frame without colours.
    pub color: Option<PathBuf>,
    pub depth: PathBuf,
    pub mask: Option<PathBuf>,
    /// fx, fy, cx, cy of the colour image.
    pub intrinsics: [f64; 4],
    pub world_from_camera: Option<Isometry<Camera, World>>,
    pub camera_from_object: Option<Isometry<MeshFile, Camera>>,
}

/// What a layout says of a folder.
pub(crate) struct Parts {
    pub frames: Vec<FrameFiles>,
    pub code: DepthCode,
    /// Level of the object in images of labels.
    pub object: Option<u32>,
    pub notes: Vec<String>,
    pub object_name: Option<String>,
}
