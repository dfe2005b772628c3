//! Files of a run. All of them are functions of its record ([`RunRecord`]) and of its meshes; nothing here simulates or estimates.
//!
//! A file appears under its name only when it is complete: it is written beside it and renamed.

use std::fs;
use std::path::Path;

use anyhow::Result;
use mvt_calibration::Calibration;
use mvt_frames::{Field, Isometry, Object, World};
use mvt_mesh::Mesh;
use mvt_metrics::{AddS, TrueSurface};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::estimator::Mode;
use crate::explorer::ExplorerChoice;
use crate::io::write_file;
use crate::observed::Observed;
use crate::source::Modality;
use crate::truth::Truth;
pub use mvt_slam::{Deviation, TrackState};

mod camera_poses;
mod carried_masks;
mod coordinates;
mod curves;
mod live;
pub mod mesh_file;
mod summary;
mod surface_colours;
mod table;
#[cfg(test)]
mod tests;
mod tracked;
mod trajectory;
mod turntable;
mod words;

pub use camera_poses::{FrameCamera, write_camera_poses};
pub use carried_masks::CarriedMasks;
pub use coordinates::Coordinates;
pub use live::{CommandRecord, LiveLatency, LiveLogRecord, LiveRecord, LiveTopicRecord, SharedLiveRecord};
pub use summary::{ErrorStatistics, KNOWN_RAD, ObservedScores, RotationStatistics, SURE_M, ShapeScores, Summary};
pub use surface_colours::SurfaceColours;
pub use tracked::{benchmark, is_symmetric};
pub use trajectory::{read_trajectory, stated_coordinates, write_trajectory};
pub use words::in_words;

/// Names of the files in a run's folder.
pub mod file {
    /// See [`super::Summary`].
    pub const SUMMARY: &str = "summary.json";
    /// See [`super::write_trajectory`].
    pub const TRAJECTORY: &str = "trajectory.csv";
    /// The estimated surface in the frame that the estimated poses lead from, coloured by its error where the truth is known.
    pub const PLY: &str = "mesh.ply";
    /// The same without colours.
    pub const OBJ: &str = "mesh.obj";
    /// The same in the colours that a camera saw; without a camera in colour there is none.
    pub const GLB: &str = "mesh.glb";
    /// Pose error, shape scores, confidence and time per frame over time.
    pub const CURVES: &str = "curves.svg";
    /// The estimated surface turns beside the true one, coloured by its error.
    pub const TURNTABLE: &str = "mesh.gif";
}

/// A run as it was recorded, whole or up to where it was interrupted.
#[derive(Debug, Clone, Default)]
pub struct RunRecord {
    /// Name in the catalogue or path of a mesh.
    pub object: String,
    /// Seed of the episode, of its noise and of the estimate.
    pub seed: u64,
    /// The estimated quantities.
    pub mode: Mode,
    /// Which sensors are used.
    pub modality: Modality,
    /// Every frame, in order of time.
    pub frames: Vec<FrameRow>,
    /// The shape's score as it grew, in order of time.
    pub shape: Vec<ShapePoint>,
    /// Events, in order of time.
    pub events: Vec<Event>,
    /// Choices of the explorer, in order of time.
    pub choices: Vec<ExplorerChoice>,
    /// Shares of the object that the hand hid from the first camera, of the frames of which they are known.
    pub hidden: Vec<f64>,
    /// Measured points of the object, where its true pose is known.
    pub observed: Observed,
    /// Takes the coordinates of the field to those of the mesh in the end; `None` before anything was seen.
    pub object_from_field: Option<Isometry<Field, Object>>,
    /// Wall time, seconds.
    pub wall_s: f64,
    /// Time of the episode or log, seconds.
    pub simulated_s: f64,
    /// See [`peak_memory_mb`].
    pub peak_memory_mb: Option<f64>,
    /// The refined calibration; `None` before the end, and if it was taken as given.
    pub calibration: Option<Calibration>,
    /// The frames of a recording of which the poses of the camera are known, in their order.
    pub cameras: Vec<FrameCamera>,
    /// The live connection, which its source updates; `None` for other sources.
    pub live: Option<SharedLiveRecord>,
    /// Whether the run came to its end.
    pub complete: bool,
}

/// A frame of a run: estimate, truth and time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FrameRow {
    /// Number of the frame in the episode or log.
    pub frame: u64,
    /// Seconds since the start of the episode or log.
    pub time_s: f64,
    /// Whether the tracker trusts the pose; lost before the object was seen.
    pub state: TrackState,
    /// Part of the measurements that agree with the pose, 0 to 1.
    pub confidence: f64,
    /// How far the pose may be off; `None` while the object is lost, and where it was not recorded.
    pub deviation: Option<Deviation>,
    /// Estimated pose: it takes the coordinates of the estimated surface to the world. With an unknown shape these are tied to the
    /// object's at the first frame, which is a choice of gauge and no knowledge of the tracker's.
    pub estimate: Isometry<Object, World>,
    /// True pose, where it is known.
    pub truth: Option<Isometry<Object, World>>,
    /// Error of the estimate, where the truth is known.
    pub add_s: Option<AddS>,
    /// ADD of the estimate, metres, where the truth is known: of an object that looks the same after a turn, it counts the turn.
    pub add_m: Option<f64>,
    /// Wall time of the frame by stage.
    pub stage_ms: StageMs,
}

