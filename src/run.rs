//! `run`: an episode or a log from the first frame to scores, meshes and curves.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use anyhow::{Context as _, Result, bail};
use clap::{Args, value_parser};
use indicatif::ProgressBar;
use mvt_frames::camera::PosedCamera;
use mvt_gaits::gait;
use mvt_mesh::Mesh;
use mvt_objects::object::Object;
use mvt_robot::hand::Side;
use mvt_robot::rig::Placement;
use mvt_slam::map::Map;

use crate::view;
use mvt_live::{Fault, LiveSettings, LiveSource};
use mvt_recording::About;
use mvt_run::arguments::{Manner, duration};
use mvt_run::input::map_obstacles;
use mvt_run::io::print_line;
use mvt_run::io::write_file;
use mvt_run::object::load_object;
use mvt_run::pipeline::{Entry, Finished, FrameResult, Init, Meshing, Mode, Pipeline, Progress, RunConfig, Truth};
use mvt_run::progress;
use mvt_run::report;
use mvt_run::report::{RunRecord, Summary, file};
use mvt_run::settings;
use mvt_run::source::{LogSource, Modality, Source, TouchArguments, TouchNetwork};
use mvt_run::supervisor::{Goal, Supervisor};

/// Name of the file with every setting.
const CONFIG: &str = "config.toml";
/// The object of a run that is not told otherwise.
const OBJECT: &str = "077_rubiks_cube";
/// Its likeness that needs no download.
const OFFLINE_OBJECT: &str = "rubiks_cube_small";

/// Estimate pose and shape of the object in the hand, live or from a log
///
/// Without --log an episode is simulated, sensed, reconstructed and acted upon in a closed loop: what the hand does depends on the
/// estimate alone. Without --object either, the object is the Rubik's cube, 077_rubiks_cube.
///
/// DIR receives summary.json (the run in numbers), trajectory.csv (every frame), mesh.ply and mesh.obj (the shape), curves.svg, mesh.gif,
/// and config.toml: every setting, under the command that repeats the run. They are there in part from the first second on; of an
/// interrupted run summary.json says "complete": false. Where the shape is estimated there are also field.safetensors and
/// keyframes.safetensors: what was learnt, for `mesh` and --resume. recording/ is for `view`, also while the run goes on.
#[derive(Debug, Args)]
pub struct Arguments {
    /// Object: a name that `assets list` shows, or the path of a mesh in metres. With --log, the object to score against instead of the
    /// one that the log names
    #[arg(long)]
    object: Option<String>,
    /// A FeelSight log instead of a live episode
    #[arg(long, value_name = "LOGDIR", conflicts_with_all = ["goal", "gait", "side"])]
    log: Option<PathBuf>,
    /// What is estimated
    #[arg(long, value_enum, default_value_t = Mode::Slam)]
    mode: Mode,
    /// Which sensors are used
    #[arg(long, value_enum, default_value_t = Modality::Vitac)]
    modality: Modality,
    #[command(flatten)]
    touch: TouchArguments,
    /// One to three cameras, by name or as azimuth/elevation in degrees such as 330/35; of a log, those that it has. Without it
    /// `side`, or the first one of the log
    #[arg(long)]
    cameras: Option<String>,
    /// Longest duration in seconds; without it 30, or the whole log
    #[arg(long, value_parser = duration)]
    duration: Option<f64>,
    /// Seed of the episode, its noise and the estimate; without it 0, or the log's
    #[arg(long)]
    seed: Option<u64>,
    /// When the episode is over, decided on the estimate: turn=360deg, turn=2rev, coverage=0.9 or time
    #[arg(long, default_value = "time")]
    goal: Goal,
    /// Where the pose starts with --mode pose; `near` if not given
    #[arg(long, value_enum)]
    init: Option<Init>,
    /// Goes on with the shape that an earlier run has learnt, in its folder; the object is searched for first
    #[arg(long, value_name = "DIR")]
    resume: Option<PathBuf>,
    /// Settings as TOML, as config.toml of another run
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// A setting; repeat for several
    #[arg(long, value_name = "KEY=VALUE")]
    set: Vec<String>,
    /// Folder of the results
    #[arg(long, value_name = "DIR", default_value = "out")]
    out: PathBuf,
    /// Write into a folder that holds something else than a run
    #[arg(long)]
    overwrite: bool,
    /// Threads, one per core unless given; the result does not depend on it
    #[arg(long, value_parser = value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,
    /// Print summary.json instead of words
    #[arg(long)]
    json: bool,
    /// No progress bar, and no words
    #[arg(long)]
    quiet: bool,
    /// Watch the run in a window; closing it does not end the run
    #[arg(long)]
    view: bool,
    #[command(flatten)]
    manner: Manner,
}

