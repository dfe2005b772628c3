//! Ways to hold a shape, taught by the same tracked frames.

use std::collections::{BTreeMap, HashSet};
use std::fmt::Write as _;
use std::time::{Duration, Instant};

use anyhow::{Context as _, Result};
use glam::{Vec3, Vec3A};
use mvt_field::field;
use mvt_field::shape::Shape;
use mvt_field::surface::outer_surface;
use mvt_frames::{Field, Isometry, Occupied, World};
use mvt_robot::hand::solid::HandSamples;
use mvt_slam::Obstacles;
use mvt_slam::map;
use mvt_slam::map::Map;
use mvt_slam::scan::{Scan, View};
use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use super::tsdf::{Tsdf, VOXEL_M};
use super::{Episode, EvaluateArguments, Key, Keyed, Tell, follow, key, setup, simulated};
use mvt_run::config::RunConfig;
use mvt_run::estimator::Mode;
use mvt_run::input::map_obstacles;
use mvt_run::pipeline::FrameResult;
use mvt_run::report::ShapeScores;
use mvt_run::source::Modality;
use mvt_run::truth::Truth;
use mvt_simulated::Fault;

/// The compared shapes: the map of the run that tracks, which refines the poses of its keyframes and closes loops; the same field,
/// taught with the poses as they were tracked; one with hashed levels; and a grid of truncated distances.
const NAMES: [&str; 4] = ["refined", "dense", "hashed", "tsdf"];

/// Vertices per axis of the hashed field: eight levels, each 1.49 times as fine as the one before, as in
/// Instant-NGP (Mueller et al. 2022).
const HASHED_LEVELS: [u32; 8] = [8, 12, 18, 26, 39, 58, 86, 128];
/// Its finer levels share tables of two to this entries.
const HASHED_TABLE_LOG2: u32 = 16;

/// The teaching draws other random numbers than the scans.
const TEACHING: u64 = 2 << 32;

/// How one of them did in an episode. Lengths are millimetres.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Comparison {
    #[serde(flatten)]
    key: Key,
    /// Frames that taught, of all.
    learnt: usize,
    frames: usize,
    /// F-score by threshold from 10,000 points.
    f_score: BTreeMap<u32, f64>,
    /// F-score by threshold from 100,000 points.
    f_score_fine: BTreeMap<u32, f64>,
    /// Mean distance of 100,000 estimated points to the nearest true one; `None` without a surface.
    mesh_error_mm: Option<f64>,
    /// Mean time of a frame that teaches, milliseconds.
    learn_ms: f64,
    /// Memory that answers queries, megabytes.
    shape_mb: f64,
    /// The same with the optimiser's state and the rays that are replayed.
    learning_mb: f64,
}

impl Keyed for Comparison {
    fn key(&self) -> &Key {
        &self.key
    }
}

/// Time and memory of a shape.
struct Cost {
    spent: Duration,
    shape_bytes: usize,
    learning_bytes: usize,
}

impl Cost {
    fn of_map(map: &Map, spent: Duration) -> Self {
        let views = map.keyframes().iter().flat_map(|keyframe| &keyframe.scan().views);
        let rays = |view: &View| size_of_val(&*view.hits) + size_of_val(view.outline()) + size_of_val(&*view.misses);
        let shape_bytes = map.field().size_bytes();
        Self { spent, shape_bytes, learning_bytes: 4 * shape_bytes + views.map(rays).sum::<usize>() }
    }
}

