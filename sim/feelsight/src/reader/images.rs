//! Images, depths and labels of a log.

use std::path::PathBuf;

use image::{ImageBuffer, Pixel, RgbImage};
use mvt_frames::camera::{Intrinsics, PosedCamera};
use mvt_frames::depth::Label;
use mvt_robot::digit;
use mvt_robot::hand::{Finger, PerFinger};
use mvt_robot::observation::TouchTruth;
use ndarray::Array2;

use super::Log;
use crate::error::LogError;
use crate::io::read_at_most;
use crate::lens::Lens;
use crate::levels::{is_level, labels_of};
use crate::npz;
use crate::picture::{MAX_FILE, encode_color, encode_exact, read_color, read_gray};

/// Images of one instant, without the depths of the cameras.
pub(crate) struct Images {
    pub touch: PerFinger<RgbImage>,
    pub color: Vec<RgbImage>,
    pub touch_truth: Option<PerFinger<TouchTruth>>,
    pub labels: Option<Vec<Array2<Label>>>,
}

/// Image files of one instant, each a JPEG or PNG image.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub struct ImageFiles {
    /// Colours of each camera.
    pub colours: Vec<Vec<u8>>,
    /// Labels of each camera, grey: 0 background, 127 hand, 255 object. `None` if the log has none.
    pub labels: Option<Vec<Vec<u8>>>,
    /// Image of each DIGIT.
    pub touch: PerFinger<Vec<u8>>,
    /// True depth of each DIGIT, in the levels of [`DigitInfo`](crate::DigitInfo), and its contact mask, grey: 0 or 255. `None` if the log has
    /// none.
    pub touch_truth: Option<PerFinger<[Vec<u8>; 2]>>,
}

impl Log {
    /// Reads the image files of a frame, without decoding them. Images of a camera whose lens distorts are straightened and encoded anew.
    ///
    /// # Errors
    /// [`LogError`] if a file cannot be read.
    pub fn image_files(&self, frame: usize) -> Result<ImageFiles, LogError> {
        let name = format!("{frame}.jpg");
        let read = |folder: PathBuf| read_at_most(&folder.join(&name), MAX_FILE);
        let (mut colours, mut labels) = (Vec::new(), Vec::new());
        for (camera, lens) in self.cameras.iter().zip(&self.lenses) {
            let folder = self.camera_folder(&camera.name);
            let [image, seg] = ["image", "seg"].map(|kind| folder.join(kind));
            let Some(lens) = lens else {
                colours.push(read(image)?);
                if self.segmentation {
                    labels.push(read(seg)?);
                }
                continue;
            };
            let size = (camera.intrinsics.width, camera.intrinsics.height);
            let defect = |defect: String| LogError::defect(&folder, defect);
            let straight = lens.straighten_image(&read_color(&image.join(&name), size)?);
            colours.push(encode_color(&straight).map_err(defect)?);
            if self.segmentation {
                let straight = lens.straighten_image(&read_gray(&seg.join(&name), size)?);
                labels.push(encode_exact(&straight).map_err(defect)?);
            }
        }
        let each = |kind: &str| -> Result<PerFinger<Vec<u8>>, LogError> {
            let [index, middle, ring, thumb] = Finger::ALL.map(|finger| read(self.touch_folder(finger).join(kind)));
            Ok(PerFinger([index?, middle?, ring?, thumb?]))
        };
        let touch = each("image")?;
        let touch_truth = if self.touch_labels {
            let (PerFinger(depths), PerFinger(masks)) = (each("depth")?, each("mask")?);
            let mut masks = masks.into_iter();
            Some(PerFinger(depths.map(|depth| [depth, masks.next().unwrap_or_default()])))
        } else {
            None
        };
        Ok(ImageFiles { colours, labels: self.segmentation.then_some(labels), touch, touch_truth })
    }

    /// Returns the depths of a camera, from the first on, with their file.
    pub(crate) fn depths(&self, camera: usize) -> Result<(PathBuf, npz::NpzReader), LogError> {
        let PosedCamera { name, intrinsics: Intrinsics { width: w, height: h, .. }, .. } = &self.cameras[camera];
        let path = self.camera_folder(name).join("depth.npz");
        let reader = npz::NpzReader::open(&path).map_err(LogError::npz(&path))?;
        let [_, height, width] = reader.shape();
        if (width, height) != (*w, *h) {
            return Err(LogError::defect(
                path,
                format!("its images are {width} x {height} pixels and those of the camera {w} x {h}"),
            ));
        }
        Ok((path, reader))
    }

    /// Returns the next depth of a camera, positive; NaN or infinite where the file is.
    pub(crate) fn next_depth(
        &self,
        camera: usize,
        (path, reader): &mut (PathBuf, npz::NpzReader),
    ) -> Result<Array2<f32>, LogError> {
        let values = reader.read().map_err(LogError::npz(&*path))?;
        let mut depth = values.ok_or_else(|| LogError::defect(&*path, "depth ends early"))?;
        // The sign differs between simulated and recorded logs and has no meaning.
        depth.iter_mut().for_each(|z| *z = z.abs());
        if let Some(lens) = &self.lenses[camera] {
            depth = lens.straighten(&depth);
        }
        let [_, height, width] = reader.shape();
        Array2::from_shape_vec((height, width), depth).map_err(|e| LogError::defect(&*path, e.to_string()))
    }

