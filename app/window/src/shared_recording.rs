//! A recording that several threads read while it grows.

use std::sync::{Mutex, PoisonError, RwLock, RwLockReadGuard, TryLockError};

use mvt_recording::{Recording, Status};

/// Recording that the window and the painting threads read, and that is refreshed between reads.
pub struct SharedRecording {
    recording: RwLock<Recording>,
    /// Problem of the last refresh.
    problem: Mutex<Option<String>>,
}

impl SharedRecording {
    /// Shares a recording.
    pub fn new(recording: Recording) -> Self {
        Self { recording: RwLock::new(recording), problem: Mutex::new(None) }
    }

    /// Returns the recording for reading. Readers never block each other; `refresh` gives up while anyone reads.
    pub fn read(&self) -> RwLockReadGuard<'_, Recording> {
        self.recording.read().unwrap_or_else(PoisonError::into_inner)
    }

    /// Whether the run goes on.
    pub fn is_running(&self) -> bool {
        self.read().status() == Status::Running
    }

    /// Whether the recording may change.
    pub fn is_growing(&self) -> bool {
        self.read().is_growing()
    }

    /// Reads appended data, unless a reader holds the recording. Returns whether anything is new.
    pub fn refresh(&self) -> bool {
        let mut recording = match self.recording.try_write() {
            Ok(recording) => recording,
            Err(TryLockError::Poisoned(broken)) => broken.into_inner(),
            Err(TryLockError::WouldBlock) => return false,
        };
        if !recording.is_growing() {
            return false;
        }
        let result = recording.refresh();
        drop(recording);
        let mut problem = self.problem.lock().unwrap_or_else(PoisonError::into_inner);
        let before = problem.take();
        let (has_news, now) = result.map_or_else(|error| (false, Some(error.to_string())), |has_news| (has_news, None));
        let is_other = before != now;
        *problem = now;
        has_news || is_other
    }

    /// Returns the problem of the last refresh.
    pub fn problem(&self) -> Option<String> {
        self.problem.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}
