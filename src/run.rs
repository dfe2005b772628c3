//! `run`: an episode or a log, from the first frame to scores, meshes and curves.

mod arguments;
mod folder;
mod input;

use std::sync::Arc;

use anyhow::{Context as _, Result, bail};
use clap::{Args as _, Command, FromArgMatches as _};
use indicatif::ProgressBar;
use mvt_exchange::FoxgloveView;
use mvt_exchange::command::run_as_mcap;
use mvt_files::output::refuse_existing;
use mvt_recording::About;
use mvt_run::config::RunConfig;
use mvt_run::estimator::Mode;
use mvt_run::input::map_obstacles;
use mvt_run::io::{print_line, write_file};
use mvt_run::pipeline::{EstimatorSetup, Meshing, Pipeline};
use mvt_run::progress;
use mvt_run::progress_recorder::ProgressRecorder;
use mvt_run::report::{RunRecord, in_words};
use mvt_run::truth::Truth;
use mvt_slam::map::Map;
use mvt_viewer::window_program::WindowProgram;

pub use arguments::{CalibrationChoice, RunArguments};
use input::RunInput;

use crate::signals::stop_on_signals;
use crate::view;

/// Runs the command without arguments, as the program does without a command.
pub fn main_job() -> Result<()> {
    let matches = RunArguments::augment_args(Command::new("run")).try_get_matches_from(["run"])?;
    run(&RunArguments::from_arg_matches(&matches)?)
}

/// Runs the command.
pub fn run(arguments: &RunArguments) -> Result<()> {
    let mut config = suited(arguments)?.changed(arguments.config.as_deref(), &arguments.set)?;
    if let Some(choice) = arguments.calibration {
        config.calibration.refine = choice == CalibrationChoice::Refine;
    }
    arguments.check()?;
    arguments.device.choose()?;
    // Before the run claims its folder, because it may be built first.
    let window = arguments.view.then(WindowProgram::find).transpose().context("without --view no window is needed")?;
    let mut foxglove = arguments.foxglove.listen(arguments.json || arguments.quiet)?;
    if let Some(threads) = arguments.threads {
        rayon::ThreadPoolBuilder::new().num_threads(usize::from(threads)).build_global()?;
    }
    let stop = stop_on_signals()?;
    let RunInput { mut source, seed, name, object, supervisor, cameras, frame_cameras, mut live } =
        RunInput::new(arguments, &config, &stop)?;
    let doubt = &mut config.slam.trust.camera_scale_sigma;
    *doubt = doubt.max(source.camera_scale_sigma());
    // Read before any file is moved, because --resume and --out may be the same folder.
    let map = match &arguments.resume {
        Some(folder) => Some(Map::load(folder, config.slam.map.clone(), map_obstacles(source.hand()))?),
        None => None,
    };
    if let Some(file) = arguments.mcap.as_deref().filter(|_| !arguments.overwrite) {
        refuse_existing(file).with_context(|| format!("{}: give another --mcap, or --overwrite", file.display()))?;
    }
    // Held until the last file is written.
    let _claimed = folder::claim(&arguments.out, arguments.overwrite)?;
    let settings = format!("# {}\n{}", arguments.repeat(&name, seed), config.to_toml()?);
    write_file(&arguments.out, folder::CONFIG, settings.as_bytes())?;

    let about = About {
        version: mvt_recording::VERSION,
        object: name.clone(),
        seed,
        mode: Some(arguments.mode),
        modality: arguments.modality,
        hand: Arc::clone(source.hand()),
        cameras,
        frames: source.frame_count(),
        process: std::process::id(),
    };
    let true_mesh = object.as_ref().map(|object| &object.mesh);
    let writer = mvt_recording::RecordingWriter::create(&arguments.out, &about, true_mesh)?;
    if arguments.mode == Mode::Pose {
        true_mesh.into_iter().for_each(|mesh| writer.given(mesh));
    }
    if let Some(window) = &window {
        view::watch(window, &arguments.out)?;
    }
    foxglove.iter_mut().try_for_each(|view| view.show(&arguments.out))?;
    let truth = object.clone().map(Truth::new);
    let pipeline = Pipeline {
        estimators: vec![EstimatorSetup {
            config: &config.slam,
            mode: arguments.mode,
            modality: arguments.modality,
            init: arguments.init.unwrap_or_default(),
            seed,
            map,
        }],
        meshing: Meshing { cell_m: (config.mesh_cell_mm * 1e-3) as f32, every: Some(config.score_every) },
        object: object.as_ref(),
        truth: truth.as_ref(),
        supervisor,
        single_threaded: arguments.threads == Some(1),
    };
    let (mode, modality) = (arguments.mode, arguments.modality);
    let counts = live.as_ref().map(|live| Arc::clone(&live.record));
    let record =
        RunRecord { object: name, seed, mode, modality, cameras: frame_cameras, live: counts, ..RunRecord::default() };
    let bar = if arguments.quiet { ProgressBar::hidden() } else { progress::bar(0, "") };
    let mut recorder = ProgressRecorder::new(&arguments.out, record, bar);
    // A signal is the intended end of a live connection, which then delivers no more frames.
    let interrupted = if arguments.is_live() { Arc::default() } else { stop };
    let finished = pipeline.run(source.as_mut(), &interrupted, &mut |progress| {
        if let Some(live) = &mut live {
            live.listener.receive(&progress);
        }
        recorder.receive(&progress);
        writer.receive(progress);
    });
    if let Some(live) = live {
        live.listener.finish();
    }
    // The recording of a failed run is finished, too.
    let recorded = writer.finish(finished.as_ref().is_ok_and(|finished| finished.complete));
    if let Err(error) = recorded {
        tracing::warn!("the recording is incomplete: {error}");
    }
    foxglove.into_iter().for_each(FoxgloveView::finish);
    if let Some(file) = &arguments.mcap {
        run_as_mcap(&arguments.out, file, arguments.overwrite)?;
    }
    let mut finished = finished?;
    let estimated = finished.estimators.pop().flatten().context("the source delivered no frame")?;
    let summary = recorder.finish(&finished, estimated.mesh.as_ref(), truth.as_ref())?;
    if let Some(map) = estimated.estimator.map() {
        map.save(&arguments.out)?;
    }
    if let Some(calibration) = &summary.calibration {
        calibration.warnings(source.hand()).iter().for_each(|warning| tracing::warn!("{warning}"));
    }
    if arguments.json {
        print_line(&serde_json::to_string_pretty(&summary)?)?;
    } else if !arguments.quiet {
        let benchmark = summary.benchmark.as_ref().map(mvt_benchmark::score_in_words);
        print_line(&in_words(&summary, &arguments.out, benchmark.as_deref()))?;
    }
    if !finished.complete {
        bail!("the run was interrupted; {} contains its results so far", arguments.out.display());
    }
    Ok(())
}

/// Returns the settings with which a run starts.
fn suited(arguments: &RunArguments) -> Result<RunConfig> {
    #[cfg(feature = "ros")]
    if let Some(file) = &arguments.live.ros {
        return mvt_ros::suited(file);
    }
    Ok(RunConfig::suited(arguments.log.as_deref()))
}
