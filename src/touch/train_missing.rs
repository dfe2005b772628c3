//! `touch train` of a program that was built without the feature `train`.

use std::ffi::OsString;

use anyhow::{Result, bail};
use clap::Args;

/// Train a touch network; needs a program built with `--features train`
///
/// This program was built without training, which few users need. Build it with `cargo build --release --features
/// train`; the package in the folder gpu also trains on an NVIDIA GPU.
#[derive(Debug, Args)]
pub struct TouchTrainArguments {
    /// Any arguments; they are not used
    #[arg(trailing_var_arg = true, allow_hyphen_values = true, hide = true)]
    _arguments: Vec<OsString>,
}

/// Says how to get the command.
///
/// # Errors
/// Always.
pub fn run(_: &TouchTrainArguments) -> Result<()> {
    bail!("this program was built without training; build it with `cargo build --release --features train`")
}