/// A source with what is known of it.
struct Subject {
    source: Box<dyn Source>,
    side: Side,
    seed: u64,
    /// Its name in the catalogue or its path, and the object, if it could be had.
    name: String,
    object: Option<Object>,
    supervisor: Option<Supervisor>,
    cameras: Vec<PosedCamera>,
}

/// Runs the command.
pub fn run(arguments: &Arguments) -> Result<()> {
    let config: RunConfig = settings::load(arguments.config.as_deref(), &arguments.set)?;
    if arguments.init.is_some() && arguments.mode != Mode::Pose {
        bail!("--init is for --mode pose; in the other modes the first frame decides");
    }
    if arguments.resume.is_some() && arguments.mode != Mode::Slam {
        bail!("--resume is for --mode slam; in the other modes shape or pose is given");
    }
    if matches!(arguments.goal, Goal::Coverage(_)) && arguments.mode == Mode::Pose {
        bail!("--goal coverage is for a shape that grows; with --mode pose it is known from the start");
    }
    let weights = arguments.touch.weights()?.filter(|_| arguments.modality.has_touch());
    let network = weights.map(|weights| TouchNetwork::new(&weights, config.touch));
    check_vacant(&arguments.out, arguments.overwrite)?;
    if let Some(threads) = arguments.threads {
        rayon::ThreadPoolBuilder::new().num_threads(usize::from(threads)).build_global()?;
    }
    let stop = stop_on_signals()?;
    let Subject { mut source, side, seed, name, object, supervisor, cameras } = match &arguments.log {
        Some(log) => from_log(arguments, log, &config, network)?,
        None => live(arguments, &config, network)?,
    };
    // Read before anything is removed: it may be the folder that is written to.
    let map = match &arguments.resume {
        Some(folder) => Some(Map::load(folder, config.slam.map.clone(), map_obstacles(side))?),
        None => None,
    };
    prepare(&arguments.out)?;
    let settings = format!("# {}\n{}", repeat(arguments, &name, seed), settings::to_toml_with_comments(&config)?);
    write_file(&arguments.out, CONFIG, settings.as_bytes())?;

    let about = About {
        version: mvt_recording::VERSION,
        object: name.clone(),
        seed,
        mode: Some(arguments.mode),
        modality: arguments.modality,
        side,
        cameras,
        frames: source.len(),
        process: std::process::id(),
    };
    let true_mesh = object.as_ref().map(|object| &object.mesh);
    let writer = mvt_recording::RecordingWriter::create(&arguments.out, &about, true_mesh)?;
    if arguments.mode == Mode::Pose {
        true_mesh.into_iter().for_each(|mesh| writer.given(mesh));
    }
    if arguments.view {
        view::watch(&arguments.out)?;
    }
    let truth = object.clone().map(Truth::new);
    let pipeline = Pipeline {
        entries: vec![Entry {
            config: &config.slam,
            mode: arguments.mode,
            modality: arguments.modality,
            init: arguments.init.unwrap_or_default(),
            seed,
            map,
        }],
        meshing: Meshing { cell_m: (config.mesh_cell_mm * 1e-3) as f32, every: Some(config.score_every) },
        side,
        object: object.as_ref(),
        truth: truth.as_ref(),
        supervisor,
        single_threaded: arguments.threads == Some(1),
    };
    let record =
        RunRecord { object: name, seed, mode: arguments.mode, modality: arguments.modality, ..RunRecord::default() };
    let bar = if arguments.quiet { ProgressBar::hidden() } else { progress::bar(0, "") };
    let mut recorder = Recorder::new(&arguments.out, record, bar);
    let finished = pipeline.run(source.as_mut(), &stop, &mut |progress| {
        recorder.receive(&progress);
        writer.receive(progress);
    });
    // Of a run that has failed there is a recording, too.
    let recorded = writer.finish(finished.as_ref().is_ok_and(|finished| finished.complete));
    if let Err(error) = recorded {
        tracing::warn!("the recording is incomplete: {error}");
    }
    let mut finished = finished?;
    let estimated = finished.estimators.pop().flatten().context("the source delivered no frame")?;
    let summary = recorder.finish(&finished, estimated.mesh.as_ref(), truth.as_ref())?;
    if let Some(map) = estimated.estimator.map() {
        map.save(&arguments.out)?;
    }
    if arguments.json {
        print_line(&serde_json::to_string_pretty(&summary)?)?;
    } else if !arguments.quiet {
        print_line(&in_words(&summary, &arguments.out))?;
    }
    if !finished.complete {
        bail!("interrupted; {} holds the run up to there", arguments.out.display());
    }
    Ok(())
}

