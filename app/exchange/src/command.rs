//! The commands `export` and `import`.

use std::path::{Path, PathBuf};

use anyhow::Result;
use clap::{Args, Subcommand};
use mvt_feelsight::Log;
use mvt_recording::Recording;
use mvt_run::io::{print_line, shell_word};
use mvt_run::progress;

use crate::import_sequence::{ImportedSequence, import_sequence, is_sequence};
use crate::{Exported, export_lerobot, export_mcap, export_run, import_lerobot, import_mcap};

/// Write a log or a run in a format that other programs read
#[derive(Debug, Subcommand)]
pub enum ExportCommand {
    /// Write a log or a run as an MCAP file, which Foxglove and rerun open
    ///
    /// The file has Foxglove's protobuf schemas: poses of cameras, touch sensors and object in /tf (frame world), joint angles in
    /// /hand/joints, colours, labels, depth in metres and calibration of each camera in /camera/NAME, images and labels of
    /// each touch sensor in /touch/PAD. Images are the files of the log. The true pose of the object is included where the log
    /// has one; the preview is not. Messages are compressed with LZ4.
    ///
    /// Of a run (the folder of `run --out`), the file has the recording: the estimated pose, the shape as it grew, state and scores
    /// in /estimate, the true shape in /truth, events, point clouds, and every third image, reduced.
    Mcap(McapArguments),
    /// Write logs as a data set of LeRobot v3.0, one episode for each log
    ///
    /// Colours and depth of the cameras, images of the touch sensors, joint angles as state, those of the next frame as action, and the
    /// object's pose where every frame has it. Images are PNG and JPEG files in Parquet, without video. Depth is in steps of 0.1
    /// mm. All logs need the same cameras and frame rate. docs/exchange.md lists the columns.
    Lerobot(LerobotArguments),
}

/// Arguments of `export mcap`.
#[derive(Debug, Args)]
pub struct McapArguments {
    /// Folder of the log or of the run
    source: PathBuf,
    /// File to write
    #[arg(long, value_name = "FILE", default_value = "log.mcap")]
    out: PathBuf,
    /// Replace an existing file
    #[arg(long)]
    overwrite: bool,
}

/// Arguments of `export lerobot`.
#[derive(Debug, Args)]
pub struct LerobotArguments {
    /// Folders of the logs
    #[arg(value_name = "LOG", required = true)]
    logs: Vec<PathBuf>,
    /// Folder for the data set, which must not exist or be empty
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Runs of the logs, in their order: their estimates become columns
    #[arg(long, value_name = "RUN,...", value_delimiter = ',')]
    runs: Vec<PathBuf>,
    /// Keep depth to the bit for `import`, beside the tables; twice the space
    #[arg(long)]
    exact_depth: bool,
}

/// Runs `export`.
///
/// # Errors
/// If a source cannot be read or the file not be written.
pub fn export(command: &ExportCommand) -> Result<()> {
    match command {
        ExportCommand::Mcap(arguments) => mcap(arguments),
        ExportCommand::Lerobot(arguments) => lerobot(arguments),
    }
}

fn mcap(arguments: &McapArguments) -> Result<()> {
    let McapArguments { source, out, overwrite } = arguments;
    let exported = if source.join(mvt_recording::FOLDER).is_dir() {
        run_as_mcap(source, out, *overwrite)?
    } else {
        let log = Log::open(source)?;
        let bar = progress::bar(log.len() as u64, "exporting frames");
        let exported = export_mcap(&log, out, *overwrite, || bar.inc(1))?;
        bar.finish_and_clear();
        exported
    };
    let megabytes = exported.bytes as f64 / 1e6;
    let (frames, channels) = (exported.frames, exported.channels);
    print_line(&format!("{frames} frames in {channels} channels, {megabytes:.1} MB in {}", out.display()))
}

