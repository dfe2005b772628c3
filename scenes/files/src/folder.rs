//! Folders that one process writes.
//!
//! A claimed folder holds the file [`MARK`] with the name of the command that made it and the number of its process. The process holds a
//! lock on that file, which the operating system takes back even from a process that is killed.

use std::fs::{self, File, OpenOptions, TryLockError};
use std::io::{self, Read as _, Seek as _, Write as _};
use std::path::{Path, PathBuf};

/// Name of the file that marks a folder as written by this program.
pub const MARK: &str = ".mambavitact";
/// Longest mark that is read, bytes.
const LONGEST_MARK: u64 = 256;

/// What becomes of the files that the same command left in the folder earlier.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Earlier {
    /// The folder is moved to another name, with all that is in it.
    Move,
    /// They stay, and the command continues with them.
    Keep,
}

/// Reason why a folder cannot be claimed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ClaimError {
    /// Another process writes into the folder.
    #[error("{}: another mambavitact{process} writes into this folder; wait for it or choose another folder", path.display())]
    InUse {
        /// The folder.
        path: PathBuf,
        /// The number of the process in words, where it is known.
        process: String,
    },
    /// The folder contains files that the command did not write.
    #[error("{}: the folder contains {found}; choose another folder or give --overwrite", path.display())]
    Foreign {
        /// The folder.
        path: PathBuf,
        /// What it contains.
        found: String,
    },
    /// The path is not a folder, or the folder cannot be read or made.
    #[error("{}: {reason}", path.display())]
    Io {
        /// The folder.
        path: PathBuf,
        /// Reason of the operating system.
        reason: io::Error,
    },
}

/// Folder that this process writes, until the value is dropped.
#[derive(Debug)]
pub struct ClaimedFolder {
    moved: Option<PathBuf>,
    _lock: File,
}

/// Contents of a mark.
struct Mark {
    command: String,
    process: String,
}

impl ClaimedFolder {
    /// Makes or claims a folder for a command. With `overwrite` a folder with any contents is claimed, and nothing is moved.
    ///
    /// # Errors
    /// [`ClaimError::Foreign`] if the folder holds files and has no mark of the command; [`ClaimError::InUse`] if another process has it;
    /// [`ClaimError::Io`] for all else.
    pub fn claim(path: &Path, command: &str, earlier: Earlier, overwrite: bool) -> Result<Self, ClaimError> {
        let path = &resolved(path)?;
        let _turn = wait_for_turn(path)?;
        let mut moved = None;
        loop {
            fs::create_dir_all(path).map_err(io_error(path))?;
            let mark = path.join(MARK);
            // No mark is written into a folder of somebody else.
            if !overwrite
                && mark.symlink_metadata().is_err()
                && let Some(name) = first_entry(path)?
            {
                return Err(foreign_error(path, &name, command));
            }
            let mut lock = lock(path, &mark)?;
            let old = read_mark(&mut lock);
            // Without text the mark is new, or of a process that was killed before it wrote it.
            let foreign = if old.is_none() { first_entry(path)? } else { None };
            if let Some(name) = foreign.as_ref().filter(|_| !overwrite) {
                return Err(foreign_error(path, name, command));
            }
            if let Some(old) = old.filter(|_| !overwrite) {
                if old.command != command {
                    let found = match old.command.as_str() {
                        "" => "other files than results".to_owned(),
                        other => format!("the results of `{other}`"),
                    };
                    return Err(ClaimError::Foreign { path: path.to_path_buf(), found });
                }
                if earlier == Earlier::Move {
                    moved = Some(move_aside(path)?);
                    continue;
                }
            }
            // A folder with files of somebody else is never taken for one of the command.
            let owner = if foreign.is_some() { "" } else { command };
            write_mark(&mut lock, owner).map_err(io_error(&mark))?;
            return Ok(Self { moved, _lock: lock });
        }
    }

    /// Returns the folder into which the earlier results were moved.
    pub fn moved(&self) -> Option<&Path> {
        self.moved.as_deref()
    }
}

fn io_error(path: &Path) -> impl FnOnce(io::Error) -> ClaimError {
    let path = path.to_path_buf();
    |reason| ClaimError::Io { path, reason }
}

/// Returns where a link leads, or else the path. Earlier results are moved where they lie, and the link stays.
fn resolved(path: &Path) -> Result<PathBuf, ClaimError> {
    if !path.is_symlink() {
        return Ok(path.to_path_buf());
    }
    fs::canonicalize(path).map_err(|reason| {
        let nowhere = || io::Error::new(reason.kind(), "it is a link that leads nowhere; remove it");
        io_error(path)(if reason.kind() == io::ErrorKind::NotFound { nowhere() } else { reason })
    })
}

