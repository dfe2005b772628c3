//! Images of the frames of a log, in either layout.

use std::fs;
use std::path::{Path, PathBuf};

use image::{GrayImage, RgbImage};
use mvt_robot::hand::{Hand, PerPad};

use crate::archive::ArchiveWriter;
use crate::compact;
use crate::error::LogError;
use crate::hand::{pad_folder, pad_name};
use crate::npz::{DeflatedFrame, NpzWriter};
use crate::picture::{encode_color, encode_exact, encode_png};

/// Images of one instant as they are stored, but decoded.
pub(super) struct RawFrame {
    pub touch: PerPad<RawTouch>,
    pub cameras: Vec<RawCamera>,
}

/// Images of one touch sensor.
pub(super) struct RawTouch {
    /// `None` if the log has none.
    pub image: Option<RgbImage>,
    /// Levels of the depth, and the mask with 0 and 255.
    pub labels: Option<(GrayImage, GrayImage)>,
}

/// Images of one camera.
pub(super) struct RawCamera {
    pub name: String,
    /// Width and height.
    pub size: (usize, usize),
    /// `None` if the log has none.
    pub image: Option<RgbImage>,
    pub segmentation: Option<GrayImage>,
    /// Metres along the axis, row by row; 0 where nothing was measured. The sign has no meaning.
    pub depth_m: Vec<f32>,
}

/// File of one frame. Its bytes depend on the frame alone.
#[derive(Debug, Clone)]
struct EncodedFile {
    /// Folder in the log.
    folder: String,
    extension: &'static str,
    bytes: Vec<u8>,
}

/// Files of one frame, and its parts of each depth.npz.
#[derive(Debug, Clone)]
pub(super) struct EncodedImages {
    files: Vec<EncodedFile>,
    depths: Vec<DeflatedFrame>,
}

/// Encodes a frame: as differences from untouched images in a compact log, else in FeelSight's layout.
pub(super) fn encode(
    frame: &RawFrame,
    hand: &Hand,
    untouched: Option<&PerPad<RgbImage>>,
) -> Result<EncodedImages, String> {
    let (mut files, mut depths) = (Vec::new(), Vec::new());
    let mut add = |folder: String, extension, bytes| files.push(EncodedFile { folder, extension, bytes });
    for (pad, RawTouch { image, labels }) in frame.touch.iter().enumerate() {
        let folder = pad_folder(hand, pad);
        let of_pad = |e| format!("{}: {e}", pad_name(hand, pad));
        match (image, untouched) {
            (None, _) => {}
            (Some(image), Some(untouched)) => {
                let untouched = untouched.get(pad).ok_or_else(|| of_pad("it has no untouched image".to_owned()))?;
                let (bytes, is_difference) = compact::encode_touch(image, untouched).map_err(of_pad)?;
                add(format!("{folder}/{}", if is_difference { "difference" } else { "image" }), "jpg", bytes);
            }
            (Some(image), None) => add(format!("{folder}/image"), "jpg", encode_color(image).map_err(of_pad)?),
        }
        let Some((levels, mask)) = labels else { continue };
        let (levels, mask, extension) = match untouched {
            Some(_) => (compact::encode_levels(levels, hand, pad), encode_png(mask), "png"),
            None => (encode_exact(levels), encode_exact(mask), "jpg"),
        };
        add(format!("{folder}/depth"), extension, levels.map_err(of_pad)?);
        add(format!("{folder}/mask"), extension, mask.map_err(of_pad)?);
    }
    for RawCamera { name, size, image, segmentation, depth_m } in &frame.cameras {
        let folder = format!("realsense/{name}");
        let of_camera = |e| format!("{name}: {e}");
        if let Some(image) = image {
            let colors = if untouched.is_some() { compact::encode_camera_color(image) } else { encode_color(image) };
            add(format!("{folder}/image"), "jpg", colors.map_err(of_camera)?);
        }
        match (segmentation, untouched) {
            (Some(labels), Some(_)) => add(format!("{folder}/seg"), "png", encode_png(labels).map_err(of_camera)?),
            (Some(labels), None) => add(format!("{folder}/seg"), "jpg", encode_exact(labels).map_err(of_camera)?),
            (None, _) => {}
        }
        if untouched.is_some() {
            add(format!("{folder}/depth"), "png", compact::encode_camera_depth(depth_m, *size).map_err(of_camera)?);
        } else {
            // The camera's z is negative in front of it.
            let signed = depth_m.iter().map(|&depth| if depth == 0.0 { 0.0 } else { -depth.abs() });
            depths.push(DeflatedFrame::new(signed).map_err(|e| of_camera(e.to_string()))?);
        }
    }
    Ok(EncodedImages { files, depths })
}

