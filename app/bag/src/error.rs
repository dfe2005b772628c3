//! Reasons why a bag or a message cannot be used.

use std::path::{Path, PathBuf};

use crate::cdr::CdrError;

/// Name of the file beside a bag, or in its folder, that states the choice of topics.
pub(crate) const FILE: &str = "bag.toml";

/// Reason why a message cannot be used. Each text is one line.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum RosError {
    /// The message is cut off or of another type.
    #[error(transparent)]
    Cdr(#[from] CdrError),
    /// The contents have a fault.
    #[error("{0}")]
    Fault(String),
}

impl RosError {
    /// Returns a fault.
    pub(crate) fn fault(text: impl Into<String>) -> Self {
        Self::Fault(text.into())
    }
}

/// Reason why a bag cannot be used. Each text is one line.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum BagError {
    /// A file cannot be read.
    #[error("{}: {reason}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// Reason.
        reason: std::io::Error,
    },
    /// The file is a bag of ROS 1.
    #[error(
        "{}: it is a bag of ROS 1; convert it with `pip install rosbags` and `rosbags-convert --src {} --dst FOLDER`", path.display(), path.display()
    )]
    Ros1 {
        /// The file.
        path: PathBuf,
    },
    /// A file or folder has a fault.
    #[error("{}: {fault}", path.display())]
    Fault {
        /// The file or folder.
        path: PathBuf,
        /// The fault and what to do.
        fault: String,
    },
    /// There is no topic of this name.
    #[error("{}: there is no topic {topic:?}; there are {found}", path.display())]
    NoTopic {
        /// The bag.
        path: PathBuf,
        /// The name that was asked for.
        topic: String,
        /// The names of the topics.
        found: String,
    },
    /// A topic for a purpose must be chosen by a person.
    #[error("{}: {fault}; write `{key} = \"TOPIC\"` into {} beside the bag: {candidates}", path.display(), FILE)]
    Choice {
        /// The bag.
        path: PathBuf,
        /// What is missing or doubled.
        fault: String,
        /// Key that states the choice.
        key: &'static str,
        /// The topics that may be meant.
        candidates: String,
    },
    /// A message cannot be used.
    #[error("{}: {topic}, message at {:.3} s: {reason}", path.display(), *log_ns as f64 * 1e-9)]
    Message {
        /// The bag.
        path: PathBuf,
        /// Its topic.
        topic: String,
        /// When it was recorded, nanoseconds.
        log_ns: i64,
        /// Reason.
        reason: RosError,
    },
}

impl BagError {
    /// Returns a fault of a file or folder.
    pub(crate) fn fault(path: &Path, fault: impl Into<String>) -> Self {
        Self::Fault { path: path.to_owned(), fault: fault.into() }
    }

    /// Returns a function that makes an error of the operating system one of this file.
    pub(crate) fn io(path: &Path) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.to_owned();
        move |reason| Self::Io { path, reason }
    }
}
