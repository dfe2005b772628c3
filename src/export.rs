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
    Lerobot(LerobotArguments),
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

/// Write logs as a data set of LeRobot v3.0, one episode for each log
///
/// Colours and depth of the cameras, images of the DIGITs, joint angles as state, those of the next frame as action, and the
/// object's pose where every frame has it. Images are PNG and JPEG files in Parquet, without video. Depth is in steps of 0.1
/// mm. All logs need the same cameras and frame rate. docs/exchange.md lists the columns.
#[derive(Debug, Args)]
pub struct LerobotArguments {
    /// Folders of the logs
    #[arg(value_name = "LOG", required = true)]
    logs: Vec<PathBuf>,
    /// Folder for the data set, which must not exist or be empty
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Keep depth to the bit for `import`, beside the tables; twice the space
    #[arg(long)]
    exact_depth: bool,
}

/// Runs the command.
pub fn run(command: &ExportCommand) -> Result<()> {
    match command {
        ExportCommand::Mcap(arguments) => mcap(arguments),
        ExportCommand::Lerobot(arguments) => lerobot(arguments),
    }
}

fn mcap(arguments: &McapArguments) -> Result<()> {
    let McapArguments { log, out, overwrite } = arguments;
    let log = Log::open(log)?;
    let bar = mvt_run::progress::bar(log.len() as u64, "exporting frames");
    let exported = mvt_exchange::export_mcap(&log, out, *overwrite, || bar.inc(1))?;
    bar.finish_and_clear();
    let megabytes = exported.bytes as f64 / 1e6;
    let (frames, channels) = (exported.frames, exported.channels);
    print_line(&format!("{frames} frames in {channels} channels, {megabytes:.1} MB in {}", out.display()))
}

fn lerobot(LerobotArguments { logs, out, exact_depth }: &LerobotArguments) -> Result<()> {
    let bar = mvt_run::progress::bar(0, "exporting frames");
    let exported = mvt_exchange::export_lerobot(logs, out, *exact_depth, || {
        bar.inc_length(1);
        bar.inc(1);
    })?;
    bar.finish_and_clear();
    print_line(&format!("{} episodes, {} frames in {}", exported.episodes, exported.frames, out.display()))
}
