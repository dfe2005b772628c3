//! `evaluate`: many runs, and tables of their scores.
//!
//! ```no_run
//! use clap::{Args as _, Command, FromArgMatches as _};
//! use mvt_evaluation::EvaluateArguments;
//!
//! let command = EvaluateArguments::augment_args(Command::new("evaluate"));
//! let line = ["evaluate", "--objects", "cube70,mug", "--seeds", "2", "--duration", "5", "--out", "tables"];
//! mvt_evaluation::run(&EvaluateArguments::from_arg_matches(&command.get_matches_from(line))?)?;
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

pub mod controllers;
mod explore;
mod factors;
mod faults;
mod fields;
mod grasps;
pub mod hand;
mod lines;
pub mod manner;
mod played;
mod rates;
pub mod rigs;
mod scoring;
mod single;
mod speed;
mod spread;
mod survey;
mod table;
#[cfg(feature = "train")]
mod train;
mod tsdf;

use std::collections::{BTreeMap, HashSet};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::{Result, bail};
use clap::{Args, value_parser};
use mvt_files::folder::{ClaimedFolder, Earlier};
use mvt_gaits::controller_file::ChosenController;
use mvt_gaits::gait::{self, SUITED};
use mvt_hands::{LoadedHand, load_rig};
use mvt_mesh::Mesh;
use mvt_metrics::FAILURE_M;
use mvt_objects::object::Object;
use mvt_robot::hand::{ALLEGRO_DIGIT, Hand, PerPad, Side};
use mvt_touch::network::Weights;
use serde::{Deserialize, Serialize};

use mvt_run::arguments::duration;
use mvt_run::config::RunConfig;
use mvt_run::controller::choose_any;
use mvt_run::device::DeviceArguments;
use mvt_run::estimator::{Init, Mode};
use mvt_run::io::print_line;
use mvt_run::object::load_object;
use mvt_run::observed::Observed;
use mvt_run::pipeline::{EstimatorSetup, Finished, FrameResult, Meshing, Pipeline, Progress};
use mvt_run::report;
use mvt_run::report::{ErrorStatistics, FrameRow, ObservedScores, RotationStatistics, ShapeScores, TrackState};
use mvt_run::source::{Modality, Sensed, TouchArguments};
use mvt_run::truth::Truth;
use mvt_simulated::{Fault, HIDDEN_EVERY, SimulatedSettings, SimulatedSource};

use explore::ExploreMode;
use factors::{FULL, matters, variants};
use lines::{Keyed, Tell, all};
pub use single::{SingleRun, tables};

