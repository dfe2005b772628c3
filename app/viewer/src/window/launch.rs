//! Runs that the window starts: processes of their own, which go on when the window is closed.

use std::ffi::OsString;
use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

use clap::ValueEnum as _;
use serde::{Deserialize, Serialize};

use mvt_run::pipeline::Mode;
use mvt_run::source::Modality;

/// What can be chosen of a run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Choices {
    /// Name in the catalogue, or path of a mesh.
    pub object: String,
    /// As on the command line.
    pub mode: String,
    /// As on the command line.
    pub modality: String,
    /// What moves the hand: a gait, or `auto`.
    pub gait: String,
    /// Longest duration, seconds.
    pub duration_s: f64,
    /// Seed of the episode.
    pub seed: u64,
    /// The folder in which runs get folders of their own.
    pub folder: PathBuf,
}

impl Default for Choices {
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

impl Choices {
    /// The modes as they stand on the command line, each with what it means.
    pub fn modes() -> Vec<(&'static str, String)> {
        Mode::value_variants().iter().map(|mode| (mode.name(), help(mode))).collect()
    }

    /// The modalities as they stand on the command line, each with what it means.
    pub fn modalities() -> Vec<(&'static str, String)> {
        Modality::value_variants().iter().map(|modality| (modality.name(), help(modality))).collect()
    }

    /// A folder that is not there yet: the object's name and a number.
    pub fn new_folder(&self) -> PathBuf {
        let stem = Path::new(&self.object).file_stem().map_or_else(|| "run".into(), |stem| stem.to_string_lossy());
        let named = |number: u32| self.folder.join(format!("{stem}-{number:03}"));
        (1..).map(named).find(|folder| !folder.exists()).unwrap_or_else(|| self.folder.clone())
    }

    /// The command's arguments.
    pub fn arguments(&self, out: &Path) -> Vec<OsString> {
        let mut arguments: Vec<OsString> = vec!["run".into(), "--quiet".into()];
        let mut add = |name: &str, value: &dyn AsRef<std::ffi::OsStr>| {
            arguments.push(format!("--{name}").into());
            arguments.push(value.as_ref().to_owned());
        };
        add("object", &self.object);
        add("mode", &self.mode);
        add("modality", &self.modality);
        add("gait", &self.gait);
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

/// A run that was started here.
#[derive(Debug)]
pub struct Run {
    /// Its folder.
    pub folder: PathBuf,
    child: Child,
    /// What it writes to standard error.
    complaints: PathBuf,
}

impl Run {
    /// Starts a run by this program.
    ///
    /// # Errors
    /// If the folder cannot be made or the process not be started.
    pub fn start(choices: &Choices) -> io::Result<Self> {
        let program = std::env::current_exe()?;
        fs::create_dir_all(&choices.folder)?;
        let folder = choices.new_folder();
        // Beside the run's folder, which may hold nothing before the run begins.
        let complaints = folder.with_extension("log");
        let mut command = Command::new(program);
        command.args(choices.arguments(&folder));
        command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(File::create(&complaints)?);
        // What interrupts the window from a terminal does not interrupt the run.
        #[cfg(unix)]
        std::os::unix::process::CommandExt::process_group(&mut command, 0);
        Ok(Self { folder, child: command.spawn()?, complaints })
    }

    /// Whether it has ended, and if it failed, what it said.
    pub fn poll(&mut self) -> Option<Result<(), String>> {
        let status = match self.child.try_wait() {
            Ok(None) => return None,
            Ok(Some(status)) => status,
            Err(error) => return Some(Err(error.to_string())),
        };
        if status.success() {
            // An empty file would only be in the way.
            if fs::metadata(&self.complaints).is_ok_and(|data| data.len() == 0) {
                let _ = fs::remove_file(&self.complaints);
            }
            return Some(Ok(()));
        }
        let said = fs::read(&self.complaints).unwrap_or_default();
        let said = String::from_utf8_lossy(&said);
        let last: Vec<&str> = said.lines().rev().filter(|line| !line.trim().is_empty()).take(4).collect();
        let words = last.into_iter().rev().collect::<Vec<_>>().join("\n");
        Some(Err(if words.is_empty() { status.to_string() } else { words }))
    }
}

/// Asks a run to end; it writes what it has first. The process is one that is known to live: that of a recording that goes on.
///
/// # Errors
/// If it cannot be told.
#[cfg(unix)]
pub fn stop(process: u32) -> io::Result<()> {
    let id = i32::try_from(process).ok().filter(|&id| id > 1 && process != std::process::id());
    match id.and_then(rustix::process::Pid::from_raw) {
        Some(id) => Ok(rustix::process::kill_process(id, rustix::process::Signal::INT)?),
        None => Err(io::Error::other("its process is not known")),
    }
}

/// Asks a run to end, which this system has no way to do.
///
/// # Errors
/// Always.
#[cfg(not(unix))]
pub fn stop(_: u32) -> io::Result<()> {
    Err(io::ErrorKind::Unsupported.into())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_run_gets_a_folder_that_is_not_there() {
        let folder = tempfile::tempdir().unwrap();
        let choices = Choices { folder: folder.path().into(), object: "a/b/mug.obj".into(), ..Choices::default() };
        assert_eq!(choices.new_folder(), folder.path().join("mug-001"));
        fs::create_dir(folder.path().join("mug-001")).unwrap();
        assert_eq!(choices.new_folder(), folder.path().join("mug-002"));
    }
}
