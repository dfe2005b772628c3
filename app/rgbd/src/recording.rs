//! A sequence of RGB-D images with what is known of each.

use std::path::{Path, PathBuf};

use image::RgbImage;
use mvt_frames::camera::Intrinsics;
use mvt_frames::{Camera, Isometry, MeshFile, World};
use ndarray::Array2;

use crate::description::{self, Description};
use crate::error::RgbdError;
use crate::masks::{are_carried, masks_note};
use crate::parts::{FrameFiles, Parts};
use crate::pixels::{self, DepthCode};
use crate::registration::{UNREGISTERED, are_colours_registered};
use crate::{bop, folders, ho3d, tum};

/// How the files of a folder are laid out.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RgbdLayout {
    /// `rgb/ depth/ cam_K.txt`, as BundleSDF, FoundationPose and YCBInEOAT have it.
    Folders,
    /// A scene of BOP.
    Bop,
    /// A sequence of HO3D.
    Ho3d,
    /// A sequence of the TUM RGB-D benchmark.
    Tum,
    /// As rgbd.toml says.
    Described,
}

impl RgbdLayout {
    /// Recognises a folder by its files; `None` if it is no RGB-D sequence.
    pub fn of(folder: &Path) -> Option<Self> {
        let has = |names: &[&str]| names.iter().any(|name| folder.join(name).is_dir());
        if bop::is_here(folder) {
            Some(Self::Bop)
        } else if tum::is_here(folder) {
            Some(Self::Tum)
        } else if ho3d::is_here(folder) {
            Some(Self::Ho3d)
        } else if has(&["rgb", "color"]) && has(&["depth"]) {
            Some(Self::Folders)
        } else {
            folder.join(description::FILE).is_file().then_some(Self::Described)
        }
    }
}

/// A sequence of RGB-D images.
#[derive(Debug, Clone)]
pub struct RgbdRecording {
    folder: PathBuf,
    layout: RgbdLayout,
    frames: Vec<FrameFiles>,
    code: DepthCode,
    object: Option<u32>,
    object_name: Option<String>,
    notes: Vec<String>,
    /// Width and height of colours and of depth, pixels.
    sizes: [[usize; 2]; 2],
    are_colours_registered: bool,
    carries_masks: bool,
}

/// A frame of a sequence.
#[derive(Debug, Clone)]
pub struct RgbdFrame {
    /// Its name in the data set, such as `000123`.
    pub name: String,
    /// Seconds, as the data set counts them.
    pub time_s: f64,
    /// Colours, of the size of depth; empty in a frame of a live run without colours.
    pub color: RgbImage,
    /// Depth along the optical axis, metres, 0 where nothing was measured.
    pub depth_m: Array2<f32>,
    /// Where the object is visible, of the size of depth; `None` in a frame without a mask.
    pub mask: Option<Array2<bool>>,
    /// Pinhole model of the depth image.
    pub intrinsics: Intrinsics,
    /// Pose of the camera; that of the first frame if the data set knows none.
    pub world_from_camera: Isometry<Camera, World>,
    /// True pose of the object, if the data set knows it, in the coordinates of its mesh.
    pub camera_from_object: Option<Isometry<MeshFile, Camera>>,
}

/// Distances of an object between which a unit of depth is plausible, metres.
const PLAUSIBLE_M: std::ops::Range<f32> = 0.1..8.0;
/// The principal point lies in this part of the width and height: else the intrinsics are of another resolution.
const MIDDLE: std::ops::Range<f64> = 0.25..0.75;

/// Returns the median distance of an object along the optical axis, metres; `None` if nothing was measured inside of its mask.
pub fn object_distance_m(depth_m: &Array2<f32>, mask: &Array2<bool>) -> Option<f32> {
    let inside = mask.iter().zip(depth_m).filter(|(inside, depth)| **inside && **depth > 0.0);
    let mut depths: Vec<f32> = inside.map(|(_, depth)| *depth).collect();
    let middle = depths.len() / 2;
    (!depths.is_empty()).then(|| *depths.select_nth_unstable_by(middle, f32::total_cmp).1)
}

/// Checks that the first frame with a mask shows the object at a plausible distance.
///
/// # Errors
/// The fault and what to do, in one line; `file` is where `depth_unit_m` stands.
pub fn check_first_mask(name: &str, depth_m: &Array2<f32>, mask: &Array2<bool>, file: &str) -> Result<(), String> {
    let Some(median_m) = object_distance_m(depth_m, mask) else {
        let is_empty = !mask.iter().any(|inside| *inside);
        let what = if is_empty { "its mask is empty" } else { "nothing was measured inside of its mask" };
        return Err(format!(
            "frame {name} is the first with a mask, and {what}: start at a frame that shows the object"
        ));
    };
    if PLAUSIBLE_M.contains(&median_m) {
        return Ok(());
    }
    Err(format!(
        "the object is {median_m:.3} m away in frame {name}: is the unit of depth right? `depth_unit_m` in {file} states it"
    ))
}