/// Run many episodes and print tables of their scores
///
/// Each episode (an object, a seed and cameras) is simulated and rendered once; all modes and modalities receive the
/// same frames. No supervisor directs the hand, except with --explore.
///
/// DIR/runs.jsonl receives a line per run, DIR/table.md the tables. After an interruption, the same command skips
/// finished runs and continues.
#[derive(Debug, Args)]
pub struct EvaluateArguments {
    /// Objects, separated by commas: names that `assets list` shows, random:SEED, or paths of meshes in metres
    #[arg(long, value_delimiter = ',', required = true)]
    objects: Vec<String>,
    /// Number of seeds per object
    #[arg(long, default_value_t = 3, value_parser = value_parser!(u64).range(1..=1000))]
    seeds: u64,
    /// First seed
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Number of runs of each estimator on the same frames, each with another seed of the estimator; a table then shows
    /// how far they part
    #[arg(long, default_value_t = 1, value_parser = value_parser!(u64).range(1..=100), conflicts_with_all = ["faults", "fields"])]
    estimator_seeds: u64,
    /// Quantities to estimate, separated by commas
    #[arg(long, value_enum, value_delimiter = ',', default_value = "slam,pose")]
    modes: Vec<Mode>,
    #[command(flatten)]
    device: DeviceArguments,
    /// Sensors to use, separated by commas
    #[arg(long, value_enum, value_delimiter = ',', default_value = "vitac,vi")]
    modalities: Vec<Modality>,
    /// Cameras, by name or as azimuth/elevation in degrees such as 330/35, separated by commas; semicolons separate
    /// sets of cameras, each of which makes episodes of its own
    #[arg(long, value_delimiter = ';', default_value = "side")]
    cameras: Vec<String>,
    /// Longest duration of an episode in seconds, at most 3600
    #[arg(long, default_value_t = 30.0, value_parser = duration)]
    duration: f64,
    /// Motion of the fingers: a name that `controllers` lists, the path of a controller file, a schedule such as
    /// `tumble_back:8,cubelet:8`, the path of a learnt policy, or `auto` as of `run`
    #[arg(long, value_name = "NAME|FILE", default_value = "auto")]
    controller: String,
    /// Hand with its touch sensors: a name that `rigs` lists, or the path of a hand file (.toml)
    #[arg(long, value_name = "NAME|FILE", default_value = ALLEGRO_DIGIT)]
    rig: String,
    #[command(flatten)]
    touch: TouchArguments,
    /// Folder for the results; the results of an earlier `evaluate` in it are kept and not repeated
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Allow a folder that contains other files
    #[arg(long)]
    overwrite: bool,
    /// Also run without each factor of the tracker and of the map in turn
    #[arg(long)]
    ablate: bool,
    /// Track known shapes while the object is moved at once, the camera is blank, or both (instead of whole runs)
    #[arg(long, conflicts_with = "ablate")]
    faults: bool,
    /// Compare shape representations (instead of modes and modalities): a run of mode slam with camera and touch is
    /// tracked; a dense field, a hashed field and a grid of truncated distances (TSDF) learn from the same rays and
    /// poses. They receive each pose as it was when its frame was tracked; only the run's own map, `refined`, corrects
    /// poses later. DIR/fields.jsonl receives the lines
    #[arg(long, conflicts_with_all = ["ablate", "faults", "modes", "modalities"])]
    fields: bool,
    /// Run each episode with 10, 15, 30 and 60 frames per second, and with a third of 30 dropped at random
    #[arg(long, conflicts_with_all = ["ablate", "faults", "fields"])]
    rates: bool,
    /// Let a supervisor direct the hand, and follow the F-score over time (mode slam, camera and touch). MODES, separated by
    /// semicolons, are played from the same starts: frontier chooses the controller by the estimate as `run --explore`,
    /// round-robin takes them in turn for 6 s each, random draws them, fixed=CONTROLLER plays one or a schedule as `run` without --explore, and oracle
    /// knows the true surface and plans as frontier does: an upper bound. DIR/explore.jsonl receives the lines
    #[arg(long, value_name = "MODES", value_delimiter = ';', conflicts_with_all = ["ablate", "faults", "fields", "rates", "modes", "modalities"])]
    explore: Vec<ExploreMode>,
    /// Number of episodes at a time
    #[arg(long, default_value_t = 2, value_parser = value_parser!(u16).range(1..=256))]
    jobs: u16,
    /// Read settings from a TOML file
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Override a setting (repeatable)
    #[arg(long, value_name = "KEY=VALUE")]
    set: Vec<String>,
}

/// Identity of a run.
#[derive(Debug, Clone, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Key {
    /// The object.
    pub object: String,
    /// Its seed.
    pub seed: u64,
    /// Names of the cameras with commas between.
    pub cameras: String,
    /// The estimated quantities.
    pub mode: Mode,
    /// Which sensors are used.
    pub modality: Modality,
    /// Added to the seed, gives the seed of the estimator.
    #[serde(default)]
    pub estimator_seed: u64,
    /// The variant: `full`, the setting that is 0, a fault, or the representation of the shape.
    pub variant: String,
    /// SHA-256 of all settings, the duration and where the weights of a touch network come from, hexadecimal.
    pub settings: String,
}