fn foreign_error(path: &Path, name: &str, command: &str) -> ClaimError {
    let found = format!("{name}, and nothing says that `{command}` wrote it");
    ClaimError::Foreign { path: path.to_path_buf(), found }
}

/// Returns the name of a file or folder in a folder; `None` if it is empty.
fn first_entry(path: &Path) -> Result<Option<String>, ClaimError> {
    let mut names = Vec::new();
    for entry in fs::read_dir(path).map_err(io_error(path))? {
        names.push(entry.map_err(io_error(path))?.file_name().to_string_lossy().into_owned());
    }
    // Another process may have made the mark in the meantime.
    names.retain(|name| name != MARK);
    Ok(names.into_iter().min())
}

/// Waits until no other process claims a folder beside this one, and keeps others from it until the file is dropped. A claim moves and
/// marks folders in several steps, between which another claim would read an outdated state. `None` where folders cannot be locked.
fn wait_for_turn(path: &Path) -> Result<Option<File>, ClaimError> {
    let parent = path.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."));
    fs::create_dir_all(parent).map_err(io_error(path))?;
    Ok(OpenOptions::new().read(true).open(parent).ok().filter(|parent| parent.lock().is_ok()))
}

/// Opens and locks the mark of a folder.
fn lock(path: &Path, mark: &Path) -> Result<File, ClaimError> {
    if mark.symlink_metadata().is_ok_and(|kind| !kind.is_file()) {
        let reason = io::Error::new(io::ErrorKind::InvalidInput, "it is not a regular file; remove it");
        return Err(ClaimError::Io { path: mark.to_path_buf(), reason });
    }
    let file = OpenOptions::new().read(true).write(true).create(true).truncate(false).open(mark);
    let file = file.map_err(io_error(mark))?;
    match file.try_lock() {
        Ok(()) => {}
        Err(TryLockError::WouldBlock) => {
            let process =
                crate::input::open(mark).ok().and_then(|mut file| read_mark(&mut file)).map(|mark| mark.process);
            let process = process.filter(|process| !process.is_empty());
            let process = process.map_or_else(String::new, |process| format!(" (process {process})"));
            return Err(ClaimError::InUse { path: path.to_path_buf(), process });
        }
        // A file system without locks: two processes are not kept apart there.
        Err(TryLockError::Error(_)) => {}
    }
    Ok(file)
}

fn read_mark(file: &mut File) -> Option<Mark> {
    let mut text = String::new();
    file.take(LONGEST_MARK).read_to_string(&mut text).ok()?;
    let mut lines = text.lines().map(str::to_owned);
    // An empty mark is that of a process which is about to write it.
    Some(Mark { command: lines.next()?, process: lines.next().unwrap_or_default() })
}

fn write_mark(file: &mut File, command: &str) -> io::Result<()> {
    file.set_len(0)?;
    file.rewind()?;
    writeln!(file, "{command}\n{}\nThis file shows which command of mambavitact wrote this folder.", std::process::id())
}

