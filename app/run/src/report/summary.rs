//! `summary.json`: a run in numbers.

use std::collections::BTreeMap;
use std::sync::PoisonError;

use mvt_calibration::Calibration;
use mvt_frames::{Frame, Isometry, Object};
use mvt_mesh::Mesh;
use mvt_metrics::{
    FINE_POINTS, FScore, POINTS, PoseStatistics, SequenceScore, ShapeScore, THRESHOLDS_M, TrueSurface, sample_surface,
};
use serde::Serialize;

use crate::estimator::Mode;
use crate::explorer::ExplorerChoice;
use crate::observed::{Observed, REACH_M};
use crate::source::Modality;
use crate::truth::Truth;

use super::trajectory::pose_numbers;
use super::{Event, FrameRow, LiveRecord, RunRecord, StageMs, TrackState};

/// The content of `summary.json`. Lengths are millimetres, shares run from 0 to 1. A number is null where there is no truth to hold
/// the run against, or where it is infinite.
#[derive(Debug, Clone, Serialize)]
pub struct Summary {
    /// False if the run was interrupted; all figures are then those up to there.
    pub complete: bool,
    /// Name in the catalogue or path of a mesh.
    pub object: String,
    /// Seed of the episode, of its noise and of the estimate.
    pub seed: u64,
    /// The estimated quantities.
    pub mode: Mode,
    /// Which sensors were used.
    pub modality: Modality,
    /// Number of frames.
    pub frames: usize,
    /// Time of the episode or log.
    pub simulated_s: f64,
    /// Wall time from the first frame to the last, without the work after it: the scores of every frame and the files.
    pub wall_s: f64,
    /// `frames` by `wall_s`.
    pub frames_per_second: f64,
    /// Mean over the frames of the wall time of each stage.
    pub stage_ms: StageMs,
    /// The largest memory held at once, MB.
    pub peak_memory_mb: Option<f64>,
    /// The shape in the end.
    #[serde(flatten)]
    pub shape: ShapeScores,
    /// The shape in the end where sensors have measured it; null without truth and while the run goes on.
    pub observed: Option<ObservedScores>,
    /// One-directional ADD-S, as NeuralFeels has it.
    pub add_s_mm: Option<ErrorStatistics>,
    /// Mean of both directions.
    pub add_s_symmetric_mm: Option<ErrorStatistics>,
    /// ADD, which counts every turn of the object, also one after which it looks the same.
    pub add_mm: Option<ErrorStatistics>,
    /// Angle between the estimated and the true rotation.
    pub rotation_deg: Option<RotationStatistics>,
    /// Scores by the protocol of YCBInEOAT and HO3D, of RGB-D sequences without a hand; missing of other runs.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub benchmark: Option<SequenceScore>,
    /// Whether the last frame's ADD-S exceeds 10 mm.
    pub failed: Option<bool>,
    /// Mean share of the object that the hand hid from the first camera; null if it is unknown, as in a log.
    pub hidden: Option<f64>,
    /// Frames at which the object was lost.
    pub lost_frames: usize,
    /// How often it found it again.
    pub recovered: usize,
    /// How far the last pose may be off, one standard deviation, as the tracker states it; null if it was lost.
    pub deviation_mm: Option<f64>,
    /// The same of its rotation, degrees.
    pub deviation_deg: Option<f64>,
    /// Share of the frames with a deviation of at most 2.5 mm: the pose is then within 5 mm in 19 of 20 frames.
    pub sure_frames: f64,
    /// Refined calibration of cameras and joints; null if it was taken as given.
    pub calibration: Option<Calibration>,
    /// Takes the coordinates of the field to those of the mesh: x, y, z in metres, then the quaternion w, x, y, z. Null if nothing was
    /// seen.
    pub object_from_field: Option<[f64; 7]>,
    /// The live connection; missing of other runs.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub live: Option<LiveRecord>,
    /// Events.
    pub events: Vec<Event>,
    /// Choices of the explorer with the gains that it expected; missing without `--explore`.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub choices: Vec<ExplorerChoice>,
}

/// Frames with at most this deviation of the surface are sure, metres.
pub const SURE_M: f64 = 0.0025;

