//! The results of a sweep on disk. Nothing here is locked: each file and folder has one writer, and appears whole under its name.
//!
//! ```text
//! done/<two digits>/<id>/        files of a task, with manifest.json: complete
//! attempts/<id>.<k>              attempt number k, from its beginning until the task is done: empty, or why it failed
//! partial/<id>.<k>/              files of attempt k while it works; with .gone behind the name while they are removed
//! failed/<id>                    why a task was set aside
//! ```

use std::collections::{BTreeMap, HashMap, HashSet};
use std::fs;
use std::io::{self, ErrorKind, Read as _};
use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result, bail, ensure};
use mvt_files::{input, output};
use serde::{Deserialize, Serialize};

/// Name of the file that lists the files of a task.
const MANIFEST: &str = "manifest.json";
/// Largest manifest that is read, bytes: that of an hour of uncompressed log.
const LARGEST_MANIFEST: u64 = 256 << 20;
/// Longest reason that is read, bytes.
const LONGEST_REASON: u64 = 1 << 16;
/// End of the name of files that are being removed.
const GONE: &str = ".gone";
/// Deepest folder of a task's files.
const DEEPEST: usize = 8;

/// Files of a finished task, with their sums.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Manifest {
    /// The task.
    pub task: String,
    /// Version of the program that did it.
    pub program_version: String,
    /// The files by their path in the folder, `/` between its parts.
    pub files: BTreeMap<String, FileSum>,
}

/// Size and checksum of a file.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct FileSum {
    /// Bytes.
    pub bytes: u64,
    /// BLAKE3, hexadecimal.
    pub blake3: String,
}

impl Manifest {
    /// Reads the text of a manifest.
    ///
    /// # Errors
    /// If it is no manifest, or names a file outside its folder.
    pub fn parse(bytes: &[u8]) -> Result<Self> {
        let manifest: Self = serde_json::from_slice(bytes)?;
        let is_inside =
            |path: &String| path.split('/').all(|part| !matches!(part, "" | "." | "..")) && !path.contains('\\');
        if let Some(path) = manifest.files.keys().find(|path| !is_inside(path)) {
            bail!("it names {path:?}, which is no file of the folder");
        }
        Ok(manifest)
    }
}

/// Folders of a sweep's results.
#[derive(Debug, Clone)]
pub struct Store {
    root: PathBuf,
}

/// The outcomes of the tasks, by their names.
#[derive(Debug, Default)]
pub struct TaskProgress {
    /// Finished.
    pub done: HashSet<String>,
    /// Set aside.
    pub failed: HashSet<String>,
    /// Begun and not finished, with the number of attempts. A process that was killed while it set a task aside left it here, too.
    pub begun: HashMap<String, u32>,
}

impl Store {
    /// Results in the folder of a sweep.
    pub fn new(root: &Path) -> Self {
        Self { root: root.to_path_buf() }
    }

    /// Returns the folder of a finished task.
    pub fn done(&self, id: &str) -> PathBuf {
        self.root.join("done").join(id.get(..2).unwrap_or(id)).join(id)
    }

    /// Returns the file that says why a task was set aside.
    pub fn failed(&self, id: &str) -> PathBuf {
        self.root.join("failed").join(id)
    }

    fn attempt(&self, id: &str, number: u32) -> PathBuf {
        self.root.join("attempts").join(format!("{id}.{number}"))
    }

    fn partial(&self, id: &str, number: u32) -> PathBuf {
        self.root.join("partial").join(format!("{id}.{number}"))
    }

    /// Makes the folders.
    ///
    /// # Errors
    /// If they cannot be made.
    pub fn prepare(&self) -> Result<()> {
        for name in ["done", "attempts", "partial", "failed"] {
            let folder = self.root.join(name);
            fs::create_dir_all(&folder).with_context(|| format!("cannot make {}", folder.display()))?;
        }
        Ok(())
    }

    /// Lists the outcomes of all tasks. No result is opened.
    ///
    /// # Errors
    /// If a folder cannot be read.
    pub fn progress(&self) -> Result<TaskProgress> {
        let mut progress = TaskProgress::default();
        for part in names(&self.root.join("done"))? {
            progress.done.extend(names(&self.root.join("done").join(part))?);
        }
        progress.failed.extend(names(&self.root.join("failed"))?);
        for name in names(&self.root.join("attempts"))? {
            // An attempt of a task that another process has finished.
            if let Some((id, _)) = name.rsplit_once('.').filter(|(id, _)| !progress.done.contains(*id)) {
                *progress.begun.entry(id.to_owned()).or_default() += 1;
            }
        }
        progress.failed.retain(|id| !progress.done.contains(id));
        Ok(progress)
    }