/// Moves a folder to the first free of `NAME.1`, `NAME.2` and so on.
fn move_aside(path: &Path) -> Result<PathBuf, ClaimError> {
    // Such as `.` or `/`.
    let Some(name) = path.file_name() else {
        let reason = io::Error::new(
            io::ErrorKind::InvalidInput,
            "it holds earlier results, and a folder without a name is not moved",
        );
        return Err(io_error(path)(reason));
    };
    for number in 1u32.. {
        let mut other = name.to_owned();
        other.push(format!(".{number}"));
        let other = path.with_file_name(other);
        if other.symlink_metadata().is_err() {
            fs::rename(path, &other).map_err(io_error(path))?;
            return Ok(other);
        }
    }
    Err(io_error(path)(io::ErrorKind::AlreadyExists.into()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn claim(path: &Path, command: &str, overwrite: bool) -> Result<ClaimedFolder, ClaimError> {
        ClaimedFolder::claim(path, command, Earlier::Move, overwrite)
    }

    #[cfg(unix)]
    #[test]
    fn a_link_stays_and_the_folder_behind_it_is_moved() {
        let home = tempfile::tempdir().unwrap();
        let (link, real) = (home.path().join("link"), home.path().join("real"));
        std::os::unix::fs::symlink("real", &link).unwrap();
        let said = claim(&link, "run", false).unwrap_err().to_string();
        assert!(said.ends_with("link: it is a link that leads nowhere; remove it"), "{said}");
        fs::create_dir(&real).unwrap();
        drop(claim(&link, "run", false).unwrap());
        fs::write(link.join("mesh.ply"), "earlier").unwrap();
        let moved = claim(&link, "run", false).unwrap().moved().unwrap().to_path_buf();
        assert_eq!(moved, fs::canonicalize(home.path()).unwrap().join("real.1"));
        assert_eq!(fs::read(moved.join("mesh.ply")).unwrap(), b"earlier");
        assert!(link.is_symlink() && real.join(MARK).exists() && !link.join("mesh.ply").exists());
    }

    #[test]
    fn a_folder_of_somebody_else_is_refused_and_left_as_it_is() {
        let home = tempfile::tempdir().unwrap();
        let path = home.path().join("p");
        fs::create_dir(&path).unwrap();
        fs::write(path.join("mesh.obj"), "mine").unwrap();
        let error = claim(&path, "run", false).unwrap_err().to_string();
        assert!(error.contains("contains mesh.obj") && error.contains("--overwrite"), "{error}");
        assert!(!path.join(MARK).exists());
        // With leave it is claimed, but it does not become a folder of runs, which the next one would move.
        drop(claim(&path, "run", true).unwrap());
        assert!(matches!(claim(&path, "run", false), Err(ClaimError::Foreign { .. })));
        assert_eq!(fs::read(path.join("mesh.obj")).unwrap(), b"mine");
    }

    #[test]
    fn earlier_results_are_moved_or_kept() {
        let home = tempfile::tempdir().unwrap();
        let path = home.path().join("out");
        for number in 0..3 {
            let claimed = claim(&path, "run", false).unwrap();
            let moved = (number > 0).then(|| home.path().join(format!("out.{number}")));
            assert_eq!(claimed.moved(), moved.as_deref());
            fs::write(path.join("a"), [number]).unwrap();
        }
        assert_eq!(fs::read(home.path().join("out.2/a")).unwrap(), [1]);
        let claimed = ClaimedFolder::claim(&path, "run", Earlier::Keep, false).unwrap();
        assert_eq!(fs::read(path.join("a")).unwrap(), [2]);
        assert_eq!(claimed.moved(), None);
        drop(claimed);
        let error = claim(&path, "generate", false).unwrap_err().to_string();
        assert!(error.contains("the results of `run`"), "{error}");
    }

    #[test]
    fn two_claims_exclude_each_other() {
        let home = tempfile::tempdir().unwrap();
        let path = home.path().join("out");
        let first = claim(&path, "run", false).unwrap();
        for overwrite in [false, true] {
            let error = claim(&path, "run", overwrite).unwrap_err().to_string();
            assert!(error.contains(&format!("(process {})", std::process::id())), "{error}");
        }
        drop(first);
        claim(&path, "run", false).unwrap();
    }

    #[test]
    fn of_many_claims_at_once_each_has_a_folder_of_its_own() {
        let home = tempfile::tempdir().unwrap();
        let path = home.path().join("out");
        let (threads, wins) = (4, 12);
        std::thread::scope(|scope| {
            for k in 0..threads {
                let path = &path;
                scope.spawn(move || {
                    let mut missing = wins;
                    while missing > 0 {
                        let claimed = match claim(path, "run", false) {
                            Ok(claimed) => claimed,
                            Err(ClaimError::InUse { .. }) => {
                                std::thread::yield_now();
                                continue;
                            }
                            Err(error) => panic!("{error}"),
                        };
                        // Nobody else writes here meanwhile.
                        assert!(!path.join("owner").exists());
                        fs::write(path.join("owner"), [k]).unwrap();
                        std::thread::yield_now();
                        assert_eq!(fs::read(path.join("owner")).unwrap(), [k]);
                        drop(claimed);
                        missing -= 1;
                    }
                });
            }
        });
        assert_eq!(fs::read_dir(home.path()).unwrap().count(), usize::from(threads) * wins);
    }

    #[test]
    fn what_is_no_folder_is_refused() {
        let home = tempfile::tempdir().unwrap();
        let path = home.path().join("file");
        fs::write(&path, "").unwrap();
        assert!(matches!(claim(&path, "run", true), Err(ClaimError::Io { .. })));
        let odd = home.path().join("odd");
        fs::create_dir_all(odd.join(MARK)).unwrap();
        assert!(matches!(claim(&odd, "run", true), Err(ClaimError::Io { .. })));
    }
}
