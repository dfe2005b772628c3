//! Exploration: the F-score over time with controllers that are chosen in several ways, from the same starts.

use std::collections::{BTreeMap, HashSet};
use std::fmt::Write as _;
use std::str::FromStr;
use std::sync::atomic::AtomicBool;
use std::sync::{Arc, Mutex};

use anyhow::{Context as _, Result};
use glam::Vec3;
use mvt_frames::{Field, Isometry, Model, Object as ObjectFrame};
use mvt_gaits::clock::FRAME_HZ;
use mvt_mesh::Mesh;
use mvt_mesh::triangle_area_m2;
use mvt_metrics::{POINTS, sample_surface};
use mvt_slam::map::Map;
use mvt_slam::space::FrontierPatch;
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use super::lines::{Keyed, Tell};
use super::{Episode, EvaluateArguments, Key, key, setup, simulated};
use mvt_run::config::RunConfig;
use mvt_run::estimator::Mode;
use mvt_run::explorer::{ExploreStrategy, ExplorerChoice, UnknownSurface};
use mvt_run::exploring::direct;
use mvt_run::pipeline::{FrameResult, Meshing, Pipeline, Progress};
use mvt_run::report::ShapePoint;
use mvt_run::source::Modality;
use mvt_run::supervisor::Goal;
use mvt_run::truth::Truth;
use mvt_simulated::Fault;

/// How the controllers of an episode are chosen.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum ExploreMode {
    /// By the frontier of the estimate.
    Frontier,
    /// In turn.
    RoundRobin,
    /// At random, by the seed of the episode.
    Random,
    /// As by the frontier, but the unseen part of the true surface is known.
    Oracle,
    /// This controller or schedule.
    Fixed(String),
}

impl ExploreMode {
    fn name(&self) -> String {
        match self {
            Self::Frontier => "frontier".to_owned(),
            Self::RoundRobin => "round-robin".to_owned(),
            Self::Random => "random".to_owned(),
            Self::Oracle => "oracle".to_owned(),
            Self::Fixed(controller) => format!("fixed={controller}"),
        }
    }
}

impl FromStr for ExploreMode {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match (text, text.split_once('=')) {
            ("frontier", _) => Ok(Self::Frontier),
            ("round-robin", _) => Ok(Self::RoundRobin),
            ("random", _) => Ok(Self::Random),
            ("oracle", _) => Ok(Self::Oracle),
            (_, Some(("fixed", controller))) if !controller.is_empty() => Ok(Self::Fixed(controller.to_owned())),
            _ => Err("give frontier, round-robin, random, oracle or fixed=CONTROLLER".to_owned()),
        }
    }
}

/// Frames between two scores of the shape.
const SCORED_EVERY: u64 = 3 * FRAME_HZ as u64;
/// Part of the surface that is lowest when the object stands on the palm.
const LOWEST: f64 = 0.2;
/// Distance within which the lowest part counts as found, metres.
const FOUND_M: f64 = 0.005;

/// A line of explore.jsonl.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct ExploreLine {
    #[serde(flatten)]
    key: Key,
    /// Why the episode ended.
    end: String,
    /// Duration of the episode, seconds.
    simulated_s: f64,
    /// The object fell.
    dropped: bool,
    /// Mean F-score at 5 mm and at 2 mm over the duration: trapezoids from 0 at the start; the last score counts until the end.
    area_f5: f64,
    area_f2: f64,
    /// Recall of the lowest fifth of the surface at 5 mm, at the end.
    lowest_recall5: f64,
    /// Scores over time.
    shape: Vec<ShapePoint>,
    /// Times and names of the chosen controllers.
    choices: Vec<(f64, String)>,
}

impl Keyed for ExploreLine {
    fn key(&self) -> &Key {
        &self.key
    }
}

/// Plays all modes from the start of an episode.
pub fn compare(
    arguments: &EvaluateArguments,
    episode: &Episode<'_>,
    config: &RunConfig,
    done: &HashSet<Key>,
    tell: Tell<'_, ExploreLine>,
) -> Result<HashSet<Key>> {
    let mut keys = HashSet::new();
    for mode in &arguments.explore {
        let key = key(arguments.duration, episode, Mode::Slam, Modality::Vitac, &mode.name(), config);
        if !done.contains(&key) {
            tell(play(arguments, episode, config, mode, key.clone())?)?;
        }
        keys.insert(key);
    }
    Ok(keys)
}

