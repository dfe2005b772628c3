//! Decoding of PNG and JPEG images of sensors, which refuses damaged files; encoding of both.
//!
//! [`decode`] is the one way by which images of touch, colours, labels and depth become pixels. Decoders of JPEG fill the lost part of a cut
//! file with grey and report no error; here a file of which any pixel is lost is an error. [`colours`] and [`levels`] then refuse pixels of
//! another kind instead of converting them.
//!
//! ```
//! use mvt_images::image::{ImageFormat, RgbImage};
//! use mvt_images::{DecodeError, colours, decode};
//!
//! let image = RgbImage::from_fn(48, 32, |x, y| [5 * x as u8, 7 * y as u8, 40].into());
//! let mut file = std::io::Cursor::new(Vec::new());
//! image.write_to(&mut file, ImageFormat::Jpeg)?;
//! let file = file.into_inner();
//!
//! assert_eq!(colours(decode(&file, Some((48, 32)))?)?.dimensions(), (48, 32));
//! assert!(matches!(decode(&file[..file.len() - 9], None), Err(DecodeError::Damaged(_))));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod encode;
mod jpeg;

use std::io::Cursor;

pub use encode::{Chroma, EncodeError, encode_jpeg};
pub use image;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{
    DynamicImage, ExtendedColorType, GrayImage, ImageDecoder as _, ImageEncoder as _, ImageFormat, ImageReader,
    RgbImage,
};

/// Greatest number of bytes that the pixels of an image take: a file of some kilobytes may promise more.
const MOST_MEMORY: u64 = 64 << 20;
/// Greatest difference between the three colours of a grey pixel, levels: JPEG rounds colours.
const GREY_TOLERANCE: u8 = 8;

/// Encodes pixels without loss as a PNG file, fast rather than small: images of a run that goes on. Pixels of 16 bits have the order of bytes
/// of this machine.
///
/// # Errors
/// If there are more or fewer pixels than the size says.
pub fn fast_png(pixels: &[u8], [width, height]: [u32; 2], of: ExtendedColorType) -> Result<Vec<u8>, image::ImageError> {
    // The encoder panics on another number of pixels.
    if pixels.len() as u64 != u64::from(width) * u64::from(height) * u64::from(of.bits_per_pixel()) / 8 {
        let kind = image::error::ParameterErrorKind::DimensionMismatch;
        return Err(image::ImageError::Parameter(image::error::ParameterError::from_kind(kind)));
    }
    let mut file = Vec::with_capacity(pixels.len() / 2);
    let encoder = PngEncoder::new_with_quality(&mut file, CompressionType::Fast, FilterType::Up);
    encoder.write_image(pixels, width, height, of)?;
    Ok(file)
}

/// Reason for which an image is refused.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum DecodeError {
    /// The file starts as neither format does.
    #[error("it is neither a PNG nor a JPEG image")]
    Format,
    /// The image has another size than the sensor.
    #[error("the image is {} x {} and not {} x {}", found.0, found.1, expected.0, expected.1)]
    Size {
        /// Width and height of the image.
        found: (u32, u32),
        /// Width and height of the sensor's images.
        expected: (u32, u32),
    },
    /// The image has more pixels than that of any camera.
    #[error("the image has {0} x {1} pixels, more than any camera's")]
    TooLarge(u32, u32),
    /// Part of a JPEG file is lost.
    #[error("the JPEG file is cut or damaged: {0}; copy it again")]
    Damaged(&'static str),
    /// The decoder refuses the file.
    #[error("the image is damaged or of an unknown kind ({0}); copy it again")]
    Refused(String),
    /// The image is grey where colours are needed.
    #[error("it is a grey image; give the sensor's image in colours")]
    Grey,
    /// The image has colours where levels are needed.
    #[error("it is an image in colours; give one of 8-bit grey levels")]
    Coloured,
    /// The image has 16 bits where 8 are needed.
    #[error("it is an image of 16 bits; give one of 8-bit grey levels")]
    Deep,
}

impl From<image::ImageError> for DecodeError {
    /// Takes the words of a decoder, in one line.
    fn from(error: image::ImageError) -> Self {
        Self::Refused(error.to_string().split_whitespace().collect::<Vec<_>>().join(" "))
    }
}

/// Decodes a PNG or JPEG file, of this width and height where they are given. The pixels are of the file's own kind. Bytes after the
/// image's end are allowed.
///
/// # Errors
/// If the file is cut or damaged, or of another format or size, or has more pixels than any camera.
pub fn decode(file: &[u8], expected: Option<(u32, u32)>) -> Result<DynamicImage, DecodeError> {
    let format = format_of(file)?;
    let mut reader = ImageReader::with_format(Cursor::new(file), format);
    let mut limits = image::Limits::default();
    limits.max_alloc = Some(MOST_MEMORY);
    reader.limits(limits);
    let decoder = reader.into_decoder()?;
    // Checked before memory of that size is allocated.
    let found = decoder.dimensions();
    if let Some(expected) = expected.filter(|expected| *expected != found) {
        return Err(DecodeError::Size { found, expected });
    }
    if decoder.total_bytes() > MOST_MEMORY {
        return Err(DecodeError::TooLarge(found.0, found.1));
    }
    if format == ImageFormat::Jpeg {
        jpeg::check(file).map_err(DecodeError::Damaged)?;
    }
    Ok(DynamicImage::from_decoder(decoder)?)
}

