//! frames.zip of a compact log: image files, stored without further compression.

use std::collections::HashMap;
use std::fs::File;
use std::io::{BufReader, BufWriter, ErrorKind, Read as _, Write as _};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use zip::result::ZipError;
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipArchive, ZipWriter};

use crate::error::LogError;

// Why: notes/decisions/simulation.md, "Compact logs are images in one stored zip file".
/// Name of the archive in the folder of a log.
pub(crate) const ARCHIVE: &str = "frames.zip";

/// Archive that is read.
#[derive(Debug)]
pub(crate) struct ArchiveReader {
    path: PathBuf,
    archive: Mutex<ZipArchive<BufReader<File>>>,
    /// Number of files by their folder.
    counts: HashMap<String, usize>,
}

impl ArchiveReader {
    /// Opens an archive and reads its directory.
    pub fn open(path: &Path) -> Result<Self, LogError> {
        let file = mvt_files::input::open(path).map_err(LogError::io(path))?;
        let archive = ZipArchive::new(BufReader::new(file)).map_err(|e| defect(path, &e))?;
        let mut counts = HashMap::<String, usize>::new();
        for name in archive.file_names() {
            let name = name.map_err(|e| defect(path, &e))?;
            let folder = name.rsplit_once('/').map_or("", |(folder, _)| folder);
            *counts.entry(folder.to_owned()).or_default() += 1;
        }
        Ok(Self { path: path.to_path_buf(), archive: Mutex::new(archive), counts })
    }

    /// Returns the path of a file in it, for messages.
    pub fn path(&self, name: &str) -> PathBuf {
        self.path.join(name)
    }

    /// Returns the number of files in a folder.
    pub fn count(&self, folder: &str) -> usize {
        self.counts.get(folder).copied().unwrap_or(0)
    }

    /// Returns whether there is a file of this name.
    pub fn contains(&self, name: &str) -> bool {
        self.archive.lock().unwrap_or_else(PoisonError::into_inner).index_for_name(name).is_some()
    }

    /// Returns the bytes of a file, which must not be larger than `limit`; its checksum is compared.
    pub fn read(&self, name: &str, limit: u64) -> Result<Vec<u8>, LogError> {
        let path = self.path(name);
        let mut archive = self.archive.lock().unwrap_or_else(PoisonError::into_inner);
        let mut file = archive.by_name(name).map_err(|error| match error {
            ZipError::FileNotFound => LogError::io(&path)(ErrorKind::NotFound.into()),
            error => defect(&path, &error),
        })?;
        if file.compression() != CompressionMethod::Stored {
            return Err(LogError::defect(path, "it is compressed; files of a compact log are stored (`zip -0`)"));
        }
        if file.size() > limit {
            return Err(LogError::defect(path, format!("the file is larger than {} MiB", limit >> 20)));
        }
        let mut bytes = Vec::new();
        file.by_ref().take(limit).read_to_end(&mut bytes).map_err(LogError::io(&path))?;
        Ok(bytes)
    }
}

fn defect(path: &Path, error: &ZipError) -> LogError {
    LogError::defect(path, error.to_string())
}

/// Archive that is written. Its bytes depend on the files alone.
pub(crate) struct ArchiveWriter {
    path: PathBuf,
    zip: ZipWriter<BufWriter<File>>,
}

impl ArchiveWriter {
    /// Creates an archive.
    pub fn create(path: PathBuf) -> Result<Self, LogError> {
        let file = File::options().read(true).write(true).create_new(true).open(&path).map_err(LogError::io(&path))?;
        Ok(Self { path, zip: ZipWriter::new(BufWriter::with_capacity(1 << 18, file)) })
    }

    /// Appends a file.
    pub fn add(&mut self, name: &str, bytes: &[u8]) -> Result<(), LogError> {
        let options = SimpleFileOptions::default().compression_method(CompressionMethod::Stored);
        self.zip.start_file(name, options).map_err(|e| defect(&self.path, &e))?;
        self.zip.write_all(bytes).map_err(LogError::io(&self.path))
    }

    /// Writes the directory and syncs the file to its disk.
    pub fn finish(self) -> Result<(), LogError> {
        let Self { path, zip } = self;
        let buffer = zip.finish().map_err(|e| defect(&path, &e))?;
        let file = buffer.into_inner().map_err(|e| LogError::io(&path)(e.into_error()))?;
        file.sync_all().map_err(LogError::io(&path))
    }
}
