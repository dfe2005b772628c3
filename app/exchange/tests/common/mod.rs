//! The log that the tests export.

use std::path::Path;

#[path = "../../../../sim/feelsight/tests/common/mod.rs"]
pub mod small_log;

/// Number of its frames.
pub const FRAMES: usize = 4;

/// Writes the log, with two cameras, into a folder.
pub fn write_log(folder: &Path) {
    let cameras = [small_log::camera("front-left", 64, 48), small_log::camera("top-down", 32, 24)];
    small_log::write(folder, FRAMES, &cameras);
}
