//! Images, depths and labels of a log.

use std::path::PathBuf;
use std::sync::Arc;

use image::{GrayImage, ImageBuffer, Pixel, RgbImage};
use mvt_frames::camera::{Intrinsics, PosedCamera};
use mvt_frames::depth::Label;
use mvt_robot::hand::PerPad;
use mvt_robot::observation::TouchTruth;
use ndarray::Array2;

use super::Log;
use crate::compact::CompactFrames;
use crate::depths::DepthReader;
use crate::error::LogError;
use crate::frames::{RawCamera, RawFrame, RawTouch};
use crate::hand::{pad_folder, pad_size};
use crate::io::read_at_most;
use crate::lens::Lens;
use crate::levels::{is_level, labels_of};
use crate::picture::{MAX_FILE, color_of, gray_of, read_color, read_gray, touch_of};

/// Images of one instant, without the depths of the cameras. Those of sensors that the log lacks are empty.
pub(crate) struct Images {
    pub touch: PerPad<RgbImage>,
    pub color: Vec<RgbImage>,
    pub touch_truth: Option<PerPad<TouchTruth>>,
    pub labels: Option<Vec<Array2<Label>>>,
}

impl Log {
    /// Returns the depths of a camera, from the first on.
    pub(crate) fn depths(&self, camera: usize) -> Result<DepthReader, LogError> {
        let PosedCamera { name, intrinsics: Intrinsics { width, height, .. }, .. } = &self.cameras[camera];
        match &self.compact {
            Some(frames) => Ok(DepthReader::archive(Arc::clone(frames), name, (*width, *height))),
            None => DepthReader::npz(self.camera_folder(name).join("depth.npz"), (*width, *height)),
        }
    }

    /// Returns the next depth of a camera, positive; NaN or infinite where the file is.
    pub(crate) fn next_depth(&self, camera: usize, reader: &mut DepthReader) -> Result<Array2<f32>, LogError> {
        let mut depth = reader.read()?.ok_or_else(|| LogError::defect(reader.path(), "depth ends early"))?;
        // The sign differs between simulated and recorded logs and has no meaning.
        depth.iter_mut().for_each(|z| *z = z.abs());
        if let Some(lens) = &self.lenses[camera] {
            depth = lens.straighten(&depth);
        }
        let Intrinsics { width, height, .. } = self.cameras[camera].intrinsics;
        Array2::from_shape_vec((height, width), depth).map_err(|e| LogError::defect(reader.path(), e.to_string()))
    }

    pub(super) fn touch_folder(&self, pad: usize) -> PathBuf {
        self.folder.join(pad_folder(&self.hand, pad))
    }

    pub(super) fn camera_folder(&self, camera: &str) -> PathBuf {
        self.folder.join("realsense").join(camera)
    }

    /// Reads and checks the images of a frame.
    pub(crate) fn images(&self, i: usize) -> Result<Images, LogError> {
        let mut touch = Vec::new();
        let mut touch_truth = Vec::new();
        for pad in 0..self.hand.pads().len() {
            let image = self.has_touch_images(pad).then(|| self.delivered(self.touch_image(pad, i))).transpose()?;
            touch.push(image.flatten().unwrap_or_default());
            if self.touch_labels {
                touch_truth.push(self.touch_truth(pad, i)?);
            }
        }
        let mut color = Vec::new();
        let mut labels = Vec::new();
        for (camera, lens) in self.lenses.iter().enumerate() {
            let image = self.coloured[camera].then(|| self.delivered(self.raw_colour(camera, i))).transpose()?;
            color.push(image.flatten().map(|image| straightened(lens.as_ref(), image)).unwrap_or_default());
            if self.segmentation {
                labels.push(labels_of(&self.straight_labels(camera, i)?));
            }
        }
        Ok(Images {
            touch: PerPad(touch),
            color,
            touch_truth: self.touch_labels.then_some(PerPad(touch_truth)),
            labels: self.segmentation.then_some(labels),
        })
    }

