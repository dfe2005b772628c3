//! Recordings of runs: poses, images, shapes and events in a folder, from which a viewer shows a run.
//!
//! A [`RecordingWriter`] writes on a thread of its own, so that the run never waits; it leaves images out when the disk
//! is too slow. A [`Recording`] reads runs that are finished, still going or have crashed, and FeelSight logs.
//! Recordings are for looking at: images are reduced, and nothing here can resume or score a run.
//!
//! ```text
//! DIR/recording/
//!   about.json       object, mode, seed and cameras; written first
//!   running          locked by the recording process while it records
//!   frames.jsonl     a line per frame; the last one may be incomplete
//!   images.bin       images of the frames, one block after another
//!   shapes.jsonl     a line per shape
//!   shapes.bin       the true shape, where it is known, and the estimated shapes
//!   events.jsonl     a line per event or warning
//!   end.json         whether the run is complete; written last
//! ```
//!
//! All files but about.json and end.json are appended to. A block is written before the line that refers to it, so that
//! a run that is killed leaves a valid recording. Lines hold the checksums of their blocks.
//!
//! ```
//! use mvt_recording::mvt_robot::hand::{Hand, Side};
//! use mvt_recording::mvt_run::{estimator::Mode, pipeline::Progress, source::Modality};
//! use mvt_recording::{About, Recording, RecordingWriter, Status, VERSION};
//!
//! let folder = std::env::temp_dir().join("mvt-recording-example");
//! let about = About {
//!     version: VERSION,
//!     object: "duck".into(),
//!     seed: 0,
//!     mode: Some(Mode::Slam),
//!     modality: Modality::Vitac,
//!     hand: Hand::allegro(Side::Left),
//!     cameras: vec![],
//!     frames: 2,
//!     process: std::process::id(),
//! };
//! let writer = RecordingWriter::create(&folder, &about, None)?;
//! // A listener of a pipeline passes on all progress: frames, shapes, warnings and events.
//! writer.receive(Progress::Warning("no touch sensor touches the object"));
//! writer.finish(true)?;
//!
//! let recording = Recording::open(&folder)?;
//! assert_eq!((recording.moments().len(), recording.status()), (0, Status::Finished));
//! # std::fs::remove_dir_all(&folder)?;
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

// Why: notes/decisions/viewing.md, "A folder between run and viewer, not a channel".

mod feelsight_log;
mod file_names;
mod images;
mod lines;
mod reader;
mod shape;
#[cfg(test)]
mod tests;
mod writer;

use std::path::PathBuf;
use std::sync::Arc;

use image::RgbImage;
use mvt_frames::camera::PosedCamera;
use mvt_frames::depth::Label;
use mvt_frames::{Isometry, Object, World};
use mvt_robot::digit::gel::GelView;
use mvt_robot::hand::{Hand, JointAngles, PerPad};
use mvt_robot::observation::Press;
use ndarray::Array2;
use serde::{Deserialize, Serialize};

pub use reader::Recording;
pub use shape::RecordedShape;
pub use writer::RecordingWriter;
pub use {glam, image, mvt_frames, mvt_mesh, mvt_robot, mvt_run, ndarray};

use mvt_run::estimator::Mode;
use mvt_run::report::{FrameRow, ShapePoint};
use mvt_run::source::Modality;

/// Version of the format. Readers refuse those that are newer.
pub const VERSION: u32 = 1;
/// Name of the recording's folder in the folder of a run.
pub const FOLDER: &str = "recording";

/// Whether the images of a frame are recorded: those of every third frame are.
pub fn has_images(frame: u64) -> bool {
    frame.is_multiple_of(3)
}

/// Description of a recorded run.
#[derive(Debug, Clone, PartialEq)]
pub struct About {
    /// Version of the format.
    pub version: u32,
    /// Name in the catalogue or path of a mesh.
    pub object: String,
    /// Seed of the episode and of the estimate.
    pub seed: u64,
    /// The estimated quantities; `None` for a raw log.
    pub mode: Option<Mode>,
    /// Which sensors are used.
    pub modality: Modality,
    /// The hand, with its touch sensors.
    pub hand: Arc<Hand>,
    /// The cameras, with the sizes of the recorded images.
    pub cameras: Vec<PosedCamera>,
    /// Largest number of frames.
    pub frames: usize,
    /// Number of the recording process.
    pub process: u32,
}