    /// Begins the next attempt of a task and returns its number, from 1 on; `None` after `most` attempts.
    ///
    /// # Errors
    /// If the file system refuses.
    pub fn begin(&self, id: &str, most: u32) -> Result<Option<u32>> {
        // Why: notes/decisions/sweeps.md, "An attempt is noted before it begins".
        for number in 1..=most {
            let path = self.attempt(id, number);
            match fs::File::create_new(&path) {
                Ok(_) => {
                    self.clear(id, number)?;
                    let folder = self.partial(id, number);
                    fs::create_dir_all(&folder).with_context(|| format!("cannot make {}", folder.display()))?;
                    return Ok(Some(number));
                }
                Err(error) if error.kind() == ErrorKind::AlreadyExists => {}
                Err(error) => return Err(error).with_context(|| format!("cannot write {}", path.display())),
            }
        }
        Ok(None)
    }

    /// Returns the folder in which an attempt works.
    pub fn workplace(&self, id: &str, number: u32) -> PathBuf {
        self.partial(id, number)
    }

    /// Removes the files of an attempt. They get another name first: a process that still works there, perhaps on a node that was given up,
    /// then never makes a result of half of them.
    fn clear(&self, id: &str, number: u32) -> Result<()> {
        let folder = self.partial(id, number);
        let gone = self.root.join("partial").join(format!("{id}.{number}{GONE}"));
        let removed = remove(fs::remove_dir_all(&gone))
            .and_then(|()| remove(fs::rename(&folder, &gone)))
            .and_then(|()| remove(fs::remove_dir_all(&gone)));
        removed.with_context(|| format!("cannot remove {}", folder.display()))
    }

    /// Removes the files of a task that is done, set aside or put back: the files of its first `most` attempts, and the attempts.
    fn forget(&self, id: &str, most: u32) -> Result<()> {
        (1..=most).try_for_each(|number| self.withdraw(id, number))
    }

    /// Removes an attempt and its files, so that it does not count.
    ///
    /// # Errors
    /// If the file system refuses.
    pub fn withdraw(&self, id: &str, number: u32) -> Result<()> {
        self.clear(id, number)?;
        let path = self.attempt(id, number);
        remove(fs::remove_file(&path)).with_context(|| format!("cannot remove {}", path.display()))
    }

    /// Puts the files of an attempt in their place. If another process has finished the task meanwhile, its files stay.
    ///
    /// # Errors
    /// If a file cannot be read, or the folder cannot be moved.
    pub fn finish(&self, id: &str, number: u32) -> Result<()> {
        let folder = self.partial(id, number);
        let manifest = Manifest {
            task: id.to_owned(),
            program_version: env!("CARGO_PKG_VERSION").to_owned(),
            files: sums(&folder)?,
        };
        mvt_run::io::write_file(&folder, MANIFEST, &serde_json::to_vec(&manifest)?)?;
        let done = self.done(id);
        if let Some(parent) = done.parent() {
            fs::create_dir_all(parent).with_context(|| format!("cannot make {}", parent.display()))?;
        }
        // A folder with files is never replaced by this call.
        if let Err(error) = fs::rename(&folder, &done)
            && !done.join(MANIFEST).exists()
        {
            return Err(error).with_context(|| format!("cannot make {}", done.display()));
        }
        self.forget(id, number)
    }

    /// Removes what processes left that were killed, or overtaken, after a task was done.
    ///
    /// # Errors
    /// If the file system refuses.
    pub fn tidy(&self, is_mine: impl Fn(&str) -> bool) -> Result<()> {
        for folder in ["attempts", "partial"] {
            for name in names(&self.root.join(folder))? {
                let name = name.strip_suffix(GONE).unwrap_or(&name);
                let Some((id, number)) = name.rsplit_once('.').and_then(|(id, n)| Some((id, n.parse().ok()?))) else {
                    continue;
                };
                if is_mine(id) && self.done(id).exists() {
                    self.forget(id, number)?;
                }
            }
        }
        Ok(())
    }

    /// Notes why an attempt failed and removes its files.
    ///
    /// # Errors
    /// If the file system refuses.
    pub fn note_failure(&self, id: &str, number: u32, reason: &str) -> Result<()> {
        self.clear(id, number)?;
        let path = self.attempt(id, number);
        output::replace(&path, reason.as_bytes()).with_context(|| format!("cannot write {}", path.display()))
    }

    /// Returns why the last attempt of a task failed.
    pub fn last_reason(&self, id: &str, attempts: u32) -> String {
        let reason = (1..=attempts).rev().find_map(|number| read_reason(&self.attempt(id, number)));
        reason.unwrap_or_else(|| "its process was killed, perhaps for memory or time".to_owned())
    }

    /// Sets a task aside.
    ///
    /// # Errors
    /// If the file system refuses.
    pub fn set_aside(&self, id: &str, attempts: u32) -> Result<()> {
        let path = self.failed(id);
        let reason = self.last_reason(id, attempts);
        output::replace(&path, reason.as_bytes()).with_context(|| format!("cannot write {}", path.display()))?;
        self.forget(id, attempts)
    }

    /// Returns why a task was set aside.
    pub fn failure(&self, id: &str) -> String {
        read_reason(&self.failed(id)).unwrap_or_else(|| "unknown".to_owned())
    }

