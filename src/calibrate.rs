//! `calibrate`: where cameras stand, by how much joints are off, and by how much they are late.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result};
use clap::Args;
use mvt_calibration::Calibration;
use mvt_files::input;
use mvt_gaits::controller_file;
use mvt_hands::load_rig;
use mvt_robot::hand::ALLEGRO_DIGIT;
use mvt_run::arguments::duration;
use mvt_run::config::RunConfig;
use mvt_run::io::{check_named, print_line, write_named};
use mvt_run::object::default_object;
use mvt_run::source::{LogSource, Modality, Source, TouchArguments, TouchOrigin};
use mvt_simulated::{Fault, SimulatedSettings, SimulatedSource};

/// Duration of a simulated calibration without --duration, seconds: the hand has then shown its joints several times.
const SIMULATED_S: f64 = 30.0;

/// Refine the calibration of cameras and joints by the hand in the cameras' images
///
/// The hand's shape is known, so that depth images of the moving hand tell where the cameras stand, by how much each
/// joint reading is off, and by how much the readings are late. A quantity that nothing measures keeps its prior, and its standard
/// deviation says so. `run` does the same while it goes on.
#[derive(Debug, Args)]
pub struct CalibrateArguments {
    /// Folder of a FeelSight log
    #[arg(long, value_name = "LOGDIR", required_unless_present = "simulated")]
    log: Option<PathBuf>,
    /// Simulate the moving hand instead of reading a log; the calibration of its sensors is perfect
    #[arg(long, conflicts_with = "log")]
    simulated: bool,
    /// Hand that is simulated: a name that `rigs` lists, or the path of a hand file (.toml)
    #[arg(long, value_name = "NAME|FILE", requires = "simulated", default_value = ALLEGRO_DIGIT)]
    rig: String,
    /// Cameras, separated by commas [default: all of the log, or side]
    #[arg(long)]
    cameras: Option<String>,
    /// Seed of the simulated episode and of its noise
    #[arg(long, requires = "simulated", default_value_t = 0)]
    seed: u64,
    /// Use only this many seconds [default: the whole log, or 30]
    #[arg(long, value_name = "SECONDS", value_parser = duration)]
    duration: Option<f64>,
    /// File to write, which `run --calibration-file` reads
    #[arg(long, value_name = "JSON")]
    out: Option<PathBuf>,
    /// Replace an existing file
    #[arg(long, requires = "out")]
    overwrite: bool,
    /// Override a setting (repeatable), for example calibration.joint_sigma_deg=2
    #[arg(long, value_name = "KEY=VALUE")]
    set: Vec<String>,
    /// Print one JSON object instead of words
    #[arg(long)]
    json: bool,
}

/// Runs the command.
pub fn run(arguments: &CalibrateArguments) -> Result<()> {
    let mut config = RunConfig::default().changed(None, &arguments.set)?;
    config.calibration.refine = true;
    if let Some(path) = &arguments.out {
        check_named(path, arguments.overwrite)?;
    }
    let mut source: Box<dyn Source> = match &arguments.log {
        Some(folder) => Box::new(log(arguments, folder, &config)?),
        None => Box::new(simulated(arguments, &config)?),
    };
    while let Some(sensed) = source.next()? {
        sensed.warnings.iter().for_each(|warning| tracing::warn!("{warning}"));
    }
    let calibration = source.calibration().context("there is no camera; name one with --cameras")?;
    let text = serde_json::to_string_pretty(&calibration)?;
    if let Some(path) = &arguments.out {
        write_named(path, text.as_bytes(), arguments.overwrite)?;
    }
    if arguments.json {
        return print_line(&text);
    }
    calibration.warnings(source.hand()).iter().for_each(|warning| tracing::warn!("{warning}"));
    print_line(&calibration.described(source.hand()))?;
    match &arguments.out {
        Some(path) => print_line(&format!("next: pass --calibration-file {} to `mambavitact run`", path.display())),
        None => print_line("next: add --out FILE to write it for `mambavitact run --calibration-file FILE`"),
    }
}

fn log(arguments: &CalibrateArguments, folder: &Path, config: &RunConfig) -> Result<LogSource> {
    let all;
    let cameras = match &arguments.cameras {
        Some(names) => names,
        None => {
            let log = mvt_feelsight::Log::open_tolerant(folder)?;
            all = log.cameras().iter().map(|camera| camera.name.clone()).collect::<Vec<_>>().join(",");
            &all
        }
    };
    let touch = TouchArguments::new(TouchOrigin::Truth, None);
    let (noise, perception) = (config.camera_noise, config.perception());
    let mut source = LogSource::open(folder, Some(cameras), Modality::Vi, noise, &touch, perception)?;
    if let Some(duration_s) = arguments.duration {
        source.limit(duration_s);
    }
    source.limit_pictures(|_| false, false);
    Ok(source)
}

fn simulated(arguments: &CalibrateArguments, config: &RunConfig) -> Result<SimulatedSource> {
    let (_, object) = default_object()?;
    let rig = load_rig(&arguments.rig, None)?;
    let cameras = rig.placed(arguments.cameras.as_deref().unwrap_or("side"))?;
    let hand = rig.hand;
    let settings = SimulatedSettings {
        gait: controller_file::choose("auto", &object, &hand)?.gait,
        mover: None,
        schedule: Default::default(),
        seed: arguments.seed,
        duration_s: arguments.duration.unwrap_or(SIMULATED_S),
        cameras,
        hand,
        camera_noise: config.camera_noise,
        perception: config.perception(),
        modality: Modality::Vi,
        hidden_every: None,
        fault: Fault::default(),
    };
    SimulatedSource::new(&object, settings, None)
}

/// Largest calibration file that is read, bytes: hundreds of cameras.
const LARGEST_FILE: u64 = 1 << 20;

/// Reads a file that the command wrote.
pub fn read(path: &Path) -> Result<Calibration> {
    let text = input::read_text(path, LARGEST_FILE).with_context(|| path.display().to_string())?;
    serde_json::from_str(&text).with_context(|| format!("{} is not a calibration", path.display()))
}