/// Contact of a pad.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Touching {
    /// Area of contact on the gel, square millimetres.
    pub area_mm2: f32,
    /// Largest indentation, millimetres.
    pub deepest_mm: f32,
    /// Sum of the normal forces, newtons, where a simulator knows it.
    pub force_n: Option<f32>,
}

impl Touching {
    /// From a press on a gel; `None` if nothing touches it.
    fn of(press: &Press, gel: &GelView, force_n: Option<f32>) -> Option<Self> {
        let lens = gel.camera();
        let (mut area_m2, mut deepest_mm) = (0.0, 0.0f32);
        let pixels = press.contact.iter().zip(&press.indentation_mm).zip(gel.depth_m());
        for ((_, &indentation_mm), &gel_m) in pixels.filter(|((touches, _), _)| **touches) {
            let depth_m = gel_m - 1e-3 * indentation_mm;
            area_m2 += f64::from(depth_m).powi(2) / (lens.fx * lens.fy);
            deepest_mm = deepest_mm.max(indentation_mm);
        }
        (area_m2 > 0.0).then_some(Self { area_mm2: (area_m2 * 1e6) as f32, deepest_mm, force_n })
    }
}

/// Recorded frame.
#[derive(Debug, Clone, PartialEq)]
pub struct RecordedMoment {
    /// Estimate, ground truth and time.
    pub row: FrameRow,
    /// Joint angles.
    pub joints: JointAngles,
    /// Contact of each pad; `None` without contact or if it is unknown.
    pub touching: PerPad<Option<Touching>>,
    /// Whether the map keeps the frame.
    pub is_keyframe: bool,
    /// Whether the row holds an estimate; a log has none.
    is_estimated: bool,
    /// BlockPlace of its images, if it has some.
    images: Option<BlockPlace>,
}

impl RecordedMoment {
    /// Returns the estimated pose; a log has none.
    pub fn estimate(&self) -> Option<Isometry<Object, World>> {
        self.is_estimated.then_some(self.row.estimate)
    }
}

/// Place of a block in images.bin or shapes.bin.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
struct BlockPlace {
    at: u64,
    bytes: u64,
    crc32: u32,
}

/// Images of a camera at one frame. Each may be empty.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct CameraImages {
    /// Colours.
    pub colour: RgbImage,
    /// Depth along the optical axis, metres; 0 where nothing was measured. Indexed (row, column).
    pub depth_m: Array2<f32>,
    /// What each pixel shows.
    pub labels: Array2<Label>,
}

/// Images of a touch sensor at one frame. Each may be empty.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct TouchImages {
    /// Colours.
    pub image: RgbImage,
    /// Indentation that the tracker received, millimetres. Indexed (row, column).
    pub indentation_mm: Array2<f32>,
    /// Where the object touches.
    pub contact: Array2<bool>,
    /// True indentation, millimetres, where it is known and the tracker received another.
    pub true_indentation_mm: Option<Array2<f32>>,
}

/// The images of a frame.
#[derive(Debug, Clone, PartialEq)]
pub struct FrameImages {
    /// Index of their moment.
    pub frame: usize,
    /// By camera.
    pub cameras: Vec<Option<CameraImages>>,
    /// By pad.
    pub touch: PerPad<Option<TouchImages>>,
}

/// Shape on disk.
#[derive(Debug, Clone, PartialEq)]
pub struct ShapeEntry {
    /// Number of the frame at which it was estimated.
    pub frame: u64,
    /// Its scores, where the true shape is known.
    pub point: Option<ShapePoint>,
    place: BlockPlace,
}

/// Status of a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Status {
    /// It goes on.
    Running,
    /// It is complete.
    Finished,
    /// It was interrupted and has written its results so far.
    Interrupted,
    /// Its process has ended without finishing the recording.
    Crashed,
}

/// Why a recording cannot be read or written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RecordingError {
    /// The folder holds no recording.
    #[error("{0} holds no recording; give the folder that a run has written")]
    NoRecording(PathBuf),
    /// A later version of this program has written it.
    #[error("{folder} holds a recording of version {found}, and this program reads up to {VERSION}; use a newer one")]
    NewerVersion {
        /// The folder.
        folder: PathBuf,
        /// Its version.
        found: u32,
    },
    /// A file is damaged.
    #[error("{file} is damaged: {problem}")]
    Damaged {
        /// The file.
        file: PathBuf,
        /// The problem.
        problem: String,
    },
    /// A file cannot be read or written.
    #[error("{file}: {error}")]
    Io {
        /// The file.
        file: PathBuf,
        /// The reason.
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