/// Writes the recording of a run as an MCAP file.
///
/// # Errors
/// If the recording cannot be read or the file not be written.
pub fn run_as_mcap(run: &Path, out: &Path, overwrite: bool) -> Result<Exported> {
    let recording = Recording::open(run)?;
    let bar = progress::bar(recording.moments().len() as u64, "exporting frames");
    let exported = export_run(&recording, out, overwrite, || bar.inc(1))?;
    bar.finish_and_clear();
    Ok(exported)
}

fn lerobot(LerobotArguments { logs, runs, out, exact_depth }: &LerobotArguments) -> Result<()> {
    let bar = progress::bar(0, "exporting frames");
    let exported = export_lerobot(logs, runs, out, *exact_depth, || {
        bar.inc_length(1);
        bar.inc(1);
    })?;
    bar.finish_and_clear();
    print_line(&format!("{} episodes, {} frames in {}", exported.episodes, exported.frames, out.display()))
}

/// Turn a recording into a log that `run --log` takes
///
/// SOURCE is an RGB-D sequence or a bag of ROS 2 (docs/rgbd.md), which becomes a folder of images, or a recording of a hand: an MCAP file with Foxglove's
/// protobuf schemas, or the folder of a data set of LeRobot v3.0. Those that `export`
/// wrote need no more. For others a mapping file names the topics, or the columns, of joints, cameras and touch sensors;
/// docs/exchange.md describes it. A frame of a data set is a row.
///
/// The frames of an MCAP file are the depth images of the first camera. Each frame takes the nearest image of every other
/// sensor; joint angles and the object's pose are interpolated. The command prints a table of the channels: rate,
/// offset of the clock, and distance from the frames. Warnings name the missing parts. Without labels `run` labels the pixels
/// itself; without a true pose of the object there are no scores.
#[derive(Debug, Args)]
pub struct ImportArguments {
    /// File or folder of the recording
    source: PathBuf,
    /// TOML file that says which topics or columns are which sensors; not needed for an export of this program
    #[arg(long, value_name = "FILE")]
    mapping: Option<PathBuf>,
    /// Episode of a data set
    #[arg(long, value_name = "N", default_value_t = 0)]
    episode: usize,
    /// Folder for the new log, which must not exist or be empty
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Print the table and the missing parts as JSON
    #[arg(long)]
    json: bool,
}

/// Runs `import`.
///
/// # Errors
/// If the source cannot be read or the log not be written.
pub fn import(arguments: &ImportArguments) -> Result<()> {
    let ImportArguments { source, mapping, episode, out, json } = arguments;
    let bar = progress::bar(0, "importing frames");
    let advance = |done, all| {
        bar.set_length(all as u64);
        bar.set_position(done as u64);
    };
    let mapping = mapping.as_deref();
    if mapping.is_none() && is_sequence(source) {
        let imported = import_sequence(source, out, advance)?;
        bar.finish_and_clear();
        return told_sequence(&imported, out, *json);
    }
    let imported = if source.is_dir() {
        import_lerobot(source, *episode, mapping, out, advance)?
    } else {
        import_mcap(source, mapping, out, advance)?
    };
    bar.finish_and_clear();
    if *json {
        return print_line(&serde_json::to_string(&imported)?);
    }
    for note in &imported.notes {
        tracing::warn!("{note}");
    }
    print_line(&format!("{imported} in {}", out.display()))?;
    print_line(&format!("next: `mambavitact run --log {}`", shell_word(&out.to_string_lossy())))
}

fn told_sequence(imported: &ImportedSequence, out: &Path, json: bool) -> Result<()> {
    if json {
        return print_line(&serde_json::to_string(imported)?);
    }
    for note in &imported.notes {
        tracing::warn!("{note}");
    }
    let ImportedSequence { layout, frames, masks, object_poses, moves, .. } = imported;
    let camera = if *moves { ", poses of the camera" } else { "" };
    print_line(&format!(
        "{layout}: {frames} frames, {masks} masks, {object_poses} true poses{camera} in {}",
        out.display()
    ))?;
    print_line(&format!("next: `mambavitact run --log {}`", shell_word(&out.to_string_lossy())))
}
