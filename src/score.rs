//! `score`: comparison of estimated shapes and poses with the truth.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result, anyhow, bail};
use clap::{ArgGroup, Args};
use glam::Vec3;
use mvt_files::input;
use mvt_frames::{Isometry, Object, World};
use mvt_mesh::Mesh;
use mvt_metrics::{FINE_POINTS, ORIGINAL_THRESHOLDS_M, POINTS, ShapeScore, TrueSurface, sample_surface};
use mvt_objects::catalogue;
use mvt_objects::catalogue::CatalogueWarning;
use mvt_objects::object::Object as TrueObject;
use mvt_run::io::print_line;
use mvt_run::report;
use mvt_run::report::{Coordinates, ErrorStatistics, FrameRow, RotationStatistics};
use serde::{Deserialize, Serialize};

/// Largest file of poses or summary that is read, bytes: hours of poses.
const LARGEST_FILE: u64 = 256 << 20;

/// Score an estimated mesh and estimated poses against the true object
///
/// Give either --run, the folder of a run, which contains mesh, poses and the name of the object; or results of any
/// program: a mesh (--mesh), poses (--pose) or both, with the true object (--truth).
///
/// Shape: precision is the share of the estimated surface that is near the true one, recall the converse, and F their
/// harmonic mean, at distances of 1 to 20 mm. As in NeuralFeels, 10,000 points of each surface are compared; the second
/// table uses 100,000, because with 10,000 the points are so far apart that a perfect shape fails at 1 and 2 mm. The
/// mesh error is the mean distance from estimated points to the nearest true point. The surfaces are not aligned; with
/// poses, the mesh is placed by the last one.
///
/// Pose: ADD-S is the mean distance from 10,000 points of the object at the estimated pose to the nearest point at the
/// true pose; the symmetric ADD-S is the mean of this and the converse. Every frame counts. The column `as NeuralFeels`
/// ignores the first 5 s and errors above 50 mm.
///
/// Files of poses are CSV with a header that names at least time_s, x_m, y_m, z_m, qw, qx, qy and qz: the pose of the
/// object in a fixed frame, which must be the same in both files. Files of TUM and EuRoC are read, too, and a unit at the
/// end of a name (time_ms, x_mm) is heeded. Poses at most 1 ms apart are compared. The true poses
/// may also stand in the file of the estimates, in the columns true_x_m, true_y_m, true_z_m, true_qw, true_qx, true_qy
/// and true_qz.
///
/// Of an RGB-D sequence (--sequence) the motion since the first certified frame is scored, as YCBInEOAT and HO3D do: the area
/// under the curves of ADD and ADD-S to 10 cm, and the Chamfer distance and F-score of the mesh. Frames without a pose hold the last.
#[derive(Debug, Args)]
#[command(group = ArgGroup::new("results").required(true).multiple(true).args(["run", "mesh", "pose"]))]
pub struct ScoreArguments {
    /// Folder of a run
    #[arg(long, value_name = "DIR", conflicts_with_all = ["mesh", "pose", "truth", "truth_pose", "frame"])]
    run: Option<PathBuf>,
    /// Estimated mesh (OBJ, STL or PLY) in metres; another unit stands behind the path, as in mesh.obj:mm
    #[arg(long, value_name = "FILE", requires = "truth")]
    mesh: Option<PathBuf>,
    /// True object: a name that `assets list` shows, random:SEED, or the path of a mesh in metres; another unit stands behind
    /// the path, as in can.obj:cm
    #[arg(long, value_name = "OBJECT")]
    truth: Option<String>,
    /// Estimated poses (CSV); with --sequence the folder of the poses, a 4 x 4 matrix per certified frame in FRAME.txt, from
    /// the model to a camera with OpenCV axes
    #[arg(long, value_name = "FILE", requires = "truth")]
    pose: Option<PathBuf>,
    /// RGB-D sequence or bag with true poses (docs/rgbd.md) to which the poses belong
    #[arg(long, value_name = "DIR", requires = "pose", conflicts_with_all = ["run", "truth_pose", "frame"])]
    sequence: Option<PathBuf>,
    /// True poses (CSV) [default: the columns true_* of the estimated poses]
    #[arg(long, value_name = "FILE", requires = "pose")]
    truth_pose: Option<PathBuf>,
    /// Coordinates of the object in which mesh and poses are given [default: as the files state, else file]
    #[arg(long, value_enum)]
    frame: Option<Coordinates>,
    /// Print one JSON object instead of words
    #[arg(long)]
    json: bool,
}