    pub(super) fn touch_folder(&self, finger: Finger) -> PathBuf {
        self.folder.join("allegro").join(finger.name())
    }

    pub(super) fn camera_folder(&self, camera: &str) -> PathBuf {
        self.folder.join("realsense").join(camera)
    }

    /// Reads and checks the images of a frame.
    pub(crate) fn images(&self, i: usize) -> Result<Images, LogError> {
        let name = format!("{i}.jpg");
        let mut touch = Vec::new();
        let mut touch_truth = Vec::new();
        for finger in Finger::ALL {
            touch.push(self.touch_image(finger, i)?);
            if self.touch_labels {
                touch_truth.push(self.touch_truth(finger, i)?);
            }
        }
        let mut color = Vec::new();
        let mut labels = Vec::new();
        for (camera, lens) in self.cameras.iter().zip(&self.lenses) {
            let folder = self.camera_folder(&camera.name);
            let size = (camera.intrinsics.width, camera.intrinsics.height);
            color.push(straightened(lens.as_ref(), read_color(&folder.join("image").join(&name), size)?));
            if self.segmentation {
                let path = folder.join("seg").join(&name);
                let levels = read_gray(&path, size)?;
                if self.scene.is_some() && !levels.iter().all(|&level| is_level(level)) {
                    return Err(LogError::defect(path, "a segmentation holds other levels than 0, 127 and 255"));
                }
                labels.push(labels_of(&straightened(lens.as_ref(), levels)));
            }
        }
        let four = |images: Vec<RgbImage>| <[RgbImage; 4]>::try_from(images).map(PerFinger);
        Ok(Images {
            touch: four(touch).map_err(|_| LogError::defect(&self.folder, "a finger is missing"))?,
            color,
            touch_truth: <[TouchTruth; 4]>::try_from(touch_truth).ok().map(PerFinger),
            labels: self.segmentation.then_some(labels),
        })
    }

    /// Reads the colour image of a camera, by its index, in a frame.
    ///
    /// # Errors
    /// [`LogError`] if the image does not exist or cannot be read.
    pub fn colour(&self, camera: usize, frame: usize) -> Result<RgbImage, LogError> {
        let Some((posed, lens)) = self.cameras.get(camera).zip(self.lenses.get(camera)) else {
            return Err(LogError::defect(&self.folder, format!("there is no camera {camera}")));
        };
        let path = self.camera_folder(&posed.name).join("image").join(format!("{frame}.jpg"));
        let size = (posed.intrinsics.width, posed.intrinsics.height);
        Ok(straightened(lens.as_ref(), read_color(&path, size)?))
    }

    /// Reads the image of a DIGIT in a frame.
    ///
    /// # Errors
    /// [`LogError`] if the image does not exist or cannot be read.
    pub fn touch_image(&self, finger: Finger, frame: usize) -> Result<RgbImage, LogError> {
        let path = self.touch_folder(finger).join("image").join(format!("{frame}.jpg"));
        read_color(&path, (digit::WIDTH, digit::HEIGHT))
    }

    /// Reads the true depth and contact of a DIGIT in a frame.
    ///
    /// # Errors
    /// [`LogError`] if they do not exist or cannot be read.
    pub fn touch_truth(&self, finger: Finger, frame: usize) -> Result<TouchTruth, LogError> {
        let size = (digit::WIDTH, digit::HEIGHT);
        let name = format!("{frame}.jpg");
        let folder = self.touch_folder(finger);
        let levels = read_gray(&folder.join("depth").join(&name), size)?;
        let path = folder.join("mask").join(&name);
        let mask = read_gray(&path, size)?;
        if self.scene.is_some() && mask.iter().any(|&m| m != 0 && m != 255) {
            return Err(LogError::defect(path, "a mask holds other levels than 0 and 255"));
        }
        let depth = |row, column| self.digit.depth_m(levels.get_pixel(column as u32, row as u32).0[0]);
        Ok(TouchTruth {
            depth_m: Array2::from_shape_fn((digit::HEIGHT, digit::WIDTH), |(row, column)| depth(row, column)),
            // A JPEG mask has every level; loaders use this threshold, too.
            contact: Array2::from_shape_fn((digit::HEIGHT, digit::WIDTH), |(row, column)| {
                mask.get_pixel(column as u32, row as u32).0[0] > 127
            }),
        })
    }

    /// Returns whether a DIGIT has images.
    pub fn has_touch_images(&self, finger: Finger) -> bool {
        self.touch_folder(finger).join("image").is_dir()
    }

    /// Returns whether a DIGIT has true depths.
    pub fn has_touch_truth(&self, finger: Finger) -> bool {
        self.touch_folder(finger).join("depth").is_dir()
    }
}

/// Removes the distortion of a lens from an image, if there is any.
fn straightened<P>(lens: Option<&Lens>, image: ImageBuffer<P, Vec<u8>>) -> ImageBuffer<P, Vec<u8>>
where
    P: Pixel<Subpixel = u8>,
{
    if let Some(lens) = lens { lens.straighten_image(&image) } else { image }
}
