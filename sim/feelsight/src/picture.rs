//! Image files of a log. Colours are JPEG. Labels and touch depth are PNG, so that they stay exact, but also have names
//! in .jpg: OpenCV recognises the format by the content.

use std::io::Cursor;
use std::path::Path;

use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{DynamicImage, GrayImage, ImageDecoder, ImageEncoder, ImageReader, RgbImage};

use crate::error::LogError;
use crate::io::read_at_most;

/// JPEG quality, 1 to 100: at 95 the error is about one grey level on a DIGIT image.
const QUALITY: u8 = 95;

/// Encodes colours as JPEG without subsampling, since the colours of a DIGIT image show slopes.
pub(super) fn encode_color(image: &RgbImage) -> Result<Vec<u8>, String> {
    let size = |n| u16::try_from(n).map_err(|_| format!("an image of {} x {}", image.width(), image.height()));
    let mut out = Vec::with_capacity(image.len() / 4);
    let mut encoder = jpeg_encoder::Encoder::new(&mut out, QUALITY);
    encoder.set_sampling_factor(jpeg_encoder::SamplingFactor::F_1_1);
    encoder
        .encode(image, size(image.width())?, size(image.height())?, jpeg_encoder::ColorType::Rgb)
        .map_err(|e| e.to_string())?;
    Ok(out)
}

/// Encodes labels or levels as PNG.
pub(super) fn encode_exact(image: &GrayImage) -> Result<Vec<u8>, String> {
    let mut out = Vec::with_capacity(image.len() / 8);
    // Labels are runs of few values, best without a filter.
    PngEncoder::new_with_quality(&mut out, CompressionType::Fast, FilterType::Up)
        .write_image(image, image.width(), image.height(), image::ExtendedColorType::L8)
        .map_err(|e| e.to_string())?;
    Ok(out)
}

/// Greatest size of an image file, bytes: larger than that of any camera.
pub(super) const MAX_FILE: u64 = 64 << 20;

fn decode(path: &Path, size: (usize, usize)) -> Result<DynamicImage, LogError> {
    let bytes = read_at_most(path, MAX_FILE)?;
    let image_error = |reason| LogError::Image { path: path.to_path_buf(), reason };
    let reader = ImageReader::new(Cursor::new(bytes)).with_guessed_format().map_err(LogError::io(path))?;
    let decoder = reader.into_decoder().map_err(image_error)?;
    // Checked before memory of that size is allocated.
    let (width, height) = decoder.dimensions();
    if (width as usize, height as usize) != size {
        let defect = format!("the image is {width} x {height} and not {} x {}", size.0, size.1);
        return Err(LogError::defect(path, defect));
    }
    DynamicImage::from_decoder(decoder).map_err(image_error)
}

/// Reads a colour image, whatever its format, of this width and height.
pub(super) fn read_color(path: &Path, size: (usize, usize)) -> Result<RgbImage, LogError> {
    decode(path, size).map(DynamicImage::into_rgb8)
}

/// Reads a grey image, whatever its format, of this width and height.
pub(super) fn read_gray(path: &Path, size: (usize, usize)) -> Result<GrayImage, LogError> {
    decode(path, size).map(DynamicImage::into_luma8)
}
