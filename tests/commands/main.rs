//! The program as its users meet it: commands, exit codes, what is on the disk afterwards. No network, procedural objects, short
//! episodes.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::print_stderr,
    reason = "a failed assumption in a test is a failed test, and a skipped one says so"
)]

mod faults;
mod generate;
mod inspect;
mod kill;
mod mesh_files;
mod network;
mod render_touch;
mod run;
mod score;
mod simulate;
#[cfg(feature = "train")]
mod train;
mod view;
mod workplace;
