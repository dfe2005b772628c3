//! An RGB-D sequence without a hand, whatever holds it: a folder of images, or a bag of ROS 2.

use std::path::{Path, PathBuf};

use anyhow::{Result, anyhow, bail};
use mvt_bag::{Bag, BagFrame, RgbdBag, RgbdTopics};
use mvt_frames::camera::Intrinsics;
use mvt_frames::{Camera, Isometry, MeshFile, World};
use mvt_rgbd::{
    RgbdFrame, RgbdLayout, RgbdMasks, RgbdRecording, UNREGISTERED, are_carried, are_colours_registered,
    check_first_mask, masks_note,
};

/// An RGB-D sequence without a hand.
#[derive(Debug)]
pub enum RgbdSequence {
    /// A folder of images.
    Folder(RgbdRecording),
    /// A bag.
    Bag(Box<BagSequence>),
}

/// A bag as a sequence of frames with masks.
#[derive(Debug)]
pub struct BagSequence {
    path: PathBuf,
    bag: RgbdBag,
    /// Numbers of the frames in the bag: those with a pose of the camera, if some have one.
    kept: Vec<usize>,
    camera_poses: Vec<Isometry<Camera, World>>,
    object_poses: Vec<Option<Isometry<MeshFile, Camera>>>,
    times_s: Vec<f64>,
    names: Vec<String>,
    /// Masks in files, which replace those of the bag.
    masks: Option<RgbdMasks>,
    carries_masks: bool,
    notes: Vec<String>,
    are_colours_registered: bool,
}

/// File beside a bag that names topics and masks.
const BAG_FILE: &str = "bag.toml";

impl RgbdSequence {
    /// Returns whether a folder or file is such a sequence.
    pub fn is_here(path: &Path) -> bool {
        !path.join("data.pkl").exists() && (RgbdLayout::of(path).is_some() || Bag::is_here(path))
    }

    /// Opens a folder or a bag.
    ///
    /// # Errors
    /// If it cannot be used.
    pub fn open(path: &Path) -> Result<Self> {
        if RgbdLayout::of(path).is_none() && Bag::is_here(path) {
            return Ok(Self::Bag(Box::new(BagSequence::open(path)?)));
        }
        Ok(Self::Folder(RgbdRecording::open(path)?))
    }

    /// Returns the folder or file.
    pub fn path(&self) -> &Path {
        match self {
            Self::Folder(recording) => recording.folder(),
            Self::Bag(bag) => &bag.path,
        }
    }

    /// Returns how its files are laid out, in words.
    pub fn layout(&self) -> &'static str {
        match self {
            Self::Folder(recording) => match recording.layout() {
                RgbdLayout::Folders => "folders of images",
                RgbdLayout::Bop => "BOP",
                RgbdLayout::Ho3d => "HO3D",
                RgbdLayout::Tum => "TUM",
                RgbdLayout::Described => "rgbd.toml",
            },
            Self::Bag(_) => "bag of ROS 2",
        }
    }

    /// Returns the number of frames.
    pub fn len(&self) -> usize {
        match self {
            Self::Folder(recording) => recording.len(),
            Self::Bag(bag) => bag.kept.len(),
        }
    }

    /// Returns whether there are no frames: never, because such a sequence is refused.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Returns the times of the frames, seconds, rising.
    pub fn times_s(&self) -> Vec<f64> {
        match self {
            Self::Folder(recording) => recording.times_s().collect(),
            Self::Bag(bag) => bag.times_s.clone(),
        }
    }

    /// Returns the names of the frames: those of the data set, or stamps in nanoseconds.
    pub fn names(&self) -> Vec<String> {
        match self {
            Self::Folder(recording) => recording.names().map(str::to_owned).collect(),
            Self::Bag(bag) => bag.names.clone(),
        }
    }

    /// Returns the poses of the camera in the frames; all are the identity if they are unknown.
    pub fn camera_poses(&self) -> Vec<Isometry<Camera, World>> {
        match self {
            Self::Folder(recording) => recording.camera_poses().collect(),
            Self::Bag(bag) => bag.camera_poses.clone(),
        }
    }

    /// Returns the true poses of the object in the frames, where they are known.
    pub fn object_poses(&self) -> Vec<Option<Isometry<MeshFile, Camera>>> {
        match self {
            Self::Folder(recording) => recording.object_poses().collect(),
            Self::Bag(bag) => bag.object_poses.clone(),
        }
    }

    /// Returns the object's name in the data set, if it has one.
    pub fn object_name(&self) -> Option<&str> {
        match self {
            Self::Folder(recording) => recording.object_name(),
            Self::Bag(_) => None,
        }
    }

    /// Returns notes on assumptions and omissions, in sentences.
    pub fn notes(&self) -> &[String] {
        match self {
            Self::Folder(recording) => recording.notes(),
            Self::Bag(bag) => &bag.notes,
        }
    }

    /// Returns whether the colours lie on depth, pixel by pixel; others are not used.
    pub fn are_colours_registered(&self) -> bool {
        match self {
            Self::Folder(recording) => recording.are_colours_registered(),
            Self::Bag(bag) => bag.are_colours_registered,
        }
    }

    /// Returns whether the program carries masks into the frames that have none, instead of leaving these out.
    pub fn carries_masks(&self) -> bool {
        match self {
            Self::Folder(recording) => recording.carries_masks(),
            Self::Bag(bag) => bag.carries_masks,
        }
    }

    /// Returns the pinhole model of the depth images; of the first where they differ.
    pub fn intrinsics(&self) -> Option<Intrinsics> {
        match self {
            Self::Folder(recording) => recording.intrinsics(0),
            Self::Bag(bag) => Some(bag.bag.intrinsics()),
        }
    }

    /// Reads a frame. Frames are read fastest in their order.
    ///
    /// # Errors
    /// If there is no such frame, or one of its images is damaged.
    pub fn frame(&mut self, k: usize) -> Result<RgbdFrame> {
        match self {
            Self::Folder(recording) => Ok(recording.frame(k)?),
            Self::Bag(bag) => bag.frame(k),
        }
    }
}

