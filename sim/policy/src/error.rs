//! Reasons why a policy cannot be played.

use std::path::PathBuf;

/// Why a policy cannot be read, or does not fit the hand. Each is one line.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PolicyError {
    /// The file or its contract is invalid.
    #[error("{}: {reason}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// The field, what is wrong, and what to do.
        reason: String,
    },
    /// A network that was made here cannot be written.
    #[error("the policy cannot be written: {0}")]
    Made(String),
}
