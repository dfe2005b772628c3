//! Files that appear whole, folders that one process writes, and reading that never blocks.
//!
//! - [`input`] opens regular files alone: a FIFO or a device is refused and never waited for.
//! - [`output`] writes a file beside its place and renames it: a file with the final name is complete.
//! - [`folder`] claims a folder for one process: nothing that another process or a person wrote is replaced.
//! - [`cells`] splits and quotes the cells of tables.
//! - [`seal`] puts a checksum into safetensors files.
//!
//! ```
//! use mvt_files::folder::{ClaimedFolder, Earlier};
//! use mvt_files::{input, output};
//!
//! # let home = tempfile::tempdir()?;
//! let out = home.path().join("out");
//! let claimed = ClaimedFolder::claim(&out, "example", Earlier::Move, false)?;
//! output::create(&out.join("words.txt"), b"some words")?;
//! assert_eq!(input::read_text(&out.join("words.txt"), 1 << 20)?, "some words");
//! drop(claimed);
//!
//! // The next one moves what the first one left to another name.
//! let claimed = ClaimedFolder::claim(&out, "example", Earlier::Move, false)?;
//! assert_eq!(claimed.moved(), Some(&*home.path().join("out.1")));
//! assert!(home.path().join("out.1/words.txt").exists());
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

pub mod cells;
pub mod folder;
pub mod input;
pub mod output;
pub mod seal;
