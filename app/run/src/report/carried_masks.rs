//! Masks that a run carried into frames without one.

use std::fmt::Write as _;
use std::fs;
use std::io::Cursor;
use std::path::Path;

use anyhow::{Context as _, Result};
use image::{GrayImage, ImageFormat, Luma};
use mvt_segmentation::CarriedMask;

use crate::io::write_file;

/// Folder of the masks.
const FOLDER: &str = "masks";
/// Table of how sure each is.
const TABLE: &str = "carried.csv";

/// Masks that a run carried, in files that a later run reads as given ones.
#[derive(Debug, Default)]
pub struct CarriedMasks {
    table: String,
}

impl CarriedMasks {
    /// Writes the mask of a frame as `masks/NAME.png`, 255 where the object is. A frame in which the object was not found has no image.
    ///
    /// # Errors
    /// If a file cannot be written.
    pub fn write(&mut self, out: &Path, name: &str, carried: &CarriedMask) -> Result<()> {
        let folder = out.join(FOLDER);
        fs::create_dir_all(&folder).with_context(|| format!("cannot make {}", folder.display()))?;
        if self.table.is_empty() {
            self.table.push_str("frame,pixels,sure\n");
        }
        let mask = &carried.mask;
        let count = mask.iter().filter(|inside| **inside).count();
        let _ = writeln!(self.table, "{name},{count},{:.3}", carried.sure);
        let file = format!("{name}.png");
        if count == 0 {
            // That of an earlier run.
            let stale = folder.join(file);
            return match stale.is_file() {
                true => fs::remove_file(&stale).with_context(|| format!("cannot remove {}", stale.display())),
                false => Ok(()),
            };
        }
        let (rows, columns) = mask.dim();
        let image = GrayImage::from_fn(columns as u32, rows as u32, |u, v| {
            Luma([if mask[(v as usize, u as usize)] { 255 } else { 0 }])
        });
        let mut bytes = Cursor::new(Vec::new());
        image.write_to(&mut bytes, ImageFormat::Png).with_context(|| format!("{file}: cannot be encoded"))?;
        write_file(&folder, &file, bytes.get_ref())
    }

    /// Writes `masks/carried.csv`: how sure each mask is. Nothing is written if none was carried.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn finish(&self, out: &Path) -> Result<()> {
        match self.table.as_str() {
            "" => Ok(()),
            table => write_file(&out.join(FOLDER), TABLE, table.as_bytes()),
        }
    }
}

#[cfg(test)]
mod tests {
    use ndarray::array;

    use super::*;

    #[test]
    fn masks_are_written_and_those_of_an_earlier_run_are_removed() {
        let out = tempfile::tempdir().unwrap();
        let mut masks = CarriedMasks::default();
        let found = CarriedMask { mask: array![[true, false], [true, true]], sure: 0.75, ..CarriedMask::default() };
        masks.write(out.path(), "000007", &found).unwrap();
        let image = image::open(out.path().join("masks/000007.png")).unwrap().into_luma8();
        assert_eq!(image.into_raw(), [255, 0, 255, 255]);
        masks.write(out.path(), "000007", &CarriedMask::default()).unwrap();
        assert!(!out.path().join("masks/000007.png").exists());
        masks.finish(out.path()).unwrap();
        let table = fs::read_to_string(out.path().join("masks/carried.csv")).unwrap();
        assert_eq!(table, "frame,pixels,sure\n000007,3,0.750\n000007,0,0.000\n");
    }
}