    /// Makes a task that was set aside, or begun and left, wait again.
    ///
    /// # Errors
    /// If the file system refuses.
    pub fn put_back(&self, id: &str, attempts: u32) -> Result<()> {
        let path = self.failed(id);
        remove(fs::remove_file(&path)).with_context(|| format!("cannot remove {}", path.display()))?;
        self.forget(id, attempts)
    }

    /// Moves the result of a task to `damaged/`, so that the task waits again.
    ///
    /// # Errors
    /// If the file system refuses.
    pub fn put_aside_damaged(&self, id: &str) -> Result<()> {
        let folder = self.root.join("damaged");
        fs::create_dir_all(&folder).with_context(|| format!("cannot make {}", folder.display()))?;
        let free = (1u32..).map(|k| folder.join(format!("{id}.{k}"))).find(|path| !path.exists());
        let free = free.context("damaged/ is full")?;
        fs::rename(self.done(id), &free).with_context(|| format!("cannot make {}", free.display()))
    }

    /// Reads the manifest of a finished task and checks that its files fit.
    ///
    /// # Errors
    /// If the manifest is of another task, a file is missing, or one differs; the message names it.
    pub fn check(&self, id: &str) -> Result<Manifest> {
        let folder = self.done(id);
        let path = folder.join(MANIFEST);
        let bytes = input::read(&path, LARGEST_MANIFEST).with_context(|| format!("cannot read {}", path.display()))?;
        let manifest = Manifest::parse(&bytes).with_context(|| path.display().to_string())?;
        ensure!(manifest.task == id, "{}: it is the manifest of task {}", path.display(), manifest.task);
        let mut present = sums(&folder)?;
        present.remove(MANIFEST);
        for (name, sum) in &manifest.files {
            match present.remove(name) {
                Some(found) if found == *sum => {}
                Some(_) => bail!("{} does not fit its manifest", folder.join(name).display()),
                None => bail!("{} is missing", folder.join(name).display()),
            }
        }
        if let Some((name, _)) = present.pop_first() {
            bail!("{} is not in the manifest", folder.join(name).display());
        }
        Ok(manifest)
    }
}

/// A file or folder that is not there needs no removal.
fn remove(removed: io::Result<()>) -> io::Result<()> {
    match removed {
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(()),
        other => other,
    }
}

fn read_reason(path: &Path) -> Option<String> {
    let text = input::read_text(path, LONGEST_REASON).ok()?;
    (!text.is_empty()).then_some(text)
}

/// Returns the names in a folder, without those of unfinished files; none if there is no such folder.
fn names(folder: &Path) -> Result<Vec<String>> {
    let entries = match fs::read_dir(folder) {
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(Vec::new()),
        entries => entries.with_context(|| format!("cannot read {}", folder.display()))?,
    };
    let mut names = Vec::new();
    for entry in entries {
        let name = entry.with_context(|| format!("cannot read {}", folder.display()))?.file_name();
        names.extend(name.into_string().ok().filter(|name| !name.starts_with('.')));
    }
    Ok(names)
}

/// Returns the sums of all files below a folder.
fn sums(folder: &Path) -> Result<BTreeMap<String, FileSum>> {
    let mut files = BTreeMap::new();
    add_sums(folder, "", DEEPEST, &mut files)?;
    Ok(files)
}

fn add_sums(folder: &Path, prefix: &str, depth: usize, into: &mut BTreeMap<String, FileSum>) -> Result<()> {
    ensure!(depth > 0, "{}: the folders are too deep", folder.display());
    for entry in fs::read_dir(folder).with_context(|| format!("cannot read {}", folder.display()))? {
        let entry = entry.with_context(|| format!("cannot read {}", folder.display()))?;
        let name = entry.file_name();
        let name = name.to_str().with_context(|| format!("{}: its name is no text", entry.path().display()))?;
        let kind = entry.file_type().with_context(|| format!("cannot read {}", entry.path().display()))?;
        if kind.is_dir() {
            add_sums(&entry.path(), &format!("{prefix}{name}/"), depth - 1, into)?;
        } else {
            let path = entry.path();
            let sum = file_sum(&path).with_context(|| format!("cannot read {}", path.display()))?;
            into.insert(format!("{prefix}{name}"), sum);
        }
    }
    Ok(())
}

fn file_sum(path: &Path) -> io::Result<FileSum> {
    /// A piece that stays in the processor's cache.
    const PIECE: usize = 1 << 16;
    let mut file = input::open(path)?;
    let (mut hasher, mut piece, mut bytes) = (blake3::Hasher::new(), vec![0; PIECE], 0);
    loop {
        match file.read(&mut piece)? {
            0 => return Ok(FileSum { bytes, blake3: hasher.finalize().to_hex().to_string() }),
            read => {
                hasher.update(piece.get(..read).unwrap_or_default());
                bytes += read as u64;
            }
        }
    }
}
