//! The window is a program of its own, `mambavitact-window`: runs, scores and films need neither fonts nor a display.
//!
//! It is looked for in [`VARIABLE`], beside the program, and on the search path. In a clone it is built by cargo, which also brings it up to
//! date after a change.

// Why: notes/decisions/viewing.md, "The window is a program of its own".

use std::env;
use std::ffi::OsString;
use std::io;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use mvt_run::program;

use crate::source::WindowContents;

/// Environment variable that names the file of the window's program.
pub const VARIABLE: &str = "MAMBAVITACT_WINDOW";
/// Name of the program.
const NAME: &str = if cfg!(windows) { "mambavitact-window.exe" } else { "mambavitact-window" };
/// Its package, in this crate's clone.
const PACKAGE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../window");

/// Why there is no window.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum NoWindowProgram {
    /// There is no display server.
    #[error("there is no display (neither DISPLAY nor WAYLAND_DISPLAY is set)")]
    NoDisplay,
    /// It lies nowhere, and there is no clone to build it from.
    #[error(
        "the window is a program of its own, {NAME}, and is not installed: `cargo install --path app/window` in a clone installs it"
    )]
    Missing,
    /// It cannot be built.
    #[error("the window cannot be built: `{command}` {problem}")]
    Build {
        /// The command of the build.
        command: String,
        /// The failure, in words.
        problem: String,
    },
    /// It cannot be started.
    #[error("cannot start {}: {problem}", path.display())]
    Start {
        /// File of the program.
        path: PathBuf,
        /// The operating system's reason.
        problem: io::Error,
    },
}

/// Whether there is a display. Linux and similar systems name it in the environment.
pub fn has_display() -> bool {
    let is_set = |name: &str| env::var_os(name).is_some_and(|value| !value.is_empty());
    !cfg!(all(unix, not(target_os = "macos")))
        || ["DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET"].into_iter().any(is_set)
}

/// Program of the window.
#[derive(Debug, Clone)]
pub struct WindowProgram(PathBuf);

impl WindowProgram {
    /// Finds the program, or builds it with cargo, whose messages go to standard error.
    ///
    /// # Errors
    /// [`NoWindowProgram`] if there is no display, or no program.
    pub fn find() -> Result<Self, NoWindowProgram> {
        if !has_display() {
            return Err(NoWindowProgram::NoDisplay);
        }
        if let Some(named) = env::var_os(VARIABLE).filter(|named| !named.is_empty()) {
            return Ok(Self(named.into()));
        }
        let own = program::path().unwrap_or_default();
        if let Some(build) = Build::of(&own, Path::new(PACKAGE)) {
            return build.run().map(Self);
        }
        let beside = own.parent().map(|folder| folder.join(NAME));
        let on_path =
            env::var_os("PATH").map(|path| env::split_paths(&path).map(|folder| folder.join(NAME)).collect::<Vec<_>>());
        let places = beside.into_iter().chain(on_path.unwrap_or_default());
        places.into_iter().find(|place| place.is_file()).map(Self).ok_or(NoWindowProgram::Missing)
    }

    /// Returns the command that opens a window with these contents.
    pub fn command(&self, contents: &WindowContents) -> Command {
        let mut command = self.bare_command();
        for source in contents.sources() {
            command.arg(source.option()).arg(source.folder());
        }
        command
    }

    /// Returns the command that opens a window on a sensor, which reads [`crate::live::LiveMessage`]s from its standard input.
    pub fn command_of_sensor(&self, title: &str) -> Command {
        let mut command = self.bare_command();
        command.arg("--sensor").arg(title).stdin(Stdio::piped());
        command
    }

    /// Wraps the operating system's reason for which this program does not start.
    pub fn cannot_start(&self, problem: io::Error) -> NoWindowProgram {
        NoWindowProgram::Start { path: self.0.clone(), problem }
    }

    fn bare_command(&self) -> Command {
        let mut command = Command::new(&self.0);
        // The window starts runs with it.
        if let Ok(own) = program::path() {
            command.arg("--program").arg(own);
        }
        command
    }
}

