//! `benchmark`: runs of all sequences of a data set, and a table of their scores.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::{Context as _, Result, bail};
use clap::Args;
use indicatif::ProgressBar;
use mvt_files::folder::{ClaimedFolder, Earlier};
use mvt_files::input;
use mvt_run::config::RunConfig;
use mvt_run::estimator::{Init, Mode};
use mvt_run::io::{print_line, write_file};
use mvt_run::pipeline::{EstimatorSetup, Meshing, Pipeline};
use mvt_run::progress;
use mvt_run::progress_recorder::ProgressRecorder;
use mvt_run::report::RunRecord;
use mvt_run::source::{Modality, Recorded, RecordedOptions, RgbdSequence, TouchArguments, TouchOrigin};
use mvt_run::truth::Truth;

use crate::results::{Outcome, ResultFile, ResultLine};
use crate::sets::{Member, members, mesh_of};
use crate::table::table;

/// Run all RGB-D sequences below a folder, and compare the scores with published ones
///
/// Each sequence (docs/rgbd.md) needs masks, true poses and the mesh of its object. The scores are those of YCBInEOAT and
/// HO3D: the estimated motion since the first certified frame is applied to its true pose, and frames that are not
/// certified hold the last pose.
///
/// DIR/results.jsonl receives a line per sequence, DIR/table.md the table, DIR/SEQUENCE the files of a run. After an
/// interruption the same command skips finished sequences and continues.
#[derive(Debug, Args)]
pub struct BenchmarkArguments {
    /// Folder of the data set, or of one sequence
    data: PathBuf,
    /// Folder for the results; those of an earlier `benchmark` in it are kept and not repeated
    #[arg(long, value_name = "DIR", default_value = "benchmark")]
    out: PathBuf,
    /// Folder with the meshes of the objects, NAME.obj or NAME/textured.obj [default: those of the catalogue]
    #[arg(long, value_name = "DIR")]
    meshes: Option<PathBuf>,
    /// Names of the sequences to run, separated by commas [default: all]
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    only: Vec<String>,
    /// Seed of the estimates
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Longest duration of a sequence in seconds, at most 3600 [default: the whole sequence]
    #[arg(long, value_parser = mvt_run::arguments::duration)]
    duration: Option<f64>,
    /// Allow a folder that contains other files, and drop the results of an earlier `benchmark`
    #[arg(long)]
    overwrite: bool,
    /// Read settings from a TOML file
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Override a setting (repeatable)
    #[arg(long, value_name = "KEY=VALUE")]
    set: Vec<String>,
}

/// Names of the files of results.
const RESULTS: &str = "results.jsonl";
const TABLE: &str = "table.md";
const CONFIG: &str = "config.toml";

/// Runs the command. `stop_on_signals` gives the flag that a signal sets.
///
/// # Errors
/// If there is no sequence, the folder of the results belongs to others, or a sequence fails.
pub fn run(arguments: &BenchmarkArguments, stop_on_signals: fn() -> Result<Arc<AtomicBool>>) -> Result<()> {
    let config = RunConfig::without_hand().changed(arguments.config.as_deref(), &arguments.set)?;
    let mut members = members(&arguments.data)?;
    if !arguments.only.is_empty() {
        if let Some(unknown) = arguments.only.iter().find(|name| members.iter().all(|member| member.name != **name)) {
            let names: Vec<&str> = members.iter().map(|member| member.name.as_str()).collect();
            bail!("--only {unknown}: there is no such sequence; there are {}", names.join(", "));
        }
        members.retain(|member| arguments.only.contains(&member.name));
    }
    let out = &arguments.out;
    let _claimed = ClaimedFolder::claim(out, "benchmark", Earlier::Keep, arguments.overwrite)?;
    let seed = arguments.seed;
    let duration = arguments.duration.map_or(String::new(), |duration_s| format!(", {duration_s} s"));
    keep_settings(out, &format!("# seed {seed}{duration}\n{}", config.to_toml()?), arguments.overwrite)?;
    let mut results = ResultFile::resumed(&out.join(RESULTS))?;
    let stop = stop_on_signals()?;
    let bar = progress::bar(members.len() as u64, "sequences");
    for member in &members {
        if !results.has(&member.name) {
            bar.set_message(member.name.clone());
            bar.tick();
            let line = of_member(member, arguments, &config, &stop)?;
            let Some(line) = line else { break };
            results.add(line)?;
        }
        bar.inc(1);
    }
    bar.finish_and_clear();
    let is_wanted = |line: &&ResultLine| members.iter().any(|member| member.name == line.sequence);
    let mut lines: Vec<ResultLine> = results.lines.iter().filter(is_wanted).cloned().collect();
    lines.sort_by(|a, b| a.sequence.cmp(&b.sequence));
    let table = table(&lines);
    write_file(out, TABLE, table.as_bytes())?;
    print_line(table.trim_end())?;
    if stop.load(Ordering::Relaxed) {
        bail!("the benchmark was interrupted; the same command continues it");
    }
    let failed = lines.iter().filter(|line| matches!(line.outcome, Outcome::Failed { .. })).count();
    if failed > 0 {
        bail!("{failed} of {} sequences failed; {} says why", lines.len(), out.join(TABLE).display());
    }
    Ok(())
}

