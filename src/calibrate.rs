//! `calibrate`: where cameras stand, by how much joints are off, and by how much they are late.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result};
use clap::Args;
use mvt_calibration::Calibration;
use mvt_files::input;
use mvt_run::arguments::duration;
use mvt_run::config::RunConfig;
use mvt_run::io::{check_named, print_line, write_named};
use mvt_run::settings;
use mvt_run::source::{LogSource, Modality, Source as _};

/// Refine the calibration of a log's cameras and joints by what the cameras see of the hand
///
/// The hand's shape is known, so that depth images of the moving hand tell where the cameras stand, by how much each
/// joint reading is off, and by how much the readings are late. What nothing measures keeps its prior, and its standard
/// deviation says so. `run` does the same while it goes on.
#[derive(Debug, Args)]
pub struct CalibrateArguments {
    /// Folder of a FeelSight log
    #[arg(long, value_name = "LOGDIR")]
    log: PathBuf,
    /// Cameras of the log, separated by commas [default: all]
    #[arg(long)]
    cameras: Option<String>,
    /// Use only this many seconds of the log
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
    let mut config: RunConfig = settings::load(None, &arguments.set)?;
    config.calibration.refine = true;
    if let Some(path) = &arguments.out {
        check_named(path, arguments.overwrite)?;
    }
    let all;
    let cameras = match &arguments.cameras {
        Some(names) => names,
        None => {
            let log = mvt_feelsight::Log::open_tolerant(&arguments.log)?;
            all = log.cameras().iter().map(|camera| camera.name.clone()).collect::<Vec<_>>().join(",");
            &all
        }
    };
    let (noise, calibration) = (config.camera_noise, config.calibration);
    let segmentation = config.segmentation;
    let mut source =
        LogSource::open(&arguments.log, Some(cameras), Modality::Vi, noise, segmentation, None, calibration)?;
    if let Some(duration_s) = arguments.duration {
        source.limit(duration_s);
    }
    source.limit_pictures(|_| false);
    while let Some(sensed) = source.next()? {
        sensed.warnings.iter().for_each(|warning| tracing::warn!("{warning}"));
    }
    let calibration = source.calibration().context("the log has no camera")?;
    let text = serde_json::to_string_pretty(&calibration)?;
    if let Some(path) = &arguments.out {
        write_named(path, text.as_bytes(), arguments.overwrite)?;
    }
    if arguments.json {
        return print_line(&text);
    }
    calibration.warnings().iter().for_each(|warning| tracing::warn!("{warning}"));
    print_line(&calibration.to_string())?;
    match &arguments.out {
        Some(path) => print_line(&format!("next: pass --calibration-file {} to `mambavitact run`", path.display())),
        None => print_line("next: add --out FILE to write it for `mambavitact run --calibration-file FILE`"),
    }
}

/// Largest calibration file that is read, bytes: hundreds of cameras.
const LARGEST_FILE: u64 = 1 << 20;

/// Reads a file that the command wrote.
pub fn read(path: &Path) -> Result<Calibration> {
    let text = input::read_text(path, LARGEST_FILE).with_context(|| path.display().to_string())?;
    serde_json::from_str(&text).with_context(|| format!("{} is not a calibration", path.display()))
}