/// The command that repeats a run with the settings that it is written above.
fn repeat(arguments: &Arguments, object: &str, seed: u64) -> String {
    let quoted = |text: &str| match text.contains(|c: char| !(c.is_ascii_alphanumeric() || "_-./,=:".contains(c))) {
        true => format!("'{}'", text.replace('\'', "'\\''")),
        false => text.to_owned(),
    };
    let mut command = format!("mambavitact run --object {}", quoted(object));
    let mut add = |key: &str, value: Option<String>| {
        if let Some(value) = value {
            command += &format!(" --{key} {}", quoted(&value));
        }
    };
    let path = |path: &Path| path.display().to_string();
    add("log", arguments.log.as_deref().map(path));
    add("seed", Some(seed.to_string()));
    add("mode", Some(arguments.mode.name().to_owned()));
    add("modality", Some(arguments.modality.name().to_owned()));
    for (key, value) in arguments.touch.options() {
        add(key, value);
    }
    add("cameras", arguments.cameras.clone());
    add("duration", arguments.duration.map(|seconds| seconds.to_string()));
    add("init", arguments.init.map(|init| init.name().to_owned()));
    add("resume", arguments.resume.as_deref().map(path));
    if arguments.log.is_none() {
        add("goal", Some(arguments.goal.to_string()));
        add("gait", Some(arguments.manner.gait.clone()));
        add("side", Some(arguments.manner.side.name().to_owned()));
    }
    command + " --config config.toml"
}

/// The main job: what the program does without a command.
pub fn main_job() -> Result<()> {
    use clap::{Command, FromArgMatches as _};
    let matches = Arguments::augment_args(Command::new("run")).try_get_matches_from(["run"])?;
    run(&Arguments::from_arg_matches(&matches)?)
}

fn from_log(
    arguments: &Arguments,
    folder: &Path,
    config: &RunConfig,
    network: Option<TouchNetwork>,
) -> Result<Subject> {
    let cameras = arguments.cameras.as_deref();
    let mut source =
        LogSource::open(folder, cameras, arguments.modality, config.camera_noise, config.segmentation, network)?;
    let name = arguments.object.clone().unwrap_or_else(|| source.object().to_owned());
    let object = match load_object(&name) {
        Ok(object) => Some(object),
        Err(error) if arguments.object.is_some() || arguments.mode == Mode::Pose => return Err(error),
        Err(error) => {
            tracing::warn!("{error:#}; going on without scores");
            None
        }
    };
    source.limit_pictures(mvt_recording::has_images);
    if let Some(object) = &object {
        source.set_object_from_file(object.object_from_file);
    }
    if let Some(duration_s) = arguments.duration {
        source.limit(duration_s);
    }
    let seed = arguments.seed.unwrap_or(source.seed());
    let cameras = source.cameras().to_vec();
    Ok(Subject { side: source.side(), seed, name, object, supervisor: None, cameras, source: Box::new(source) })
}

fn live(arguments: &Arguments, config: &RunConfig, network: Option<TouchNetwork>) -> Result<Subject> {
    let placements = Placement::parse_list(arguments.cameras.as_deref().unwrap_or("side"))?;
    let (name, object) = match &arguments.object {
        Some(name) => (name.clone(), load_object(name)?),
        None => default_object()?,
    };
    let side = arguments.manner.side();
    let seed = arguments.seed.unwrap_or(0);
    let (gait_name, gait) = gait::choose(&arguments.manner.gait, &object)?;
    let settings = LiveSettings {
        side,
        gait: gait.clone(),
        seed,
        duration_s: arguments.duration.unwrap_or(30.0),
        cameras: placements.iter().map(|placement| placement.camera(side)).collect(),
        camera_noise: config.camera_noise,
        segmentation: config.segmentation,
        modality: arguments.modality,
        hidden_every: None,
        fault: Fault::default(),
    };
    let others = gait::shipped().keys().map(String::as_str).filter(|&name| name != gait_name);
    let gaits: Vec<&'static str> = std::iter::once(gait_name).chain(others).collect();
    let supervisor = Supervisor::new(arguments.goal, &gaits, config.supervisor);
    let cameras = if arguments.modality.has_vision() { settings.cameras.clone() } else { Vec::new() };
    let source = Box::new(LiveSource::new(&object, settings, network)?);
    Ok(Subject { source, side, seed, name, object: Some(object), supervisor: Some(supervisor), cameras })
}

