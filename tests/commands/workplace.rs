//! A temporary folder in which the program runs.

use std::collections::BTreeMap;
use std::fs;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::Command;

use serde_json::Value;
use tempfile::TempDir;

/// Temporary folder; paths in command lines are relative to it.
pub struct Workplace(TempDir);

/// Exit code and output of a command.
#[derive(Debug, PartialEq)]
pub struct Ended {
    pub code: Option<i32>,
    pub stdout: String,
    pub stderr: String,
}

/// The files below a folder, by their path in it.
pub type Files = BTreeMap<PathBuf, Vec<u8>>;

impl Workplace {
    pub fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    pub fn path(&self, relative: &str) -> PathBuf {
        self.0.path().join(relative)
    }

    pub fn write(&self, relative: &str, bytes: impl AsRef<[u8]>) {
        fs::write(self.path(relative), bytes).unwrap();
    }

    pub fn text(&self, relative: &str) -> String {
        fs::read_to_string(self.path(relative)).unwrap()
    }

    pub fn json(&self, relative: &str) -> Value {
        serde_json::from_str(&self.text(relative)).unwrap()
    }

    /// Returns the program with arguments that are separated by spaces, without the user's own settings.
    pub fn command(&self, arguments: &str) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_mambavitact"));
        command.args(arguments.split_whitespace()).current_dir(self.0.path());
        command.env_remove("MAMBAVITACT_LOG").env_remove("YCB_DIR").env_remove("YCB_ARCHIVE");
        command
    }

    pub fn run(&self, arguments: &str) -> Ended {
        Ended::of(&mut self.command(arguments))
    }

    /// Returns every file below a folder; no files if the folder does not exist.
    pub fn files(&self, relative: &str) -> Files {
        let mut files = Files::new();
        let root = self.path(relative);
        if root.exists() {
            collect(&root, &root, &mut files);
        }
        files
    }

    /// Returns the folders of the complete logs below a data set.
    pub fn logs(&self, data_set: &str) -> Vec<String> {
        let list = |folder: &str| match fs::read_dir(self.path(folder)) {
            Ok(entries) => entries.map(|entry| format!("{folder}/{}", name(&entry.unwrap().path()))).collect(),
            Err(_) => Vec::new(),
        };
        let is_visible = |path: &String| !name(Path::new(path)).starts_with('.');
        let mut logs: Vec<String> = list(data_set).iter().flat_map(|object| list(object)).filter(is_visible).collect();
        logs.sort();
        logs
    }
}

impl Ended {
    pub fn of(command: &mut Command) -> Self {
        let output = command.output().unwrap();
        let text = |bytes| String::from_utf8(bytes).unwrap();
        Self { code: output.status.code(), stdout: text(output.stdout), stderr: text(output.stderr) }
    }

    /// Returns the standard output of a command that must have succeeded without messages.
    #[track_caller]
    pub fn good(self) -> String {
        assert_eq!((self.code, self.stderr.as_str()), (Some(0), ""), "{self:?}");
        self.stdout
    }

    /// Returns the JSON of a command that must have succeeded without messages.
    #[track_caller]
    pub fn json(self) -> Value {
        serde_json::from_str(&self.good()).unwrap()
    }

    /// Returns the warnings of a command that must have succeeded.
    #[track_caller]
    pub fn warned(self) -> String {
        assert_eq!(self.code, Some(0), "{self:?}");
        assert!(self.stderr.lines().all(|line| line.trim_start().starts_with("WARN")), "{self:?}");
        self.stderr
    }

    /// Returns the standard output of a command that must have succeeded, perhaps with warnings.
    #[track_caller]
    pub fn warned_with_output(self) -> String {
        let output = self.stdout.clone();
        self.warned();
        output
    }

    /// Returns the one line with which a command must have failed.
    #[track_caller]
    pub fn error(self) -> String {
        assert_eq!((self.code, self.stdout.as_str()), (Some(1), ""), "{self:?}");
        assert!(self.stderr.starts_with("ERROR ") && self.stderr.lines().count() == 1, "{self:?}");
        self.stderr
    }

    /// Returns the message of a command that must have refused its arguments.
    #[track_caller]
    pub fn usage(self) -> String {
        assert_eq!((self.code, self.stdout.as_str()), (Some(2), ""), "{self:?}");
        self.stderr
    }
}

/// Sends a signal, such as INT.
pub fn signal(child: &std::process::Child, name: &str) {
    assert!(Command::new("kill").args(["-s", name, &child.id().to_string()]).status().unwrap().success());
}

/// Fails with the name of the first file that differs.
#[track_caller]
pub fn assert_same(left: &Files, right: &Files) {
    assert!(!left.is_empty(), "there is nothing to compare");
    let differs = |path: &&PathBuf| left.get(*path) != right.get(*path);
    assert_eq!(left.keys().chain(right.keys()).find(differs), None, "this file differs");
}

/// Reports that a test cannot run here. With REQUIRE_ALL=1, as in CI, that is a failure.
#[track_caller]
pub fn skip(reason: &str) {
    eprintln!("SKIPPED: {reason}");
    assert!(std::env::var_os("REQUIRE_ALL").is_none_or(|value| value != "1"), "skipped: {reason}");
}

/// Returns a folder of other people's data. It lies beside the clone, because it is not ours to keep here. Where it is missing the test says so,
/// past the harness, and tests nothing.
pub fn others_data(name: &str) -> Option<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared").join(name);
    if !folder.exists() {
        // A closed standard error is no reason to fail.
        let _ = writeln!(std::io::stderr(), "NOT TESTED: {} is missing", folder.display());
        return None;
    }
    Some(folder)
}

fn collect(root: &Path, folder: &Path, files: &mut Files) {
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        // It holds the number of a process.
        if path.ends_with(".mambavitact") {
            continue;
        }
        if path.is_dir() {
            collect(root, &path, files);
        } else {
            files.insert(path.strip_prefix(root).unwrap().to_path_buf(), fs::read(&path).unwrap());
        }
    }
}

fn name(path: &Path) -> String {
    path.file_name().unwrap().to_str().unwrap().to_owned()
}
