//! One file for each bug that was found: its test was red before the bug was fixed. They need no network.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::print_stderr,
    reason = "a failed assumption in a test is a failed test"
)]

#[path = "../commands/workplace.rs"]
#[allow(dead_code, reason = "the tests of commands use more of it")]
mod workplace;

mod closed_pipe;
mod concurrent_writers;
mod damaged_touch_images;
mod duplicates_counted_twice;
mod empty_first_line;
mod fifo_in_a_log;
mod flipped_bits;
mod foreign_meshes;
mod full_disk;
mod implausible_log;
mod keyframes_from_far_away;
mod light_of_another_sensor;
mod mesh_in_another_frame;
mod mesh_of_millions_of_triangles;
mod named_file_replaced;
mod poses_of_other_times;
mod run_replaced;
mod skipped_image;
mod users_file_replaced;
mod words;
