//! Runs that the window starts. Each is a process of its own and goes on when the window is closed.

use std::fs::{self, File};
use std::io;
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};

use mvt_files::input;
use mvt_viewer::run_choices::RunChoices;

/// Largest file of messages that is read, bytes.
const LARGEST_ERRORS: u64 = 1 << 20;

// Why: notes/decisions/viewing.md, "Runs that the window starts are separate processes".
/// Run that this window has started.
#[derive(Debug)]
pub struct StartedRun {
    /// Folder of its results.
    pub folder: PathBuf,
    child: Child,
    /// Folder of the runs, if this run has created it.
    created: Option<PathBuf>,
    /// File of its standard error.
    errors: PathBuf,
}

impl StartedRun {
    /// Starts a run with this program.
    ///
    /// # Errors
    /// If the folder cannot be created or the process cannot be started.
    pub fn start(choices: &RunChoices) -> io::Result<Self> {
        let program = mvt_run::program::path()?;
        let created = (!choices.folder.exists()).then(|| choices.folder.clone());
        fs::create_dir_all(&choices.folder)?;
        let folder = choices.new_folder();
        // Beside the run's folder, which must be empty when the run begins.
        let errors = folder.with_extension("log");
        let mut command = Command::new(program);
        command.args(choices.arguments(&folder));
        command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(File::create(&errors)?);
        // Ctrl-C in the window's terminal does not interrupt the run.
        #[cfg(unix)]
        std::os::unix::process::CommandExt::process_group(&mut command, 0);
        Ok(Self { folder, child: command.spawn()?, created, errors })
    }

    /// Returns `None` while the run goes on, then its success or its last error messages.
    pub fn poll(&mut self) -> Option<Result<(), String>> {
        let status = match self.child.try_wait() {
            Ok(None) => return None,
            Ok(Some(status)) => status,
            Err(error) => return Some(Err(error.to_string())),
        };
        if status.success() {
            // An empty file is useless.
            if fs::metadata(&self.errors).is_ok_and(|data| data.len() == 0) {
                let _ = fs::remove_file(&self.errors);
            }
            return Some(Ok(()));
        }
        let text = input::read(&self.errors, LARGEST_ERRORS).unwrap_or_default();
        let text = String::from_utf8_lossy(&text);
        Some(Err(reason(&text).unwrap_or_else(|| status.to_string())))
    }

    /// Removes the file of messages, and the folders that this run has created if they are empty. Call it after a run
    /// that did not start.
    pub fn clean_up(&self) {
        // A folder that is not empty stays, and a file that is missing needs no removal.
        let _ = fs::remove_file(&self.errors);
        let _ = fs::remove_dir(&self.folder);
        if let Some(folder) = &self.created {
            let _ = fs::remove_dir(folder);
        }
    }
}

/// Returns the last errors among the messages of a run without the word ERROR; without errors, the last line.
fn reason(messages: &str) -> Option<String> {
    let lines = || messages.lines().map(str::trim).filter(|line| !line.is_empty());
    let errors: Vec<&str> = lines().filter_map(|line| line.strip_prefix("ERROR")).map(str::trim).collect();
    match errors.as_slice() {
        [] => lines().next_back().map(str::to_owned),
        errors => Some(errors.join("; ")),
    }
}

/// Interrupts a run, which then writes its results. Call it only for the process of a recording that goes on.
///
/// # Errors
/// If the signal cannot be sent.
#[cfg(unix)]
pub fn interrupt(process: u32) -> io::Result<()> {
    let id = i32::try_from(process).ok().filter(|&id| id > 1 && process != std::process::id());
    match id.and_then(rustix::process::Pid::from_raw) {
        Some(id) => Ok(rustix::process::kill_process(id, rustix::process::Signal::INT)?),
        None => Err(io::Error::other("its process is unknown")),
    }
}

/// Interrupts a run, which this system does not support.
///
/// # Errors
/// Always.
#[cfg(not(unix))]
pub fn interrupt(_: u32) -> io::Result<()> {
    Err(io::ErrorKind::Unsupported.into())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_failed_run_gives_its_reason_in_words() {
        let messages = " WARN something else\n\nERROR unknown gait \"x\"; choose one of a, b\n";
        assert_eq!(reason(messages).as_deref(), Some("unknown gait \"x\"; choose one of a, b"));
        assert_eq!(reason("killed by a signal\n").as_deref(), Some("killed by a signal"));
        assert_eq!(reason(" \n"), None);
    }

    #[cfg(unix)]
    #[test]
    fn a_failed_run_leaves_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let choices = RunChoices { folder: folder.path().join("runs"), ..RunChoices::default() };
        // This test program does not know the arguments of a run, and fails.
        let mut run = StartedRun::start(&choices).unwrap();
        while run.poll().is_none() {
            std::thread::sleep(std::time::Duration::from_millis(5));
        }
        assert!(choices.folder.exists());
        run.clean_up();
        assert!(!choices.folder.exists());
    }
}