/// The printed result. Lengths are millimetres; null means that no mesh or no poses were given, or infinity.
#[derive(Debug, Serialize)]
struct Report {
    truth: String,
    shape: Option<ShapeReport>,
    pose: Option<PoseReport>,
}

/// Scores of a shape at thresholds from 1 to 20 mm.
#[derive(Debug, Serialize)]
pub struct ShapeReport {
    /// From 10,000 points of each surface, as in NeuralFeels.
    original: SurfaceReport,
    /// From 100,000 points.
    fine: SurfaceReport,
}

#[derive(Debug, Serialize)]
struct SurfaceReport {
    scores: Vec<ThresholdReport>,
    mesh_error_mm: f64,
    completeness_mm: f64,
}

#[derive(Debug, Serialize)]
struct ThresholdReport {
    threshold_mm: f64,
    f: f64,
    precision: f64,
    recall: f64,
}

#[derive(Debug, Serialize)]
struct PoseReport {
    frames: usize,
    add_s_mm: Option<ErrorStatistics>,
    add_s_symmetric_mm: Option<ErrorStatistics>,
    add_mm: Option<ErrorStatistics>,
    rotation_deg: Option<RotationStatistics>,
}

/// The part of a run's summary that names its object.
#[derive(Debug, Deserialize)]
struct RunSummary {
    object: String,
}

/// Runs the command.
pub fn run(arguments: &ScoreArguments) -> Result<()> {
    if let (Some(sequence), Some(poses), Some(truth)) = (&arguments.sequence, &arguments.pose, &arguments.truth) {
        let mesh = arguments.mesh.as_deref().map(load_estimate).transpose()?;
        return mvt_benchmark::score(sequence, poses, mesh.as_ref(), &load_truth(truth)?, arguments.json);
    }
    let (truth, estimate, rows) = match (&arguments.run, &arguments.truth) {
        (Some(folder), _) => of_run(folder)?,
        (None, Some(truth)) => of_files(arguments, truth)?,
        // The command line already requires one of them.
        (None, None) => bail!("give --run DIR, or --truth OBJECT with --mesh or --pose"),
    };
    let surface = TrueSurface::new(&truth.mesh, POINTS, 0);
    let rows = rows.map(|rows| report::scored(rows, &surface));
    let motion = rows.as_deref().and_then(|rows| object_from_estimate(rows.last()?));
    let report = Report {
        truth: truth.name,
        shape: estimate.map(|mesh| ShapeReport::new(&mesh, &truth.mesh, motion.unwrap_or_else(Isometry::identity))),
        pose: rows.map(|rows| PoseReport {
            frames: rows.len(),
            add_s_mm: ErrorStatistics::new(&rows, |row| Some(row.add_s?.one_directional_m)),
            add_s_symmetric_mm: ErrorStatistics::new(&rows, |row| Some(row.add_s?.symmetric_m)),
            add_mm: ErrorStatistics::new(&rows, |row| row.add_m),
            rotation_deg: RotationStatistics::new(&rows),
        }),
    };
    if arguments.json { print_line(&serde_json::to_string(&report)?) } else { print_line(&in_words(&report)) }
}

/// The true object, the estimated mesh, and rows with estimated and true poses.
type Results = (TrueObject, Option<Mesh>, Option<Vec<FrameRow>>);

