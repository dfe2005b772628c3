//! Sizes of images that a network can work with.

/// Longest side of an image, pixels.
const LARGEST: u32 = 2048;

/// Image whose size is out of range.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
#[error("the touch image is {width} x {height} pixels; its sides must be 1 to {LARGEST}, 240 x 320 is a DIGIT's size")]
pub struct ImageSizeError {
    /// Width, pixels.
    pub width: u32,
    /// Height, pixels.
    pub height: u32,
}

impl ImageSizeError {
    /// Checks that both sides are in range.
    pub(crate) fn check(width: usize, height: usize) -> Result<(), Self> {
        let side = |pixels: usize| u32::try_from(pixels).unwrap_or(u32::MAX);
        let (width, height) = (side(width), side(height));
        let is_possible = [width, height].iter().all(|side| (1..=LARGEST).contains(side));
        if is_possible { Ok(()) } else { Err(Self { width, height }) }
    }
}