impl RgbdRecording {
    /// Opens a folder.
    ///
    /// # Errors
    /// [`RgbdError`] if it is not recognised, lacks a part, or its intrinsics, sizes or unit of depth cannot be right.
    pub fn open(folder: &Path) -> Result<Self, RgbdError> {
        let description = Description::of(folder)?;
        let layout = RgbdLayout::of(folder).ok_or_else(|| {
            RgbdError::fault(folder, "it is no RGB-D sequence: there are neither rgb/ and depth/ nor rgb.txt, scene_camera.json or rgbd.toml")
        })?;
        let parts = match layout {
            RgbdLayout::Folders | RgbdLayout::Described => folders::parts(folder, &description)?,
            RgbdLayout::Bop => bop::parts(folder, &description)?,
            RgbdLayout::Ho3d => ho3d::parts(folder, &description)?,
            RgbdLayout::Tum => tum::parts(folder, &description)?,
        };
        let Parts { mut frames, code, object, mut notes, object_name } = parts;
        let object_name = description.object_name(folder)?.or(object_name);
        let before = frames.len();
        let mut newest_s = f64::NEG_INFINITY;
        frames.retain(|frame| {
            let is_newer = frame.time_s > newest_s;
            newest_s = newest_s.max(frame.time_s);
            is_newer
        });
        if frames.len() < before {
            notes.push(format!("{} frames that are not newer than the one before are left out", before - frames.len()));
        }
        let Some(first) = frames.first() else {
            return Err(RgbdError::fault(folder, "no colour image belongs to a depth image: are their names alike?"));
        };
        let depth = pixels::depth_m(&first.depth, code)?;
        let depth_size = [depth.ncols(), depth.nrows()];
        let coloured = frames.iter().find_map(|frame| frame.color.as_deref());
        let color_size = coloured.map_or(Ok(depth_size), pixels::size)?;
        let mut recording = Self {
            folder: folder.to_owned(),
            layout,
            frames,
            code,
            object,
            object_name,
            notes,
            sizes: [color_size, depth_size],
            are_colours_registered: true,
            carries_masks: false,
        };
        if !description.live {
            recording.check_sizes()?;
            recording.check_masks(description.carry_masks)?;
            recording.check_colours()?;
        }
        Ok(recording)
    }

    fn check_sizes(&self) -> Result<(), RgbdError> {
        let [[width, height], [depth_width, depth_height]] = self.sizes;
        if width * depth_height != height * depth_width {
            return Err(RgbdError::fault(
                &self.folder,
                format!(
                    "colours are {width} x {height} pixels and depth {depth_width} x {depth_height}, of another shape: register depth to the colours first"
                ),
            ));
        }
        let odd = self.frames.iter().find(|frame| {
            let [_, _, cx, cy] = frame.intrinsics;
            !MIDDLE.contains(&(cx / width as f64)) || !MIDDLE.contains(&(cy / height as f64))
        });
        odd.map_or(Ok(()), |frame| {
            let [_, _, cx, cy] = frame.intrinsics;
            let fault = format!(
                "the principal point ({cx:.0}, {cy:.0}) is not in the middle of images of {width} x {height} pixels: the intrinsics are of another resolution"
            );
            Err(RgbdError::fault(&self.folder, fault))
        })
    }

    /// Checks that there are masks, and that the object has a plausible distance in the first of them.
    fn check_masks(&mut self, carry_masks: Option<bool>) -> Result<(), RgbdError> {
        let with = self.frames.iter().filter(|frame| frame.mask.is_some()).count();
        if with == 0 {
            let fault = format!(
                "there are no masks of the object: put them into masks/, or name them in {}",
                description::FILE
            );
            return Err(RgbdError::fault(&self.folder, fault));
        }
        self.carries_masks = are_carried(with, self.frames.len(), carry_masks);
        self.notes.extend(masks_note(with, self.frames.len(), self.carries_masks));
        let first = self.frames.iter().position(|frame| frame.mask.is_some()).unwrap_or(0);
        let RgbdFrame { name, depth_m, mask, .. } = self.frame(first)?;
        check_first_mask(&name, &depth_m, &mask.unwrap_or_default(), description::FILE)
            .map_err(|fault| RgbdError::fault(&self.folder, fault))
    }

