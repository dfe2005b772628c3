//! Writes recordings, on a thread of its own.

/// Records a run.
pub struct Writer;