fn play(
    arguments: &EvaluateArguments,
    episode: &Episode<'_>,
    config: &RunConfig,
    mode: &ExploreMode,
    key: Key,
) -> Result<ExploreLine> {
    let oracle = Arc::new(Oracle::new(&episode.object.mesh));
    let (controller, strategy) = match mode {
        ExploreMode::Frontier => (&arguments.controller, Some(ExploreStrategy::Frontier)),
        ExploreMode::RoundRobin => (&arguments.controller, Some(ExploreStrategy::RoundRobin)),
        ExploreMode::Random => (&arguments.controller, Some(ExploreStrategy::Random(episode.seed))),
        ExploreMode::Oracle => (&arguments.controller, Some(ExploreStrategy::Surface(oracle.clone()))),
        ExploreMode::Fixed(controller) => (controller, None),
    };
    let (controller, supervisor) =
        direct(&episode.rig.hand, controller, episode.object, Goal::Time, None, config.supervisor, strategy)?;
    let episode = Episode { controller: &controller, ..episode.clone() };
    let mut source = simulated(&episode, arguments.duration, config, Fault::default())?;
    let truth = Truth::new(episode.object.clone());
    let pipeline = Pipeline {
        estimators: vec![setup(config, Mode::Slam, Modality::Vitac, episode.seed)],
        meshing: Meshing { cell_m: (config.mesh_cell_mm * 1e-3) as f32, every: Some(SCORED_EVERY) },
        object: Some(episode.object),
        truth: Some(&truth),
        supervisor: Some(supervisor),
        single_threaded: true,
    };
    let (mut shape, mut choices, mut last) = (Vec::new(), Vec::new(), None);
    let finished = pipeline.run(&mut source, &AtomicBool::new(false), &mut |progress| match progress {
        Progress::Frame { results, .. } => {
            if let Some(FrameResult { row, estimate, .. }) = results.first().and_then(Option::as_ref) {
                if estimate.state.is_tracking() {
                    oracle.tie(row.estimate.inverse() * estimate.pose);
                }
                last = Some(*row);
            }
        }
        Progress::Shape(_, meshed) => shape.extend(meshed.point),
        Progress::Choice(ExplorerChoice { time_s, chosen, .. }) => choices.push((*time_s, chosen.clone())),
        Progress::Started { .. } | Progress::Warning(_) | Progress::Event(_) => {}
    })?;
    let last = last.context("the source delivered no frame")?;
    let mesh = finished.estimators.first().and_then(Option::as_ref).and_then(|estimated| estimated.mesh.as_ref());
    let lowest_recall5 = mesh.zip(last.truth).map_or(0.0, |(mesh, true_pose)| {
        let score = truth.original().lowest(LOWEST).score(
            &sample_surface(mesh, POINTS, 1),
            true_pose.inverse() * last.estimate,
            &[FOUND_M],
        );
        score.f_scores.first().map_or(0.0, |f_score| f_score.recall)
    });
    let end = finished.end;
    Ok(ExploreLine {
        key,
        dropped: end.contains("dropped"),
        end,
        simulated_s: last.time_s,
        area_f5: area(&shape, arguments.duration, |point| point.f5),
        area_f2: area(&shape, arguments.duration, |point| point.f2),
        lowest_recall5,
        shape,
        choices,
    })
}

/// Returns the mean of a score over a duration. It is 0 at the start; the last score counts until the end.
fn area(points: &[ShapePoint], duration_s: f64, score: fn(&ShapePoint) -> f64) -> f64 {
    let (mut sum, mut time_s, mut value) = (0.0, 0.0, 0.0);
    for point in points {
        sum += 0.5 * (value + score(point)) * (point.time_s - time_s);
        (time_s, value) = (point.time_s, score(point));
    }
    (sum + value * (duration_s - time_s).max(0.0)) / duration_s
}

/// The unseen part of the true surface, for a planner that is better than any that can be built. Only `evaluate` has it.
#[derive(Debug)]
struct Oracle {
    /// The true surface in the frame of the object.
    surface: Vec<FrontierPatch>,
    /// From the frame of the model to that of the object, as tied at the first estimate.
    object_from_model: Mutex<Option<Isometry<Model, ObjectFrame>>>,
}

/// Area of a patch of the true surface, square metres.
const PATCH_M2: f64 = 5e-6;

