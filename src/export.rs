//! `export`: logs in formats that other programs read.

use std::path::PathBuf;

use anyhow::Result;
use clap::{Args, Subcommand};
use mvt_feelsight::Log;
use mvt_run::io::print_line;

/// Write a FeelSight log in a format that other programs read
#[derive(Debug, Subcommand)]
pub enum ExportCommand {
    Mcap(McapArguments),
}

/// Write a log as an MCAP file, which Foxglove and rerun open
///
/// The file has Foxglove's protobuf schemas: poses of cameras, DIGITs and object in /tf (frame world), joint angles in
/// /hand/joints, colours, labels, depth in metres and calibration of each camera in /camera/NAME, images and labels of
/// each DIGIT in /touch/FINGER. Images are the files of the log. The true pose of the object is included where the log
/// has one; the preview is not. Messages are compressed with LZ4.
#[derive(Debug, Args)]
pub struct McapArguments {
    /// Folder of the log
    log: PathBuf,
    /// File to write
    #[arg(long, value_name = "FILE", default_value = "log.mcap")]
    out: PathBuf,
    /// Replace an existing file
    #[arg(long)]
    overwrite: bool,
}

/// Runs the command.
pub fn run(ExportCommand::Mcap(arguments): &ExportCommand) -> Result<()> {
    let McapArguments { log, out, overwrite } = arguments;
    let log = Log::open(log)?;
    let bar = mvt_run::progress::bar(log.len() as u64, "exporting frames");
    let exported = mvt_exchange::export_mcap(&log, out, *overwrite, || bar.inc(1))?;
    bar.finish_and_clear();
    let megabytes = exported.bytes as f64 / 1e6;
    let (frames, channels) = (exported.frames, exported.channels);
    print_line(&format!("{frames} frames in {channels} channels, {megabytes:.1} MB in {}", out.display()))
}