/// Returns width and height of a PNG or JPEG file.
///
/// # Errors
/// If the file is of another format, or its head is damaged.
pub fn dimensions(file: &[u8]) -> Result<(u32, u32), DecodeError> {
    Ok(ImageReader::with_format(Cursor::new(file), format_of(file)?).into_dimensions()?)
}

fn format_of(file: &[u8]) -> Result<ImageFormat, DecodeError> {
    match file {
        [0x89, b'P', b'N', b'G', ..] => Ok(ImageFormat::Png),
        [0xff, 0xd8, ..] => Ok(ImageFormat::Jpeg),
        _ => Err(DecodeError::Format),
    }
}

/// Returns the pixels of a colour image.
///
/// # Errors
/// If it is grey, whatever the kind of its pixels: it has several levels, and each pixel is grey.
pub fn colours(image: DynamicImage) -> Result<RgbImage, DecodeError> {
    if !image.color().has_color() {
        return Err(DecodeError::Grey);
    }
    let image = image.into_rgb8();
    let is_grey = image.pixels().all(|pixel| pixel.0[0] == pixel.0[1] && pixel.0[1] == pixel.0[2]);
    let is_uniform = image.pixels().zip(image.pixels().skip(1)).all(|(a, b)| a == b);
    if is_grey && !is_uniform { Err(DecodeError::Grey) } else { Ok(image) }
}

/// Returns the levels of an image of 8-bit grey. Three equal colours are a grey.
///
/// # Errors
/// If it has colours, or 16 bits.
pub fn levels(image: DynamicImage) -> Result<GrayImage, DecodeError> {
    match image {
        DynamicImage::ImageLuma16(_) | DynamicImage::ImageLumaA16(_) => Err(DecodeError::Deep),
        image if image.color().has_color() => {
            let colours = image.to_rgb8();
            let spread = |[r, g, b]: [u8; 3]| r.max(g).max(b) - r.min(g).min(b);
            if colours.pixels().any(|pixel| spread(pixel.0) > GREY_TOLERANCE) {
                return Err(DecodeError::Coloured);
            }
            Ok(image.into_luma8())
        }
        image => Ok(image.into_luma8()),
    }
}

#[cfg(test)]
mod tests {
    use image::{ImageBuffer, Luma, Rgb};
    use jpeg_encoder::{ColorType, Encoder, SamplingFactor};

    use super::*;

    /// An image of smooth slopes and a disc, as a press on a gel.
    fn press(width: u32, height: u32) -> RgbImage {
        RgbImage::from_fn(width, height, |x, y| {
            let inside = (x as i32 - 30).pow(2) + (y as i32 - 25).pow(2) < 220;
            let [r, g, b] = [x * 3 % 256, y * 5 % 256, (x * y / 7) % 256];
            Rgb(if inside { [b as u8, r as u8, g as u8] } else { [r as u8, g as u8, b as u8] })
        })
    }

    fn jpeg(image: &RgbImage, set: impl FnOnce(&mut Encoder<&mut Vec<u8>>)) -> Vec<u8> {
        let mut file = Vec::new();
        let mut encoder = Encoder::new(&mut file, 90);
        set(&mut encoder);
        encoder.encode(image, image.width() as u16, image.height() as u16, ColorType::Rgb).unwrap();
        file
    }

    /// Files of all kinds that cameras and programs write.
    fn kinds() -> Vec<(&'static str, Vec<u8>)> {
        let image = press(75, 61);
        let mut kinds = vec![
            ("plain", jpeg(&image, |_| ())),
            ("subsampled", jpeg(&image, |e| e.set_sampling_factor(SamplingFactor::F_2_2))),
            ("subsampled across", jpeg(&image, |e| e.set_sampling_factor(SamplingFactor::F_2_1))),
            ("own tables", jpeg(&image, |e| e.set_optimized_huffman_tables(true))),
            ("restarts", jpeg(&image, |e| e.set_restart_interval(3))),
            ("progressive", jpeg(&image, |e| e.set_progressive(true))),
            ("progressive with restarts", {
                jpeg(&image, |e| {
                    e.set_progressive(true);
                    e.set_sampling_factor(SamplingFactor::F_2_2);
                    e.set_restart_interval(2);
                })
            }),
        ];
        let mut grey = Vec::new();
        Encoder::new(&mut grey, 80)
            .encode(&DynamicImage::ImageRgb8(image).into_luma8(), 75, 61, ColorType::Luma)
            .unwrap();
        kinds.push(("grey", grey));
        kinds
    }

