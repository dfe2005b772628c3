//! A recording of five seconds that the program carries, for those who have no run yet. `docs/pictures.sh` makes it.

use std::io::{self, Cursor};

use mvt_viewer::RecordingSource;
use tempfile::TempDir;
use zip::ZipArchive;

/// Name of the run's folder in the archive.
const NAME: &str = "example";
const ARCHIVE: &[u8] = include_bytes!("../assets/example.zip");

/// The recording in a temporary folder, which is removed with this value.
pub struct ShippedRun {
    folder: TempDir,
}

impl ShippedRun {
    /// Unpacks the recording.
    pub fn unpack() -> io::Result<Self> {
        let folder = tempfile::tempdir()?;
        ZipArchive::new(Cursor::new(ARCHIVE))?.extract(folder.path())?;
        Ok(Self { folder })
    }

    /// Returns where it lies.
    pub fn source(&self) -> RecordingSource {
        RecordingSource::Run(self.folder.path().join(NAME))
    }
}
