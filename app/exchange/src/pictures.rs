//! Images of recordings as the files and depths of a log.

use std::borrow::Cow;
use std::io::Cursor;

use mvt_feelsight::LogImage;
use mvt_feelsight::image::imageops::{FilterType, resize, rotate90, rotate180, rotate270};
use mvt_feelsight::image::{DynamicImage, GrayImage, ImageDecoder, ImageFormat, ImageReader, RgbImage};
use mvt_robot::digit;

use crate::mapping::TouchMapping;
use crate::messages::Picture;

const PNG: &[u8] = b"\x89PNG";
const JPEG: &[u8] = b"\xff\xd8\xff";
/// Greatest number of pixels of an image.
const MAX_PIXELS: u64 = 4096 * 4096;

/// Returns an image as a JPEG or PNG file. A JPEG or PNG file that lies as a log's images do is returned to the byte.
pub(crate) fn file_of<'a>(
    picture: &Picture<'a>,
    image: LogImage,
    touch: Option<&TouchMapping>,
) -> Result<Cow<'a, [u8]>, String> {
    let turned = touch.filter(|touch| touch.quarter_turns % 4 != 0 || touch.bgr);
    let is_file = picture.encoding.is_none() && (picture.data.starts_with(PNG) || picture.data.starts_with(JPEG));
    let is_touch = matches!(image, LogImage::Touch(_));
    if is_file
        && turned.is_none()
        && !(is_touch && size_of(picture.data)? != (digit::WIDTH as u32, digit::HEIGHT as u32))
    {
        return Ok(Cow::Borrowed(picture.data));
    }
    let mut decoded = match picture.encoding {
        None => decode(picture.data)?,
        Some(_) => raw(picture)?,
    };
    if let (LogImage::Touch(_), DynamicImage::ImageLuma8(_) | DynamicImage::ImageLuma16(_)) = (image, &decoded) {
        return Err("it is a grey image; a touch sensor's three colours show the slopes of its gel".to_owned());
    }
    if is_touch {
        decoded = DynamicImage::ImageRgb8(upright(decoded.into_rgb8(), turned)?);
    }
    let mut file = Cursor::new(Vec::new());
    decoded.write_to(&mut file, ImageFormat::Png).map_err(|error| error.to_string())?;
    Ok(Cow::Owned(file.into_inner()))
}

/// Turns an image of a DIGIT upright, in its size.
fn upright(mut image: RgbImage, touch: Option<&TouchMapping>) -> Result<RgbImage, String> {
    image = match touch.map_or(0, |touch| touch.quarter_turns % 4) {
        1 => rotate90(&image),
        2 => rotate180(&image),
        3 => rotate270(&image),
        _ => image,
    };
    if touch.is_some_and(|touch| touch.bgr) {
        image.pixels_mut().for_each(|pixel| pixel.0.swap(0, 2));
    }
    let (width, height) = image.dimensions();
    if width > height {
        return Err(format!(
            "the image is {width} x {height}, and a DIGIT's is taller than wide; give quarter_turns = 1 or 3 in the mapping"
        ));
    }
    let size = (digit::WIDTH as u32, digit::HEIGHT as u32);
    Ok(if (width, height) == size { image } else { resize(&image, size.0, size.1, FilterType::Triangle) })
}

/// Returns width and height of an image file.
fn size_of(file: &[u8]) -> Result<(u32, u32), String> {
    let reader = ImageReader::new(Cursor::new(file)).with_guessed_format().map_err(|error| error.to_string())?;
    reader.into_dimensions().map_err(|error| error.to_string())
}

fn decode(file: &[u8]) -> Result<DynamicImage, String> {
    let words = |error: &dyn std::fmt::Display| error.to_string();
    let reader = ImageReader::new(Cursor::new(file)).with_guessed_format().map_err(|e| words(&e))?;
    if !matches!(reader.format(), Some(ImageFormat::Png | ImageFormat::Jpeg)) {
        return Err("the image is neither PNG nor JPEG".to_owned());
    }
    let decoder = reader.into_decoder().map_err(|e| words(&e))?;
    let (width, height) = decoder.dimensions();
    if u64::from(width) * u64::from(height) > MAX_PIXELS {
        return Err(format!("the image has {width} x {height} pixels, more than any camera's"));
    }
    DynamicImage::from_decoder(decoder).map_err(|e| words(&e))
}

/// Returns the rows of an image without their padding, with `bytes` a pixel.
fn rows<'a>(picture: &Picture<'a>, bytes: u64) -> Result<impl Iterator<Item = &'a [u8]>, String> {
    let &Picture { width, height, step, data, .. } = picture;
    let row = width.checked_mul(bytes).filter(|row| *row > 0 && *row <= step);
    let needed = row.and_then(|row| step.checked_mul(height.checked_sub(1)?)?.checked_add(row));
    let fits = needed.is_some_and(|needed| needed <= data.len() as u64) && width.saturating_mul(height) <= MAX_PIXELS;
    let (Some(row), true) = (row, fits) else {
        return Err(format!("the data are shorter than {width} x {height} pixels of {bytes} bytes"));
    };
    Ok(data.chunks(step as usize).take(height as usize).map(move |line| line.get(..row as usize).unwrap_or_default()))
}