    /// Compares colours with masks in frames spread over the sequence.
    fn check_colours(&mut self) -> Result<(), RgbdError> {
        let masked: Vec<usize> = (0..self.len()).filter(|&k| self.frames[k].mask.is_some()).collect();
        let read = |k| self.frame(k).map(|RgbdFrame { color, mask, .. }| (color, mask.unwrap_or_default()));
        self.are_colours_registered = are_colours_registered(&masked, read)?;
        if !self.are_colours_registered {
            self.notes.push(UNREGISTERED.to_owned());
        }
        Ok(())
    }

    /// Returns whether the colours lie on depth, pixel by pixel; others are not used.
    pub fn are_colours_registered(&self) -> bool {
        self.are_colours_registered
    }

    /// Returns whether masks are carried into the frames that have none, instead of leaving these out.
    pub fn carries_masks(&self) -> bool {
        self.carries_masks
    }

    /// Returns the folder.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// Returns how its files are laid out.
    pub fn layout(&self) -> RgbdLayout {
        self.layout
    }

    /// Returns the number of frames.
    pub fn len(&self) -> usize {
        self.frames.len()
    }

    /// Returns whether there are no frames: never, because such a folder is refused.
    pub fn is_empty(&self) -> bool {
        self.frames.is_empty()
    }

    /// Returns the times of the frames, seconds, rising.
    pub fn times_s(&self) -> impl Iterator<Item = f64> {
        self.frames.iter().map(|frame| frame.time_s)
    }

    /// Returns the names of the frames in the data set.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.frames.iter().map(|frame| frame.name.as_str())
    }

    /// Returns the poses of the camera in the frames; all are the identity if the data set knows none.
    pub fn camera_poses(&self) -> impl Iterator<Item = Isometry<Camera, World>> {
        self.frames.iter().map(|frame| frame.world_from_camera.unwrap_or_else(Isometry::identity))
    }

    /// Returns the true poses of the object in the frames, where the data set knows them.
    pub fn object_poses(&self) -> impl Iterator<Item = Option<Isometry<MeshFile, Camera>>> {
        self.frames.iter().map(|frame| frame.camera_from_object)
    }

    /// Returns the object's name in the data set, if it has one.
    pub fn object_name(&self) -> Option<&str> {
        self.object_name.as_deref()
    }

    /// Returns notes on assumptions and omissions, in sentences.
    pub fn notes(&self) -> &[String] {
        &self.notes
    }

    /// Returns the pinhole model of the depth image of a frame.
    pub fn intrinsics(&self, k: usize) -> Option<Intrinsics> {
        let [fx, fy, cx, cy] = self.frames.get(k)?.intrinsics;
        let [[color_width, _], [width, height]] = self.sizes;
        let scale = width as f64 / color_width as f64;
        // Centres of pixels are at whole numbers. Without a scale the last bit stays.
        let place = |c: f64| if scale == 1.0 { c } else { (c + 0.5) * scale - 0.5 };
        Some(Intrinsics { width, height, fx: fx * scale, fy: fy * scale, cx: place(cx), cy: place(cy) })
    }

    /// Reads a frame.
    ///
    /// # Errors
    /// [`RgbdError`] if there is no such frame, or an image is damaged or has another size than those of the first frame.
    pub fn frame(&self, k: usize) -> Result<RgbdFrame, RgbdError> {
        let (Some(files), Some(intrinsics)) = (self.frames.get(k), self.intrinsics(k)) else {
            return Err(RgbdError::fault(
                &self.folder,
                format!("there is no frame {k}; there are {}", self.frames.len()),
            ));
        };
        let depth_m = pixels::depth_m(&files.depth, self.code)?;
        let (size, found) = (self.sizes[1], [depth_m.ncols(), depth_m.nrows()]);
        if found != size {
            let fault =
                format!("{} x {} pixels; the first depth image has {} x {}", found[0], found[1], size[0], size[1]);
            return Err(RgbdError::fault(&files.depth, fault));
        }
        let color = files.color.as_deref().map(|path| pixels::colour(path, size)).transpose()?.unwrap_or_default();
        let mask = files.mask.as_deref().map(|path| pixels::mask(path, self.object, size)).transpose()?;
        Ok(RgbdFrame {
            name: files.name.clone(),
            time_s: files.time_s,
            color,
            depth_m,
            mask,
            intrinsics,
            world_from_camera: files.world_from_camera.unwrap_or_else(Isometry::identity),
            camera_from_object: files.camera_from_object,
        })
    }
}