/// A line of runs.jsonl. Lengths are millimetres.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Line {
    /// Which run.
    #[serde(flatten)]
    pub key: Key,
    /// Frames, of which all count.
    pub frames: usize,
    /// Why the episode ended.
    pub end: String,
    /// Mean share of the object that the hand hides from the first camera, at the true pose.
    pub hidden: Option<f64>,
    /// F-score by threshold from 10,000 points.
    pub f_score: BTreeMap<u32, f64>,
    /// F-score by threshold from 100,000 points.
    pub f_score_fine: BTreeMap<u32, f64>,
    /// F-score by threshold from 10,000 points of the part of the surface that was measured.
    #[serde(default)]
    pub f_score_observed: BTreeMap<u32, f64>,
    /// Sum of the true object's rotations from half second to half second, radians.
    #[serde(default)]
    pub turned_rad: f64,
    /// One-directional ADD-S; `None` if the object was never seen.
    pub add_s_mm: Option<Errors>,
    /// Symmetric ADD-S.
    pub add_s_symmetric_mm: Option<Errors>,
    /// ADD.
    #[serde(default)]
    pub add_mm: Option<Errors>,
    /// Angle between the estimated and the true rotation, degrees.
    #[serde(default)]
    pub rotation_deg: Option<Errors>,
    /// Frames at which the object was lost.
    pub lost_frames: usize,
    /// How often it was found again.
    pub recovered: usize,
    /// The last error exceeds 10 mm although the object was not declared lost.
    pub undeclared: bool,
    /// Frames per second of tracking and mapping; `None` in a sweep, whose results depend on no clock.
    pub frames_per_second: Option<f64>,
}

/// Pose errors of a run, mm or degrees.
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
pub struct Errors {
    /// Mean.
    pub mean: f64,
    /// Median.
    pub median: f64,
    /// 95 % are at most this.
    pub p95: f64,
    /// At the last frame.
    #[serde(rename = "final")]
    pub last: f64,
}

impl Errors {
    /// JSON has no infinity, and a run whose pose is not a number must not vanish from the tables.
    fn written(errors: [f64; 4]) -> Self {
        let [mean, median, p95, last] = errors.map(|error| error.min(f64::MAX));
        Self { mean, median, p95, last }
    }
}

impl From<ErrorStatistics> for Errors {
    fn from(e: ErrorStatistics) -> Self {
        Self::written([e.mean, e.median, e.p95, e.last])
    }
}

impl From<RotationStatistics> for Errors {
    fn from(e: RotationStatistics) -> Self {
        Self::written([e.mean, e.median, e.p95, e.last])
    }
}

/// An object with a seed and cameras.
#[derive(Debug, Clone)]
struct Episode<'a> {
    name: &'a str,
    object: &'a Object,
    seed: u64,
    cameras: &'a str,
    /// Weights of the touch networks, by pad; without them the true indentation is used.
    weights: Option<&'a PerPad<Arc<Weights>>>,
    controller: &'a ChosenController,
    rig: &'a LoadedHand,
}

/// A run of an episode.
#[derive(Debug, Clone)]
struct Trial {
    key: Key,
    mode: Mode,
    modality: Modality,
    config: RunConfig,
}

