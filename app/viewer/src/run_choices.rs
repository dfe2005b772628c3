//! Choices for a run that the window starts.

use std::ffi::OsString;
use std::path::{Path, PathBuf};

use clap::ValueEnum as _;
use mvt_run::estimator::Mode;
use mvt_run::source::Modality;
use serde::{Deserialize, Serialize};

/// Choices for a run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct RunChoices {
    /// Name in the catalogue, or path of a mesh.
    pub object: String,
    /// Mode, as on the command line.
    pub mode: String,
    /// Modality, as on the command line.
    pub modality: String,
    /// Gait of the hand, or `auto`.
    pub gait: String,
    /// Longest duration, seconds.
    pub duration_s: f64,
    /// Seed of the episode.
    pub seed: u64,
    /// Folder in which each run gets a folder.
    pub folder: PathBuf,
}

impl Default for RunChoices {
    fn default() -> Self {
        Self {
            object: "rubiks_cube_small".to_owned(),
            mode: Mode::Slam.name().to_owned(),
            modality: Modality::Vitac.name().to_owned(),
            gait: "auto".to_owned(),
            duration_s: 30.0,
            seed: 0,
            folder: PathBuf::from("runs"),
        }
    }
}

impl RunChoices {
    /// Returns the modes of the command line with their help texts.
    pub fn modes() -> Vec<(&'static str, String)> {
        Mode::value_variants().iter().map(|mode| (mode.name(), help(mode))).collect()
    }

    /// Returns the modalities of the command line with their help texts.
    pub fn modalities() -> Vec<(&'static str, String)> {
        Modality::value_variants().iter().map(|modality| (modality.name(), help(modality))).collect()
    }

    /// Returns a folder that does not exist yet: the object's name and a number.
    pub fn new_folder(&self) -> PathBuf {
        let stem = Path::new(&self.object).file_stem().map_or_else(|| "run".into(), |stem| stem.to_string_lossy());
        let named = |number: u32| self.folder.join(format!("{stem}-{number:03}"));
        (1..).map(named).find(|folder| !folder.exists()).unwrap_or_else(|| self.folder.clone())
    }

    /// Returns the arguments of the command line.
    pub fn arguments(&self, out: &Path) -> Vec<OsString> {
        let mut arguments: Vec<OsString> = vec!["run".into(), "--quiet".into()];
        let mut add = |name: &str, value: &dyn AsRef<std::ffi::OsStr>| {
            arguments.push(format!("--{name}").into());
            arguments.push(value.as_ref().to_owned());
        };
        add("object", &self.object);
        add("mode", &self.mode);
        add("modality", &self.modality);
        add("controller", &self.gait);
        add("duration", &self.duration_s.to_string());
        add("seed", &self.seed.to_string());
        add("out", &out);
        arguments
    }
}

fn help(value: &impl clap::ValueEnum) -> String {
    let help = value.to_possible_value().and_then(|value| value.get_help().map(ToString::to_string));
    help.unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    #[test]
    fn a_run_gets_a_folder_that_does_not_exist() {
        let folder = tempfile::tempdir().unwrap();
        let choices =
            RunChoices { folder: folder.path().into(), object: "a/b/mug.obj".into(), ..RunChoices::default() };
        assert_eq!(choices.new_folder(), folder.path().join("mug-001"));
        fs::create_dir(folder.path().join("mug-001")).unwrap();
        assert_eq!(choices.new_folder(), folder.path().join("mug-002"));
    }
}
