//! What can be wrong with a log. Messages hold their reasons, so that one line says all; there is no chain of sources.

use std::path::{Path, PathBuf};

use super::{npz, pickle};

/// Why a log could not be written or read. Every message names the file.
#[derive(Debug, thiserror::Error)]
pub enum LogError {
    /// The operating system refused: disk full, read-only, missing.
    #[error("{}: {reason}", path.display())]
    Io {
        /// File or folder.
        path: PathBuf,
        /// Its reason.
        reason: std::io::Error,
    },
    /// The folder for a new log holds something.
    #[error("{}: the folder is not empty; choose another or ask to overwrite it", path.display())]
    NotEmpty {
        /// The folder.
        path: PathBuf,
    },
    /// data.pkl is no pickle of plain data.
    #[error("{}: {reason}", path.display())]
    Pickle {
        /// data.pkl
        path: PathBuf,
        /// The defect.
        reason: pickle::PickleError,
    },
    /// depth.npz is broken.
    #[error("{}: {reason}", path.display())]
    Npz {
        /// depth.npz
        path: PathBuf,
        /// The defect.
        reason: npz::NpzError,
    },
    /// An image is broken.
    #[error("{}: {reason}", path.display())]
    Image {
        /// The image.
        path: PathBuf,
        /// The defect.
        reason: image::ImageError,
    },
    /// scene.json is broken.
    #[error("{}: {reason}", path.display())]
    Json {
        /// scene.json
        path: PathBuf,
        /// The defect.
        reason: serde_json::Error,
    },
    /// The contents contradict the format or one another.
    #[error("{}: {defect}", path.display())]
    Defect {
        /// File or folder.
        path: PathBuf,
        /// A sentence.
        defect: String,
    },
    /// A frame that was to be written does not fit the log.
    #[error("the frame at {time_s:.3} s does not fit the log: {defect}")]
    Frame {
        /// Time of the frame.
        time_s: f64,
        /// A sentence.
        defect: String,
    },
}

impl LogError {
    pub(super) fn defect(path: impl Into<PathBuf>, defect: impl Into<String>) -> Self {
        Self::Defect { path: path.into(), defect: defect.into() }
    }

    pub(super) fn io(path: impl AsRef<Path>) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.as_ref().to_path_buf();
        move |reason| Self::Io { path, reason }
    }
}