fn of_run(folder: &Path) -> Result<Results> {
    let path = folder.join(report::file::SUMMARY);
    let text = input::read_text(&path, LARGEST_FILE).with_context(|| {
        format!("--run {} is not the folder of a run: it contains no readable summary.json", folder.display())
    })?;
    let RunSummary { object } = serde_json::from_str(&text).with_context(|| path.display().to_string())?;
    let truth = load_truth(&object)?;
    let mesh_path = folder.join(report::file::PLY);
    // An interrupted run may have left no mesh.
    let estimate = if mesh_path.exists() { Some(load_estimate(&mesh_path)?) } else { None };
    let trajectory = folder.join(report::file::TRAJECTORY);
    let rows = load_rows(&trajectory)?;
    Ok((truth, estimate, Some(with_truth(rows, &trajectory)?)))
}

fn of_files(arguments: &ScoreArguments, truth: &str) -> Result<Results> {
    let mut truth = load_truth(truth)?;
    if coordinates(arguments)? == Coordinates::File {
        // Scores do not depend on coordinates, so the truth is moved to those of the results.
        let (rotation, translation) = truth.object_from_file.inverse().to_f32();
        for vertex in &mut truth.mesh.vertices {
            *vertex = Vec3::from(rotation * glam::Vec3A::from(*vertex) + translation);
        }
    }
    let estimate = arguments.mesh.as_deref().map(load_estimate).transpose()?;
    let rows = match (&arguments.pose, &arguments.truth_pose) {
        (None, _) => None,
        (Some(path), None) => Some(with_truth(load_rows(path)?, path)?),
        (Some(path), Some(truth_path)) => {
            let (estimates, truths) = (load_rows(path)?, load_rows(truth_path)?);
            let times = |rows: &[FrameRow]| rows.iter().map(|row| row.time_s).collect::<Vec<f64>>();
            let (estimated_s, true_s) = (times(&estimates), times(&truths));
            let joined = joined(estimates, &truths);
            let (fewer, more) = (estimated_s.len().min(true_s.len()), estimated_s.len().max(true_s.len()));
            let found = format!(
                "{} of the {} poses of {} and the {} of {} are at the same time (within 1 ms)",
                joined.len(),
                estimated_s.len(),
                path.display(),
                true_s.len(),
                truth_path.display()
            );
            if 2 * joined.len() < fewer {
                bail!("{found}; {}", misfit(&estimated_s, &true_s));
            }
            if joined.len() < more {
                tracing::warn!("{found} and are scored");
            }
            Some(joined)
        }
    };
    Ok((truth, estimate, rows))
}

/// Returns the coordinates of the results: those on the command line, or else those that the files state.
fn coordinates(arguments: &ScoreArguments) -> Result<Coordinates> {
    let of_mesh = arguments.mesh.as_deref().and_then(|path| Some((path, Coordinates::of_mesh_file(path)?)));
    let of_poses = |path: &Path| -> Result<_> { Ok(report::stated_coordinates(&read_text(path)?)) };
    let of_poses = match &arguments.pose {
        Some(path) => of_poses(path)?.map(|coordinates| (path.as_path(), coordinates)),
        None => None,
    };
    if let (Some((mesh, a)), Some((poses, b))) = (of_mesh, of_poses)
        && a != b
    {
        bail!(
            "{} states coordinates {:?}, but {} states {:?}: write both in the same coordinates",
            mesh.display(),
            a.name(),
            poses.display(),
            b.name()
        );
    }
    let stated = of_mesh.or(of_poses);
    match (arguments.frame, stated) {
        (Some(given), Some((path, stated))) if given != stated => {
            bail!("--frame {}, but {} states coordinates {:?}", given.name(), path.display(), stated.name())
        }
        (None, Some((path, Coordinates::Field))) => bail!(
            "{} is in the coordinates of a field, which cannot be compared with the truth; write it again with `mambavitact mesh --run DIR`",
            path.display()
        ),
        (given, stated) => Ok(given.or(stated.map(|(_, stated)| stated)).unwrap_or(Coordinates::File)),
    }
}

