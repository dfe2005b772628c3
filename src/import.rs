//! `import`: recordings of other programs as logs.

use std::path::PathBuf;

use anyhow::Result;
use clap::Args;
use mvt_exchange::{import_lerobot, import_mcap};
use mvt_run::io::{print_line, shell_word};
use mvt_run::progress;

/// Turn a recording into a log that `run --log` takes
///
/// SOURCE is an MCAP file with Foxglove's protobuf schemas, or the folder of a data set of LeRobot v3.0. Those that `export`
/// wrote need no more. For others a mapping file names the topics, or the columns, of joints, cameras and touch sensors;
/// docs/exchange.md describes it. A frame of a data set is a row.
///
/// The frames of an MCAP file are the depth images of the first camera. Each frame takes the nearest image of every other
/// sensor; joint angles and the object's pose are interpolated. The command prints a table of the channels: rate,
/// offset of the clock, and distance from the frames. Warnings name the missing parts. Without labels `run` labels the pixels
/// itself; without a true pose of the object there are no scores.
#[derive(Debug, Args)]
pub struct ImportArguments {
    /// MCAP file, or folder of a data set
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

/// Runs the command.
pub fn run(arguments: &ImportArguments) -> Result<()> {
    let ImportArguments { source, mapping, episode, out, json } = arguments;
    let bar = progress::bar(0, "importing frames");
    let advance = |done, all| {
        bar.set_length(all as u64);
        bar.set_position(done as u64);
    };
    let mapping = mapping.as_deref();
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