/// How a shape compares with the true one, at thresholds in mm. All null without truth.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct ShapeScores {
    /// F-score by threshold, as NeuralFeels has it: 10,000 points of either surface.
    pub f_score: Option<BTreeMap<u32, f64>>,
    /// Precision at 5 mm: share of the estimated points that are near a true one.
    pub precision_5mm: Option<f64>,
    /// Recall at 5 mm: share of the true points that are near an estimated one.
    pub recall_5mm: Option<f64>,
    /// F-score of 100,000 points of either surface: 10,000 lie so far apart that a perfect shape fails at 1 and 2 mm.
    pub f_score_fine: Option<BTreeMap<u32, f64>>,
    /// Mean distance of estimated points to the nearest of 10,000 true ones, as NeuralFeels has it.
    pub mesh_error_mm: Option<f64>,
    /// The same of 100,000 points.
    pub mesh_error_fine_mm: Option<f64>,
}

/// Scores of the part of the surface that the sensors have measured at least once: the estimate cannot know the rest.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ObservedScores {
    /// Share of the true surface that lies within 4 mm of a measured point.
    pub share: f64,
    /// F-score by threshold in mm, of 10,000 points of either surface. True points that were not measured do not count, and neither do
    /// estimated points that lie nearer to these than to measured ones.
    pub f_score: BTreeMap<u32, f64>,
}

/// Pose errors of a run, mm, every frame counted but in the last.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ErrorStatistics {
    /// Mean.
    pub mean: f64,
    /// Median.
    pub median: f64,
    /// 95 % are at most this.
    pub p95: f64,
    /// That of the last frame.
    #[serde(rename = "final")]
    pub last: f64,
    /// Mean without the first 5 s and without errors above 50 mm, as NeuralFeels takes it.
    pub mean_original_definition: Option<f64>,
}

/// Rotation errors of a run, degrees, every frame counted.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct RotationStatistics {
    /// Mean.
    pub mean: f64,
    /// Median.
    pub median: f64,
    /// 95 % are at most this.
    pub p95: f64,
    /// That of the last frame.
    #[serde(rename = "final")]
    pub last: f64,
    /// Share of the frames in which the tracker states that it knows the rotation, to 20 degrees. A turn about the axis of a plain can is unknown,
    /// and an error there says nothing against the tracker.
    pub known: f64,
}

/// A rotation with at most this stated deviation is known, radians: the limit of certified poses.
pub const KNOWN_RAD: f64 = 20.0 * std::f64::consts::PI / 180.0;

fn by_threshold(score: &ShapeScore) -> BTreeMap<u32, f64> {
    score.f_scores.iter().map(|f| ((f.threshold_m * 1e3).round() as u32, f.f())).collect()
}

impl ObservedScores {
    /// Of a surface in the frame that `object_from_estimate` takes to the true one's.
    pub fn new(
        estimate: &Mesh,
        truth: &Truth,
        observed: &Observed,
        object_from_estimate: Isometry<Object, Object>,
    ) -> Self {
        let [measured, rest] = truth.original().divided(&observed.points(), REACH_M);
        let estimate = sample_surface(estimate, POINTS, 1);
        let score = measured.score_beside(&rest, &estimate, object_from_estimate, &THRESHOLDS_M);
        let share = measured.points().len() as f64 / truth.original().points().len().max(1) as f64;
        Self { share, f_score: by_threshold(&score) }
    }
}

impl ShapeScores {
    /// Of a surface in the frame that `object_from_estimate` takes to the true one's.
    pub fn new<F: Frame>(estimate: &Mesh, truth: &Truth, object_from_estimate: Isometry<F, Object>) -> Self {
        let score = |surface: &TrueSurface, points: usize| {
            surface.score(&sample_surface(estimate, points, 1), object_from_estimate, &THRESHOLDS_M)
        };
        let (original, fine) = (score(truth.original(), POINTS), score(truth.fine(), FINE_POINTS));
        let at_5mm = |of: fn(&FScore) -> f64| original.f_scores.iter().find(|f| f.threshold_m == 0.005).map(of);
        Self {
            f_score: Some(by_threshold(&original)),
            precision_5mm: at_5mm(|f| f.precision),
            recall_5mm: at_5mm(|f| f.recall),
            f_score_fine: Some(by_threshold(&fine)),
            mesh_error_mm: Some(original.mesh_error_m * 1e3),
            mesh_error_fine_mm: Some(fine.mesh_error_m * 1e3),
        }
    }
}

