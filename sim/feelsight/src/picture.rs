//! Image files of a log. Colours are JPEG. Labels and touch depth are PNG, so that they stay exact, but also have names
//! in .jpg: OpenCV recognises the format by the content.

use std::path::Path;

use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{DynamicImage, EncodableLayout, GrayImage, ImageBuffer, ImageEncoder, PixelWithColorType, RgbImage};
use mvt_images::{Chroma, DecodeError, encode_jpeg};

use crate::error::LogError;
use crate::io::read_at_most;

/// JPEG quality, 1 to 100: at 95 the error is about one grey level on a DIGIT image.
const QUALITY: u8 = 95;

/// Encodes colours as JPEG without subsampling, since the colours of a DIGIT image show slopes.
pub(super) fn encode_color(image: &RgbImage) -> Result<Vec<u8>, String> {
    encode_jpeg(image, QUALITY, Chroma::Full).map_err(|e| e.to_string())
}

/// Encodes labels or levels as PNG.
pub(super) fn encode_exact(image: &GrayImage) -> Result<Vec<u8>, String> {
    // Why: notes/decisions/simulation.md, "Labels are PNG files named .jpg".
    let mut out = Vec::with_capacity(image.len() / 8);
    // Labels are runs of few values, best without a filter.
    PngEncoder::new_with_quality(&mut out, CompressionType::Fast, FilterType::Up)
        .write_image(image, image.width(), image.height(), image::ExtendedColorType::L8)
        .map_err(|e| e.to_string())?;
    Ok(out)
}

/// Level of deflate in compact logs: the next one takes twice as long for 4 % less.
const LEVEL: CompressionType = CompressionType::Level(5);

/// Encodes colours as small JPEG of a quality, 1 to 100: colours at half the resolution.
pub(super) fn encode_small(image: &RgbImage, quality: u8) -> Result<Vec<u8>, String> {
    encode_jpeg(image, quality, Chroma::Half).map_err(|e| e.to_string())
}

/// Encodes an image as small PNG. Rows resemble those above them.
pub(super) fn encode_png<P>(image: &ImageBuffer<P, Vec<P::Subpixel>>) -> Result<Vec<u8>, String>
where
    P: PixelWithColorType,
    [P::Subpixel]: EncodableLayout,
{
    let mut out = Vec::new();
    PngEncoder::new_with_quality(&mut out, LEVEL, FilterType::Up)
        .write_image(image.as_raw().as_bytes(), image.width(), image.height(), P::COLOR_TYPE)
        .map_err(|e| e.to_string())?;
    Ok(out)
}

/// Greatest size of an image file, bytes: larger than that of any camera.
pub(super) const MAX_FILE: u64 = 64 << 20;

fn decode(bytes: &[u8], path: &Path, (width, height): (usize, usize)) -> Result<DynamicImage, LogError> {
    let side = |n| u32::try_from(n).unwrap_or(u32::MAX);
    mvt_images::decode(bytes, Some((side(width), side(height)))).map_err(image_error(path))
}

fn image_error(path: &Path) -> impl FnOnce(DecodeError) -> LogError {
    move |reason| match reason {
        DecodeError::Size { .. } => {
            let remedy = "give the image the size of its sensor, which is size_px in scene.json for touch, or w and h in data.pkl";
            LogError::defect(path, format!("{reason}; {remedy}"))
        }
        reason => LogError::Image { path: path.to_path_buf(), reason },
    }
}

/// Decodes a colour image of this width and height. A grey one becomes colours. `path` is for messages.
pub(super) fn color_of(bytes: &[u8], path: &Path, size: (usize, usize)) -> Result<RgbImage, LogError> {
    decode(bytes, path, size).map(DynamicImage::into_rgb8)
}

/// Decodes the image of a touch sensor of this width and height, which cannot be grey.
pub(super) fn touch_of(bytes: &[u8], path: &Path, size: (usize, usize)) -> Result<RgbImage, LogError> {
    mvt_images::colours(decode(bytes, path, size)?).map_err(image_error(path))
}

/// Decodes an image of 8-bit grey of this width and height.
pub(super) fn gray_of(bytes: &[u8], path: &Path, size: (usize, usize)) -> Result<GrayImage, LogError> {
    mvt_images::levels(decode(bytes, path, size)?).map_err(image_error(path))
}

/// Decodes a grey image with 16 bits of this width and height.
pub(super) fn levels16_of(bytes: &[u8], path: &Path, size: (usize, usize)) -> Result<Vec<u16>, LogError> {
    match decode(bytes, path, size)? {
        DynamicImage::ImageLuma16(image) => Ok(image.into_raw()),
        other => {
            Err(LogError::defect(path, format!("the image has {:?} pixels and not 16 bits of grey", other.color())))
        }
    }
}

/// Reads a colour image of this width and height.
pub(super) fn read_color(path: &Path, size: (usize, usize)) -> Result<RgbImage, LogError> {
    color_of(&read_at_most(path, MAX_FILE)?, path, size)
}

/// Reads an image of 8-bit grey of this width and height.
pub(super) fn read_gray(path: &Path, size: (usize, usize)) -> Result<GrayImage, LogError> {
    gray_of(&read_at_most(path, MAX_FILE)?, path, size)
}
