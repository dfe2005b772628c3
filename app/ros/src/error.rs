//! Reasons why there is no connection.

use std::path::PathBuf;

/// Reason why there is no connection to ROS 2. Each text is one line.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum LiveError {
    /// The file cannot be read.
    #[error("{}: {reason}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// Reason.
        reason: std::io::Error,
    },
    /// The file has a fault.
    #[error("{}: {fault}", path.display())]
    Fault {
        /// The file.
        path: PathBuf,
        /// The fault and what to do.
        fault: String,
    },
    /// The network cannot be joined, or a topic cannot be opened.
    #[error("ROS 2: {what}: {reason}")]
    Network {
        /// What failed.
        what: String,
        /// Reason of the library.
        reason: String,
    },
}

impl LiveError {
    /// Returns a function that makes a failure of the library one of this purpose.
    pub(crate) fn network<E: std::fmt::Debug>(what: impl Into<String>) -> impl FnOnce(E) -> Self {
        let what = what.into();
        move |reason| Self::Network { what, reason: format!("{reason:?}").replace('\n', " ") }
    }
}
