//! A recording that several threads read while it grows.

use std::sync::{Mutex, PoisonError, RwLock, RwLockReadGuard, TryLockError};

use mvt_recording::{Recording, Status};

/// A recording that is read by the window and by the threads that paint, and refreshed when nobody reads.
pub struct Shared {
    recording: RwLock<Recording>,
    /// What was wrong with what was appended.
    problem: Mutex<Option<String>>,
}

impl Shared {
    /// Shares a recording.
    pub fn new(recording: Recording) -> Self {
        Self { recording: RwLock::new(recording), problem: Mutex::new(None) }
    }

    /// The recording as it is. No reader waits for another: what is appended is read by nobody who would have to wait for this.
    pub fn read(&self) -> RwLockReadGuard<'_, Recording> {
        self.recording.read().unwrap_or_else(PoisonError::into_inner)
    }

    /// Whether there may be more to come.
    pub fn is_running(&self) -> bool {
        self.read().status() == Status::Running
    }

    /// Whether what is shown may change.
    pub fn is_growing(&self) -> bool {
        self.read().is_growing()
    }

    /// Reads what was appended, unless somebody reads; whether anything is new.
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

    /// What was wrong with what was appended last.
    pub fn problem(&self) -> Option<String> {
        self.problem.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}
