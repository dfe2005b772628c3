//! Reads recordings, also those that still grow.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use scenes::mesh::Mesh;

use super::{About, Images, KnownShape, Moment, RecordingError, ShapeEntry, Status};
use crate::report::Event;

/// A recording, read.
pub struct Recording {
    folder: PathBuf,
    about: About,
    moments: Vec<Moment>,
    shapes: Vec<ShapeEntry>,
    events: Vec<Event>,
    warnings: Vec<String>,
    status: Status,
    truth: Option<Mesh>,
}

impl Recording {
    /// Opens the recording in the folder of a run.
    ///
    /// # Errors
    /// [`RecordingError`], which names the file and says what is wrong.
    pub fn open(folder: &Path) -> Result<Self, RecordingError> {
        Err(RecordingError::NoRecording(folder.to_path_buf()))
    }

    /// Opens a FeelSight log as a recording in which nothing is estimated.
    ///
    /// # Errors
    /// [`RecordingError::Log`] if the log cannot be used at all.
    pub fn open_log(folder: &Path) -> Result<Self, RecordingError> {
        Err(RecordingError::NoRecording(folder.to_path_buf()))
    }

    /// Reads what was appended since; true if anything is new, the status included.
    ///
    /// # Errors
    /// [`RecordingError`] if what was appended cannot be read. What was there before stays.
    pub fn refresh(&mut self) -> Result<bool, RecordingError> {
        Ok(false)
    }

    /// The folder of the run or log.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// What is recorded.
    pub fn about(&self) -> &About {
        &self.about
    }

    /// The frames so far.
    pub fn moments(&self) -> &[Moment] {
        &self.moments
    }

    /// The shapes so far, in order of their frames.
    pub fn shapes(&self) -> &[ShapeEntry] {
        &self.shapes
    }

    /// What happened so far, in order of time.
    pub fn events(&self) -> &[Event] {
        &self.events
    }

    /// What was amiss, in sentences.
    pub fn warnings(&self) -> &[String] {
        &self.warnings
    }

    /// Whether the run goes on.
    pub fn status(&self) -> Status {
        self.status
    }

    /// The newest images at or before a moment; none if there are none yet. The newest few are kept.
    ///
    /// # Errors
    /// [`RecordingError`] if they cannot be read or decoded.
    pub fn images(&self, _moment: usize) -> Result<Option<Arc<Images>>, RecordingError> {
        Ok(None)
    }

    /// The newest shape at or before a moment; none if there is none yet. The newest few are kept.
    ///
    /// # Errors
    /// [`RecordingError`] if it cannot be read.
    pub fn shape(&self, _moment: usize) -> Result<Option<Arc<KnownShape>>, RecordingError> {
        Ok(None)
    }

    /// The object's true surface, where it could be had.
    pub fn truth(&self) -> Option<&Mesh> {
        self.truth.as_ref()
    }
}