/// The Rubik's cube, or without a network its procedural likeness.
fn default_object() -> Result<(String, Object)> {
    match load_object(OBJECT) {
        Ok(object) => Ok((OBJECT.to_owned(), object)),
        Err(error) => {
            tracing::warn!("{error:#}");
            tracing::warn!("going on with the procedural object {OFFLINE_OBJECT}");
            Ok((OFFLINE_OBJECT.to_owned(), load_object(OFFLINE_OBJECT)?))
        }
    }
}

/// The files that a run may have left.
const OURS: [&str; 10] = [
    file::SUMMARY,
    file::TRAJECTORY,
    file::PLY,
    file::OBJ,
    file::CURVES,
    file::TURNTABLE,
    CONFIG,
    Map::FILES[0],
    Map::FILES[1],
    mvt_recording::FOLDER,
];

/// Checks that a folder holds nothing but a run, which may be replaced.
fn check_vacant(out: &Path, overwrite: bool) -> Result<()> {
    if !out.exists() || overwrite {
        return Ok(());
    }
    let entries = fs::read_dir(out).with_context(|| out.display().to_string())?;
    for entry in entries {
        let name = entry?.file_name();
        let name = name.to_string_lossy();
        let is_ours = OURS.contains(&name.as_ref()) || (name.starts_with('.') && name.ends_with(".partial"));
        if !is_ours {
            bail!("{} holds {name}, which is no run's; choose another --out, or give --overwrite", out.display());
        }
    }
    Ok(())
}

/// Makes the folder and removes what an earlier run has left in it.
fn prepare(out: &Path) -> Result<()> {
    fs::create_dir_all(out).with_context(|| format!("cannot make {}", out.display()))?;
    for name in OURS {
        let path = out.join(name);
        // The recording is replaced by the new one.
        if path.is_file() {
            fs::remove_file(&path).with_context(|| format!("cannot remove {}", path.display()))?;
        }
    }
    Ok(())
}

/// Set by the first signal to end; the second ends at once.
fn stop_on_signals() -> Result<Arc<AtomicBool>> {
    /// What shells give for SIGINT.
    const INTERRUPTED: i32 = 130;
    let stop = Arc::new(AtomicBool::new(false));
    let flag = Arc::clone(&stop);
    ctrlc::set_handler(move || {
        if flag.swap(true, Ordering::Relaxed) {
            std::process::exit(INTERRUPTED);
        }
    })
    .context("cannot listen for signals")?;
    Ok(stop)
}

/// Keeps the record of a run, shows it on the bar, and writes what there is every second.
struct Recorder<'a> {
    out: &'a Path,
    record: RunRecord,
    bar: ProgressBar,
    begun: Instant,
    written: Instant,
    /// The first failure to write.
    failure: Option<anyhow::Error>,
}

impl<'a> Recorder<'a> {
    fn new(out: &'a Path, record: RunRecord, bar: ProgressBar) -> Self {
        let now = Instant::now();
        Self { out, record, bar, begun: now, written: now, failure: None }
    }

    fn receive(&mut self, progress: &Progress<'_>) {
        const INTERVAL: Duration = Duration::from_secs(1);
        match progress {
            Progress::Started { frames } => {
                self.begun = Instant::now();
                self.bar.set_length(*frames as u64);
            }
            Progress::Frame { results, .. } => {
                let Some(FrameResult { row, .. }) = results.first().and_then(Option::as_ref) else { return };
                self.record.frames.push(*row);
                self.record.simulated_s = row.time_s;
                self.show();
                if self.record.frames.len() == 1 || self.written.elapsed() >= INTERVAL {
                    self.record.wall_s = self.begun.elapsed().as_secs_f64();
                    self.record.peak_memory_mb = report::peak_memory_mb();
                    if let Err(error) = report::write_partial(self.out, &self.record) {
                        self.failure.get_or_insert(error);
                    }
                    self.written = Instant::now();
                }
            }
            Progress::Shape(_, shape) => {
                self.record.shape.extend(shape.point);
                // The mesh is made while later frames are estimated.
                if let Some(row) = self.record.frames.iter_mut().rev().find(|row| row.frame == shape.frame) {
                    row.stage_ms.mesh += shape.mesh_ms;
                }
            }
            Progress::Warning(text) => self.bar.suspend(|| tracing::warn!("{text}")),
            Progress::Event(event) => {
                self.record.events.push((*event).clone());
                self.bar.println(format!("{:6.2} s  {}", event.time_s, event.text));
            }
        }
    }

