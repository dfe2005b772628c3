//! Masks in files that belong to the frames of another recording, such as a bag.

use std::path::{Path, PathBuf};

use ndarray::Array2;

use crate::error::RgbdError;
use crate::pattern::{FrameName, NamedFiles, matching};
use crate::pixels;

/// Masks in files that belong to the frames of another recording.
#[derive(Debug, Clone)]
pub struct RgbdMasks {
    /// The file of each frame.
    files: Vec<Option<PathBuf>>,
    object: Option<u32>,
}

impl RgbdMasks {
    /// Finds the masks that fit a pattern below a folder, such as `masks/*.png`. They are named by the stamps of the frames, nanoseconds, or by
    /// their numbers from 0 on. `object` is the level of the object in masks that hold labels.
    ///
    /// # Errors
    /// [`RgbdError`] if no file fits the pattern, or none belongs to a frame.
    pub fn open(root: &Path, pattern: &str, object: Option<u32>, stamps_ns: &[i64]) -> Result<Self, RgbdError> {
        let named = matching(root, pattern)?;
        if named.is_empty() {
            return Err(RgbdError::fault(root, format!("no file fits the pattern {pattern:?} of the masks")));
        }
        let by_stamp = files(&named, stamps_ns.iter().map(|stamp_ns| u128::from(stamp_ns.unsigned_abs())));
        let files = match by_stamp.iter().any(Option::is_some) {
            true => by_stamp,
            false => files(&named, 0..stamps_ns.len() as u128),
        };
        if !files.iter().any(Option::is_some) {
            let first = stamps_ns.first().copied().unwrap_or(0);
            let fault = format!(
                "no mask {pattern:?} belongs to a frame: name them by the stamps of the depth images in nanoseconds (the first is {first}), or by the numbers of the frames from 0 on"
            );
            return Err(RgbdError::fault(root, fault));
        }
        Ok(Self { files, object })
    }

    /// Returns whether a frame has a mask.
    pub fn has(&self, k: usize) -> bool {
        self.files.get(k).is_some_and(Option::is_some)
    }

    /// Reads the mask of a frame in its own size; `None` without one.
    ///
    /// # Errors
    /// [`RgbdError`] if the file is damaged or holds several labels.
    pub fn mask(&self, k: usize) -> Result<Option<Array2<bool>>, RgbdError> {
        let file = self.files.get(k).and_then(Option::as_ref);
        file.map(|path| pixels::mask_as_drawn(path, self.object)).transpose()
    }
}

/// Returns whether masks are carried into the frames that have none: as stated, or else if fewer than half of `frames` have one.
pub fn are_carried(with_mask: usize, frames: usize, stated: Option<bool>) -> bool {
    with_mask < frames && stated.unwrap_or(2 * with_mask < frames)
}

/// Returns a note on frames without a mask; `None` if all have one.
pub fn masks_note(with_mask: usize, frames: usize, are_carried: bool) -> Option<String> {
    let what = match are_carried {
        true => "it is carried into the others; carry_masks = false leaves them out",
        false => "the others are not used; carry_masks = true carries masks into them",
    };
    (with_mask < frames).then(|| format!("{with_mask} of {frames} frames have a mask; {what}"))
}

/// Returns the files with these numbers.
fn files(named: &NamedFiles, numbers: impl Iterator<Item = u128>) -> Vec<Option<PathBuf>> {
    let by_number: std::collections::BTreeMap<u128, &PathBuf> =
        named.iter().filter_map(|(name, path)| Some((FrameName::number(name)?, path))).collect();
    numbers.map(|number| by_number.get(&number).map(|path| (*path).clone())).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn masks_are_named_by_stamp_or_by_number() {
        let folder = tempfile::tempdir().unwrap();
        let image = image::GrayImage::from_vec(2, 1, vec![0, 255]).unwrap();
        let put = |name: &str| image.save(folder.path().join(name)).unwrap();
        let open = |stamps_ns: &[i64]| RgbdMasks::open(folder.path(), "m*.png", None, stamps_ns);
        assert!(open(&[7]).unwrap_err().to_string().contains("no file fits"));
        put("m000001.png");
        let masks = open(&[5_000, 6_000, 7_000]).unwrap();
        assert_eq!([0, 1, 2].map(|k| masks.has(k)), [false, true, false]);
        assert_eq!(masks.mask(1).unwrap().unwrap().into_raw_vec_and_offset().0, [false, true]);
        assert!(masks.mask(0).unwrap().is_none());
        put("m7000.png");
        assert_eq!([0, 1, 2].map(|k| open(&[5_000, 6_000, 7_000]).unwrap().has(k)), [false, false, true]);
        assert!(open(&[9_000]).unwrap_err().to_string().contains("(the first is 9000)"));
    }
}
