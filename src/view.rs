//! `view`: a run or a log, looked at.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use anyhow::{Context as _, Result, bail};
use clap::Args;

use crate::recording::Recording;

/// Look at a run, finished or still going, or at a raw log
#[derive(Debug, Args)]
pub struct Arguments {
    /// Folder of a run
    #[arg(long, value_name = "DIR", conflicts_with = "log")]
    run: Option<PathBuf>,
    /// A FeelSight log
    #[arg(long, value_name = "LOGDIR")]
    log: Option<PathBuf>,
}

/// Runs the command.
pub fn run(arguments: &Arguments) -> Result<()> {
    let recording = match (&arguments.run, &arguments.log) {
        (Some(folder), _) => Recording::open(folder)?,
        (None, Some(folder)) => Recording::open_log(folder)?,
        (None, None) => bail!("give --run DIR or --log LOGDIR"),
    };
    println!("{} {:?}", recording.moments().len(), recording.status());
    Ok(())
}

/// Opens a window on a run in a process of its own, so that neither waits for the other nor ends with it.
pub fn watch(run: &Path) -> Result<()> {
    let program = std::env::current_exe().context("cannot find this program")?;
    Command::new(program)
        .args(["view", "--run"])
        .arg(run)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .spawn()
        .context("cannot start the viewer")?;
    Ok(())
}
