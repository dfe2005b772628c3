//! Reading of files that people name.

use std::ffi::OsStr;
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

/// Returns whether a name in a folder is that of a file which a desktop leaves there, and not a person: the forks `._NAME` and `.DS_Store`
/// of macOS, `Thumbs.db` and `desktop.ini` of Windows.
pub fn is_litter(name: &OsStr) -> bool {
    let name = name.to_string_lossy();
    name.starts_with("._")
        || [".DS_Store", "Thumbs.db", "desktop.ini"].iter().any(|litter| name.eq_ignore_ascii_case(litter))
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

/// Returns the text of a regular file of at most `limit` bytes, without a byte order mark. Programs of Windows write UTF-16 with such a mark.
///
/// # Errors
/// As [`read`], and [`io::ErrorKind::InvalidData`] if it is neither UTF-8 nor UTF-16 with a byte order mark.
pub fn read_text(path: &Path, limit: u64) -> io::Result<String> {
    let bytes = read(path, limit)?;
    let utf_16 = |of: fn([u8; 2]) -> u16| {
        let (pairs, rest) = bytes[2..].as_chunks::<2>();
        let text = String::from_utf16(&pairs.iter().map(|pair| of(*pair)).collect::<Vec<_>>()).ok();
        text.filter(|_| rest.is_empty())
    };
    let text = match bytes.as_slice() {
        [0xff, 0xfe, ..] => utf_16(u16::from_le_bytes),
        [0xfe, 0xff, ..] => utf_16(u16::from_be_bytes),
        [0xef, 0xbb, 0xbf, rest @ ..] => String::from_utf8(rest.to_vec()).ok(),
        _ => String::from_utf8(bytes).ok(),
    };
    text.ok_or_else(|| io::Error::new(io::ErrorKind::InvalidData, "it is not text in UTF-8"))
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
    fn text_with_a_byte_order_mark_is_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.csv");
        let pairs = |of: fn(u16) -> [u8; 2]| "\u{feff}x,é\n".encode_utf16().flat_map(of).collect::<Vec<_>>();
        for bytes in [pairs(u16::to_le_bytes), pairs(u16::to_be_bytes), "\u{feff}x,é\n".into(), "x,é\n".into()] {
            std::fs::write(&path, bytes).unwrap();
            assert_eq!(read_text(&path, 100).unwrap(), "x,é\n");
        }
    }

    #[test]
    fn litter_of_desktops_is_known() {
        for (name, is) in
            [("._a.png", true), (".DS_Store", true), ("thumbs.db", true), ("a.png", false), (".hidden", false)]
        {
            assert_eq!(is_litter(OsStr::new(name)), is, "{name}");
        }
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
