//! What a live connection adds to a run.

use crate::pipeline::Progress;
use crate::report::SharedLiveRecord;

/// Counts of a live connection, and somebody who publishes the results.
pub struct LiveParts {
    /// The counts.
    pub record: SharedLiveRecord,
    /// Publishes the results.
    pub listener: Box<dyn LiveListener>,
}

/// Somebody who is told the results of a run at once.
pub trait LiveListener {
    /// Receives the progress of the run.
    fn receive(&mut self, progress: &Progress<'_>);

    /// Completes the counts at the end of the run.
    fn finish(self: Box<Self>);
}