/// Runs the command.
pub fn run(arguments: &EvaluateArguments) -> Result<()> {
    // Everything is checked before anything is simulated.
    arguments.device.choose()?;
    let variants = variants(arguments)?;
    let mut rig = load_rig(&arguments.rig, None)?;
    rig.hand = arguments.touch.equipped(&rig.hand)?;
    let weights = arguments.touch.weights(&rig.hand)?;
    for cameras in &arguments.cameras {
        rig.placed(cameras)?;
    }
    check_repeated("--objects", &arguments.objects)?;
    check_repeated("--cameras", &arguments.cameras)?;
    check_repeated("--modes", &arguments.modes)?;
    check_repeated("--modalities", &arguments.modalities)?;
    let load = |name: &String| -> Result<(String, Object, ChosenController)> {
        let object = load_object(name)?;
        let controller = choose_any(&arguments.controller, &object, &rig.hand)?;
        controller.misfit.iter().for_each(|misfit| tracing::warn!("{misfit}"));
        Ok((name.clone(), object, controller))
    };
    let objects: Vec<(String, Object, ChosenController)> = arguments.objects.iter().map(load).collect::<Result<_>>()?;
    let _claimed = ClaimedFolder::claim(&arguments.out, "evaluate", Earlier::Keep, arguments.overwrite)?;
    let episodes: Vec<Episode<'_>> = objects
        .iter()
        .flat_map(|subject| {
            let seeds = arguments.seed..arguments.seed + arguments.seeds;
            seeds.flat_map(move |seed| arguments.cameras.iter().map(move |cameras| (subject, seed, cameras)))
        })
        .map(|((name, object, controller), seed, cameras)| Episode {
            name,
            object,
            seed,
            cameras,
            weights: weights.as_ref(),
            controller,
            rig: &rig,
        })
        .collect();
    // Exploration, faults and fields have narrow tables, which are printed whole.
    let (text, summary) = if !arguments.explore.is_empty() {
        let path = arguments.out.join("explore.jsonl");
        let lines = all(arguments, &episodes, &path, |episode, done, tell| {
            explore::compare(arguments, episode, &variants[0].1, done, tell)
        })?;
        let text = explore::table(&lines);
        (text.clone(), text)
    } else if arguments.faults {
        let path = arguments.out.join("faults.jsonl");
        let lines = all(arguments, &episodes, &path, |episode, done, tell| {
            faults::trials(arguments, episode, &variants[0].1, done, tell)
        })?;
        let text = faults::table(&lines);
        (text.clone(), text)
    } else if arguments.fields {
        let path = arguments.out.join("fields.jsonl");
        let lines = all(arguments, &episodes, &path, |episode, done, tell| {
            fields::comparisons(arguments, episode, &variants[0].1, done, tell)
        })?;
        let text = fields::table(&lines);
        (text.clone(), text)
    } else {
        let path = arguments.out.join("runs.jsonl");
        let lines = all(arguments, &episodes, &path, |episode, done, tell| {
            let mut trials = trials(arguments, episode, &variants);
            let keys: HashSet<Key> = trials.iter().map(|trial| trial.key.clone()).collect();
            let at_rates = if arguments.rates {
                rates::runs(arguments.duration, episode, &trials, done, tell)?
            } else {
                HashSet::new()
            };
            trials.retain(|trial| !done.contains(&trial.key));
            whole(arguments.duration, episode, &trials, tell)?;
            Ok(&keys | &at_rates)
        })?;
        let spread = spread::table(&lines);
        (table::tables(&lines) + &spread, table::summary(&lines) + &spread)
    };
    mvt_run::io::write_file(&arguments.out, "table.md", text.as_bytes())?;
    print_line(&summary)?;
    print_line(&format!("next: open {}", arguments.out.join("table.md").display()))
}

/// Checks that a list names nothing twice, because the same run would be counted twice.
fn check_repeated<T: PartialEq + std::fmt::Debug>(option: &str, list: &[T]) -> Result<()> {
    match list.iter().enumerate().find(|(k, item)| list[..*k].contains(item)) {
        Some((_, item)) => bail!("{option} names {item:?} twice"),
        None => Ok(()),
    }
}

fn trials(arguments: &EvaluateArguments, episode: &Episode<'_>, variants: &[(&str, RunConfig)]) -> Vec<Trial> {
    let mut trials = Vec::new();
    for &mode in &arguments.modes {
        for &modality in &arguments.modalities {
            for (variant, config) in variants {
                if *variant != FULL && !matters(variant, mode, modality) {
                    continue;
                }
                for estimator_seed in 0..arguments.estimator_seeds {
                    let key =
                        Key { estimator_seed, ..key(arguments.duration, episode, mode, modality, variant, config) };
                    trials.push(Trial { key, mode, modality, config: config.clone() });
                }
            }
        }
    }
    trials
}

