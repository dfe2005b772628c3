//! `report`: one HTML file of runs and sweeps.

use std::path::PathBuf;

use anyhow::Result;
use clap::Args;
use mvt_report::{MediaChoice, RunCollection, html};
use mvt_run::io::{check_named, print_line, write_named};

/// Make a report of runs and sweeps: one HTML file that can be sent
///
/// The file needs neither a network nor a server. It shows headline figures with 95 % intervals, plots by object,
/// cameras and sensors, errors over time and against the hidden part of the object, the worst runs first with films,
/// shapes that turn with the mouse, and a table of all runs that sorts and filters. It is readable on a phone and in
/// dark mode.
///
/// With --against the runs of both sides that have the same object, seed and sensors are compared in pairs.
#[derive(Debug, Args)]
pub struct ReportArguments {
    /// Folders of runs, or folders that contain them or tables of `evaluate` (*.jsonl) at any depth
    #[arg(value_name = "DIR", required = true)]
    folders: Vec<PathBuf>,
    /// Folders of the runs to compare with
    #[arg(long, value_name = "DIR", num_args = 1..)]
    against: Vec<PathBuf>,
    /// File to write
    #[arg(long, value_name = "FILE", default_value = "report.html")]
    out: PathBuf,
    /// Number of films, of the worst runs; each takes some 0.9 MB and a second. All films take at most 7 MB
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u16).range(0..=100))]
    films: u16,
    /// Number of shapes, of the worst runs and of the median run of each object; all shapes take at most 5 MB
    #[arg(long, value_name = "N", default_value_t = 24, value_parser = clap::value_parser!(u16).range(0..=1000))]
    shapes: u16,
    /// Replace an existing file
    #[arg(long)]
    overwrite: bool,
}

/// Runs the command.
pub fn run(arguments: &ReportArguments) -> Result<()> {
    let ReportArguments { folders, against, out, films, shapes, overwrite } = arguments;
    check_named(out, *overwrite)?;
    let bar = mvt_run::progress::bar(3, "reading runs");
    let read = |folders: &[PathBuf]| -> Result<RunCollection> {
        let runs = RunCollection::read(folders)?;
        bar.suspend(|| runs.warnings.iter().for_each(|warning| tracing::warn!("{warning}")));
        Ok(runs)
    };
    let runs = read(folders)?;
    let others = if against.is_empty() { None } else { Some(read(against)?) };
    bar.inc(1);
    bar.set_message("painting films and shapes");
    let choice = MediaChoice { films: usize::from(*films), shapes: usize::from(*shapes) };
    let (page, warnings) = html(&runs, others.as_ref(), choice);
    bar.suspend(|| warnings.iter().for_each(|warning| tracing::warn!("{warning}")));
    bar.inc(1);
    write_named(out, page.as_bytes(), *overwrite)?;
    bar.finish_and_clear();
    let count = runs.rows.len() + others.map_or(0, |others| others.rows.len());
    print_line(&format!("{count} runs, {:.1} MB in {}", page.len() as f64 / 1e6, out.display()))?;
    print_line(&format!("next: open {} in a browser", out.display()))
}
