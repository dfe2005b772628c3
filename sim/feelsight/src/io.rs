//! Reading and writing of whole files.

use std::fs;
use std::io::{Read, Write};
use std::path::Path;

use crate::LogError;

/// Returns the bytes of a file, which must not be larger than `limit`.
pub(crate) fn read_at_most(path: &Path, limit: u64) -> Result<Vec<u8>, LogError> {
    let mut bytes = Vec::new();
    let file = mvt_files::input::open(path).map_err(LogError::io(path))?;
    file.take(limit + 1).read_to_end(&mut bytes).map_err(LogError::io(path))?;
    if bytes.len() as u64 > limit {
        return Err(LogError::defect(path, format!("the file is larger than {} MiB", limit >> 20)));
    }
    Ok(bytes)
}

/// Writes a file and syncs it to its disk.
pub(crate) fn write_synced(path: &Path, bytes: &[u8]) -> Result<(), LogError> {
    let write = || {
        let mut file = fs::File::create(path)?;
        file.write_all(bytes)?;
        file.sync_all()
    };
    write().map_err(LogError::io(path))
}

/// Syncs the entries of a folder to its disk.
pub(crate) fn sync_folder(folder: &Path) -> Result<(), LogError> {
    // Only Unix can open a folder to sync it.
    if cfg!(unix) {
        fs::File::open(folder).and_then(|f| f.sync_all()).map_err(LogError::io(folder))?;
    }
    Ok(())
}