    /// Returns `None` for an image without a file: real sensors skip frames, and a note of the log counts them. In a log of this program, which
    /// has scene.json, all images exist.
    pub(crate) fn delivered<T>(&self, image: Result<T, LogError>) -> Result<Option<T>, LogError> {
        match image {
            Err(error) if self.scene.is_none() && error.is_missing_file() => Ok(None),
            image => image.map(Some),
        }
    }

    /// Reads the colour image of a camera, by its index, in a frame.
    ///
    /// # Errors
    /// [`LogError`] if the image does not exist or cannot be read.
    pub fn colour(&self, camera: usize, frame: usize) -> Result<RgbImage, LogError> {
        let Some(lens) = self.lenses.get(camera) else {
            return Err(LogError::defect(&self.folder, format!("there is no camera {camera}")));
        };
        Ok(straightened(lens.as_ref(), self.raw_colour(camera, frame)?))
    }

    /// Reads a camera's image with the distortion of its lens.
    fn raw_colour(&self, camera: usize, frame: usize) -> Result<RgbImage, LogError> {
        let PosedCamera { name, intrinsics: Intrinsics { width, height, .. }, .. } = &self.cameras[camera];
        if let Some(CompactFrames { archive, .. }) = self.compact.as_deref() {
            let file = format!("realsense/{name}/image/{frame}.jpg");
            return color_of(&archive.read(&file, MAX_FILE)?, &archive.path(&file), (*width, *height));
        }
        read_color(&self.camera_folder(name).join("image").join(format!("{frame}.jpg")), (*width, *height))
    }

    /// Reads what the pixels of a camera, by its index, show in a frame.
    ///
    /// # Errors
    /// [`LogError`] if the image does not exist or cannot be read.
    pub fn labels(&self, camera: usize, frame: usize) -> Result<Array2<Label>, LogError> {
        if camera >= self.cameras.len() {
            return Err(LogError::defect(&self.folder, format!("there is no camera {camera}")));
        }
        Ok(labels_of(&self.straight_labels(camera, frame)?))
    }

    /// Reads a camera's segmentation.
    pub(super) fn straight_labels(&self, camera: usize, frame: usize) -> Result<GrayImage, LogError> {
        let lens = self.lenses.get(camera).and_then(Option::as_ref);
        Ok(straightened(lens, self.raw_labels(camera, frame)?))
    }

    /// Reads a camera's segmentation with the distortion of its lens.
    fn raw_labels(&self, camera: usize, frame: usize) -> Result<GrayImage, LogError> {
        let PosedCamera { name, intrinsics: Intrinsics { width, height, .. }, .. } = &self.cameras[camera];
        let (levels, path) = if let Some(CompactFrames { archive, .. }) = self.compact.as_deref() {
            let file = format!("realsense/{name}/seg/{frame}.png");
            let path = archive.path(&file);
            (gray_of(&archive.read(&file, MAX_FILE)?, &path, (*width, *height))?, path)
        } else {
            let path = self.camera_folder(name).join("seg").join(format!("{frame}.jpg"));
            (read_gray(&path, (*width, *height))?, path)
        };
        if self.scene.is_some() && !levels.iter().all(|&level| is_level(level)) {
            return Err(LogError::defect(path, "a segmentation holds other levels than 0, 127 and 255"));
        }
        Ok(levels)
    }

    /// Reads all images of a frame as they are stored; `depths` are those of the cameras.
    pub(crate) fn raw_frame(&self, i: usize, depths: Vec<Vec<f32>>) -> Result<RawFrame, LogError> {
        let touch = |pad: usize| {
            let labels = self.touch_labels.then(|| self.raw_touch_labels(pad, i)).transpose()?;
            let image = self.has_touch_images(pad).then(|| self.touch_image(pad, i)).transpose()?;
            Ok(RawTouch { image, labels })
        };
        let touch = (0..self.hand.pads().len()).map(touch).collect::<Result<_, LogError>>()?;
        let camera = |(camera, depth_m): (usize, Vec<f32>)| {
            Ok(RawCamera {
                name: self.cameras[camera].name.clone(),
                size: (self.cameras[camera].intrinsics.width, self.cameras[camera].intrinsics.height),
                image: self.coloured[camera].then(|| self.raw_colour(camera, i)).transpose()?,
                segmentation: self.segmentation.then(|| self.raw_labels(camera, i)).transpose()?,
                depth_m,
            })
        };
        let cameras = depths.into_iter().enumerate().map(camera).collect::<Result<_, LogError>>()?;
        Ok(RawFrame { touch, cameras })
    }

