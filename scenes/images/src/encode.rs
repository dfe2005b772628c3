//! Encoding of colours as JPEG.

use image::RgbImage;
use jpeg_encoder::{ColorType, Encoder, SamplingFactor};

/// Resolution of the colours of a JPEG image; the brightness always has all pixels.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Chroma {
    /// A colour for each pixel.
    Full,
    /// A colour for two by two pixels.
    Half,
}

/// Reason for which an image cannot be encoded.
#[derive(Debug, thiserror::Error)]
#[error("an image of {width} x {height} pixels cannot be a JPEG file: {reason}")]
pub struct EncodeError {
    width: u32,
    height: u32,
    reason: String,
}

/// Encodes an image as a JPEG file of a quality, 1 to 100, with standard Huffman tables. Tables of its own would need a scan for each colour,
/// which the decoder of `image` misreads when colours are subsampled.
///
/// # Errors
/// [`EncodeError`] if a side of the image is 0 or above 65,535 pixels.
pub fn encode_jpeg(image: &RgbImage, quality: u8, chroma: Chroma) -> Result<Vec<u8>, EncodeError> {
    let (width, height) = image.dimensions();
    let refused = |reason: String| EncodeError { width, height, reason };
    let side = |pixels: u32| u16::try_from(pixels).map_err(|_| refused("a side has at most 65,535 pixels".to_owned()));
    let mut file = Vec::with_capacity(image.len() / 8);
    let mut encoder = Encoder::new(&mut file, quality);
    encoder.set_sampling_factor(match chroma {
        Chroma::Full => SamplingFactor::F_1_1,
        Chroma::Half => SamplingFactor::F_2_2,
    });
    encoder.encode(image, side(width)?, side(height)?, ColorType::Rgb).map_err(|error| refused(error.to_string()))?;
    Ok(file)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{colours, decode};

    #[test]
    fn another_decoder_finds_the_colours_and_their_resolution() {
        // Two colours in turns from column to column: at half the resolution they become one.
        let image =
            RgbImage::from_fn(64, 32, |x, _| if x % 2 == 0 { [200, 60, 60].into() } else { [60, 60, 200].into() });
        let worst = |chroma| {
            let found = colours(decode(&encode_jpeg(&image, 98, chroma).unwrap(), Some((64, 32))).unwrap()).unwrap();
            image.iter().zip(found.iter()).map(|(a, b)| a.abs_diff(*b)).max().unwrap()
        };
        assert!(worst(Chroma::Full) < 12, "{}", worst(Chroma::Full));
        assert!(worst(Chroma::Half) > 40, "{}", worst(Chroma::Half));
    }

    #[test]
    fn sides_that_the_format_cannot_state_are_refused() {
        let error = encode_jpeg(&RgbImage::new(65_536, 1), 90, Chroma::Full).unwrap_err().to_string();
        assert_eq!(error, "an image of 65536 x 1 pixels cannot be a JPEG file: a side has at most 65,535 pixels");
        encode_jpeg(&RgbImage::new(0, 4), 90, Chroma::Full).unwrap_err();
    }
}
