//! Progress bars on standard error, drawn only for people.

use indicatif::{ProgressBar, ProgressStyle};

/// A bar over `length` steps.
pub fn bar(length: u64, message: &str) -> ProgressBar {
    let style = ProgressStyle::with_template("{msg:<28} {bar:40} {pos}/{len} {elapsed} (left: {eta})")
        .unwrap_or_else(|_| ProgressStyle::default_bar());
    ProgressBar::new(length).with_style(style).with_message(message.to_owned())
}

/// A count of steps whose number is unknown.
pub fn counter(message: &str) -> ProgressBar {
    let style = ProgressStyle::with_template("{msg:<28} {pos} ({per_sec}) {elapsed}")
        .unwrap_or_else(|_| ProgressStyle::default_bar());
    ProgressBar::no_length().with_style(style).with_message(message.to_owned())
}
