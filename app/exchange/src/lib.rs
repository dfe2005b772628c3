//! Logs in formats that other programs read, and recordings of other programs as logs.
//!
//! [`export_mcap`] writes a log as one MCAP file with Foxglove's protobuf schemas, which Foxglove and rerun open; [`export_run`] does so with a run. [`import_mcap`] turns such a
//! file, ours or another's, into a log. [`export_lerobot`] and [`import_lerobot`] do the same with data sets of LeRobot. The crate estimates
//! and renders nothing.
//!
//! ```no_run
//! let log = mvt_feelsight::Log::open("logs/cube70/00".as_ref())?;
//! let exported = mvt_exchange::export_mcap(&log, "cube.mcap".as_ref(), false, || ())?;
//! println!("{} frames in {} channels", exported.frames, exported.channels);
//! let imported = mvt_exchange::import_mcap("cube.mcap".as_ref(), None, "again".as_ref(), |_, _| ())?;
//! println!("{} frames", imported.frames);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod clock;
pub mod command;
mod data_set;
mod error;
mod export_lerobot;
mod export_mcap;
mod export_run;
mod extras;
mod foxglove;
mod foxglove_arguments;
#[cfg(feature = "foxglove")]
mod foxglove_server;
mod import_lerobot;
mod import_mcap;
mod import_sequence;
mod joints;
mod mapping;
mod messages;
mod pages;
mod parquet;
mod pictures;
mod plausibility;
mod protobuf;
mod record;
mod run_messages;
mod schema;
mod skips;
mod statistics;
mod survey;
mod table;
mod tree;
mod writer;

pub use error::ExchangeError;
pub use export_lerobot::{ExportedDataSet, export_lerobot};
pub use export_mcap::{Exported, export_mcap};
pub use export_run::export_run;
pub use foxglove_arguments::{FoxgloveArguments, FoxgloveView};
#[cfg(feature = "foxglove")]
pub use foxglove_server::FoxgloveServer;
pub use import_lerobot::import_lerobot;
pub use import_mcap::{Imported, ImportedChannel, import_mcap};
pub use {mvt_feelsight, mvt_recording};
