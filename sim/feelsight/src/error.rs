//! Defects of a log. Each message holds its reason, so there is no chain of sources.

use std::path::{Path, PathBuf};

use crate::npz::NpzError;
use crate::pickle::PickleError;

/// Reason why a log was not written or read. Every message names the file.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum LogError {
    /// The operating system refused: the disk is full, a file is missing or read-only.
    #[error("{}: {reason}", path.display())]
    Io {
        /// File or folder.
        path: PathBuf,
        /// Reason of the operating system.
        reason: std::io::Error,
    },
    /// A signal has ended the encoder of a film, as it does when a job is cancelled.
    #[error("{}: ffmpeg was interrupted: the log has no film", path.display())]
    Interrupted {
        /// The film.
        path: PathBuf,
    },
    /// The folder for a new log is not empty.
    #[error("{}: the folder is not empty; choose another or ask to overwrite it", path.display())]
    NotEmpty {
        /// The folder.
        path: PathBuf,
    },
    /// data.pkl is not a pickle of plain data.
    #[error("{}: {reason}", path.display())]
    Pickle {
        /// data.pkl
        path: PathBuf,
        /// The defect.
        reason: PickleError,
    },
    /// depth.npz is damaged.
    #[error("{}: {reason}", path.display())]
    Npz {
        /// depth.npz
        path: PathBuf,
        /// The defect.
        reason: NpzError,
    },
    /// An image is damaged.
    #[error("{}: {reason}", path.display())]
    Image {
        /// The image.
        path: PathBuf,
        /// The defect.
        reason: mvt_images::DecodeError,
    },
    /// scene.json is damaged.
    #[error("{}: {reason}", path.display())]
    Json {
        /// scene.json
        path: PathBuf,
        /// The defect.
        reason: serde_json::Error,
    },
    /// The contents contradict the format or each other.
    #[error("{}: {defect}", path.display())]
    Defect {
        /// File or folder.
        path: PathBuf,
        /// A sentence.
        defect: String,
    },
    /// A frame does not fit the log to which it was pushed.
    #[error("the frame at {time_s:.3} s does not fit the log: {defect}")]
    Frame {
        /// Time of the frame.
        time_s: f64,
        /// A sentence.
        defect: String,
    },
}

impl LogError {
    /// Whether the file does not exist.
    pub(crate) fn is_missing_file(&self) -> bool {
        matches!(self, Self::Io { reason, .. } if reason.kind() == std::io::ErrorKind::NotFound)
    }

    /// Describes a defect of a file or folder.
    pub(super) fn defect(path: impl Into<PathBuf>, defect: impl Into<String>) -> Self {
        Self::Defect { path: path.into(), defect: defect.into() }
    }

    /// Names the file of an error of depth.npz.
    pub(super) fn npz(path: impl Into<PathBuf>) -> impl FnOnce(NpzError) -> Self {
        let path = path.into();
        move |reason| Self::Npz { path, reason }
    }

    /// Names the file of an error of the operating system.
    pub(super) fn io(path: impl AsRef<Path>) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.as_ref().to_path_buf();
        move |reason| Self::Io { path, reason }
    }
}
