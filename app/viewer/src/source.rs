//! The recordings that a window, a picture or a film shows.

use std::path::{Path, PathBuf};

use mvt_recording::{Recording, RecordingError};
use mvt_run::io::shell_word;

/// Folder that a recording is read from.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum RecordingSource {
    /// The folder of a run.
    Run(PathBuf),
    /// A raw FeelSight log.
    Log(PathBuf),
}

impl RecordingSource {
    /// Returns the folder.
    pub fn folder(&self) -> &Path {
        match self {
            Self::Run(folder) | Self::Log(folder) => folder,
        }
    }

    /// Returns the name of the folder.
    pub fn name(&self) -> String {
        let name = self.folder().file_name().map(|name| name.to_string_lossy().into_owned());
        name.unwrap_or_else(|| "run".to_owned())
    }

    /// Returns the option that names this folder on the command line.
    pub fn option(&self) -> &'static str {
        match self {
            Self::Run(_) => "--run",
            Self::Log(_) => "--log",
        }
    }

    /// Opens the recording.
    ///
    /// # Errors
    /// See [`Recording::open`].
    pub fn open(&self) -> Result<Recording, RecordingError> {
        match self {
            Self::Run(folder) => Recording::open(folder),
            Self::Log(folder) => Recording::open_log(folder),
        }
    }
}

/// Contents with which the window opens.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum WindowContents {
    /// The page that starts and opens runs.
    Start,
    /// A run or a log.
    Recording(RecordingSource),
    /// Two runs or logs side by side.
    Comparison([RecordingSource; 2]),
}

impl WindowContents {
    /// Returns the sources that are shown.
    pub fn sources(&self) -> &[RecordingSource] {
        match self {
            Self::Start => &[],
            Self::Recording(source) => std::slice::from_ref(source),
            Self::Comparison(both) => both,
        }
    }

    /// Returns in words the command that shows the same without a window.
    pub fn without_window(&self) -> String {
        let shown = self.sources().first();
        let option = shown.map_or("--run", RecordingSource::option);
        let folder = shown.map_or(Path::new("DIR"), RecordingSource::folder);
        let folder = shell_word(&folder.to_string_lossy());
        format!("`mambavitact view {option} {folder} --record out.gif` needs no window")
    }
}