    #[test]
    fn whole_files_are_decoded_and_padding_after_the_end_is_allowed() {
        for (name, mut file) in kinds() {
            let image = decode(&file, Some((75, 61))).unwrap_or_else(|error| panic!("{name}: {error}"));
            assert_eq!(image, image::load_from_memory(&file).unwrap(), "{name}");
            file.extend([0, 0, 17, 0xff, 0xd8]);
            assert_eq!(decode(&file, None).unwrap(), image, "{name}");
        }
    }

    #[test]
    fn a_cut_jpeg_is_an_error_wherever_it_is_cut() {
        for (name, file) in kinds() {
            for length in 0..file.len() {
                let said = decode(&file[..length], None).unwrap_err().to_string();
                assert!(!said.contains('\n'), "{name} cut to {length} of {}: {said}", file.len());
                // A recorder may close a file of which a part is lost.
                let closed = [&file[..length], &[0xff, 0xd9]].concat();
                // The last byte of the codes may consist of filling bits alone.
                if length < file.len() - 3 {
                    assert!(decode(&closed, None).is_err(), "{name} cut to {length} and closed");
                }
            }
        }
    }

    #[test]
    fn a_byte_0xff_too_many_is_an_error_and_a_lost_part_mostly() {
        for (name, file) in kinds() {
            let scan = file.windows(2).position(|pair| pair == [0xff, 0xda]).unwrap() + 14;
            let (mut tries, mut missed) = (0, 0);
            let lost = file.len() / 8;
            for at in (scan..file.len() - lost - 2).step_by(7) {
                let inserted = [&file[..at], &[0xff], &file[at..]].concat();
                // A byte 0xff may precede a marker, and is itself written as 0xff 0.
                if file[at] != 0 && file[at] != 0xff && file[at - 1] != 0xff {
                    assert!(decode(&inserted, None).is_err(), "{name}: 0xff inserted at {at}");
                }
                tries += 1;
                missed += usize::from(decode(&[&file[..at], &file[at + lost..]].concat(), None).is_ok());
            }
            // Codes may come back into step, by chance with as many blocks as before.
            assert!(10 * missed <= tries, "{name}: {missed} of {tries} damaged files are read");
        }
    }

    #[test]
    fn a_cut_or_changed_png_is_an_error() {
        let mut file = Cursor::new(Vec::new());
        press(75, 61).write_to(&mut file, ImageFormat::Png).unwrap();
        let file = file.into_inner();
        let whole = decode(&file, None).unwrap();
        // The last 12 bytes are a mark of the end without content.
        for length in 0..file.len() - 12 {
            assert!(decode(&file[..length], None).is_err(), "cut to {length} of {}", file.len());
        }
        for at in (50..file.len() - 12).step_by(11) {
            let mut changed = file.clone();
            changed[at] ^= 0x10;
            assert!(decode(&changed, None).map_or(true, |image| image == whole), "changed at {at}");
        }
    }

    #[test]
    fn pixels_of_another_kind_are_not_converted() {
        let sixteen = ImageBuffer::<Luma<u16>, _>::from_fn(9, 7, |x, _| Luma([x as u16 * 300]));
        let grey = GrayImage::from_fn(9, 7, |x, _| Luma([x as u8 * 20]));
        let grey_colours = DynamicImage::ImageLuma8(grey.clone()).into_rgb8();
        assert!(matches!(levels(DynamicImage::ImageLuma16(sixteen.clone())), Err(DecodeError::Deep)));
        assert!(matches!(colours(DynamicImage::ImageLuma16(sixteen)), Err(DecodeError::Grey)));
        assert!(matches!(colours(DynamicImage::ImageLuma8(grey.clone())), Err(DecodeError::Grey)));
        assert!(matches!(colours(DynamicImage::ImageRgb8(grey_colours.clone())), Err(DecodeError::Grey)));
        assert_eq!(levels(DynamicImage::ImageRgb8(grey_colours)).unwrap(), grey);
        assert!(matches!(levels(DynamicImage::ImageRgb8(press(9, 7))), Err(DecodeError::Coloured)));
        assert_eq!(colours(DynamicImage::ImageRgb8(press(9, 7))).unwrap(), press(9, 7));
    }

    #[test]
    fn other_sizes_and_formats_are_refused_before_pixels_are_read() {
        let file = jpeg(&press(75, 61), |_| ());
        let said = decode(&file, Some((61, 75))).unwrap_err().to_string();
        assert_eq!(said, "the image is 75 x 61 and not 61 x 75");
        assert_eq!(decode(b"GIF89a", None).unwrap_err().to_string(), "it is neither a PNG nor a JPEG image");
        assert_eq!(dimensions(&file).unwrap(), (75, 61));
        // A file may promise more pixels than there is memory for.
        let mut large = file;
        let head = large.windows(2).position(|pair| pair == [0xff, 0xc0]).unwrap();
        large[head + 5..head + 9].fill(0xff);
        assert!(matches!(decode(&large, None), Err(DecodeError::TooLarge(65535, 65535))));
    }
}
