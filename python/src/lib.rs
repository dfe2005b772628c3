//! The native part of the Python package `mambavitact`. Python's classes and their documentation stand in `mambavitact/_native.pyi`.
//!
//! Arguments are checked here, so that a wrong one is named. Long calls release the interpreter's lock, and a panic becomes an
//! exception.

#![allow(clippy::needless_pass_by_value, reason = "PyO3 extracts the arguments of Python's functions by value")]

use pyo3::prelude::*;

mod arrays;
mod camera;
mod environment;
mod episode;
mod errors;
mod frame;
mod log;
mod mesh;
mod recording;
mod score;
mod segment;
mod slam;
mod touch;

/// Runs the program `mambavitact` with these arguments, the first of which is its name, and returns the exit code.
#[pyfunction]
fn main(py: Python<'_>, arguments: Vec<std::ffi::OsString>) -> PyResult<u8> {
    if let Some(program) = arguments.first() {
        mvt_run::program::set(program.into());
    }
    errors::detached(py, || Ok(mambavitact::main(arguments)))
}

/// Returns the version of the program.
#[pyfunction]
fn version() -> &'static str {
    env!("CARGO_PKG_VERSION")
}

#[pymodule]
mod _native {
    #[pymodule_export]
    use super::camera::Camera;
    #[pymodule_export]
    use super::environment::Environments;
    #[pymodule_export]
    use super::episode::{Episode, EpisodeState};
    #[pymodule_export]
    use super::frame::Frame;
    #[pymodule_export]
    use super::log::{Log, LogFrames, record_log};
    #[pymodule_export]
    use super::recording::{Recording, RecordingFrame};
    #[pymodule_export]
    use super::score::{score, score_poses};
    #[pymodule_export]
    use super::segment::segment;
    #[pymodule_export]
    use super::slam::{Estimate, Slam};
    #[pymodule_export]
    use super::touch::{TouchNetwork, TouchPrediction, TouchRendering, render_touch};
    #[pymodule_export]
    use super::{main, version};
}
