//! Writing of whole files.
//!
//! A file is written under another name in the same folder, `.NAME.PROCESS.partial`, and renamed when it is complete. A process that is
//! killed leaves that file, and the file with the final name as it was.

use std::ffi::OsString;
use std::fs::{self, File};
use std::io::{self, Write as _};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

/// Writes a file; an earlier file of that name is there until the new one is complete.
///
/// # Errors
/// Those of the operating system.
pub fn replace(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let mut partial = PartialFile::create(path)?;
    partial.file().write_all(bytes)?;
    partial.replace()
}

/// Writes a file that does not exist yet.
///
/// # Errors
/// Those of the operating system, and [`io::ErrorKind::AlreadyExists`] if there is a file of that name.
pub fn create(path: &Path, bytes: &[u8]) -> io::Result<()> {
    // Before the work, so that the usual case is cheap.
    refuse_existing(path)?;
    let mut partial = PartialFile::create(path)?;
    partial.file().write_all(bytes)?;
    partial.finish()
}

/// Returns an error if there is a file of that name, or a link that leads nowhere.
///
/// # Errors
/// [`io::ErrorKind::AlreadyExists`].
pub fn refuse_existing(path: &Path) -> io::Result<()> {
    match path.symlink_metadata() {
        Ok(_) => Err(io::ErrorKind::AlreadyExists.into()),
        Err(_) => Ok(()),
    }
}

/// File that is being written. If it is dropped before it is finished, it is removed.
#[derive(Debug)]
pub struct PartialFile {
    file: File,
    partial: PathBuf,
    path: PathBuf,
    is_placed: bool,
}

impl PartialFile {
    /// Begins a file with the final path `path`.
    ///
    /// # Errors
    /// Those of the operating system, and [`io::ErrorKind::InvalidInput`] if the path does not end in a name.
    pub fn create(path: &Path) -> io::Result<Self> {
        // Two threads of a process may write files of one name.
        static NUMBER: AtomicU64 = AtomicU64::new(0);
        let name = path.file_name();
        let name =
            name.ok_or_else(|| io::Error::new(io::ErrorKind::InvalidInput, "the path does not end in a file name"))?;
        let number = NUMBER.fetch_add(1, Ordering::Relaxed);
        let mut hidden = OsString::from(".");
        hidden.push(name);
        hidden.push(format!(".{}-{number}.partial", std::process::id()));
        let partial = path.with_file_name(hidden);
        let file = File::create_new(&partial)?;
        Ok(Self { file, partial, path: path.to_path_buf(), is_placed: false })
    }

    /// Returns the file, for writing.
    pub fn file(&mut self) -> &mut File {
        &mut self.file
    }

    /// Returns the path under which the file lies until it is finished.
    pub fn partial_path(&self) -> &Path {
        &self.partial
    }

    /// Gives the file its name; an earlier file of that name is replaced.
    ///
    /// # Errors
    /// Those of the operating system.
    pub fn replace(mut self) -> io::Result<()> {
        fs::rename(&self.partial, &self.path)?;
        self.is_placed = true;
        Ok(())
    }

    /// Gives the file its name, which no file has.
    ///
    /// # Errors
    /// Those of the operating system, and [`io::ErrorKind::AlreadyExists`] if there is a file of that name.
    pub fn finish(self) -> io::Result<()> {
        // A link never replaces a file, so that two processes cannot both have the name. Some file systems have none.
        match fs::hard_link(&self.partial, &self.path) {
            // Dropping removes the first name.
            Ok(()) => Ok(()),
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => Err(error),
            Err(_) => {
                refuse_existing(&self.path)?;
                self.replace()
            }
        }
    }
}

impl Drop for PartialFile {
    fn drop(&mut self) {
        if !self.is_placed {
            // Nothing more can be done if even that fails.
            let _ = fs::remove_file(&self.partial);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(folder: &Path) -> Vec<String> {
        let name = |entry: io::Result<fs::DirEntry>| entry.unwrap().file_name().into_string().unwrap();
        let mut names: Vec<String> = fs::read_dir(folder).unwrap().map(name).collect();
        names.sort();
        names
    }

    #[test]
    fn a_new_file_replaces_none() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.txt");
        create(&path, b"one").unwrap();
        assert_eq!(create(&path, b"two").unwrap_err().kind(), io::ErrorKind::AlreadyExists);
        assert_eq!(fs::read(&path).unwrap(), b"one");
        // The name was taken while the file was written.
        let late = PartialFile::create(&folder.path().join("b.txt")).unwrap();
        fs::write(folder.path().join("b.txt"), "mine").unwrap();
        assert_eq!(late.finish().unwrap_err().kind(), io::ErrorKind::AlreadyExists);
        assert_eq!(fs::read(folder.path().join("b.txt")).unwrap(), b"mine");
        replace(&path, b"three").unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"three");
        assert_eq!(names(folder.path()), ["a.txt", "b.txt"]);
    }

    #[test]
    fn one_of_many_writers_has_the_name() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.txt");
        let written = std::thread::scope(|scope| {
            let write = |k: u8| create(&path, &[k; 100_000]).is_ok().then_some(k);
            let writers: Vec<_> = (0..8).map(|k| scope.spawn(move || write(k))).collect();
            writers.into_iter().filter_map(|writer| writer.join().unwrap()).collect::<Vec<_>>()
        });
        let &[one] = written.as_slice() else { panic!("{written:?}") };
        assert_eq!(fs::read(&path).unwrap(), [one; 100_000]);
        assert_eq!(names(folder.path()), ["a.txt"]);
    }

    #[test]
    fn a_dropped_file_leaves_nothing() {
        let folder = tempfile::tempdir().unwrap();
        drop(PartialFile::create(&folder.path().join("a.txt")).unwrap());
        assert!(names(folder.path()).is_empty());
        assert!(PartialFile::create(&folder.path().join("..")).is_err());
        assert!(create(&folder.path().join("absent/a.txt"), b"").is_err());
    }
}