fn key(
    duration_s: f64,
    episode: &Episode<'_>,
    mode: Mode,
    modality: Modality,
    variant: &str,
    config: &RunConfig,
) -> Key {
    let mut settings = serde_json::json!([config, duration_s, env!("CARGO_PKG_VERSION")]).to_string();
    let ChosenController { gait, schedule, policy_sha256, .. } = episode.controller;
    if !schedule.is_empty()
        || !gait::choose(SUITED, episode.object, &episode.rig.hand).is_ok_and(|(_, suited)| suited == gait)
    {
        settings += &serde_json::json!([gait, schedule]).to_string();
    }
    settings += policy_sha256.as_deref().unwrap_or_default();
    // The results of earlier versions are those of the left Allegro.
    if episode.rig.hand != Hand::allegro(Side::Left) {
        settings += &serde_json::json!(episode.rig.hand.description()).to_string();
    }
    let weights = episode.weights.map_or(&[][..], |weights| weights);
    let is_new = |pad: usize| !weights[..pad].iter().any(|earlier| Arc::ptr_eq(earlier, &weights[pad]));
    for weights in (0..weights.len()).filter(|&pad| is_new(pad)).map(|pad| &weights[pad]) {
        settings += &serde_json::json!([weights.architecture(), weights.provenance()]).to_string();
    }
    Key {
        object: episode.name.to_owned(),
        seed: episode.seed,
        cameras: episode.cameras.to_owned(),
        mode,
        modality,
        estimator_seed: 0,
        variant: variant.to_owned(),
        settings: mvt_pinned::sha256_of(settings.as_bytes()),
    }
}

/// The source of an episode, with trouble that is made on purpose.
fn simulated(episode: &Episode<'_>, duration_s: f64, config: &RunConfig, fault: Fault) -> Result<SimulatedSource> {
    let settings = SimulatedSettings {
        hand: Arc::clone(&episode.rig.hand),
        gait: episode.controller.gait.clone(),
        mover: episode.controller.mover.clone(),
        schedule: episode.controller.schedule.clone(),
        seed: episode.seed,
        duration_s,
        cameras: episode.rig.placed(episode.cameras)?,
        camera_noise: config.camera_noise,
        perception: config.perception(),
        modality: Modality::Vitac,
        hidden_every: Some(HIDDEN_EVERY),
        fault,
    };
    SimulatedSource::new(episode.object, settings, episode.weights)
}

/// An estimator on the frames of an episode.
fn setup(config: &RunConfig, mode: Mode, modality: Modality, seed: u64) -> EstimatorSetup<'_> {
    EstimatorSetup { config: &config.slam, mode, modality, init: Init::Near, seed, map: None }
}

/// Runs estimators on the frames of a source, on the calling thread: episodes, not frames, are what runs in parallel here.
fn follow<'a>(
    source: &mut SimulatedSource,
    object: &'a Object,
    truth: Option<&'a Truth>,
    estimators: Vec<EstimatorSetup<'a>>,
    cell_mm: f64,
    mut frame: impl FnMut(&[Option<FrameResult>], &Sensed) -> Result<()>,
) -> Result<Finished> {
    let pipeline = Pipeline {
        estimators,
        meshing: Meshing { cell_m: (cell_mm * 1e-3) as f32, every: None },
        object: Some(object),
        truth,
        supervisor: None,
        single_threaded: true,
    };
    let mut failure = None;
    let stop = AtomicBool::new(false);
    let finished = pipeline.run(source, &stop, &mut |progress| {
        if let Progress::Frame { results, sensed } = progress
            && let Err(error) = frame(results, &sensed)
        {
            failure.get_or_insert(error);
            stop.store(true, Ordering::Relaxed);
        }
    })?;
    failure.map_or(Ok(finished), Err)
}

/// All trials of an episode as estimators of one run, so that all receive the same frames and no frame is kept.
fn whole(duration_s: f64, episode: &Episode<'_>, trials: &[Trial], tell: Tell<'_, Line>) -> Result<()> {
    let Some(first) = trials.first() else { return Ok(()) };
    let source = simulated(episode, duration_s, &first.config, Fault::default())?;
    scored(source, episode, trials, tell)
}

