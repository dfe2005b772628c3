//! Images of a log. Colours are JPEG; labels and touch depth are PNG under the same .jpg names, which OpenCV reads by content, so
//! that masks, levels and depths stay exact.

use std::io::Cursor;
use std::path::Path;

use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{GrayImage, ImageEncoder, ImageReader, Limits, RgbImage};

use super::Error;

/// Quality at which JPEG's error is about one grey on a DIGIT image.
const QUALITY: u8 = 95;

/// Encodes colours as JPEG without subsampling: a DIGIT image tells slopes by its colours.
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

fn decode(path: &Path, size: (usize, usize)) -> Result<image::DynamicImage, Error> {
    let bytes = std::fs::read(path).map_err(Error::io(path))?;
    let image_error = |source| Error::Image { path: path.to_path_buf(), source };
    let mut reader = ImageReader::new(Cursor::new(bytes)).with_guessed_format().map_err(Error::io(path))?;
    let mut limits = Limits::default();
    // A header that claims other than what the log does is not worth its memory.
    limits.max_image_width = Some(4096);
    limits.max_image_height = Some(4096);
    limits.max_alloc = Some(256 << 20);
    reader.limits(limits);
    let image = reader.decode().map_err(image_error)?;
    let (width, height) = (image.width() as usize, image.height() as usize);
    if (width, height) != size {
        let defect = format!("the image is {width} x {height} and not {} x {}", size.0, size.1);
        return Err(Error::defect(path, defect));
    }
    Ok(image)
}

/// Reads a colour image, whatever its format, of this width and height.
pub(super) fn read_color(path: &Path, size: (usize, usize)) -> Result<RgbImage, Error> {
    decode(path, size).map(image::DynamicImage::into_rgb8)
}

/// Reads a grey image, whatever its format, of this width and height.
pub(super) fn read_gray(path: &Path, size: (usize, usize)) -> Result<GrayImage, Error> {
    decode(path, size).map(image::DynamicImage::into_luma8)
}
