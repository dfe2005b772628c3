//! `convert`: logs from FeelSight's layout to the compact one and back.

use std::path::PathBuf;

use anyhow::Result;
use clap::Args;
use mvt_feelsight::{Log, LogFormat};
use mvt_run::io::{print_line, shell_word};
use mvt_run::progress;

/// Change the layout of a log: FeelSight's to compact, and back
///
/// A compact log takes an eighth of the space and a few files. Every command reads both layouts. Joints, poses, labels
/// and touch depth stay exact; camera depth is rounded to 0.1 mm; images are JPEG of lower quality, those of DIGITs as
/// differences from the untouched image. docs/compact_log.md describes the layout and gives the bounds.
#[derive(Debug, Args)]
pub struct ConvertArguments {
    /// Folder of the log
    #[arg(value_name = "LOG")]
    log: PathBuf,
    /// Folder for the new log, which must not exist or be empty
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Layout of the new log: feelsight or compact [default: the one that the log does not have]
    #[arg(long, value_name = "FORMAT")]
    format: Option<LogFormat>,
}

/// Runs the command.
pub fn run(arguments: &ConvertArguments) -> Result<()> {
    let ConvertArguments { log, out, format } = arguments;
    let format = format.unwrap_or(match LogFormat::of(log) {
        LogFormat::FeelSight => LogFormat::Compact,
        LogFormat::Compact => LogFormat::FeelSight,
    });
    let frames = Log::open(log)?.len();
    let bar = progress::bar(frames as u64, "frames");
    mvt_feelsight::convert(log, out, format, |frames| bar.set_position(frames as u64))?;
    bar.finish_and_clear();
    print_line(&format!("{frames} frames in {}, layout {format}", out.display()))?;
    print_line(&format!("next: check it with `mambavitact inspect {}`", shell_word(&out.to_string_lossy())))
}