    fn show(&self) {
        let Some(row) = self.record.frames.last() else { return };
        let ms = self.begun.elapsed().as_secs_f64() * 1e3 / self.record.frames.len() as f64;
        let add_s = row.add_s.map_or_else(|| "-".to_owned(), |e| format!("{:.1} mm", e.one_directional_m * 1e3));
        let f5 = self.record.shape.last().map_or_else(|| "-".to_owned(), |point| format!("{:.2}", point.f5));
        let state = if row.state == report::TrackState::Lost { " lost" } else { "" };
        self.bar.set_message(format!("{ms:.0} ms  ADD-S {add_s}  F@5 {f5}  confidence {:.2}{state}", row.confidence));
        self.bar.inc(1);
    }

    /// Scores every frame with all points and writes everything.
    fn finish(mut self, finished: &Finished, mesh: Option<&Mesh>, truth: Option<&Truth>) -> Result<Summary> {
        let record = &mut self.record;
        record.wall_s = finished.wall_s;
        record.complete = finished.complete;
        record.peak_memory_mb = report::peak_memory_mb();
        if !finished.complete {
            // Whoever interrupts may not wait for the rest.
            report::write_partial(self.out, record)?;
        }
        self.bar.set_message("scores and files");
        if let Some(truth) = truth {
            let has_error: Vec<bool> = record.frames.iter().map(|row| row.add_s.is_some()).collect();
            record.frames = report::scored(std::mem::take(&mut record.frames), truth.original());
            for (row, has_error) in record.frames.iter_mut().zip(has_error) {
                row.add_s = row.add_s.filter(|_| has_error);
            }
        }
        record.peak_memory_mb = report::peak_memory_mb();
        let summary = match mesh.filter(|mesh| mesh.area_m2() > 0.0) {
            Some(mesh) => report::write(self.out, record, mesh, truth)?,
            None => {
                tracing::warn!("the object was never seen: there is no mesh");
                report::write_partial(self.out, record)?
            }
        };
        self.bar.finish_and_clear();
        match self.failure {
            Some(failure) => Err(failure),
            None => Ok(summary),
        }
    }
}

fn in_words(summary: &Summary, out: &Path) -> String {
    let number = |value: Option<f64>| value.map_or_else(|| "-".to_owned(), |value| format!("{value:.3}"));
    let f = |mm: u32| number(summary.shape.f_score.as_ref().and_then(|scores| scores.get(&mm).copied()));
    let add_s = summary.add_s_mm;
    let mut text = format!(
        "{} ({} {}, seed {}): {} frames, {:.1} s, at {:.1} frames/s (sense {:.1}, track {:.1}, map {:.1}, mesh {:.1} ms)\n",
        summary.object,
        summary.mode,
        summary.modality,
        summary.seed,
        summary.frames,
        summary.simulated_s,
        summary.frames_per_second,
        summary.stage_ms.sense,
        summary.stage_ms.track,
        summary.stage_ms.map,
        summary.stage_ms.mesh
    );
    if let Some(e) = add_s {
        text += &format!(
            "ADD-S, mm: mean {:.2}, median {:.2}, p95 {:.2}, final {:.2}; lost {} frames, found again {} times\n",
            e.mean, e.median, e.p95, e.last, summary.lost_frames, summary.recovered
        );
        text += &format!("F-score at 1, 2, 5 and 10 mm: {}, {}, {}, {}\n", f(1), f(2), f(5), f(10));
    }
    text += &format!("results in {}", out.display());
    text
}

#[cfg(test)]
mod tests {
    use clap::{Args as _, Command, FromArgMatches as _};
    use mvt_viewer::window::launch::RunChoices;

    use super::*;

    #[test]
    fn every_choice_makes_a_command_that_run_understands() {
        let gaits = mvt_gaits::gait::shipped().keys().map(String::as_str).chain(["auto"]);
        for (mode, _) in RunChoices::modes() {
            for (modality, what) in RunChoices::modalities() {
                assert!(!what.is_empty());
                for gait in gaits.clone() {
                    let choices = RunChoices {
                        mode: mode.to_owned(),
                        modality: modality.to_owned(),
                        gait: gait.to_owned(),
                        ..RunChoices::default()
                    };
                    let arguments = choices.arguments(Path::new("some where"));
                    let matches =
                        Arguments::augment_args(Command::new("run")).try_get_matches_from(&arguments).unwrap();
                    Arguments::from_arg_matches(&matches).unwrap();
                }
            }
        }
    }
}
