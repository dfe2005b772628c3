//! Logs in formats that other programs read.
//!
//! [`export_mcap`] writes a log as one MCAP file with Foxglove's protobuf schemas, which Foxglove and rerun open. The crate estimates and
//! renders nothing.
//!
//! ```no_run
//! let log = mvt_feelsight::Log::open("logs/cube70/00".as_ref())?;
//! let exported = mvt_exchange::export_mcap(&log, "cube.mcap".as_ref(), false, || ())?;
//! println!("{} frames in {} channels", exported.frames, exported.channels);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod container;
mod export;
mod protobuf;
mod schema;

pub use export::{ExchangeError, Exported, export_mcap};
pub use mvt_feelsight;