/// Loads the true object, without the warning about its mass, which scores do not use.
fn load_truth(name: &str) -> Result<TrueObject> {
    let mut warnings = Vec::new();
    let object = catalogue::load(name, &mut warnings);
    for warning in warnings.iter().filter(|warning| !matches!(warning, CatalogueWarning::EstimatedMass { .. })) {
        tracing::warn!("{warning}");
    }
    Ok(object?)
}

/// Loads a mesh without repairing it, so that stray parts lower its score.
fn load_estimate(path: &Path) -> Result<Mesh> {
    let (mesh, warnings) = mvt_mesh::read(path)?;
    for warning in warnings {
        tracing::warn!("{warning}");
    }
    mvt_mesh::check(&mesh).map_err(|defect| anyhow!("{}: {defect}", path.display()))?;
    // Vertices without faces do not count.
    let corners = || mesh.triangles().flatten();
    let (low, high) = (corners().reduce(Vec3::min), corners().reduce(Vec3::max));
    let extent = f64::from((high.unwrap_or_default() - low.unwrap_or_default()).max_element());
    if extent > mvt_mesh::MILLIMETRES_ABOVE_M {
        bail!(
            "{0}: its largest side is {extent} m; if it is not in metres, give the unit: --mesh {0}:mm",
            path.display()
        );
    }
    if mesh.area_m2() <= 0.0 {
        bail!("{}: {}", path.display(), mvt_mesh::Defect::NoFaces);
    }
    Ok(mesh)
}

fn read_text(path: &Path) -> Result<String> {
    input::read_text(path, LARGEST_FILE).with_context(|| format!("cannot read {}", path.display()))
}

fn load_rows(path: &Path) -> Result<Vec<FrameRow>> {
    report::read_trajectory(&read_text(path)?).with_context(|| path.display().to_string())
}

/// Returns the rows with a true pose, of which there must be at least one.
fn with_truth(mut rows: Vec<FrameRow>, path: &Path) -> Result<Vec<FrameRow>> {
    rows.retain(|row| row.truth.is_some());
    if rows.is_empty() {
        bail!("{}: there are no true poses; give them with --truth-pose", path.display());
    }
    Ok(rows)
}

/// Returns what times of two files that do not agree seem to be.
fn misfit(estimated_s: &[f64], true_s: &[f64]) -> String {
    let span = |times: &[f64]| times.last().zip(times.first()).map_or(0.0, |(last, first)| last - first);
    let ratio = span(estimated_s) / span(true_s);
    for (factor, unit) in [(1e3, "ms"), (1e6, "us"), (1e9, "ns")] {
        let is_near = |ratio: f64| (0.5..2.0).contains(&(ratio / factor));
        if is_near(ratio) || is_near(1.0 / ratio) {
            let which = if ratio > 1.0 { "the estimates" } else { "the truth" };
            return format!("the times of {which} seem to be in {unit}: name that column time_{unit}");
        }
    }
    let gap = |time_s: &f64| true_s.iter().map(|other| (other - time_s).abs()).fold(f64::INFINITY, f64::min);
    let mut gaps: Vec<f64> = estimated_s.iter().map(gap).collect();
    gaps.sort_unstable_by(f64::total_cmp);
    let usual_s = gaps.get(gaps.len() / 2).copied().unwrap_or_default();
    let usually = if usual_s < 1.0 { format!("{:.1} ms", 1e3 * usual_s) } else { format!("{usual_s:.1} s") };
    format!("usually the nearest is {usually} away: give times of the same clock")
}