impl Oracle {
    fn new(mesh: &Mesh) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(0);
        let mut surface = Vec::new();
        for corners in mesh.triangles() {
            let [a, b, c] = corners;
            let Some(normal) = (b - a).cross(c - a).try_normalize() else { continue };
            // The expected number of patches is the area in patches.
            let count = triangle_area_m2(corners) / PATCH_M2 + rng.random_range(0.0..1.0);
            for _ in 0..count as usize {
                let (mut u, mut v): (f32, f32) = (rng.random_range(0.0..1.0), rng.random_range(0.0..1.0));
                if u + v > 1.0 {
                    (u, v) = (1.0 - u, 1.0 - v);
                }
                let centre = a + u * (b - a) + v * (c - a);
                surface.push(FrontierPatch { centre, normal, area_m2: PATCH_M2 as f32 });
            }
        }
        Self { surface, object_from_model: Mutex::new(None) }
    }

    /// Ties the model to the object at the first estimate.
    fn tie(&self, object_from_model: Isometry<Model, ObjectFrame>) {
        if let Ok(mut tied) = self.object_from_model.lock() {
            tied.get_or_insert(object_from_model);
        }
    }
}

impl UnknownSurface for Oracle {
    fn patches(&self, map: &Map) -> Vec<FrontierPatch> {
        let Some(object_from_model) = self.object_from_model.lock().ok().and_then(|tied| *tied) else {
            return Vec::new();
        };
        let field_from_object: Isometry<ObjectFrame, Field> = map.field_from_model() * object_from_model.inverse();
        let (rotation, translation) = field_from_object.to_f32();
        let placed = self.surface.iter().map(|patch| FrontierPatch {
            centre: Vec3::from(rotation * glam::Vec3A::from(patch.centre)) + Vec3::from(translation),
            normal: Vec3::from(rotation * glam::Vec3A::from(patch.normal)),
            ..*patch
        });
        placed.filter(|patch| !map.space().is_near_surface(patch.centre)).collect()
    }
}

/// Returns the means of each mode, with the difference to frontier from the same starts.
pub fn table(lines: &[ExploreLine]) -> String {
    let mut text = "| mode | episodes | area under F@5 | area under F@2 | recall of the lowest fifth | dropped |\n|---|---|---|---|---|---|\n".to_owned();
    let mut modes: BTreeMap<&str, Vec<&ExploreLine>> = BTreeMap::new();
    for line in lines {
        modes.entry(&line.key.variant).or_default().push(line);
    }
    for (mode, lines) in modes {
        let mean =
            |value: fn(&ExploreLine) -> f64| lines.iter().map(|line| value(line)).sum::<f64>() / lines.len() as f64;
        let (f5, f2, lowest) = (mean(|line| line.area_f5), mean(|line| line.area_f2), mean(|line| line.lowest_recall5));
        let dropped = lines.iter().filter(|line| line.dropped).count();
        let _ = writeln!(text, "| {mode} | {} | {f5:.3} | {f2:.3} | {lowest:.3} | {dropped} |", lines.len());
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn modes_are_those_of_the_help() {
        for text in ["frontier", "round-robin", "random", "oracle", "fixed=tumble_back:6,cubelet:6"] {
            assert_eq!(text.parse::<ExploreMode>().unwrap().name(), text);
        }
        for text in ["", "fixed", "fixed=", "truth"] {
            assert!(text.parse::<ExploreMode>().unwrap_err().contains("fixed=CONTROLLER"));
        }
    }

    #[test]
    fn the_area_is_the_mean_over_time() {
        let point =
            |time_s: f64, f5: f64| ShapePoint { time_s, f5, f2: 0.0, f1: 0.0, f10: 1.0, precision5: 1.0, recall5: 1.0 };
        // A ramp from 0 to 1 in 4 s, and 1 until the end at 10 s.
        assert!((area(&[point(2.0, 0.5), point(4.0, 1.0)], 10.0, |p| p.f5) - 0.8).abs() < 1e-12);
        assert_eq!(area(&[], 10.0, |p| p.f5), 0.0);
    }

    #[test]
    fn the_oracle_knows_the_whole_surface() {
        let object = mvt_objects::catalogue::load("cube70", &mut Vec::new()).unwrap();
        let oracle = Oracle::new(&object.mesh);
        let area_m2: f64 = oracle.surface.iter().map(|patch| f64::from(patch.area_m2)).sum();
        assert!((area_m2 / object.mesh.area_m2() - 1.0).abs() < 0.05, "{area_m2}");
        assert!(oracle.surface.iter().all(|patch| patch.normal.dot(patch.centre) > 0.0), "normals point out of a cube");
    }
}