/// Writer of the images of a log.
pub(super) struct FrameWriter {
    log: PathBuf,
    frames: usize,
    place: Place,
}

enum Place {
    /// FeelSight's folders, and depth.npz of each camera.
    Folders(Vec<(PathBuf, NpzWriter)>),
    /// frames.zip.
    Archive(Box<ArchiveWriter>),
}

impl FrameWriter {
    /// Begins the images in the folder of a log, of cameras with these names, widths and heights; compact if there are untouched images.
    pub fn create(
        log: &Path,
        cameras: &[(&str, (usize, usize))],
        hand: &Hand,
        untouched: Option<&PerPad<RgbImage>>,
    ) -> Result<Self, LogError> {
        let make = |folder: &Path| fs::create_dir_all(folder).map_err(LogError::io(folder));
        make(log)?;
        let place = if let Some(untouched) = untouched {
            Place::Archive(Box::new(compact::begin(log, hand, untouched)?))
        } else {
            let mut depths = Vec::new();
            for (name, (width, height)) in cameras {
                let folder = log.join("realsense").join(name);
                make(&folder)?;
                let path = folder.join("depth.npz");
                let writer = NpzWriter::create(&path, *height, *width).map_err(LogError::io(&path))?;
                depths.push((path, writer));
            }
            Place::Folders(depths)
        };
        Ok(Self { log: log.to_path_buf(), frames: 0, place })
    }

    /// Returns whether a frame has the depths of this log's cameras.
    pub fn fits(&self, frame: &EncodedImages) -> bool {
        match &self.place {
            Place::Folders(depths) => frame.depths.len() == depths.len(),
            Place::Archive(_) => frame.depths.is_empty(),
        }
    }

    /// Appends a frame.
    pub fn push(&mut self, frame: &EncodedImages) -> Result<(), LogError> {
        for EncodedFile { folder, extension, bytes } in &frame.files {
            match &mut self.place {
                Place::Archive(archive) => archive.add(&format!("{folder}/{}.{extension}", self.frames), bytes)?,
                Place::Folders(_) => {
                    let folder = self.log.join(folder);
                    if self.frames == 0 {
                        fs::create_dir_all(&folder).map_err(LogError::io(&folder))?;
                    }
                    let path = folder.join(format!("{}.{extension}", self.frames));
                    fs::write(&path, bytes).map_err(LogError::io(path))?;
                }
            }
        }
        if let Place::Folders(depths) = &mut self.place {
            for ((path, writer), depth) in depths.iter_mut().zip(&frame.depths) {
                writer.push(depth).map_err(LogError::io(path))?;
            }
        }
        self.frames += 1;
        Ok(())
    }

    /// Completes archive and depths, and syncs them to the disk.
    pub fn finish(self) -> Result<(), LogError> {
        match self.place {
            Place::Archive(archive) => archive.finish(),
            Place::Folders(depths) => {
                depths.into_iter().try_for_each(|(path, writer)| writer.finish(1.0).map_err(LogError::io(path)))
            }
        }
    }
}
