//! A run as it was and looked, in a folder: what a viewer knows of a run, whether it is finished, still going or has crashed.
//!
//! ```text
//! DIR/recording/
//!   about.json       what is recorded; written first
//!   running          locked by the process that records, for as long as it does
//!   frames.jsonl     a line per frame; the last one may be incomplete
//!   images.bin       their images, one block after another
//!   shapes.jsonl     a line per shape
//!   shapes.bin       the true shape, where it is known, and the estimated ones as they grew
//!   events.jsonl     a line per event or warning
//!   end.json         how the run has ended; written last
//! ```
//!
//! Everything but about.json and end.json is appended to, what a line refers to before the line, so that a run that dies leaves what
//! it had. Lines give the checksums of the blocks that they refer to.

mod images;
mod line;
mod log;
mod reader;
mod shape;
#[cfg(test)]
mod tests;
mod writer;

use std::path::PathBuf;

use image::{GrayImage, RgbImage};
use mvt_frames::camera::PosedCamera;
use mvt_frames::{Isometry, Object, World};
use mvt_robot::digit;
use mvt_robot::hand::{JointAngles, PerFinger, Side};
use ndarray::Array2;
use serde::{Deserialize, Serialize};

pub use images::gel_depth_m;
pub use reader::Recording;
pub use shape::KnownShape;
pub use writer::Writer;

use mvt_run::report::{FrameRow, ShapePoint};

/// Version of the format. Readers refuse those that are newer.
pub const VERSION: u32 = 1;
/// Name of the folder in a run's folder.
pub const FOLDER: &str = "recording";

/// Whether the images of a frame are recorded: those of every third are.
pub fn has_images(frame: u64) -> bool {
    frame.is_multiple_of(3)
}

/// What is recorded.
#[derive(Debug, Clone, PartialEq)]
pub struct About {
    /// Version of the format.
    pub version: u32,
    /// Name in the catalogue or path of a mesh.
    pub object: String,
    /// Seed of the episode and of the estimate.
    pub seed: u64,
    /// `slam`, `pose` or `map`; `log` where nothing is estimated.
    pub mode: String,
    /// `vitac`, `vi` or `tac`.
    pub modality: String,
    /// Which hand.
    pub side: Side,
    /// The cameras, with the sizes of the recorded images.
    pub cameras: Vec<PosedCamera>,
    /// Frames there will be at most.
    pub frames: usize,
    /// The process that records.
    pub process: u32,
}

/// How a fingertip touches the object.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Touching {
    /// Area of the gel that is pressed in, square millimetres.
    pub area_mm2: f32,
    /// How far it is pressed in at most, millimetres.
    pub deepest_mm: f32,
    /// Sum of the normal forces, newtons, where a simulator knows it.
    pub force_n: Option<f32>,
}

impl Touching {
    /// From a DIGIT's depth in metres and its contact; none if nothing touches it.
    fn of(depth_m: &Array2<f32>, contact: &GrayImage, force_n: Option<f32>) -> Option<Self> {
        if !contact.contains(&255) {
            return None;
        }
        let lens = digit::intrinsics();
        let (mut area_m2, mut deepest_m) = (0.0, 0.0f32);
        let pixels = contact.iter().zip(depth_m).zip(gel_depth_m());
        for ((_, &depth_m), &gel_m) in pixels.filter(|((level, _), _)| **level > 127) {
            area_m2 += f64::from(depth_m).powi(2) / (lens.fx * lens.fy);
            deepest_m = deepest_m.max(gel_m - depth_m);
        }
        (area_m2 > 0.0).then_some(Self { area_mm2: (area_m2 * 1e6) as f32, deepest_mm: deepest_m * 1e3, force_n })
    }
}

/// A frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Moment {
    /// What was estimated, what was true and what it cost.
    pub row: FrameRow,
    /// Joint angles.
    pub joints: JointAngles,
    /// How each finger touches; none where it does not or nobody knows.
    pub fingers: PerFinger<Option<Touching>>,
    /// Whether the map keeps the frame.
    pub is_keyframe: bool,
    /// Whether something was estimated: in a log nothing is.
    is_estimated: bool,
    /// Where its images are, if it has some.
    images: Option<Place>,
}

impl Moment {
    /// The estimated pose, where something is estimated.
    pub fn estimate(&self) -> Option<Isometry<Object, World>> {
        self.is_estimated.then_some(self.row.estimate)
    }
}

/// A block of images.bin or shapes.bin.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
struct Place {
    at: u64,
    bytes: u64,
    crc32: u32,
}

/// What a camera saw, and what became of it. Each image may be empty.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct CameraImages {
    /// Colours.
    pub colour: RgbImage,
    /// Depth along the optical axis, metres; 0 where nothing was measured. Indexed (row, column).
    pub depth_m: Array2<f32>,
    /// Levels of [`mvt_robot::observation`].
    pub segmentation: GrayImage,
}

/// What a DIGIT showed, and what became of it. Each image may be empty.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct FingerImages {
    /// Colours.
    pub image: RgbImage,
    /// Depth that the tracker received, metres. Indexed (row, column).
    pub depth_m: Array2<f32>,
    /// 255 in contact.
    pub contact: GrayImage,
    /// True depth, metres, where it is known and not what the tracker received.
    pub true_depth_m: Option<Array2<f32>>,
}

/// The images of a frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Images {
    /// Index of the moment that they belong to.
    pub frame: usize,
    /// By camera.
    pub cameras: Vec<Option<CameraImages>>,
    /// By finger.
    pub touch: PerFinger<Option<FingerImages>>,
}

/// A shape that is on disk.
#[derive(Debug, Clone, PartialEq)]
pub struct ShapeEntry {
    /// Number of the frame at which it was known.
    pub frame: u64,
    /// Its scores, where the truth is known.
    pub point: Option<ShapePoint>,
    place: Place,
}

/// Whether a run goes on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Status {
    /// It does.
    Running,
    /// It came to its end.
    Finished,
    /// Somebody has ended it.
    Interrupted,
    /// Its process is gone and has not said why.
    Crashed,
}

/// Why a folder cannot be shown.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RecordingError {
    /// There is none.
    #[error("{0} holds no recording: give the folder of a run, such as the --out of `run`")]
    NoRecording(PathBuf),
    /// It was made by a later version of this program.
    #[error("{folder} holds a recording of version {found}, and this program reads up to {VERSION}: use a newer one")]
    NewerVersion {
        /// The folder.
        folder: PathBuf,
        /// Its version.
        found: u32,
    },
    /// A file is not as it was written.
    #[error("{file} is damaged: {problem}")]
    Damaged {
        /// The file.
        file: PathBuf,
        /// What is wrong with it.
        problem: String,
    },
    /// A file cannot be read or written.
    #[error("{file}: {error}")]
    Io {
        /// The file.
        file: PathBuf,
        /// Why.
        error: std::io::Error,
    },
    /// A raw log cannot be read.
    #[error(transparent)]
    Log(#[from] mvt_feelsight::LogError),
}

impl RecordingError {
    fn io(file: impl Into<PathBuf>) -> impl FnOnce(std::io::Error) -> Self {
        let file = file.into();
        move |error| Self::Io { file, error }
    }

    fn damaged(file: impl Into<PathBuf>, problem: impl std::fmt::Display) -> Self {
        Self::Damaged { file: file.into(), problem: problem.to_string() }
    }
}
