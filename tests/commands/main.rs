//! Tests of the commands as users see them: output, exit codes and files. They need no network, and use procedural
//! objects and short episodes.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::print_stderr,
    reason = "a failed assumption in a test is a failed test"
)]

mod bags;
mod calibrate;
mod exchange;
mod explore;
mod faults;
#[cfg(feature = "foxglove")]
mod foxglove;
mod generate;
mod hand;
mod inspect;
mod kill;
mod mesh_files;
mod npy;
mod old_names;
mod policies;
mod report;
mod rgbd;
mod rigs;
#[cfg(feature = "ros")]
mod ros;
#[cfg(feature = "ros")]
mod ros_drive;
mod run;
mod score;
mod sequences;
mod shell;
mod simulate;
mod sweep;
mod touch;
mod touch_calibrate;
mod touch_predict;
mod touch_render;
mod touch_shear;
mod touch_stream;
#[cfg(feature = "train")]
mod touch_train;
mod view;
mod workplace;

#[path = "../../app/bag/tests/common/mod.rs"]
mod small_bags;