impl BagSequence {
    fn open(path: &Path) -> Result<Self> {
        let mut topics = RgbdTopics::beside(path)?;
        // A topic has no `*` in its name.
        let pattern = topics.masks.take_if(|masks| masks.contains('*'));
        let object = topics.object;
        let carry_masks = topics.carry_masks;
        let bag = RgbdBag::open_with(path, &topics)?;
        let known: Vec<Option<Isometry<Camera, World>>> = bag.camera_poses().collect();
        let is_moving = known.iter().any(Option::is_some);
        let kept: Vec<usize> =
            (0..bag.len()).filter(|k| !is_moving || known.get(*k).is_some_and(Option::is_some)).collect();
        // Some begin with the name of the file, as ours will.
        let prefix = format!("{}: ", path.display());
        let mut notes: Vec<String> =
            bag.notes().iter().map(|note| note.strip_prefix(&prefix).unwrap_or(note).to_owned()).collect();
        if kept.len() < bag.len() {
            notes.push(format!(
                "{} of {} frames have a pose of the camera; the others are left out",
                kept.len(),
                bag.len()
            ));
        }
        let stamps_ns: Vec<i64> = bag.stamps_ns().collect();
        let times_s: Vec<f64> = bag.times_s().collect();
        fn at<T: Clone>(kept: &[usize], values: &[T]) -> Vec<T> {
            kept.iter().filter_map(|k| values.get(*k).cloned()).collect()
        }
        let masks = match pattern {
            Some(pattern) => {
                let folder = if path.is_dir() { path } else { path.parent().unwrap_or(path) };
                Some(RgbdMasks::open(folder, &pattern, object.map(u32::from), &stamps_ns)?)
            }
            None => None,
        };
        let mut sequence = Self {
            path: path.to_owned(),
            camera_poses: at(&kept, &known).into_iter().map(|pose| pose.unwrap_or_else(Isometry::identity)).collect(),
            object_poses: at(&kept, &bag.object_poses().collect::<Vec<_>>()),
            times_s: at(&kept, &times_s),
            names: at(&kept, &stamps_ns).iter().map(i64::to_string).collect(),
            bag,
            kept,
            masks,
            carries_masks: false,
            notes,
            are_colours_registered: true,
        };
        sequence.check_masks(carry_masks)?;
        Ok(sequence)
    }

    /// Checks that there are masks, and that the first of them shows an object at a plausible distance.
    fn check_masks(&mut self, carry_masks: Option<bool>) -> Result<()> {
        let in_bag: Vec<bool> = self.bag.has_mask().collect();
        let has_mask = |k: &usize| match &self.masks {
            Some(masks) => masks.has(*k),
            None => in_bag.get(*k).copied().unwrap_or(false),
        };
        let masked: Vec<usize> =
            self.kept.iter().enumerate().filter(|(_, k)| has_mask(k)).map(|(place, _)| place).collect();
        let (with, Some(&first)) = (masked.len(), masked.first()) else {
            bail!(
                "{}: there are no masks of the object: write `masks = \"TOPIC\"`, or `masks = \"masks/*.png\"` for files that are named by the stamps of the depth images in nanoseconds, into {BAG_FILE} beside it",
                self.path.display()
            );
        };
        self.carries_masks = are_carried(with, self.kept.len(), carry_masks);
        self.notes.extend(masks_note(with, self.kept.len(), self.carries_masks));
        let RgbdFrame { name, depth_m, mask, .. } = self.frame(first)?;
        check_first_mask(&name, &depth_m, &mask.unwrap_or_default(), BAG_FILE)
            .map_err(|fault| anyhow!("{}: {fault}", self.path.display()))?;
        let read = |k| self.frame(k).map(|RgbdFrame { color, mask, .. }| (color, mask.unwrap_or_default()));
        self.are_colours_registered = are_colours_registered(&masked, read)?;
        if !self.are_colours_registered {
            self.notes.push(UNREGISTERED.to_owned());
        }
        Ok(())
    }

    fn frame(&mut self, k: usize) -> Result<RgbdFrame> {
        let (Some(&number), Some(name)) = (self.kept.get(k), self.names.get(k).cloned()) else {
            bail!("{}: there is no frame {k}; there are {}", self.path.display(), self.kept.len());
        };
        let BagFrame { time_s, color, depth_m, mask, intrinsics, world_from_camera, camera_from_object, .. } =
            self.bag.frame(number)?;
        let mask = match &self.masks {
            None => mask,
            Some(masks) => match masks.mask(number)? {
                None => None,
                Some(drawn) => {
                    let (rows, columns) = drawn.dim();
                    let Some(mask) = self.bag.mask_over_depth(drawn) else {
                        bail!(
                            "{}: the mask of frame {name} is {columns} x {rows} pixels, of another shape than depth with {} x {}: draw it on the colour image",
                            self.path.display(),
                            intrinsics.width,
                            intrinsics.height
                        );
                    };
                    Some(mask)
                }
            },
        };
        Ok(RgbdFrame {
            name,
            time_s,
            color,
            depth_m,
            mask,
            intrinsics,
            world_from_camera: world_from_camera.unwrap_or_else(Isometry::identity),
            camera_from_object,
        })
    }
}
