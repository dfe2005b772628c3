//! Reading of files that people name.

use std::fs::{File, OpenOptions};
use std::io::{self, Read, Seek as _};
use std::path::Path;

/// First bytes of the file that git-lfs puts in the place of one that was not downloaded.
const LFS_POINTER: &[u8] = b"version https://git-lfs.github.com/spec/v1";

/// Opens a regular file for reading. A FIFO, a device, a socket or a folder is an error, and the call never waits for a writer.
///
/// # Errors
/// Those of the operating system, [`io::ErrorKind::InvalidInput`] if the path is not a regular file, and [`io::ErrorKind::InvalidData`]
/// if it is a pointer of git-lfs.
pub fn open(path: &Path) -> io::Result<File> {
    let mut options = OpenOptions::new();
    options.read(true);
    // Without it the call would wait until somebody writes into a FIFO. It has no effect on regular files.
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::custom_flags(&mut options, libc::O_NONBLOCK);
    let mut file = options.open(path)?;
    let kind = file.metadata()?;
    if kind.is_dir() {
        return Err(io::Error::new(io::ErrorKind::InvalidInput, "it is a folder, not a file"));
    }
    if !kind.is_file() {
        return Err(io::Error::new(io::ErrorKind::InvalidInput, "it is not a regular file"));
    }
    let mut first = Vec::new();
    (&file).take(LFS_POINTER.len() as u64).read_to_end(&mut first)?;
    if first == LFS_POINTER {
        return Err(io::Error::new(io::ErrorKind::InvalidData, "it is a git-lfs pointer; run `git lfs pull`"));
    }
    file.rewind()?;
    Ok(file)
}

/// Returns the bytes of a regular file of at most `limit` bytes. Needs memory in proportion to the file, not to the limit.
///
/// # Errors
/// As [`open`], and [`io::ErrorKind::FileTooLarge`] if the file is larger.
pub fn read(path: &Path, limit: u64) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    open(path)?.take(limit.saturating_add(1)).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > limit {
        return Err(io::Error::new(io::ErrorKind::FileTooLarge, format!("it is larger than {}", size(limit))));
    }
    Ok(bytes)
}

/// Returns the text of a regular file of at most `limit` bytes.
///
/// # Errors
/// As [`read`], and [`io::ErrorKind::InvalidData`] if it is not UTF-8.
pub fn read_text(path: &Path, limit: u64) -> io::Result<String> {
    String::from_utf8(read(path, limit)?)
        .map_err(|_| io::Error::new(io::ErrorKind::InvalidData, "it is not text in UTF-8"))
}

/// Returns a number of bytes in words.
fn size(bytes: u64) -> String {
    match bytes {
        0..1024 => format!("{bytes} bytes"),
        1024..0x10_0000 => format!("{} KiB", bytes >> 10),
        _ => format!("{} MiB", bytes >> 20),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_is_read_up_to_the_limit() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a");
        std::fs::write(&path, "twelve bytes").unwrap();
        assert_eq!(read_text(&path, 12).unwrap(), "twelve bytes");
        assert_eq!(read(&path, 11).unwrap_err().to_string(), "it is larger than 11 bytes");
        assert_eq!(open(folder.path()).unwrap_err().to_string(), "it is a folder, not a file");
        std::fs::write(&path, [0xff]).unwrap();
        assert_eq!(read_text(&path, 12).unwrap_err().kind(), io::ErrorKind::InvalidData);
        assert_eq!(read(&folder.path().join("b"), 1).unwrap_err().kind(), io::ErrorKind::NotFound);
    }

    #[test]
    fn a_git_lfs_pointer_is_an_error_and_other_files_are_read_from_their_start() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.mcap");
        std::fs::write(&path, [LFS_POINTER, b"\noid sha256:2f\nsize 12345\n"].concat()).unwrap();
        for error in [open(&path).map(|_| ()), read(&path, 10).map(|_| ()), read_text(&path, 1000).map(|_| ())] {
            assert_eq!(error.unwrap_err().to_string(), "it is a git-lfs pointer; run `git lfs pull`");
        }
        std::fs::write(&path, [&LFS_POINTER[..40], b" is a longer text"].concat()).unwrap();
        assert_eq!(read(&path, 100).unwrap().len(), 57);
    }

    #[cfg(unix)]
    #[test]
    fn a_fifo_and_a_device_are_refused_at_once() {
        use std::ffi::CString;
        use std::os::unix::ffi::OsStrExt as _;

        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("fifo");
        let name = CString::new(path.as_os_str().as_bytes()).unwrap();
        // SAFETY: the name is a string that ends with a zero and lives during the call.
        assert_eq!(unsafe { libc::mkfifo(name.as_ptr(), 0o600) }, 0);
        for path in [&path, Path::new("/dev/zero")] {
            assert_eq!(open(path).unwrap_err().to_string(), "it is not a regular file");
        }
    }
}