/// Returns the estimates that have a true pose at the same time, with it.
fn joined(estimates: Vec<FrameRow>, truths: &[FrameRow]) -> Vec<FrameRow> {
    const SAME_TIME_S: f64 = 1e-3;
    let true_pose = |time_s: f64| -> Option<Isometry<Object, World>> {
        let after = truths.partition_point(|row| row.time_s < time_s);
        let near = truths.get(after.saturating_sub(1)..).unwrap_or_default().iter().take(2);
        let gap = |row: &FrameRow| (row.time_s - time_s).abs();
        near.filter(|row| gap(row) <= SAME_TIME_S).min_by(|a, b| gap(a).total_cmp(&gap(b))).map(|row| row.estimate)
    };
    let mut rows = estimates;
    rows.retain_mut(|row| {
        row.truth = true_pose(row.time_s);
        row.truth.is_some()
    });
    rows
}

fn object_from_estimate(row: &FrameRow) -> Option<Isometry<Object, Object>> {
    Some(row.truth?.inverse() * row.estimate)
}

impl ShapeReport {
    /// Compares an estimated surface with the true one; `motion` takes the coordinates of the one to those of the other.
    pub fn new(estimate: &Mesh, truth: &Mesh, motion: Isometry<Object, Object>) -> Self {
        let score = |points: usize| {
            let surface = TrueSurface::new(truth, points, 0);
            SurfaceReport::new(&surface.score(&sample_surface(estimate, points, 1), motion, &ORIGINAL_THRESHOLDS_M))
        };
        Self { original: score(POINTS), fine: score(FINE_POINTS) }
    }
}

impl SurfaceReport {
    fn new(score: &ShapeScore) -> Self {
        let row = |f: &mvt_metrics::FScore| ThresholdReport {
            threshold_mm: (f.threshold_m * 1e6).round() / 1e3,
            f: f.f(),
            precision: f.precision,
            recall: f.recall,
        };
        Self {
            scores: score.f_scores.iter().rev().map(row).collect(),
            mesh_error_mm: score.mesh_error_m * 1e3,
            completeness_mm: score.completeness_m * 1e3,
        }
    }
}

fn in_words(report: &Report) -> String {
    let mut text = report.truth.clone();
    if let Some(pose) = &report.pose {
        let _ = write!(
            text,
            ", {} frames\n\nerror               mean  median     p95   final  as NeuralFeels",
            pose.frames
        );
        for (name, errors) in
            [("ADD-S, mm", pose.add_s_mm), ("both ways, mm", pose.add_s_symmetric_mm), ("ADD, mm", pose.add_mm)]
        {
            let Some(ErrorStatistics { mean, median, p95, last, mean_original_definition }) = errors else { continue };
            let original = mean_original_definition.map_or("-".to_owned(), |mean| format!("{mean:.2}"));
            let _ = write!(text, "\n{name:17} {mean:6.2}  {median:6.2}  {p95:6.2}  {last:6.2}  {original:>14}");
        }
        if let Some(RotationStatistics { mean, median, p95, last, .. }) = pose.rotation_deg {
            let _ = write!(text, "\nrotation, degrees {mean:6.2}  {median:6.2}  {p95:6.2}  {last:6.2}");
        }
    }
    if let Some(ShapeReport { original, fine }) = &report.shape {
        let _ = write!(text, "\n\n            10,000 points              100,000 points");
        let _ = write!(text, "\n  mm      F   precision  recall       F   precision  recall");
        for (a, b) in original.scores.iter().zip(&fine.scores) {
            let _ = write!(
                text,
                "\n{:4}  {:.4}     {:.4}  {:.4}  {:.4}     {:.4}  {:.4}",
                a.threshold_mm, a.f, a.precision, a.recall, b.f, b.precision, b.recall
            );
        }
        let _ = write!(
            text,
            "\nmesh error, mm {:.3} ({:.3} with 100,000 points)",
            original.mesh_error_mm, fine.mesh_error_mm
        );
    }
    text
}