fn raw(picture: &Picture<'_>) -> Result<DynamicImage, String> {
    let encoding = picture.encoding.unwrap_or_default();
    let (channels, is_bgr) = match encoding {
        "rgb8" | "8UC3" => (3, false),
        "bgr8" => (3, true),
        "rgba8" => (4, false),
        "bgra8" => (4, true),
        "mono8" | "8UC1" => (1, false),
        other => return Err(format!("the encoding {other:?} is unknown; give rgb8, bgr8, rgba8, bgra8 or mono8")),
    };
    let mut pixels: Vec<u8> = Vec::new();
    for row in rows(picture, channels)? {
        match channels {
            4 => row.as_chunks::<4>().0.iter().for_each(|pixel| pixels.extend_from_slice(&pixel[..3])),
            _ => pixels.extend_from_slice(row),
        }
    }
    if is_bgr {
        pixels.as_chunks_mut::<3>().0.iter_mut().for_each(|pixel| pixel.swap(0, 2));
    }
    let (width, height) = (picture.width as u32, picture.height as u32);
    let image = match channels {
        1 => GrayImage::from_raw(width, height, pixels).map(DynamicImage::ImageLuma8),
        _ => RgbImage::from_raw(width, height, pixels).map(DynamicImage::ImageRgb8),
    };
    image.ok_or_else(|| "the image has holes".to_owned())
}

/// Returns depth in metres of so many pixels; whole numbers are multiples of `unit_m`.
pub(crate) fn depth_of(picture: &Picture<'_>, unit_m: f64, pixels: usize) -> Result<Vec<f32>, String> {
    let scaled = |steps: u16| (f64::from(steps) * unit_m) as f32;
    let depth: Vec<f32> = match picture.encoding {
        Some("32FC1") => {
            let numbers =
                rows(picture, 4)?.flat_map(|row| row.as_chunks::<4>().0).map(|four| f32::from_le_bytes(*four));
            // Sensors send NaN or infinity where they measure nothing.
            numbers.map(|depth| if depth.is_finite() { depth } else { 0.0 }).collect()
        }
        Some("16UC1" | "mono16") => rows(picture, 2)?
            .flat_map(|row| row.as_chunks::<2>().0)
            .map(|two| scaled(u16::from_le_bytes(*two)))
            .collect(),
        Some(other) => return Err(format!("the encoding {other:?} is no depth; give 32FC1 or 16UC1")),
        None => match decode(picture.data)? {
            DynamicImage::ImageLuma16(image) => image.iter().map(|&steps| scaled(steps)).collect(),
            _ => return Err("the image is no depth: it has not 16 bits of grey".to_owned()),
        },
    };
    if depth.len() == pixels {
        Ok(depth)
    } else {
        Err(format!("the depth has {} pixels and its camera {pixels}", depth.len()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn picture<'a>(encoding: &'a str, width: u64, height: u64, step: u64, data: &'a [u8]) -> Picture<'a> {
        Picture { width, height, step, encoding: Some(encoding), data }
    }

    #[test]
    fn depths_have_metres_whatever_their_encoding() {
        let floats: Vec<u8> = [0.5_f32, f32::NAN, 2.0].iter().flat_map(|z| z.to_le_bytes()).collect();
        assert_eq!(depth_of(&picture("32FC1", 3, 1, 12, &floats), 1.0, 3).unwrap(), [0.5, 0.0, 2.0]);
        // Two rows with a byte behind each.
        let whole = [1, 0, 9, 0, 4, 9];
        assert_eq!(depth_of(&picture("16UC1", 1, 2, 3, &whole), 0.001, 2).unwrap(), [0.001, 1.024]);
        for (wrong, said) in [
            (picture("16UC1", 2, 2, 4, &whole), "shorter"),
            (picture("16UC1", u64::MAX, u64::MAX, u64::MAX, &whole), "shorter"),
            (picture("16UC1", 0, 0, 0, &whole), "shorter"),
            (picture("rgb8", 1, 2, 3, &whole), "no depth"),
            (picture("16UC1", 1, 1, 2, &whole), "1 pixels and its camera 2"),
        ] {
            let error = depth_of(&wrong, 1.0, 2).unwrap_err();
            assert!(error.contains(said), "{error}");
        }
    }

    #[test]
    fn colours_are_put_in_order_and_upright() {
        let pixels = [10, 20, 30, 0, 40, 50, 60, 0];
        let image = raw(&picture("bgra8", 2, 1, 8, &pixels)).unwrap().into_rgb8();
        assert_eq!(image.as_raw(), &[30, 20, 10, 60, 50, 40]);
        let lying = RgbImage::from_fn(320, 240, |x, _| [if x < 160 { 200 } else { 0 }, 0, 50].into());
        let finger = mvt_robot::hand::Finger::Ring;
        let sent = picture("rgb8", 320, 240, 960, lying.as_raw());
        let refused = file_of(&sent, LogImage::Touch(finger), None).unwrap_err();
        assert!(refused.contains("quarter_turns"), "{refused}");
        let turned = TouchMapping { quarter_turns: 1, bgr: true, ..TouchMapping::default() };
        let file = file_of(&sent, LogImage::Touch(finger), Some(&turned)).unwrap();
        let image = decode(&file).unwrap().into_rgb8();
        assert_eq!((image.dimensions(), image.get_pixel(5, 5).0), ((240, 320), [50, 0, 200]));
        // A file that lies as it should is kept to the byte.
        let again = Picture { data: &file, ..Picture::default() };
        assert!(matches!(file_of(&again, LogImage::Touch(finger), None).unwrap(), Cow::Borrowed(_)));
    }
}
