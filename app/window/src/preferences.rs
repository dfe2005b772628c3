//! Preferences of the viewer: a TOML file in the user's configuration folder.

use std::fs;
use std::path::{Path, PathBuf};

use mvt_files::input;
use mvt_run::io::write_file;
use serde::{Deserialize, Serialize};

use super::plots::Threshold;
use super::style::Appearance;
use mvt_viewer::layers::Colouring;
use mvt_viewer::run_choices::RunChoices;

const FILE: &str = "viewer.toml";
/// Largest file that is read, bytes.
const LARGEST_FILE: u64 = 1 << 20;
/// Number of recent runs.
const RECENT: usize = 12;

/// Preferences of the viewer.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Preferences {
    /// Light or dark.
    pub appearance: Appearance,
    /// Size of text and widgets, percent.
    pub zoom_percent: u32,
    /// Speed of playback; 1 is real time.
    pub speed: f64,
    /// Whether the camera follows the object.
    pub follow: bool,
    /// Threshold of the plotted F-score.
    pub threshold: Threshold,
    /// The runs that were opened last, newest first.
    pub recent: Vec<PathBuf>,
    /// Open panels.
    pub panels: Panels,
    /// Meaning of the colours of the estimated surface.
    pub colouring: Colouring,
    /// Choices for the last run.
    pub choices: RunChoices,
}

/// Open panels beside the scene.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct Panels {
    /// Layers of the scene.
    pub layers: bool,
    /// Images of the sensors.
    pub sensors: bool,
    /// Curves.
    pub plots: bool,
}

impl Default for Panels {
    fn default() -> Self {
        Self { layers: true, sensors: true, plots: true }
    }
}

impl Default for Preferences {
    fn default() -> Self {
        Self {
            appearance: Appearance::default(),
            zoom_percent: Self::ZOOM_PERCENT[0],
            speed: 1.0,
            follow: false,
            threshold: Threshold::default(),
            recent: Vec::new(),
            panels: Panels::default(),
            colouring: Colouring::default(),
            choices: RunChoices::default(),
        }
    }
}

impl Preferences {
    /// Smallest and largest zoom, percent.
    pub const ZOOM_PERCENT: [u32; 2] = [100, 200];

    /// Returns the folder of the file: `$XDG_CONFIG_HOME/mambavitact`, else `$HOME/.config/mambavitact`; `None` if
    /// neither variable is set.
    pub fn folder() -> Option<PathBuf> {
        let from = |name: &str| std::env::var_os(name).filter(|value| !value.is_empty()).map(PathBuf::from);
        from("XDG_CONFIG_HOME")
            .filter(|path| path.is_absolute())
            .or_else(|| from("HOME").map(|home| home.join(".config")))
            .map(|base| base.join("mambavitact"))
    }

    /// Reads the preferences in a folder. Returns the defaults and the problem if the file cannot be used.
    pub fn load(folder: &Path) -> (Self, Option<String>) {
        let path = folder.join(FILE);
        let (mut preferences, problem) = match input::read_text(&path, LARGEST_FILE) {
            Ok(text) => match toml::from_str::<Self>(&text) {
                Ok(preferences) => (preferences, None),
                Err(error) => (Self::default(), Some(format!("{}: {}", path.display(), error.message()))),
            },
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => (Self::default(), None),
            Err(error) => (Self::default(), Some(format!("{}: {error}", path.display()))),
        };
        let [least, most] = Self::ZOOM_PERCENT;
        preferences.zoom_percent = preferences.zoom_percent.clamp(least, most);
        if !super::timeline::SPEEDS.contains(&preferences.speed) {
            preferences.speed = 1.0;
        }
        preferences.recent.truncate(RECENT);
        (preferences, problem)
    }

    /// Writes the file.
    ///
    /// # Errors
    /// If the folder cannot be created or the file cannot be written.
    pub fn save(&self, folder: &Path) -> anyhow::Result<()> {
        fs::create_dir_all(folder)?;
        write_file(folder, FILE, toml::to_string_pretty(self)?.as_bytes())
    }

    /// Moves a run to the front of the recent runs.
    pub fn remember(&mut self, folder: &Path) {
        let folder = std::path::absolute(folder).unwrap_or_else(|_| folder.to_path_buf());
        self.recent.retain(|other| *other != folder);
        self.recent.insert(0, folder);
        self.recent.truncate(RECENT);
    }

    /// Changes the zoom by steps of 10 %.
    pub fn zoom(&mut self, steps: i32) {
        let [least, most] = Self::ZOOM_PERCENT;
        self.zoom_percent = self.zoom_percent.saturating_add_signed(10 * steps).clamp(least, most);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn saved_preferences_are_loaded() {
        let folder = tempfile::tempdir().unwrap();
        let mut preferences = Preferences { zoom_percent: 150, follow: true, speed: 2.0, ..Preferences::default() };
        preferences.colouring = Colouring::Sensor;
        preferences.remember(Path::new("/runs/a"));
        preferences.save(&folder.path().join("new")).unwrap();
        assert_eq!(Preferences::load(&folder.path().join("new")), (preferences, None));
    }

    #[test]
    fn a_damaged_file_is_reported_and_does_no_harm() {
        let folder = tempfile::tempdir().unwrap();
        assert_eq!(Preferences::load(folder.path()), (Preferences::default(), None));
        for text in ["zoom_percent = \"much\"", "= 3", "[panels]\nplots = 7", "\u{0}"] {
            fs::write(folder.path().join(FILE), text).unwrap();
            let (preferences, problem) = Preferences::load(folder.path());
            assert_eq!(preferences, Preferences::default());
            assert!(problem.unwrap().contains(FILE), "{text}");
        }
        fs::write(folder.path().join(FILE), "zoom_percent = 4000000000\nspeed = nan\nof_another_version = 1").unwrap();
        let (preferences, problem) = Preferences::load(folder.path());
        assert_eq!((preferences.zoom_percent, preferences.speed, problem), (200, 1.0, None));
    }

    #[test]
    fn the_newest_runs_are_remembered_once_each() {
        let mut preferences = Preferences::default();
        for k in 0..40 {
            preferences.remember(&PathBuf::from(format!("/runs/{}", k % 20)));
        }
        assert_eq!(preferences.recent.len(), RECENT);
        assert_eq!(preferences.recent[0], PathBuf::from("/runs/19"));
        preferences.remember(Path::new("/runs/15"));
        assert_eq!(preferences.recent.iter().filter(|run| run.ends_with("15")).count(), 1);
    }
}
