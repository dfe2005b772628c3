//! The rules of the house: who imports whom, names, circles, sizes, panics. Each test names every offender at once.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a failed assumption in a test is a failed test")]

mod build;
mod dependencies;
mod modules;
mod names;
mod pages;
mod rigs;
mod sizes;
mod sources;
mod truth;

/// Fails with all offenders, if there are any.
#[track_caller]
fn nothing_offends(rule: &str, offenders: &[String]) {
    assert!(offenders.is_empty(), "{rule}; {} offender(s):\n  {}", offenders.len(), offenders.join("\n  "));
}
