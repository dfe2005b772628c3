//! Reports of runs and sweeps: one HTML file that needs neither network nor server.
//!
//! [`RunCollection`] reads folders of runs and tables of `evaluate`; [`html`] writes the page: headline figures with
//! intervals, plots, the worst runs with films, shapes in three dimensions and a table of all runs, and the paired
//! differences to another collection. Text from files is escaped, and the page forbids its browser every request. The
//! same runs give the same bytes. Nothing is estimated or scored here.
//!
//! ```
//! use mvt_report::{MediaChoice, RunCollection, html};
//!
//! # let home = tempfile::tempdir()?;
//! # let line = r#"{"object":"can","seed":1,"cameras":"side","mode":"slam","modality":"vitac","variant":"full","frames":9,
//! #  "f_score":{"5":0.9},"add_s_mm":{"mean":1.5,"median":1,"p95":2,"final":1},"lost_frames":0}"#.replace('\n', "");
//! # std::fs::write(home.path().join("runs.jsonl"), line)?;
//! # let folder = home.path().to_path_buf();
//! let runs = RunCollection::read(&[folder])?;
//! let (page, warnings) = html(&runs, None, MediaChoice { films: 4, shapes: 24 });
//! assert!(page.starts_with("<!DOCTYPE html>") && page.contains("slam · vitac · side"));
//! assert!(warnings.is_empty());
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod collect;
mod compare;
mod encode;
mod film;
mod media;
mod metric;
mod page;
mod plot;
mod row;
mod shape;
mod statistics;
mod thin;

use std::collections::BTreeMap;
use std::path::PathBuf;

pub use collect::RunCollection;
pub use row::{ErrorCurve, ReportRow, RunIdentity, RunKind};

use media::PageMedia;
use page::Page;

/// Most runs in the list of the worst.
const WORST: usize = 12;

/// Why there is no report.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ReportError {
    /// There is no run.
    #[error("{} contains no run{}; give folders that `run`, `evaluate` or `sweep` has written", named(.folders), because(.reason))]
    NoRuns {
        /// The folders.
        folders: Vec<PathBuf>,
        /// The first thing that was skipped.
        reason: Option<String>,
    },
    /// A folder cannot be read.
    #[error("cannot read {}: {error}", path.display())]
    Io {
        /// The folder.
        path: PathBuf,
        /// The reason.
        error: std::io::Error,
    },
}

fn named(folders: &[PathBuf]) -> String {
    folders.iter().map(|folder| folder.display().to_string()).collect::<Vec<_>>().join(", ")
}

fn because(reason: &Option<String>) -> String {
    reason.as_ref().map_or_else(String::new, |reason| format!(" ({reason})"))
}

/// Numbers of films and shapes on a page.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct MediaChoice {
    /// Films, of the worst runs.
    pub films: usize,
    /// Shapes, of the worst runs and of the median run of each object.
    pub shapes: usize,
}

/// Writes the page of a collection, compared with another one if it is given. Returns also a line for each film or shape
/// that could not be read.
pub fn html(runs: &RunCollection, against: Option<&RunCollection>, choice: MediaChoice) -> (String, Vec<String>) {
    let others = against.map(|old| old.rows.as_slice()).unwrap_or_default();
    let rows: Vec<&ReportRow> = runs.rows.iter().chain(others).collect();
    let worst = by_badness(&runs.rows);
    // Runs that have a folder come first among those that are shown with films and shapes.
    let with_folder: Vec<usize> =
        worst.iter().copied().filter(|&k| rows.get(k).is_some_and(|row| row.folder.is_some())).collect();
    let films: Vec<usize> = with_folder.iter().copied().take(choice.films).collect();
    let pairs = against.map(|old| compare::Comparison::new(runs, old).notable()).unwrap_or_default();
    let pairs = pairs.into_iter().filter(|&k| rows.get(k).is_some_and(|row| row.folder.is_some()));
    let mut shapes: Vec<usize> = with_folder.iter().copied().take(WORST.min(choice.shapes)).collect();
    for number in pairs.chain(typical(&runs.rows)).chain(with_folder.iter().copied().take(choice.shapes)) {
        if shapes.len() < choice.shapes && !shapes.contains(&number) {
            shapes.push(number);
        }
    }
    let (media, warnings) = PageMedia::read(&rows, &films, &shapes);
    let listed: Vec<usize> = worst.into_iter().take(WORST).collect();
    (Page { runs, against, worst: &listed, media: &media }.html(), warnings)
}

/// Returns the numbers of the runs, the worst first. Interrupted runs come last.
fn by_badness(rows: &[ReportRow]) -> Vec<usize> {
    let mut numbers: Vec<usize> = (0..rows.len()).collect();
    let key = |&k: &usize| rows.get(k).map_or((false, 0.0), |row| (row.is_complete, row.badness()));
    numbers.sort_by(|a, b| {
        let ((complete_a, a), (complete_b, b)) = (key(a), key(b));
        complete_b.cmp(&complete_a).then(b.total_cmp(&a))
    });
    numbers
}

/// Returns the numbers of the median run of each object, among those that have a folder.
fn typical(rows: &[ReportRow]) -> Vec<usize> {
    let mut objects = BTreeMap::<&str, Vec<(f64, usize)>>::new();
    for (number, row) in rows.iter().enumerate().filter(|(_, row)| row.folder.is_some() && row.is_complete) {
        objects.entry(&row.id.object).or_default().push((row.badness(), number));
    }
    let median = |runs: &mut Vec<(f64, usize)>| {
        runs.sort_by(|a, b| a.0.total_cmp(&b.0));
        runs.get(runs.len() / 2).map(|(_, number)| *number)
    };
    objects.values_mut().filter_map(median).collect()
}
