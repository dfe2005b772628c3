//! A run of the estimator: sources, pipeline, supervisor, settings and results.

pub mod arguments;
pub mod io;
pub mod object;
pub mod pipeline;
pub mod progress;
pub mod progress_recorder;
pub mod report;
pub mod sdf_grid;
pub mod settings;
pub mod source;
pub mod supervisor;
