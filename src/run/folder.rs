//! Folder of the results: its files, and the rule that no earlier result is lost.

use std::fs;
use std::path::Path;

use anyhow::{Context as _, Result};
use mvt_files::folder::{ClaimedFolder, Earlier};
use mvt_run::report::file;
use mvt_slam::map::Map;

/// Name of the file with all settings.
pub const CONFIG: &str = "config.toml";

/// The files that a run writes, beside the folder of its recording.
const WRITTEN: [&str; 9] = [
    file::SUMMARY,
    file::TRAJECTORY,
    file::PLY,
    file::OBJ,
    file::CURVES,
    file::TURNTABLE,
    CONFIG,
    Map::FILES[0],
    Map::FILES[1],
];

/// Makes the folder and keeps other processes out of it. An earlier run in it is moved to another name; with `overwrite` its files are
/// removed instead, and the folder may contain other files.
pub fn claim(out: &Path, overwrite: bool) -> Result<ClaimedFolder> {
    let claimed = ClaimedFolder::claim(out, "run", Earlier::Move, overwrite)?;
    if let Some(moved) = claimed.moved() {
        tracing::warn!("{} contained an earlier run, which is now {}", out.display(), moved.display());
    }
    for name in WRITTEN {
        let path = out.join(name);
        // The folder of the recording is replaced when the new one begins.
        if path.is_file() {
            fs::remove_file(&path).with_context(|| format!("cannot remove {}", path.display()))?;
        }
    }
    Ok(claimed)
}
