//! Reader of logs: those of this program, and those of the published data set, which deviate in details.

mod files;
mod images;
mod open;

pub use files::ImageFiles;

use std::path::{Path, PathBuf};
use std::sync::Arc;

use mvt_frames::camera::PosedCamera;
use mvt_frames::{Isometry, Object, World};
use mvt_robot::hand::{Hand, JointAngles, PerPad};
use mvt_robot::observation::{GroundTruth, Observation, Rgbd};

use crate::compact::CompactFrames;
use crate::depths::DepthReader;
use crate::error::LogError;
use crate::format::LogFormat;
use crate::lens::Lens;
use crate::live::LiveFile;
use crate::record::{DigitInfo, Matrix};
use crate::scene::SceneFile;

/// Open log. Images and depths are read on demand.
///
/// All poses are in the world in which [`Hand`] places its base, whatever the log's own world, and depths are positive. A log without
/// scene.json counts as a recording of a left Allegro unless data.pkl says otherwise, and its object frame is that of the mesh.
#[derive(Debug)]
pub struct Log {
    folder: PathBuf,
    scene: Option<SceneFile>,
    live: Option<LiveFile>,
    hand: Arc<Hand>,
    object_name: String,
    times_s: Vec<f64>,
    joints: Vec<JointAngles>,
    /// `None` where the log has only zeros, as it has while a tracker is lost.
    object_poses: Vec<Option<Isometry<Object, World>>>,
    finger_poses: Option<Vec<Vec<Matrix>>>,
    /// From the log's world to that of this program.
    world: Isometry<World, World>,
    digit: DigitInfo,
    cameras: Vec<PosedCamera>,
    /// The lens of each camera; `None` without distortion.
    lenses: Vec<Option<Lens>>,
    /// The images of a compact log; `None` in FeelSight's layout.
    compact: Option<Arc<CompactFrames>>,
    /// Which touch sensors have images; logs of other programs may lack some.
    felt: PerPad<bool>,
    /// Which cameras have colours.
    coloured: Vec<bool>,
    /// Whether every frame has true touch depths and masks.
    touch_labels: bool,
    /// Whether every frame has segmentations.
    segmentation: bool,
    /// Whether defects of single sensors are noted and not refused.
    tolerant: bool,
    notes: Vec<String>,
}

/// One instant of a log.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct LogFrame {
    /// Raw images and joint angles. Images of sensors that the log lacks are empty.
    pub observation: Observation,
    /// Ground truth, if the log has a pose of the object and every label. As a rule only simulated logs do.
    pub truth: Option<GroundTruth>,
}

impl Log {
    /// Returns the folder of the log.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// Returns the layout.
    pub fn format(&self) -> LogFormat {
        if self.compact.is_some() { LogFormat::Compact } else { LogFormat::FeelSight }
    }

    /// Returns the contents of scene.json, which only logs of this program have.
    pub fn scene(&self) -> Option<&SceneFile> {
        self.scene.as_ref()
    }

    /// Returns the contents of live.json, which only logs of live runs have.
    pub fn live(&self) -> Option<&LiveFile> {
        self.live.as_ref()
    }

    /// Returns the name of the object.
    pub fn object_name(&self) -> &str {
        &self.object_name
    }

    /// Returns the hand.
    pub fn hand(&self) -> &Arc<Hand> {
        &self.hand
    }

    /// Returns the number of frames.
    #[allow(clippy::len_without_is_empty, reason = "a log without frames is refused")]
    pub fn len(&self) -> usize {
        self.times_s.len()
    }

    /// Returns the time of each frame, seconds.
    pub fn times_s(&self) -> &[f64] {
        &self.times_s
    }

    /// Returns the joint angles of each frame.
    pub fn joints(&self) -> &[JointAngles] {
        &self.joints
    }

    /// Returns the pose of the object in each frame, also in logs without other labels. In recorded data it is an
    /// estimate, and `None` where the estimate is missing.
    pub fn object_poses(&self) -> &[Option<Isometry<Object, World>>] {
        &self.object_poses
    }

    /// Returns the cameras, in the order of the observations.
    pub fn cameras(&self) -> &[PosedCamera] {
        &self.cameras
    }

    /// Returns the encoding of touch depth.
    pub fn digit(&self) -> &DigitInfo {
        &self.digit
    }

    /// Returns the defects that were tolerated, in sentences.
    pub fn notes(&self) -> &[String] {
        &self.notes
    }

    /// Returns the poses of the touch sensors' cameras in the log's world, as recorded in data.pkl.
    pub(super) fn finger_poses(&self) -> Option<&[Vec<Matrix>]> {
        self.finger_poses.as_deref()
    }

    /// Returns the motion from the log's world to that of this program.
    pub(super) fn world(&self) -> Isometry<World, World> {
        self.world
    }

    /// Iterates over all frames in order. Depths are decompressed frame by frame.
    ///
    /// # Errors
    /// [`LogError`] if a depth.npz cannot be opened. At the first defect the iterator returns an error and ends.
    pub fn frames(&self) -> Result<LogFrames<'_>, LogError> {
        self.frames_from(0)
    }

    /// Iterates over the frames from number `first` on. The depths before it are decompressed, too.
    ///
    /// # Errors
    /// As [`Log::frames`].
    pub fn frames_from(&self, first: usize) -> Result<LogFrames<'_>, LogError> {
        let mut depths = Vec::new();
        for camera in 0..self.cameras.len() {
            let mut reader = self.depths(camera)?;
            for _ in 0..first.min(self.len()) {
                reader.skip()?;
            }
            depths.push(reader);
        }
        Ok(LogFrames { log: self, next: first, depths })
    }

    /// Reads frame number `i`; `None` beyond the last.
    ///
    /// # Errors
    /// As [`Log::frames_from`].
    pub fn frame(&self, i: usize) -> Result<Option<LogFrame>, LogError> {
        self.frames_from(i)?.next().transpose()
    }
}

/// Iterator over the frames of a log.
pub struct LogFrames<'a> {
    log: &'a Log,
    next: usize,
    depths: Vec<DepthReader>,
}

impl LogFrames<'_> {
    fn read(&mut self) -> Result<LogFrame, LogError> {
        let log = self.log;
        let i = self.next;
        let images = log.images(i)?;
        let mut cameras = Vec::new();
        for ((camera, color), depths) in images.color.into_iter().enumerate().zip(&mut self.depths) {
            let mut depth_m = log.next_depth(camera, depths)?;
            depth_m.mapv_inplace(|z| if z.is_finite() { z } else { 0.0 });
            cameras.push(Rgbd { color, depth_m, labels: None, world_from_camera: None });
        }
        let truth = match (images.touch_truth, images.labels, log.object_poses[i]) {
            (Some(touch), Some(labels), Some(object_pose)) => {
                Some(GroundTruth { object_pose, touch, shear: None, labels })
            }
            _ => None,
        };
        let joints = log.joints[i].clone();
        let observation = Observation { time_s: log.times_s[i], joints, touch: images.touch, cameras };
        Ok(LogFrame { observation, truth })
    }
}

impl Iterator for LogFrames<'_> {
    type Item = Result<LogFrame, LogError>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.next >= self.log.len() {
            return None;
        }
        let frame = self.read();
        self.next = if frame.is_ok() { self.next + 1 } else { self.log.len() };
        Some(frame)
    }
}
