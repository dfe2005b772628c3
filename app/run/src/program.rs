//! The file of this program, for commands that start another process of it.

use std::io;
use std::path::PathBuf;
use std::sync::OnceLock;

static PROGRAM: OnceLock<PathBuf> = OnceLock::new();

/// Names the file that starts this program, where it is not that of the process: Python's interpreter runs the program of the Python package.
pub fn set(program: PathBuf) {
    // The first name holds: a process runs one command.
    let _ = PROGRAM.set(program);
}

/// Returns the file that starts this program.
///
/// # Errors
/// If none was named and the system does not know the file of the process.
pub fn path() -> io::Result<PathBuf> {
    PROGRAM.get().cloned().map_or_else(std::env::current_exe, Ok)
}