/// Writes the settings, or checks that they are those of the results that are there.
fn keep_settings(out: &Path, text: &str, overwrite: bool) -> Result<()> {
    let path = out.join(CONFIG);
    if overwrite {
        // Results of other settings.
        let results = out.join(RESULTS);
        if results.is_file() {
            std::fs::remove_file(&results).with_context(|| format!("cannot remove {}", results.display()))?;
        }
    } else if path.exists() {
        let earlier = input::read_text(&path, 1 << 20).with_context(|| path.display().to_string())?;
        if earlier != text {
            bail!(
                "{}: the results in this folder have other settings; give another --out, or --overwrite to drop them",
                path.display()
            );
        }
    }
    write_file(out, CONFIG, text.as_bytes())
}

/// Runs a sequence; `None` if it was interrupted. A sequence that cannot be used has a result that says why.
fn of_member(
    member: &Member,
    arguments: &BenchmarkArguments,
    config: &RunConfig,
    stop: &AtomicBool,
) -> Result<Option<ResultLine>> {
    let mut line = ResultLine {
        sequence: member.name.clone(),
        layout: String::new(),
        object: String::new(),
        outcome: Outcome::Failed { error: String::new() },
    };
    let scored = scored(member, arguments, config, stop, &mut line);
    line.outcome = match scored {
        Ok(None) => return Ok(None),
        Ok(Some(outcome)) => outcome,
        Err(error) => Outcome::Failed { error: format!("{error:#}") },
    };
    Ok(Some(line))
}

fn scored(
    member: &Member,
    arguments: &BenchmarkArguments,
    config: &RunConfig,
    stop: &AtomicBool,
    line: &mut ResultLine,
) -> Result<Option<Outcome>> {
    let sequence = RgbdSequence::open(&member.path)?;
    line.layout = sequence.layout().to_owned();
    if sequence.object_poses().iter().all(Option::is_none) {
        bail!("it has no true poses of the object");
    }
    let Some(name) = sequence.object_name() else {
        bail!("its object is unknown: write its name into object.txt, or `mesh = \"FILE\"` into rgbd.toml");
    };
    line.object = name.to_owned();
    let mesh = mesh_of(name, arguments.meshes.as_deref(), sequence.layout())?;
    drop(sequence);
    let options = RecordedOptions {
        cameras: None,
        modality: Modality::Vi,
        touch: &TouchArguments::new(TouchOrigin::Truth, None),
        object: Some(&mesh),
        needs_object: true,
        calibration: None,
        duration_s: arguments.duration,
        wants_pictures: |_| false,
        config,
    };
    let Recorded { mut source, object, frame_cameras, .. } = Recorded::open(&member.path, &options)?;
    let mut slam = config.slam.clone();
    slam.trust.camera_scale_sigma = slam.trust.camera_scale_sigma.max(source.camera_scale_sigma());
    let truth = object.clone().map(Truth::new);
    let out = arguments.out.join(&member.name);
    std::fs::create_dir_all(&out).with_context(|| format!("cannot make {}", out.display()))?;
    let pipeline = Pipeline {
        estimators: vec![EstimatorSetup {
            config: &slam,
            mode: Mode::Slam,
            modality: Modality::Vi,
            init: Init::default(),
            seed: arguments.seed,
            map: None,
        }],
        meshing: Meshing { cell_m: (config.mesh_cell_mm * 1e-3) as f32, every: None },
        object: object.as_ref(),
        truth: truth.as_ref(),
        supervisor: None,
        single_threaded: false,
    };
    let record = RunRecord {
        object: line.object.clone(),
        seed: arguments.seed,
        modality: Modality::Vi,
        cameras: frame_cameras,
        ..RunRecord::default()
    };
    let mut recorder = ProgressRecorder::new(&out, record, ProgressBar::hidden());
    let mut finished = pipeline.run(source.as_mut(), stop, &mut |progress| recorder.receive(&progress))?;
    if !finished.complete {
        return Ok(None);
    }
    let estimated = finished.estimators.pop().flatten().context("it delivered no frame")?;
    let summary = recorder.finish(&finished, estimated.mesh.as_ref(), truth.as_ref())?;
    let score = summary.benchmark.context("the object was never seen at a frame with a true pose")?;
    Ok(Some(Outcome::Scored { frames: summary.frames, frames_per_second: summary.frames_per_second, score }))
}