impl ErrorStatistics {
    /// Of the frames with an error, metres; `None` without such frames.
    pub fn new(frames: &[FrameRow], error_m: fn(&FrameRow) -> Option<f64>) -> Option<Self> {
        let errors: Vec<(f64, f64)> = frames.iter().filter_map(|row| Some((row.time_s, error_m(row)?))).collect();
        let PoseStatistics { mean_m, median_m, p95_m, final_m, mean_original_m } = PoseStatistics::new(&errors)?;
        Some(Self {
            mean: mean_m * 1e3,
            median: median_m * 1e3,
            p95: p95_m * 1e3,
            last: final_m * 1e3,
            mean_original_definition: mean_original_m.map(|m| m * 1e3),
        })
    }
}

impl RotationStatistics {
    /// Of the frames with an error; `None` without such frames.
    pub fn new(frames: &[FrameRow]) -> Option<Self> {
        let errors: Vec<(f64, f64)> =
            frames.iter().filter_map(|row| Some((row.time_s, row.rotation_error_rad()?))).collect();
        // The statistics of lengths do for angles.
        let PoseStatistics { mean_m, median_m, p95_m, final_m, .. } = PoseStatistics::new(&errors)?;
        let [mean, median, p95, last] = [mean_m, median_m, p95_m, final_m].map(f64::to_degrees);
        let is_known = |row: &&FrameRow| row.deviation.is_some_and(|deviation| deviation.angle_rad <= KNOWN_RAD);
        let known = frames.iter().filter(is_known).count() as f64 / frames.len().max(1) as f64;
        Some(Self { mean, median, p95, last, known })
    }
}

impl Summary {
    /// Of a run and the score of its last shape.
    pub fn new(run: &RunRecord, shape: ShapeScores) -> Self {
        let frames = &run.frames;
        let mean_ms = |of: fn(&StageMs) -> f64| {
            frames.iter().map(|row| of(&row.stage_ms)).sum::<f64>() / frames.len().max(1) as f64
        };
        let count = |state| frames.iter().filter(|row| row.state == state).count();
        let last = frames.last().and_then(|row| row.deviation);
        let sure = frames.iter().filter(|row| row.deviation.is_some_and(|d| d.surface_m <= SURE_M)).count();
        let add_s_mm = ErrorStatistics::new(frames, |row| Some(row.add_s?.one_directional_m));
        Self {
            complete: run.complete,
            object: run.object.clone(),
            seed: run.seed,
            mode: run.mode,
            modality: run.modality,
            frames: frames.len(),
            simulated_s: run.simulated_s,
            wall_s: run.wall_s,
            frames_per_second: if run.wall_s > 0.0 { frames.len() as f64 / run.wall_s } else { 0.0 },
            stage_ms: StageMs {
                sense: mean_ms(|s| s.sense),
                track: mean_ms(|s| s.track),
                map: mean_ms(|s| s.map),
                mesh: mean_ms(|s| s.mesh),
            },
            peak_memory_mb: run.peak_memory_mb,
            shape,
            observed: None,
            add_s_mm,
            add_s_symmetric_mm: ErrorStatistics::new(frames, |row| Some(row.add_s?.symmetric_m)),
            add_mm: ErrorStatistics::new(frames, |row| row.add_m),
            rotation_deg: RotationStatistics::new(frames),
            benchmark: None,
            failed: add_s_mm.map(|e| e.last > mvt_metrics::FAILURE_M * 1e3),
            hidden: (!run.hidden.is_empty()).then(|| run.hidden.iter().sum::<f64>() / run.hidden.len() as f64),
            lost_frames: count(TrackState::Lost),
            recovered: count(TrackState::Relocalised),
            deviation_mm: last.map(|d| d.surface_m * 1e3),
            deviation_deg: last.map(|d| d.angle_rad.to_degrees()),
            sure_frames: sure as f64 / frames.len().max(1) as f64,
            calibration: run.calibration.clone(),
            object_from_field: run.object_from_field.map(pose_numbers),
            live: run.live.as_ref().map(|live| live.lock().unwrap_or_else(PoisonError::into_inner).clone()),
            events: run.events.clone(),
            choices: run.choices.clone(),
        }
    }
}