/// Compares them in an episode; returns the keys of all, done before or not.
///
/// The run that tracks is `refined`; it corrects poses afterwards. The others receive each pose as it was when its frame was tracked,
/// the same for all of them, and the same rays. A frame that the run does not believe teaches none of them.
pub fn comparisons(
    arguments: &EvaluateArguments,
    episode: &Episode<'_>,
    config: &RunConfig,
    done: &HashSet<Key>,
    tell: Tell<'_, Comparison>,
) -> Result<HashSet<Key>> {
    let keyed = |name: &str| key(arguments.duration, episode, Mode::Slam, Modality::Vitac, name, config);
    let keys = HashSet::from(NAMES.map(keyed));
    if keys.is_subset(done) {
        return Ok(keys);
    }
    let (slam, seed) = (&config.slam, episode.seed);
    let taught = map::MapConfig { refined_per_s: 0.0, loop_turn_deg: 0.0, ..slam.map.clone() };
    let hashed_field =
        field::FieldConfig { levels: HASHED_LEVELS.to_vec(), table_log2: HASHED_TABLE_LOG2, ..slam.field.clone() };
    let mut dense = Map::new(taught.clone(), &slam.field, map_obstacles(&episode.rig.hand), seed)?;
    let mut hashed = Map::new(taught, &hashed_field, map_obstacles(&episode.rig.hand), seed)?;
    let mut tsdf = Tsdf::new(slam.field.half_extent_m, slam.map.free_reach_m);
    let samples = HandSamples::new(&episode.rig.hand, f64::from(VOXEL_M), seed);
    let obstacles = Obstacles::new(samples.bodies().map(<[_]>::to_vec));
    let mut spent = [Duration::ZERO; NAMES.len()];

    let mut source = simulated(episode, arguments.duration, config, Fault::default())?;
    let (mut frames, mut learnt) = (0, 0);
    let (mut last, mut before_s) = (None, None);
    let estimators = vec![setup(config, Mode::Slam, Modality::Vitac, seed)];
    let mut finished =
        follow(&mut source, episode.object, None, estimators, config.mesh_cell_mm, |results, sensed| {
            let Some(FrameResult { estimate, scan, .. }) = results.first().and_then(Option::as_ref) else {
                return Ok(());
            };
            let truth = sensed.truth.context("a simulated episode without truth")?;
            last = Some(truth.inverse() * estimate.pose);
            frames += 1;
            let interval_s = estimate.time_s - before_s.replace(estimate.time_s).unwrap_or(estimate.time_s);
            if !estimate.state.is_tracking() || estimate.confidence < slam.trust.learn_above {
                return Ok(());
            }
            learnt += 1;
            let rng = || {
                let mut rng = ChaCha8Rng::seed_from_u64(seed ^ TEACHING);
                rng.set_stream(estimate.frame as u64);
                rng
            };
            // Of the others the model and the field are one: they refine no poses.
            let pose = Isometry::new(estimate.pose.untyped());
            spent[0] += estimate.spent.map;
            spent[1] += time(|| dense.learn(scan, pose, interval_s, &mut rng()));
            spent[2] += time(|| hashed.learn(scan, pose, interval_s, &mut rng()));
            spent[3] += time(|| integrate(&mut tsdf, &obstacles, scan, pose));
            Ok(())
        })?;
    let estimator = finished.estimators.pop().flatten().context("there was no frame")?.estimator;
    let object_from_model = last.context("there was no frame")?;
    let refined = estimator.map().context("a run without a map")?;
    let grid = tsdf.shape(dense.space());
    let size = tsdf.size_bytes();
    let cell_m = (config.mesh_cell_mm * 1e-3) as f32;
    let rivals: [(&dyn Shape, _, _); NAMES.len()] = [
        (refined, refined.field_from_model(), Cost::of_map(refined, spent[0])),
        (&dense, dense.field_from_model(), Cost::of_map(&dense, spent[1])),
        (&hashed, hashed.field_from_model(), Cost::of_map(&hashed, spent[2])),
        (&grid, Isometry::identity(), Cost { spent: spent[3], shape_bytes: size, learning_bytes: size }),
    ];
    let truth = Truth::new(episode.object.clone());
    for (name, (shape, shape_from_model, cost)) in NAMES.into_iter().zip(rivals) {
        let key = keyed(name);
        if done.contains(&key) {
            continue;
        }
        let mesh = outer_surface(shape, slam.field.half_extent_m, cell_m);
        let object_from_shape = object_from_model * shape_from_model.inverse();
        let scores = ShapeScores::new(&mesh, &truth, object_from_shape);
        tell(Comparison {
            key,
            learnt,
            frames,
            f_score: scores.f_score.unwrap_or_default(),
            f_score_fine: scores.f_score_fine.unwrap_or_default(),
            mesh_error_mm: scores.mesh_error_fine_mm,
            learn_ms: cost.spent.as_secs_f64() * 1e3 / learnt.max(1) as f64,
            shape_mb: cost.shape_bytes as f64 * 1e-6,
            learning_mb: cost.learning_bytes as f64 * 1e-6,
        })?;
    }
    Ok(keys)
}

fn time<T>(work: impl FnOnce() -> T) -> Duration {
    let begun = Instant::now();
    work();
    begun.elapsed()
}

fn integrate(tsdf: &mut Tsdf, obstacles: &Obstacles, scan: &Scan, pose: Isometry<Field, World>) {
    let (turn, shift) = pose.inverse().to_f32();
    let to_model = |p: Vec3| Vec3::from(turn * Vec3A::from(p) + shift);
    for view in &scan.views {
        tsdf.add(view, to_model);
    }
    tsdf.add_occupied(obstacles.posed(&scan.obstacles).map(|o| Occupied { point: to_model(o.point), ..o }));
}

/// The means over objects and seeds, as Markdown.
pub fn table(lines: &[Comparison]) -> String {
    let mut text = "| cameras | field | runs | F@1 | F@2 | F@5 | fine F@1 | F@2 | F@5 | mesh error, mm | ms/frame | MB | MB to learn |\n"
        .to_owned();
    text += &"|---".repeat(13);
    text += "|\n";
    let mut cameras: Vec<&str> = lines.iter().map(|line| line.key.cameras.as_str()).collect();
    cameras.sort_unstable();
    cameras.dedup();
    for (cameras, name) in cameras.iter().flat_map(|cameras| NAMES.map(|name| (*cameras, name))) {
        let runs: Vec<&Comparison> =
            lines.iter().filter(|line| line.key.cameras == cameras && line.key.variant == name).collect();
        let mean = |of: &dyn Fn(&Comparison) -> f64| runs.iter().map(|run| of(run)).sum::<f64>() / runs.len() as f64;
        let _ = write!(text, "| {cameras} | {name} | {} |", runs.len());
        for mm in [1, 2, 5] {
            let _ = write!(text, " {:.3} |", mean(&|run| run.f_score.get(&mm).copied().unwrap_or(0.0)));
        }
        for mm in [1, 2, 5] {
            let _ = write!(text, " {:.3} |", mean(&|run| run.f_score_fine.get(&mm).copied().unwrap_or(0.0)));
        }
        let error_mm = mean(&|run| run.mesh_error_mm.unwrap_or(f64::INFINITY));
        let _ = writeln!(
            text,
            " {error_mm:.2} | {:.1} | {:.1} | {:.1} |",
            mean(&|run| run.learn_ms),
            mean(&|run| run.shape_mb),
            mean(&|run| run.learning_mb)
        );
    }
    text
}
