//! The camera of RGB-D images: lens, units and labels, by which messages become colours, depth and masks of one size.

use image::RgbImage;
use image::imageops::{FilterType, resize};
use mvt_frames::camera::Intrinsics;
use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use ndarray::Array2;

use crate::error::RosError;
use crate::lens::{Remap, RosLens};
use crate::messages::{RosCompressedImage, RosImage};

/// Focal lengths of colours and depth that differ by more, as a share, are those of images that are not registered.
const REGISTERED: f64 = 0.02;

/// Image as a message holds it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum RosPicture<'a> {
    /// Message `sensor_msgs/msg/Image`.
    Raw(RosImage<'a>),
    /// Message `sensor_msgs/msg/CompressedImage`.
    Compressed(RosCompressedImage<'a>),
}

impl<'a> RosPicture<'a> {
    /// Decodes a message of either type.
    ///
    /// # Errors
    /// [`RosError`] if it is cut off or of another type. The pixels are judged when they are converted.
    pub fn decode(message: &'a [u8], is_compressed: bool) -> Result<Self, RosError> {
        if is_compressed {
            RosCompressedImage::decode(message).map(Self::Compressed)
        } else {
            RosImage::decode(message).map(Self::Raw)
        }
    }

    /// Returns the colours.
    ///
    /// # Errors
    /// [`RosError`] if there are none, or the pixels are damaged.
    pub fn colours(&self) -> Result<RgbImage, RosError> {
        match self {
            Self::Raw(image) => image.colours(),
            Self::Compressed(image) => image.colours(),
        }
    }

    fn depth_m(&self, unit_m: f64) -> Result<Array2<f32>, RosError> {
        match self {
            Self::Raw(image) => image.depth_m(unit_m),
            Self::Compressed(image) => image.depth_m(unit_m),
        }
    }

    /// Returns labels, and whether their edges are blurred.
    fn labels(&self) -> Result<(Array2<u16>, bool), RosError> {
        Ok(match self {
            Self::Raw(image) => (image.labels()?, false),
            Self::Compressed(image) => (image.labels()?, image.is_lossy()),
        })
    }
}

/// Camera of RGB-D images. It removes the distortion of the lens and brings colours and masks to the size of depth.
#[derive(Debug)]
pub struct RosCamera {
    /// Lens of depth.
    pub lens: RosLens,
    /// Lens of the colours, if a camera model stands beside them.
    pub color_lens: Option<RosLens>,
    /// Metres per level of depth images of 16 bits; 0.001 without it.
    pub depth_unit_m: Option<f64>,
    /// Label of the object in the masks; without it a mask has two levels.
    pub object: Option<u16>,
    /// File in which the user states the choice of topics, for messages.
    pub file: String,
    remaps: Vec<Remap>,
}

impl RosCamera {
    /// Metres per level of depth images of 16 bits without a statement: REP 118.
    pub const UNIT_M: f64 = 0.001;

    /// Returns a camera whose depth images have this lens; `file` states the choice of topics and stands in messages.
    pub fn new(lens: RosLens, file: impl Into<String>) -> Self {
        Self { lens, color_lens: None, depth_unit_m: None, object: None, file: file.into(), remaps: Vec::new() }
    }

    /// Returns the motion from OpenGL axes, which cameras have here, to those of an optical frame of ROS; it is its own inverse.
    pub fn optical_from_camera() -> Isometry3<f64> {
        Isometry3::from_parts(
            Vector3::zeros().into(),
            UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI),
        )
    }

    /// Returns whether the name of an image topic says that its images are rectified.
    pub fn is_rectified(topic: &str) -> bool {
        topic.split('/').any(|part| part.starts_with("image_rect"))
    }

    /// Returns a sentence if the camera models say that depth is not registered to the colours.
    pub fn registration_note(&self) -> Option<String> {
        let scaled = self.color_lens?.resized([self.lens.intrinsics.width, self.lens.intrinsics.height]);
        let (color_fx, depth_fx) = (scaled.intrinsics.fx, self.lens.intrinsics.fx);
        ((color_fx / depth_fx - 1.0).abs() > REGISTERED).then(|| {
            format!(
                "focal lengths of colours and depth differ ({color_fx:.1} and {depth_fx:.1} pixels): depth is not registered; use aligned depth"
            )
        })
    }

    /// Returns depth along the optical axis, metres, 0 where nothing was measured.
    ///
    /// # Errors
    /// [`RosError`] if the pixels are damaged, are not those of depth, or are more or fewer than those of the camera model.
    pub fn depth_m(&mut self, image: &RosPicture<'_>) -> Result<Array2<f32>, RosError> {
        let depth_m = image.depth_m(self.depth_unit_m.unwrap_or(Self::UNIT_M))?;
        let Intrinsics { width, height, .. } = self.lens.intrinsics;
        if depth_m.dim() != (height, width) {
            let (rows, columns) = depth_m.dim();
            return Err(RosError::fault(format!(
                "the depth image has {columns} x {rows} pixels, but its camera model has {width} x {height}: name the model of this size as camera_info in {}",
                self.file
            )));
        }
        let lens = self.lens;
        Ok(match self.remap(&lens) {
            Some(remap) => remap.nearest(&depth_m),
            None => depth_m,
        })
    }

    /// Returns the colours of an image from the topic of this name, in the size of depth.
    ///
    /// # Errors
    /// [`RosError`] if the pixels are damaged, or the image has another shape than depth.
    pub fn colours(&mut self, image: &RosPicture<'_>, topic: &str) -> Result<RgbImage, RosError> {
        let color = image.colours()?;
        let Intrinsics { width, height, .. } = self.lens.intrinsics;
        let size = [color.width() as usize, color.height() as usize];
        self.check_shape(size)?;
        let lens = self.lens_of(size, topic);
        let color = match self.remap(&lens) {
            Some(remap) => remap.colours(&color),
            None => color,
        };
        if size == [width, height] {
            return Ok(color);
        }
        Ok(resize(&color, width as u32, height as u32, FilterType::Triangle))
    }

    /// Returns where a mask or label image from the topic of this name shows the object, in the size of depth.
    ///
    /// # Errors
    /// [`RosError`] if the pixels are damaged, several labels may be the object, or the image has another shape than depth.
    pub fn mask(&mut self, image: &RosPicture<'_>, topic: &str) -> Result<Array2<bool>, RosError> {
        let (labels, is_lossy) = image.labels()?;
        let (rows, columns) = labels.dim();
        self.check_shape([columns, rows])?;
        let inside = self.inside(is_lossy, &labels)?;
        Ok(self.straight(inside, topic))
    }

    /// Returns a mask that was drawn on an image of the topic of this name without the distortion of the lens and in the size of depth;
    /// `None` if it has another shape than depth.
    pub fn drawn_mask(&mut self, drawn: Array2<bool>, topic: &str) -> Option<Array2<bool>> {
        let (rows, columns) = drawn.dim();
        self.check_shape([columns, rows]).is_ok().then(|| self.straight(drawn, topic))
    }

    /// Refuses images of another shape than that of depth.
    fn check_shape(&self, [columns, rows]: [usize; 2]) -> Result<(), RosError> {
        let Intrinsics { width, height, .. } = self.lens.intrinsics;
        if columns * height == rows * width {
            return Ok(());
        }
        Err(RosError::fault(format!(
            "{columns} x {rows} pixels are of another shape than depth with {width} x {height}: use depth that is aligned to the colours"
        )))
    }

    /// Returns the lens of images in this size, which have the colours' place in the camera.
    fn lens_of(&self, size: [usize; 2], topic: &str) -> RosLens {
        let own = self.color_lens.filter(|lens| [lens.intrinsics.width, lens.intrinsics.height] == size);
        let mut lens = own.unwrap_or_else(|| self.lens.resized(size));
        if Self::is_rectified(topic) {
            lens.distortion = [0.0; 8];
        }
        lens
    }

    /// Returns a mask of the topic of this name without distortion, in the size of depth.
    fn straight(&mut self, inside: Array2<bool>, topic: &str) -> Array2<bool> {
        let (rows, columns) = inside.dim();
        let lens = self.lens_of([columns, rows], topic);
        let mask = match self.remap(&lens) {
            Some(remap) => remap.nearest(&inside),
            None => inside,
        };
        let Intrinsics { width, height, .. } = self.lens.intrinsics;
        if (rows, columns) == (height, width) {
            return mask;
        }
        let at = |at: usize, of: usize, from: usize| ((2 * at + 1) * from) / (2 * of);
        Array2::from_shape_fn((height, width), |(v, u)| {
            mask.get((at(v, height, rows), at(u, width, columns))).copied().unwrap_or(false)
        })
    }

    /// Returns the map that removes the distortion of a lens; `None` without distortion.
    fn remap(&mut self, lens: &RosLens) -> Option<&Remap> {
        let at = match self.remaps.iter().position(|remap| remap.is_of(lens)) {
            Some(at) => at,
            None => {
                self.remaps.push(Remap::new(lens)?);
                self.remaps.len() - 1
            }
        };
        self.remaps.get(at)
    }

    /// Returns where labels show the object.
    fn inside(&self, is_lossy: bool, labels: &Array2<u16>) -> Result<Array2<bool>, RosError> {
        if let Some(object) = self.object {
            return Ok(labels.mapv(|label| label == object));
        }
        let most = labels.iter().copied().max().unwrap_or(0);
        if is_lossy {
            return Ok(labels.mapv(|label| u32::from(label) * 2 > u32::from(most)));
        }
        if let Some(other) = labels.iter().find(|label| **label != 0 && **label != most) {
            return Err(RosError::fault(format!(
                "it holds several labels ({other}, {most}): say which is the object by `object = LABEL` in {}",
                self.file
            )));
        }
        Ok(labels.mapv(|label| label > 0))
    }
}
