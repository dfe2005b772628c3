//! Frames of an RGB-D sequence without a hand.

use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

use anyhow::{Context as _, Result, anyhow};
use mvt_calibration::Calibration;
use mvt_frames::camera::PosedCamera;
use mvt_frames::depth::GivenLabels;
use mvt_frames::{Isometry, MeshFile, Object};
use mvt_perceive::{Perception, PerceptionConfig, PerceptionSetup, Seen};
use mvt_rgbd::RgbdFrame;
use mvt_robot::hand::{Hand, PerPad};
use mvt_robot::observation::{Observation, Rgbd};
use mvt_segmentation::{CarriedMask, SegmentationConfig};

use crate::carrier::leave_labels_open;

use super::{Pictures, RgbdSequence, Sensed, Source};

/// How wrong lengths of a camera may be whose colours do not lie on depth: nobody has calibrated it. The way of an object was 2 to 4 % too short with the
/// common intrinsics of a Kinect (7-Scenes).
const UNCALIBRATED_SIGMA: f64 = 0.04;

/// A sequence, read frame by frame. There is no hand, and the labels are those of its masks.
pub struct RgbdSource {
    hand: Arc<Hand>,
    sequence: RgbdSequence,
    perception: Perception,
    segmentation: SegmentationConfig,
    camera: PosedCamera,
    next: usize,
    /// Frames from this number on are left out.
    end: usize,
    object_from_file: Isometry<MeshFile, Object>,
    warnings: Vec<String>,
}

impl RgbdSource {
    /// Opens a folder or bag.
    ///
    /// # Errors
    /// If it cannot be used.
    pub fn open(path: &Path, config: PerceptionConfig) -> Result<Self> {
        let sequence = RgbdSequence::open(path)?;
        let first = sequence.intrinsics().zip(sequence.camera_poses().first().copied());
        let (intrinsics, pose) = first.with_context(|| format!("{}: there are no frames", path.display()))?;
        let camera = PosedCamera { name: "camera".to_owned(), intrinsics, pose };
        let hand = Hand::none();
        let setup = PerceptionSetup { weights: None, config };
        let perception = Perception::new(Arc::clone(&hand), vec![camera.clone()], &setup);
        let notes = sequence.notes().iter().map(|note| format!("{}: {note}", path.display()));
        Ok(Self {
            warnings: notes.collect(),
            hand,
            perception,
            segmentation: config.segmentation,
            camera,
            next: 0,
            end: sequence.len(),
            object_from_file: Isometry::identity(),
            sequence,
        })
    }

    /// Ends after this time.
    pub fn limit(&mut self, duration_s: f64) {
        let times_s = self.sequence.times_s();
        let until_s = times_s.first().unwrap_or(&0.0) + duration_s;
        self.end = times_s.iter().take_while(|time_s| **time_s < until_s).count();
    }

    /// Says how the mesh, whose poses the data set holds, lies in the object's frame.
    pub fn set_object_from_file(&mut self, object_from_file: Isometry<MeshFile, Object>) {
        self.object_from_file = object_from_file;
    }

    /// The sequence.
    pub fn sequence(&self) -> &RgbdSequence {
        &self.sequence
    }

    /// The camera, as it stands in the first frame.
    pub fn camera(&self) -> &PosedCamera {
        &self.camera
    }
}

impl Source for RgbdSource {
    fn next(&mut self) -> Result<Option<Sensed>> {
        let begun = Instant::now();
        let number = self.next;
        if number == self.end {
            return Ok(None);
        }
        self.next += 1;
        let RgbdFrame { time_s, color, depth_m, mask, world_from_camera, camera_from_object, .. } =
            self.sequence.frame(number)?;
        let is_carried = mask.is_none() && self.sequence.carries_masks();
        let color = if self.sequence.are_colours_registered() { color } else { Default::default() };
        // Without a mask nothing is known of a pixel.
        let depth_m = if mask.is_some() || is_carried { depth_m } else { Default::default() };
        let camera =
            Rgbd { color, depth_m, labels: mask.map(GivenLabels::Mask), world_from_camera: Some(world_from_camera) };
        let mut observation =
            Observation { time_s, joints: Vec::new(), touch: PerPad::default(), cameras: vec![camera] };
        let carried = (is_carried && leave_labels_open(&mut observation)).then(CarriedMask::default);
        let seen = self.perception.see(number as u64, observation, None);
        let Seen { percept, warnings, .. } =
            seen.map_err(|error| anyhow!("{}: frame {number}: {error}", self.sequence.path().display()))?;
        self.warnings.extend(warnings);
        let truth = camera_from_object.map(|pose| world_from_camera * pose * self.object_from_file.inverse());
        Ok(Some(Sensed {
            frame: number as u64,
            percept,
            truth,
            carried,
            pictures: Pictures::default(),
            sense_ms: begun.elapsed().as_secs_f64() * 1e3,
            hidden: None,
            warnings: std::mem::take(&mut self.warnings),
            events: Vec::new(),
        }))
    }

    fn hand(&self) -> &Arc<Hand> {
        &self.hand
    }

    fn carries_masks(&self) -> Option<SegmentationConfig> {
        self.sequence.carries_masks().then_some(self.segmentation)
    }

    fn camera_scale_sigma(&self) -> f64 {
        if self.sequence.are_colours_registered() { 0.0 } else { UNCALIBRATED_SIGMA }
    }

    fn frame_count(&self) -> usize {
        self.end
    }

    fn end(&self) -> (String, bool) {
        ("the sequence ended".to_owned(), true)
    }

    fn calibration(&self) -> Option<Calibration> {
        None
    }
}
