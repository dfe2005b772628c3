//! The program `mambavitact-window`: `mambavitact view`, `run --view` and `touch predict --view` start it.

use std::io::{IsTerminal as _, stderr};
use std::path::PathBuf;
use std::process::ExitCode;

use clap::Parser;
use mvt_viewer::{RecordingSource, WindowContents};
use mvt_window::WindowError;
use tracing_subscriber::Layer as _;
use tracing_subscriber::filter::{LevelFilter, Targets};
use tracing_subscriber::layer::SubscriberExt as _;
use tracing_subscriber::util::SubscriberInitExt as _;

/// Show runs and logs in a window, compare two of them, or show a touch sensor
///
/// Without options the window opens on a page that starts runs, or plays an example if there was no run yet. `mambavitact view` has more options.
#[derive(Debug, Parser)]
#[command(version, max_term_width = 110)]
struct WindowArguments {
    /// Folder of a run; two are compared
    #[arg(long = "run", value_name = "DIR")]
    runs: Vec<PathBuf>,
    /// Folder of a FeelSight log
    #[arg(long, value_name = "LOGDIR", conflicts_with = "runs")]
    log: Option<PathBuf>,
    /// Show the frames of this sensor, which come through standard input
    #[arg(long, value_name = "NAME", conflicts_with_all = ["runs", "log"])]
    sensor: Option<String>,
    /// Program that runs episodes [default: mambavitact beside this program]
    #[arg(long, value_name = "FILE")]
    program: Option<PathBuf>,
}

fn main() -> ExitCode {
    // Failures of the window's libraries are reported by the window itself.
    let off = ["eframe", "winit"].map(|library| (library, LevelFilter::OFF));
    let shown = Targets::new().with_default(LevelFilter::WARN).with_targets(off);
    let words = tracing_subscriber::fmt::layer()
        .with_writer(stderr)
        .with_ansi(stderr().is_terminal())
        .with_target(false)
        .without_time()
        .log_internal_errors(false);
    tracing_subscriber::registry().with(words.with_filter(shown)).init();

    let arguments = WindowArguments::parse();
    let beside = || Some(std::env::current_exe().ok()?.with_file_name("mambavitact"));
    if let Some(program) = arguments.program.or_else(beside) {
        mvt_run::program::set(program);
    }
    match open(arguments.sensor, arguments.runs, arguments.log) {
        Ok(()) => ExitCode::SUCCESS,
        Err(words) => {
            tracing::error!("{words}");
            ExitCode::FAILURE
        }
    }
}

/// Opens the window and returns when it is closed; the error is in words.
fn open(sensor: Option<String>, runs: Vec<PathBuf>, log: Option<PathBuf>) -> Result<(), String> {
    if let Some(sensor) = sensor {
        return mvt_window::open_sensor(&sensor)
            .map_err(|error| format!("{error}; without --view no window is needed"));
    }
    let mut runs = runs.into_iter().map(RecordingSource::Run);
    let contents = match (runs.next(), runs.next(), log) {
        (Some(first), Some(second), _) => WindowContents::Comparison([first, second]),
        (Some(run), None, _) => WindowContents::Recording(run),
        (None, _, Some(log)) => WindowContents::Recording(RecordingSource::Log(log)),
        (None, _, None) => WindowContents::Start,
    };
    mvt_window::open(&contents).map_err(|error: WindowError| format!("{error}; {}", contents.without_window()))
}
