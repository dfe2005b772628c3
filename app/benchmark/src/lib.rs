//! RGB-D sequences of an object without a hand: facts about one, scores by the protocol of YCBInEOAT and HO3D, and runs of whole data sets.
//!
//! ```no_run
//! // Prints size, distance and motion of the object, and what will be hard.
//! mvt_benchmark::inspect("mustard0".as_ref(), false, None, false)?;
//! # Ok::<(), mvt_benchmark::anyhow::Error>(())
//! ```

mod command;
mod facts;
mod inspect;
mod published;
mod results;
mod score;
mod sets;
mod sheet;
mod table;

pub use anyhow;
pub use command::{BenchmarkArguments, run};
pub use facts::SequenceFacts;
pub use inspect::inspect;
pub use score::{score, score_in_words};
pub use {clap, mvt_mesh, mvt_objects};
