//! Reasons why a folder cannot be read.

use std::path::{Path, PathBuf};

/// Reason why an RGB-D sequence cannot be used. Each message is one line.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RgbdError {
    /// A file cannot be read.
    #[error("{}: {reason}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// Reason.
        reason: std::io::Error,
    },
    /// A file or folder has a fault.
    #[error("{}: {fault}", path.display())]
    Fault {
        /// The file or folder.
        path: PathBuf,
        /// The fault and what to do.
        fault: String,
    },
}

impl RgbdError {
    /// A fault of a file or folder.
    pub(crate) fn fault(path: &Path, fault: impl Into<String>) -> Self {
        Self::Fault { path: path.to_owned(), fault: fault.into() }
    }

    /// Returns a function that makes an error of the operating system one of this file.
    pub(crate) fn io(path: &Path) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.to_owned();
        move |reason| Self::Io { path, reason }
    }
}