    /// Reads the image of a touch sensor, by the index of its pad, in a frame.
    ///
    /// # Errors
    /// [`LogError`] if the image does not exist or cannot be read.
    pub fn touch_image(&self, pad: usize, frame: usize) -> Result<RgbImage, LogError> {
        if let Some(frames) = &self.compact {
            return frames.touch_image(pad, frame);
        }
        let path = self.touch_folder(pad).join("image").join(format!("{frame}.jpg"));
        touch_of(&read_at_most(&path, MAX_FILE)?, &path, pad_size(&self.hand, pad))
    }

    /// Reads the true depth and contact of a touch sensor, by the index of its pad, in a frame.
    ///
    /// # Errors
    /// [`LogError`] if they do not exist or cannot be read.
    pub fn touch_truth(&self, pad: usize, frame: usize) -> Result<TouchTruth, LogError> {
        let (levels, mask) = self.raw_touch_labels(pad, frame)?;
        let digit = self.hand.pads().get(pad).map_or(self.digit, |pad| self.digit.of(&pad.profile));
        let shape = (levels.height() as usize, levels.width() as usize);
        let depth = |row, column| digit.depth_m(levels.get_pixel(column as u32, row as u32).0[0]);
        Ok(TouchTruth {
            depth_m: Array2::from_shape_fn(shape, |(row, column)| depth(row, column)),
            // A JPEG mask has every level; loaders use this threshold, too.
            contact: Array2::from_shape_fn(shape, |(row, column)| mask.get_pixel(column as u32, row as u32).0[0] > 127),
        })
    }

    /// Reads the levels of touch depth and the mask.
    fn raw_touch_labels(&self, pad: usize, frame: usize) -> Result<(GrayImage, GrayImage), LogError> {
        let size = pad_size(&self.hand, pad);
        let (levels, mask, path) = if let Some(frames) = &self.compact {
            let file = format!("{}/mask/{frame}.png", pad_folder(&self.hand, pad));
            let path = frames.archive.path(&file);
            let mask = gray_of(&frames.archive.read(&file, MAX_FILE)?, &path, size)?;
            (frames.touch_levels(pad, frame)?, mask, path)
        } else {
            let (folder, name) = (self.touch_folder(pad), format!("{frame}.jpg"));
            let path = folder.join("mask").join(&name);
            (read_gray(&folder.join("depth").join(&name), size)?, read_gray(&path, size)?, path)
        };
        if self.scene.is_some() && mask.iter().any(|&m| m != 0 && m != 255) {
            return Err(LogError::defect(path, "a mask holds other levels than 0 and 255"));
        }
        Ok((levels, mask))
    }

    /// Returns whether a touch sensor, by the index of its pad, has images.
    pub fn has_touch_images(&self, pad: usize) -> bool {
        self.felt.get(pad).copied().unwrap_or_default()
    }

    /// Returns whether a camera, by its index, has colours.
    pub fn has_colours(&self, camera: usize) -> bool {
        self.coloured.get(camera).copied().unwrap_or_default()
    }

    /// Returns whether every frame has labels of all cameras.
    pub fn has_labels(&self) -> bool {
        self.segmentation
    }

    /// Returns whether a touch sensor, by the index of its pad, has true depths.
    pub fn has_touch_truth(&self, pad: usize) -> bool {
        match &self.compact {
            Some(frames) => frames.archive.count(&format!("{}/depth", pad_folder(&self.hand, pad))) > 0,
            None => self.touch_folder(pad).join("depth").is_dir(),
        }
    }
}

/// Removes the distortion of a lens from an image, if there is any.
fn straightened<P>(lens: Option<&Lens>, image: ImageBuffer<P, Vec<u8>>) -> ImageBuffer<P, Vec<u8>>
where
    P: Pixel<Subpixel = u8>,
{
    if let Some(lens) = lens { lens.straighten_image(&image) } else { image }
}
