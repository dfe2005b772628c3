//! `rgbd.toml`: what a folder does not say by its files.

use std::path::Path;

use serde::Deserialize;

use crate::error::RgbdError;
use crate::text;

/// Name of the file in the folder.
pub(crate) const FILE: &str = "rgbd.toml";

/// The contents; every key may be missing.
#[derive(Debug, Clone, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Description {
    /// Pattern of the colour images.
    pub color: Option<String>,
    /// Pattern of the depth images.
    pub depth: Option<String>,
    /// Pattern of the masks.
    pub masks: Option<String>,
    /// Whether masks are carried into the frames that have none.
    pub carry_masks: Option<bool>,
    /// Level of the object in masks that hold labels, or its number in BOP.
    pub object: Option<u32>,
    /// fx, fy, cx, cy of the colour images, pixels.
    pub intrinsics: Option<[f64; 4]>,
    /// Metres per level of depth.
    pub depth_unit_m: Option<f64>,
    /// Frames per second.
    pub frame_hz: Option<f64>,
    /// Pattern of the poses of the camera in the world.
    pub camera_poses: Option<String>,
    /// Whether a live run recorded the frames: all are used as that run used them, also those without colours, and none is judged.
    #[serde(default)]
    pub live: bool,
    /// Mesh of the object: a file beside this one, or a name of the catalogue.
    pub mesh: Option<String>,
    /// Pattern of the true poses of the object in the camera.
    pub object_poses: Option<String>,
}

impl Description {
    /// Reads the file of a folder; an empty description if there is none.
    pub fn of(folder: &Path) -> Result<Self, RgbdError> {
        let path = folder.join(FILE);
        if !path.exists() {
            return Ok(Self::default());
        }
        let contents: Self = toml::from_str(&text::read(&path)?)
            .map_err(|error| RgbdError::fault(&path, error.message().replace('\n', "; ")))?;
        let positive = |name: &str, number: Option<f64>| match number {
            Some(number) if !(number.is_finite() && number > 0.0) => {
                Err(RgbdError::fault(&path, format!("{name} must be above 0 (it is {number})")))
            }
            _ => Ok(()),
        };
        positive("depth_unit_m", contents.depth_unit_m)?;
        positive("frame_hz", contents.frame_hz)?;
        if contents.intrinsics.is_some_and(|[fx, fy, ..]| !(fx > 0.0 && fy > 0.0)) {
            return Err(RgbdError::fault(&path, "intrinsics are fx, fy, cx and cy of the colour images, pixels"));
        }
        Ok(contents)
    }

    /// Returns the stated name of the object: that of a mesh beside the images, or as `object.txt` has it.
    pub fn object_name(&self, folder: &Path) -> Result<Option<String>, RgbdError> {
        if let Some(mesh) = &self.mesh {
            let path = folder.join(mesh);
            return Ok(Some(if path.is_file() { path.display().to_string() } else { mesh.clone() }));
        }
        let path = folder.join("object.txt");
        if !path.is_file() {
            return Ok(None);
        }
        let text = text::read(&path)?;
        let name = text.lines().next().map(str::trim).filter(|name| !name.is_empty());
        let name = name.ok_or_else(|| RgbdError::fault(&path, "its first line must be the name of the object"))?;
        Ok(Some(name.to_owned()))
    }

    /// Returns fx, fy, cx and cy as stated, or else those of `cam_K.txt`; `None` if there is neither.
    pub fn intrinsics_or_cam_k(&self, folder: &Path) -> Result<Option<[f64; 4]>, RgbdError> {
        let path = folder.join("cam_K.txt");
        match self.intrinsics {
            None if path.exists() => text::camera_matrix(&path).map(Some),
            stated => Ok(stated),
        }
    }
}
