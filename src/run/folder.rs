//! Folder of the results: its files, and the rule that a run replaces only an earlier run.

use std::fs;
use std::path::Path;

use anyhow::{Context as _, Result, bail};
use mvt_run::report::file;
use mvt_slam::map::Map;

/// Name of the file with all settings.
pub const CONFIG: &str = "config.toml";

/// The files and folders that a run writes.
const WRITTEN: [&str; 10] = [
    file::SUMMARY,
    file::TRAJECTORY,
    file::PLY,
    file::OBJ,
    file::CURVES,
    file::TURNTABLE,
    CONFIG,
    Map::FILES[0],
    Map::FILES[1],
    mvt_recording::FOLDER,
];

/// Checks that a folder contains only an earlier run, which may be replaced.
pub fn check_vacant(out: &Path, overwrite: bool) -> Result<()> {
    if !out.exists() || overwrite {
        return Ok(());
    }
    let entries = fs::read_dir(out).with_context(|| format!("cannot read --out {}", out.display()))?;
    for entry in entries {
        let name = entry?.file_name();
        let name = name.to_string_lossy();
        let is_of_a_run = WRITTEN.contains(&name.as_ref()) || (name.starts_with('.') && name.ends_with(".partial"));
        if !is_of_a_run {
            bail!(
                "--out {} contains {name}, which a run did not write; choose another folder or give --overwrite",
                out.display()
            );
        }
    }
    Ok(())
}

/// Makes the folder and removes the files of an earlier run.
pub fn prepare(out: &Path) -> Result<()> {
    fs::create_dir_all(out).with_context(|| format!("cannot make {}", out.display()))?;
    for name in WRITTEN {
        let path = out.join(name);
        // The folder of the recording is replaced when the new one begins.
        if path.is_file() {
            fs::remove_file(&path).with_context(|| format!("cannot remove {}", path.display()))?;
        }
    }
    Ok(())
}
