//! Mutated files: whatever happened to a file, its reader returns a value or an error, soon and in little memory, and never panics.
//!
//! Each test mutates valid files of one reader [`COUNT`] times; the environment variable `MUTATIONS` sets another number, and
//! `tests/nightly/mutations` gives 20,000. A failure names the numbers of the inputs, and `MUTATION=NUMBER cargo test --test mutations READER` reads one of them again.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::print_stderr,
    reason = "a failed assumption in a test is a failed test"
)]

mod memory;
mod mutator;
mod originals;
mod readers;
mod trial;

#[path = "../../sim/feelsight/tests/common/mod.rs"]
mod small_log;

#[path = "../../app/rgbd/tests/sequences/mod.rs"]
#[allow(dead_code, reason = "the tests of layouts use more of it")]
mod sequences;

#[path = "../../app/bag/tests/common/mod.rs"]
mod small_bags;

#[path = "../commands/workplace.rs"]
#[allow(dead_code, reason = "the tests of commands use more of it")]
mod workplace;

/// Number of inputs of a reader, if the environment does not say otherwise.
const COUNT: u64 = 100;
