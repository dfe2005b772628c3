//! Depth images with what their pixels show: the input of tracking and mapping.

use image::RgbImage;
use ndarray::Array2;

use crate::camera::Intrinsics;
use crate::{Camera, Isometry, Pad, World};

/// What a pixel of a camera shows.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Hash)]
pub enum Label {
    /// Neither hand nor object, or nothing was measured.
    #[default]
    Background,
    /// The hand, or anything else that moves in front of the object.
    Hand,
    /// The object.
    Object,
    /// Perhaps the object: neither its surface nor free space can be read from the pixel. Only a measured segmentation has it.
    Unsure,
}

impl Label {
    /// Returns the grey level that stands for the label in an image: 0, 127 and 255 as in FeelSight, and 64 for [`Label::Unsure`].
    pub const fn grey(self) -> u8 {
        match self {
            Self::Background => 0,
            Self::Hand => 127,
            Self::Object => 255,
            Self::Unsure => 64,
        }
    }

    /// Returns the label that a grey level stands for; `None` if it stands for none.
    pub const fn from_grey(grey: u8) -> Option<Self> {
        match grey {
            0 => Some(Self::Background),
            127 => Some(Self::Hand),
            255 => Some(Self::Object),
            64 => Some(Self::Unsure),
            _ => None,
        }
    }
}

/// What is known beforehand of the pixels of a camera image. Arrays are indexed (row, column).
#[derive(Debug, Clone, PartialEq)]
pub enum GivenLabels {
    /// What every pixel shows.
    Labels(Array2<Label>),
    /// Where the object is visible. Of the other pixels nothing is known.
    Mask(Array2<bool>),
}

impl GivenLabels {
    /// Returns width and height, pixels.
    pub fn size(&self) -> [usize; 2] {
        let (rows, columns) = match self {
            Self::Labels(labels) => labels.dim(),
            Self::Mask(mask) => mask.dim(),
        };
        [columns, rows]
    }
}

/// Returns the least column, the least row, the greatest column and the greatest row of the pixels for which `shows` holds; `None` if it holds
/// for none.
pub fn extent<T>(image: &Array2<T>, shows: impl Fn(&T) -> bool) -> Option<[usize; 4]> {
    let mut extent: Option<[usize; 4]> = None;
    for (v, row) in image.rows().into_iter().enumerate() {
        let Some(first) = row.iter().position(&shows) else { continue };
        let last = row.len() - 1 - row.iter().rev().position(&shows).unwrap_or(0);
        let [left, top, right, _] = extent.unwrap_or([first, v, last, v]);
        extent = Some([left.min(first), top, right.max(last), v]);
    }
    extent
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
    /// What every pixel shows; as large as `depth_m`.
    pub labels: Array2<Label>,
    /// The colour image of the same camera at the same instant, if there is one; of the size of `depth_m`, or it is not used.
    pub colour: Option<RgbImage>,
}

/// Depth and contact of one touch sensor, as its camera sees them from inside. Arrays are indexed (row, column).
#[derive(Debug, Clone, PartialEq)]
pub struct TouchDepth {
    /// Pinhole model of the camera in the sensor.
    pub intrinsics: Intrinsics,
    /// Pose of that camera.
    pub world_from_camera: Isometry<Camera, World>,
    /// Pose of the pad that the object sticks to while it presses; any frame that is fixed to the sensor will do.
    pub world_from_pad: Isometry<Pad, World>,
    /// Depth along the camera's axis to the nearer of gel and object, metres.
    pub depth_m: Array2<f32>,
    /// Where the object presses into the gel; as large as `depth_m`.
    pub contact: Array2<bool>,
    /// Standard deviation of the depth where the object touches, metres.
    pub sigma_m: f32,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_extent_holds_all_pixels_and_no_more() {
        let mut image = Array2::from_elem((5, 7), false);
        assert_eq!(extent(&image, |shows| *shows), None);
        image[(3, 5)] = true;
        assert_eq!(extent(&image, |shows| *shows), Some([5, 3, 5, 3]));
        (image[(1, 6)], image[(2, 2)]) = (true, true);
        assert_eq!(extent(&image, |shows| *shows), Some([2, 1, 6, 3]));
    }
}
