//! Lines of results that outlive an interruption.

use std::fs::{File, OpenOptions};
use std::io::Write as _;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result};
use mvt_files::input;
use mvt_metrics::SequenceScore;
use serde::{Deserialize, Serialize};

/// Result of a sequence.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct ResultLine {
    /// Path below the data set.
    pub sequence: String,
    /// How its files are laid out.
    pub layout: String,
    /// Name of the object, or the path of its mesh.
    pub object: String,
    #[serde(flatten)]
    pub outcome: Outcome,
}

/// End of a run on a sequence.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub(crate) enum Outcome {
    Scored { frames: usize, frames_per_second: f64, score: SequenceScore },
    Failed { error: String },
}

/// File of results, a line of JSON for each sequence.
pub(crate) struct ResultFile {
    path: PathBuf,
    file: File,
    pub lines: Vec<ResultLine>,
}

/// Largest file of results that is read, bytes.
const LARGEST: u64 = 64 << 20;

impl ResultFile {
    /// Opens a file with the results that an earlier run has left. Failures are tried again.
    pub fn resumed(path: &Path) -> Result<Self> {
        let text = if path.exists() {
            input::read_text(path, LARGEST).with_context(|| path.display().to_string())?
        } else {
            String::new()
        };
        // The last line of a killed process may be cut off.
        let (mut lines, mut kept) = (Vec::new(), String::new());
        for text in text.lines() {
            let Ok(line) = serde_json::from_str::<ResultLine>(text) else { continue };
            if matches!(line.outcome, Outcome::Scored { .. }) {
                lines.push(line);
                kept += &format!("{text}\n");
            }
        }
        mvt_files::output::replace(path, kept.as_bytes())
            .with_context(|| format!("cannot write {}", path.display()))?;
        let file = OpenOptions::new().append(true).open(path).with_context(|| path.display().to_string())?;
        Ok(Self { path: path.to_owned(), file, lines })
    }

    /// Returns whether a sequence has a result.
    pub fn has(&self, sequence: &str) -> bool {
        self.lines.iter().any(|line| line.sequence == sequence)
    }

    /// Adds a result.
    pub fn add(&mut self, line: ResultLine) -> Result<()> {
        let text = serde_json::to_string(&line)? + "\n";
        self.file.write_all(text.as_bytes()).with_context(|| format!("cannot write {}", self.path.display()))?;
        self.lines.push(line);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn failures_and_cut_lines_are_dropped() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("results.jsonl");
        let line = |sequence: &str, outcome| ResultLine {
            sequence: sequence.to_owned(),
            layout: "BOP".to_owned(),
            object: "a".to_owned(),
            outcome,
        };
        let mut results = ResultFile::resumed(&path).unwrap();
        results.add(line("x", Outcome::Failed { error: "no mask".to_owned() })).unwrap();
        let score = r#"{"scored_frames":2,"first_frame":0,"add_auc":90.0,"add_s_auc":95.5,"add_mm":10.0,"add_s_mm":4.5,"chamfer_mm":null,"f5":null,"wrong":0.0,"abstained":50.0}"#;
        let score = serde_json::from_str(score).unwrap();
        results.add(line("y", Outcome::Scored { frames: 2, frames_per_second: 20.0, score })).unwrap();
        results.file.write_all(b"{\"sequence\":\"z\",").unwrap();
        let again = ResultFile::resumed(&path).unwrap();
        assert!(again.has("y") && !again.has("x") && again.lines.len() == 1);
        assert_eq!(again.lines[0], results.lines[1]);
    }
}
