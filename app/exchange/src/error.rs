//! Reasons why a log was not exported or a recording not imported.

use std::path::{Path, PathBuf};

use mvt_bag::mcap::McapError;
use mvt_feelsight::LogError;

/// Why a log was not exported or a recording not imported.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ExchangeError {
    /// The log cannot be read or written.
    #[error(transparent)]
    Log(#[from] LogError),
    /// The recording of a run cannot be read.
    #[error(transparent)]
    Recording(#[from] mvt_recording::RecordingError),
    /// The new file exists.
    #[error("{} already exists; choose another name or ask to overwrite it", .0.display())]
    Exists(PathBuf),
    /// The operating system refused.
    #[error("cannot write {}: {reason}", path.display())]
    Io {
        /// The new file.
        path: PathBuf,
        /// Reason of the operating system.
        reason: std::io::Error,
    },
    /// The mapping file is invalid.
    #[error("{}: {reason}", path.display())]
    Mapping {
        /// The mapping file.
        path: PathBuf,
        /// A sentence.
        reason: String,
    },
    /// The recording is damaged, or lacks a part that a log needs.
    #[error("{}: {defect}", path.display())]
    Source {
        /// The recording.
        path: PathBuf,
        /// A sentence.
        defect: String,
    },
}

/// Why the messages of a recording are not used, without the name of the file.
#[derive(Debug)]
pub(crate) enum Defect {
    Log(LogError),
    Words(String),
}

impl Defect {
    /// Names the file.
    pub fn of(self, path: &Path) -> ExchangeError {
        match self {
            Self::Log(error) => ExchangeError::Log(error),
            Self::Words(defect) => ExchangeError::Source { path: path.to_path_buf(), defect },
        }
    }
}

impl From<McapError> for Defect {
    fn from(error: McapError) -> Self {
        Self::Words(error.to_string())
    }
}

impl From<LogError> for Defect {
    fn from(error: LogError) -> Self {
        Self::Log(error)
    }
}

impl From<String> for Defect {
    fn from(words: String) -> Self {
        Self::Words(words)
    }
}
