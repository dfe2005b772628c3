//! Lines to standard output, and files that appear whole.

use std::fs;
use std::path::Path;

use anyhow::{Context as _, Result};
use image::RgbImage;

/// Writes a result to standard output; a reader that has gone away is an error, not a panic.
pub fn print_line(text: &str) -> Result<()> {
    use std::io::Write as _;
    writeln!(std::io::stdout(), "{text}")?;
    Ok(())
}

/// Puts a file in its place, whole: an earlier one of that name is there until the new one is.
pub fn write_file(folder: &Path, name: &str, bytes: &[u8]) -> Result<()> {
    let partial = folder.join(format!(".{name}.partial"));
    let path = folder.join(name);
    fs::write(&partial, bytes)
        .and_then(|()| fs::rename(&partial, &path))
        .with_context(|| format!("cannot write {}", path.display()))
}

/// Reads an image as RGB.
///
/// # Errors
/// If the file cannot be read or is not an image.
pub fn read_image(path: &Path) -> Result<RgbImage> {
    let bytes = fs::read(path).with_context(|| format!("cannot read {}", path.display()))?;
    let image =
        image::load_from_memory(&bytes).with_context(|| format!("{} is not a readable image", path.display()))?;
    Ok(image.to_rgb8())
}
