//! MCAP files (<https://mcap.dev/spec>), of any encoding of messages.
//!
//! [`scan`] passes the records of a file on from the first to the last and never holds a chunk whole. [`crate::Bag`] reads by the index of
//! chunks, or from front to back where there is none.

mod file;
mod record;
mod scan;
mod survey;

pub(crate) use file::{McapCursor, McapEntry, McapReader};
pub(crate) use record::MAGIC;
pub use record::McapChannel;
pub use scan::{McapError, McapRecord, scan};