/// The same on a source of its own.
fn scored(mut source: SimulatedSource, episode: &Episode<'_>, trials: &[Trial], tell: Tell<'_, Line>) -> Result<()> {
    let Some(first) = trials.first() else { return Ok(()) };
    let seed = |trial: &Trial| episode.seed.wrapping_add(trial.key.estimator_seed);
    let estimators = trials.iter().map(|trial| setup(&trial.config, trial.mode, trial.modality, seed(trial))).collect();
    let mut rows: Vec<Vec<FrameRow>> = trials.iter().map(|_| Vec::new()).collect();
    let mut observed: Vec<Observed> = trials.iter().map(|_| Observed::default()).collect();
    let mut hidden = Vec::new();
    // Errors are computed at the end, with all points.
    let finished =
        follow(&mut source, episode.object, None, estimators, first.config.mesh_cell_mm, |results, sensed| {
            for ((rows, observed), result) in rows.iter_mut().zip(&mut observed).zip(results) {
                let Some(result) = result else { continue };
                rows.push(result.row);
                if let Some(truth) = sensed.truth {
                    observed.add(&result.scan, truth);
                }
            }
            hidden.extend(sensed.hidden);
            Ok(())
        })?;
    let hidden = (!hidden.is_empty()).then(|| hidden.iter().sum::<f64>() / hidden.len() as f64);
    let truth = Truth::new(episode.object.clone());
    let results = rows.into_iter().zip(&observed).zip(&finished.estimators);
    for (trial, ((rows, observed), estimated)) in trials.iter().zip(results) {
        // A known shape needs no score.
        let learned = estimated.as_ref().filter(|estimated| estimated.estimator.map().is_some());
        let mesh = learned.and_then(|estimated| estimated.mesh.as_ref());
        tell(line(trial, (rows, observed), mesh, &truth, &finished.end, hidden))?;
    }
    Ok(())
}

fn line(
    trial: &Trial,
    (rows, observed): (Vec<FrameRow>, &Observed),
    mesh: Option<&Mesh>,
    truth: &Truth,
    end: &str,
    hidden: Option<f64>,
) -> Line {
    let rows = report::scored(rows, truth.original());
    let motion = report::placed_shape(&rows);
    let surface = mesh.filter(|mesh| mesh.area_m2() > 0.0).zip(motion);
    let shape = surface.map(|(mesh, motion)| ShapeScores::new(mesh, truth, motion)).unwrap_or_default();
    let of_observed = surface.map(|(mesh, motion)| ObservedScores::new(mesh, truth, observed, motion));
    let count = |state| rows.iter().filter(|row| row.state == state).count();
    let failed = rows.last().and_then(|row| row.add_s).is_some_and(|e| e.one_directional_m > FAILURE_M);
    let ms: f64 = rows.iter().map(|row| row.stage_ms.track + row.stage_ms.map).sum();
    Line {
        key: trial.key.clone(),
        frames: rows.len(),
        end: end.to_owned(),
        hidden,
        f_score: shape.f_score.unwrap_or_default(),
        f_score_fine: shape.f_score_fine.unwrap_or_default(),
        f_score_observed: of_observed.map(|scores| scores.f_score).unwrap_or_default(),
        turned_rad: turned_rad(&rows),
        add_s_mm: ErrorStatistics::new(&rows, |row| Some(row.add_s?.one_directional_m)).map(Into::into),
        add_s_symmetric_mm: ErrorStatistics::new(&rows, |row| Some(row.add_s?.symmetric_m)).map(Into::into),
        add_mm: ErrorStatistics::new(&rows, |row| row.add_m).map(Into::into),
        rotation_deg: RotationStatistics::new(&rows).map(Into::into),
        lost_frames: count(TrackState::Lost),
        recovered: count(TrackState::Relocalised),
        undeclared: failed && rows.last().is_some_and(|row| row.state != TrackState::Lost),
        frames_per_second: Some(if ms > 0.0 { rows.len() as f64 / ms * 1e3 } else { 0.0 }),
    }
}

/// Sum of the true rotations from half second to half second, radians: vibrations do not count.
fn turned_rad(rows: &[FrameRow]) -> f64 {
    const SPAN_S: f64 = 0.5;
    let mut poses = rows.iter().filter_map(|row| Some((row.time_s, row.truth?.untyped().rotation)));
    let Some(mut from) = poses.next() else { return 0.0 };
    let mut sum = 0.0;
    for (time_s, rotation) in poses {
        if time_s - from.0 >= SPAN_S {
            sum += from.1.angle_to(&rotation);
            from = (time_s, rotation);
        }
    }
    sum
}
