//! Lines to standard output, and files that appear whole.

use std::io::{Cursor, ErrorKind};
use std::path::Path;

use anyhow::{Context as _, Result, bail};
use image::{DynamicImage, ImageBuffer, ImageFormat, PixelWithColorType, RgbImage};
use mvt_files::{input, output};

/// Largest image that is read, bytes.
const LARGEST_IMAGE: u64 = 256 << 20;

/// Writes a result to standard output; a reader that has gone away is an error, not a panic.
pub fn print_line(text: &str) -> Result<()> {
    use std::io::Write as _;
    writeln!(std::io::stdout(), "{text}").context("cannot write to standard output")
}

/// Returns a word as a shell needs it, such as the name of a folder in a command that the user may copy.
pub fn shell_word(word: &str) -> String {
    let is_plain = |c: char| c.is_ascii_alphanumeric() || "_-./,=:".contains(c);
    if !word.is_empty() && word.chars().all(is_plain) {
        word.to_owned()
    } else {
        format!("'{}'", word.replace('\'', r"'\''"))
    }
}

/// Puts a file in its place, whole: an earlier one of that name is there until the new one is.
pub fn write_file(folder: &Path, name: &str, bytes: &[u8]) -> Result<()> {
    let path = folder.join(name);
    output::replace(&path, bytes).with_context(|| format!("cannot write {}", path.display()))
}

/// Writes a file whose path a person gave. An existing file is replaced only with `overwrite`.
///
/// # Errors
/// If there is a file of that name, or it cannot be written.
pub fn write_named(path: &Path, bytes: &[u8], overwrite: bool) -> Result<()> {
    let written = if overwrite { output::replace(path, bytes) } else { output::create(path, bytes) };
    match written {
        Err(error) if error.kind() == ErrorKind::AlreadyExists => bail!(already_exists(path)),
        written => written.with_context(|| format!("cannot write {}", path.display())),
    }
}

/// Returns an error if a file whose path a person gave exists and `overwrite` is false. For commands that work long before they write.
///
/// # Errors
/// If there is a file of that name.
pub fn check_named(path: &Path, overwrite: bool) -> Result<()> {
    if !overwrite && output::refuse_existing(path).is_err() {
        bail!(already_exists(path));
    }
    Ok(())
}

fn already_exists(path: &Path) -> String {
    format!("{} already exists; choose another name or give --overwrite", path.display())
}

/// Encodes a picture as PNG.
///
/// # Errors
/// Those of the encoder.
pub fn png<P>(picture: &ImageBuffer<P, Vec<u8>>) -> Result<Vec<u8>>
where
    P: PixelWithColorType<Subpixel = u8>,
{
    let mut bytes = Cursor::new(Vec::new());
    picture.write_to(&mut bytes, ImageFormat::Png)?;
    Ok(bytes.into_inner())
}

/// Reads an image as RGB.
///
/// # Errors
/// If the file cannot be read or is not an image.
pub fn read_image(path: &Path) -> Result<RgbImage> {
    Ok(read_any_image(path)?.into_rgb8())
}

/// Reads a PNG or JPEG image with the pixels of its file.
///
/// # Errors
/// If the file cannot be read, or is not an image, or part of it is lost.
pub fn read_any_image(path: &Path) -> Result<DynamicImage> {
    let bytes = input::read(path, LARGEST_IMAGE).with_context(|| format!("cannot read {}", path.display()))?;
    mvt_images::decode(&bytes, None).with_context(|| format!("{} is not a readable image", path.display()))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A file of some bytes could take memory for all the pixels that it promised.
    #[test]
    fn a_picture_of_countless_pixels_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("large.png");
        let side = 12_000_u32.to_be_bytes();
        let mut bytes = b"\x89PNG\r\n\x1a\n".to_vec();
        for (name, data) in [(b"IHDR", [&side[..], &side, &[8, 2, 0, 0, 0]].concat()), (b"IDAT", vec![])] {
            let chunk = [name.as_slice(), &data].concat();
            bytes.extend((data.len() as u32).to_be_bytes());
            bytes.extend(&chunk);
            bytes.extend(crc32fast::hash(&chunk).to_be_bytes());
        }
        std::fs::write(&path, bytes).unwrap();
        let said = format!("{:#}", read_image(&path).unwrap_err());
        assert!(said.contains("large.png is not a readable image: the image has 12000 x 12000 pixels"), "{said}");
    }
}