/// Build of the window's program in a clone.
#[derive(Debug, PartialEq, Eq)]
struct Build {
    arguments: Vec<OsString>,
    /// File that the build leaves.
    built: PathBuf,
}

impl Build {
    /// Returns the build that belongs to a program in the target folder of a clone, and none for a program that lies elsewhere, such as an
    /// installed one.
    fn of(own: &Path, package: &Path) -> Option<Self> {
        let folder = own.parent()?;
        // Tests lie in a folder below.
        let profile = if folder.ends_with("deps") { folder.parent()? } else { folder };
        let target = profile.parent()?;
        let manifest = package.join("Cargo.toml");
        // Cargo leaves this file in each target folder.
        if !target.join("CACHEDIR.TAG").is_file() || !manifest.is_file() {
            return None;
        }
        let name = match profile.file_name()?.to_str()? {
            "debug" => "dev",
            other => other,
        };
        let arguments: [OsString; 9] = [
            "build".into(),
            "--locked".into(),
            "--manifest-path".into(),
            manifest.into(),
            "--profile".into(),
            name.into(),
            "--target-dir".into(),
            target.into(),
            "--bins".into(),
        ];
        Some(Self { arguments: arguments.into(), built: profile.join(NAME) })
    }

    /// Runs cargo and returns the program.
    fn run(self) -> Result<PathBuf, NoWindowProgram> {
        let mut command = Command::new(env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
        command.args(&self.arguments).stdin(Stdio::null()).stdout(Stdio::null());
        if self.built.is_file() {
            command.arg("--quiet");
        } else {
            tracing::warn!("the window is a program of its own and is built now, once: this takes some minutes");
        }
        let problem = match command.status() {
            Ok(status) if status.success() => return Ok(self.built),
            Ok(status) => format!("ended with {status}"),
            Err(error) => format!("cannot be started: {error}"),
        };
        let words: Vec<_> = self.arguments.iter().map(|argument| argument.to_string_lossy()).collect();
        Err(NoWindowProgram::Build { command: format!("cargo {}", words.join(" ")), problem })
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;
    use crate::source::RecordingSource;

    #[test]
    fn only_a_program_in_a_target_folder_is_built_with_its_window() {
        let home = tempfile::tempdir().unwrap();
        let package = home.path().join("app/window");
        fs::create_dir_all(&package).unwrap();
        fs::write(package.join("Cargo.toml"), "").unwrap();
        let installed = home.path().join("bin/mambavitact");
        assert_eq!(Build::of(&installed, &package), None);
        let target = home.path().join("target");
        fs::create_dir(&target).unwrap();
        fs::write(target.join("CACHEDIR.TAG"), "").unwrap();
        for (folder, profile) in [("release", "release"), ("debug", "dev"), ("debug/deps", "dev"), ("small", "small")] {
            let build = Build::of(&target.join(folder).join("mambavitact"), &package).unwrap();
            assert!(build.arguments.contains(&profile.into()), "{build:?}");
            assert_eq!(build.built.parent().unwrap().parent(), Some(&*target));
        }
        assert_eq!(Build::of(&target.join("release/mambavitact"), &home.path().join("gone")), None);
    }

    #[test]
    fn a_build_that_fails_names_its_command() {
        let build = Build { arguments: vec!["no-such-subcommand".into()], built: "/nowhere/window".into() };
        let said = build.run().unwrap_err().to_string();
        assert!(said.contains("`cargo no-such-subcommand` ended with"), "{said}");
    }

    #[test]
    fn the_window_is_told_its_contents() {
        let program = WindowProgram("window".into());
        let both = [RecordingSource::Run("a b".into()), RecordingSource::Log("c".into())];
        let command = program.command(&WindowContents::Comparison(both));
        let arguments: Vec<_> = command.get_args().filter_map(|argument| argument.to_str()).collect();
        assert_eq!(arguments[2..], ["--run", "a b", "--log", "c"]);
    }
}