/// Wall time by stage, milliseconds.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct StageMs {
    /// Simulation and rendering, or reading the log.
    pub sense: f64,
    /// The pose.
    pub track: f64,
    /// The field.
    pub map: f64,
    /// The mesh and the scores.
    pub mesh: f64,
}

impl StageMs {
    /// All stages together.
    pub fn total(self) -> f64 {
        self.sense + self.track + self.map + self.mesh
    }
}

/// The shape's score at a time.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ShapePoint {
    /// Seconds since the start.
    pub time_s: f64,
    /// F-score at 5 mm.
    pub f5: f64,
    /// F-score at 2 mm.
    pub f2: f64,
    /// F-score at 1 mm.
    pub f1: f64,
    /// F-score at 10 mm.
    pub f10: f64,
    /// Precision at 5 mm.
    pub precision5: f64,
    /// Recall at 5 mm.
    pub recall5: f64,
}

/// An event at a time.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Event {
    /// Seconds since the start.
    pub time_s: f64,
    /// The event, in words.
    pub text: String,
}

/// The motion that takes the estimated surface to the true one, for scores of the shape: as the tracker saw the two at the last frame whose truth is
/// known and whose place the tracker certifies, or at the last one whose truth is known if it certifies none. An episode may end as the object
/// falls, when nobody knows its pose. `None` without truth.
pub fn placed_shape<'a, Rows>(rows: Rows) -> Option<Isometry<Object, Object>>
where
    Rows: IntoIterator<Item = &'a FrameRow, IntoIter: DoubleEndedIterator> + Clone,
{
    let certified =
        rows.clone().into_iter().rev().filter(|row| camera_poses::is_placed(row)).find_map(object_from_estimate);
    certified.or_else(|| rows.into_iter().rev().find_map(object_from_estimate))
}

/// Writes the present results of a run that goes on, so that an interruption loses little: the summary without the shape's scores, and the
/// trajectory. Some milliseconds.
///
/// # Errors
/// If a file cannot be written; the message names it.
pub fn write_partial(folder: &Path, run: &RunRecord) -> Result<Summary> {
    let summary = Summary::new(run, ShapeScores::default());
    write_tables(folder, run, &summary)?;
    Ok(summary)
}

/// Writes all files of a run: with the true shape also the scores, the colours and the turntable. Some seconds.
///
/// # Errors
/// If a file cannot be written; the message names it.
pub fn write(folder: &Path, run: &RunRecord, estimate: &Mesh, truth: Option<&Truth>) -> Result<Summary> {
    let truth = truth.zip(placed_shape(&run.frames));
    let shape = truth.map(|(truth, motion)| ShapeScores::new(estimate, truth, motion)).unwrap_or_default();
    let mut summary = Summary::new(run, shape);
    summary.observed = truth.map(|(truth, motion)| ObservedScores::new(estimate, truth, &run.observed, motion));
    summary.benchmark = truth.and_then(|(truth, _)| benchmark(run, estimate, truth.mesh()));
    write_tables(folder, run, &summary)?;
    write_file(folder, file::OBJ, mesh_file::obj(estimate, Coordinates::Object).as_bytes())?;
    write_file(folder, file::CURVES, curves::curves(run).as_bytes())?;
    let errors_m = truth.map(|(truth, motion)| turntable::vertex_errors_m(estimate, motion, truth.object()));
    write_file(folder, file::PLY, &mesh_file::ply(estimate, Coordinates::Object, errors_m.as_deref()))?;
    if let Some(((truth, object_from_estimate), errors_m)) = truth.zip(errors_m.as_deref()) {
        let turntable = turntable::Turntable { estimate, errors_m, object_from_estimate, truth: truth.mesh() };
        write_file(folder, file::TURNTABLE, &turntable.gif()?)?;
    }
    Ok(summary)
}

fn write_tables(folder: &Path, run: &RunRecord, summary: &Summary) -> Result<()> {
    write_file(folder, file::TRAJECTORY, write_trajectory(&run.frames).as_bytes())?;
    write_file(folder, file::SUMMARY, format!("{}\n", serde_json::to_string_pretty(summary)?).as_bytes())
}

/// The largest memory that this process has held at once, MB (10^6 bytes), where the system says (Linux).
pub fn peak_memory_mb() -> Option<f64> {
    let status = fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    let kibibytes: f64 = line.trim().strip_suffix(" kB")?.trim().parse().ok()?;
    Some(kibibytes * 1024.0 / 1e6)
}

/// The rows with errors computed anew.
pub fn scored(mut rows: Vec<FrameRow>, surface: &TrueSurface) -> Vec<FrameRow> {
    rows.par_iter_mut().for_each(|row| {
        let motion = object_from_estimate(row);
        row.add_s = motion.map(|motion| surface.add_s(motion));
        row.add_m = motion.map(|motion| surface.add_m(motion));
    });
    rows
}

fn object_from_estimate(row: &FrameRow) -> Option<Isometry<Object, Object>> {
    Some(row.truth?.inverse() * row.estimate)
}

impl FrameRow {
    /// Angle between the estimated and the true rotation, radians; `None` where the error is not known.
    pub fn rotation_error_rad(&self) -> Option<f64> {
        self.add_s?;
        Some(self.truth?.untyped().rotation.angle_to(&self.estimate.untyped().rotation))
    }
}
