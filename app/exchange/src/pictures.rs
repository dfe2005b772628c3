//! Images of recordings as the files and depths of a log.

use std::borrow::Cow;
use std::io::Cursor;

use mvt_feelsight::LogImage;
use mvt_images::image::imageops::{FilterType, resize, rotate90, rotate180, rotate270};
use mvt_images::image::{DynamicImage, GrayImage, ImageFormat, RgbImage};
use mvt_images::{colours, decode, levels};
use mvt_robot::hand::Hand;

use crate::mapping::TouchMapping;
use crate::messages::Picture;

const PNG: &[u8] = b"\x89PNG";
/// Greatest number of pixels of an image.
const MAX_PIXELS: u64 = 4096 * 4096;

/// Returns width and height of the images of a touch sensor, pixels. A pad that does not exist has none.
pub(crate) fn touch_size(hand: &Hand, pad: usize) -> (usize, usize) {
    hand.pads().get(pad).map_or((0, 0), |pad| pad.profile.size_px.into())
}

/// Returns an image as a JPEG or PNG file. A JPEG or PNG file that lies as a log's images do is returned to the byte. `size` is the width and
/// height of the sensor's images.
pub(crate) fn file_of<'a>(
    picture: &Picture<'a>,
    image: LogImage,
    touch: Option<&TouchMapping>,
    size: (usize, usize),
) -> Result<Cow<'a, [u8]>, String> {
    // Why: notes/decisions/exchange.md, "Images stay the bytes of their file".
    let turned = touch.filter(|touch| touch.quarter_turns % 4 != 0 || touch.bgr);
    let size = (size.0 as u32, size.1 as u32);
    let expected = (!matches!(image, LogImage::Touch(_))).then_some(size);
    let mut decoded = match picture.encoding {
        None => decode(picture.data, None).map_err(|error| error.to_string())?,
        Some(_) => raw(picture)?,
    };
    let found = (decoded.width(), decoded.height());
    if let Some((width, height)) = expected.filter(|expected| *expected != found) {
        let remedy = "all images of a camera must have the size and view of its depth";
        return Err(format!("the image is {} x {} and not {width} x {height}; {remedy}", found.0, found.1));
    }
    match image {
        LogImage::Touch(_) => {
            let upright_already = turned.is_none() && found == size;
            // The three colours of a touch sensor show the slopes of its gel.
            let image = colours(decoded).map_err(|error| error.to_string())?;
            if upright_already && picture.encoding.is_none() {
                return Ok(Cow::Borrowed(picture.data));
            }
            decoded = DynamicImage::ImageRgb8(upright(image, turned, size)?);
        }
        LogImage::Colours(_) if picture.encoding.is_none() => return Ok(Cow::Borrowed(picture.data)),
        LogImage::Colours(_) => {}
        LogImage::Labels(_) | LogImage::TouchDepth(_) | LogImage::Contact(_) => {
            decoded = DynamicImage::ImageLuma8(levels(decoded).map_err(|error| error.to_string())?);
            if picture.encoding.is_none() {
                return Ok(Cow::Borrowed(picture.data));
            }
        }
    }
    let mut file = Cursor::new(Vec::new());
    decoded.write_to(&mut file, ImageFormat::Png).map_err(|error| error.to_string())?;
    Ok(Cow::Owned(file.into_inner()))
}

/// Turns an image of a touch sensor upright, in the size of its images.
fn upright(mut image: RgbImage, touch: Option<&TouchMapping>, size: (u32, u32)) -> Result<RgbImage, String> {
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
    if (size.0 < size.1 && width > height) || (size.0 > size.1 && width < height) {
        return Err(format!(
            "the image is {width} x {height}, and the touch sensor's is {} x {}; give quarter_turns = 1 or 3 in the mapping",
            size.0, size.1
        ));
    }
    Ok(if (width, height) == size { image } else { resize(&image, size.0, size.1, FilterType::Triangle) })
}

/// Returns the rows of an image without their padding, with `bytes` a pixel.
fn rows<'a>(picture: &Picture<'a>, bytes: u64) -> Result<impl Iterator<Item = &'a [u8]>, String> {
    let &Picture { width, height, step, data, .. } = picture;
    let row = width.checked_mul(bytes).filter(|row| *row > 0);
    // Some drivers leave it out.
    let step = if step == 0 { row.unwrap_or_default() } else { step };
    let row = row.filter(|row| *row <= step);
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

/// Returns depth in metres of a camera with images of this width and height; whole numbers are multiples of `unit_m`.
pub(crate) fn depth_of(picture: &Picture<'_>, unit_m: f64, camera: (usize, usize)) -> Result<Vec<f32>, String> {
    let scaled = |steps: u16| (f64::from(steps) * unit_m) as f32;
    let size = |width: u64, height: u64| match (width, height) == (camera.0 as u64, camera.1 as u64) {
        true => Ok(()),
        false => {
            let remedy = if (height, width) == (camera.0 as u64, camera.1 as u64) {
                "the two are turned by 90 degrees to each other"
            } else {
                "name the calibration of the depth images, or give their intrinsics"
            };
            Err(format!("the depth has {width} x {height} pixels and its camera {} x {}; {remedy}", camera.0, camera.1))
        }
    };
    // A message without pixels has other defects than its size.
    if picture.encoding.is_some() && picture.width.min(picture.height) > 0 {
        size(picture.width, picture.height)?;
    }
    match picture.encoding {
        Some("32FC1") => {
            let numbers =
                rows(picture, 4)?.flat_map(|row| row.as_chunks::<4>().0).map(|four| f32::from_le_bytes(*four));
            // Sensors send NaN or infinity where they measure nothing.
            Ok(numbers.map(|depth| if depth.is_finite() { depth } else { 0.0 }).collect())
        }
        // Drivers of RealSense name it Z16.
        Some("16UC1" | "mono16" | "Z16" | "z16") => Ok(rows(picture, 2)?
            .flat_map(|row| row.as_chunks::<2>().0)
            .map(|two| scaled(u16::from_le_bytes(*two)))
            .collect()),
        Some(other) => Err(format!("the encoding {other:?} is no depth; give 32FC1 (metres) or 16UC1")),
        None => {
            let Packed { file, inverse } = packed(picture)?;
            let decoded = decode(file, None).map_err(|error| error.to_string())?;
            size(decoded.width().into(), decoded.height().into())?;
            match (decoded, inverse) {
                (DynamicImage::ImageLuma16(image), None) => Ok(image.iter().map(|&steps| scaled(steps)).collect()),
                (DynamicImage::ImageLuma16(image), Some([a, b])) => {
                    let depth = |&steps: &u16| if steps == 0 { 0.0 } else { a / (f32::from(steps) - b) };
                    Ok(image.iter().map(depth).map(|depth| if depth.is_finite() { depth } else { 0.0 }).collect())
                }
                (image, _) => Err(format!(
                    "the image is no depth: it has {:?} pixels and not 16 bits of grey; give 16-bit PNG",
                    image.color()
                )),
            }
        }
    }
}

/// Image file of depth.
struct Packed<'a> {
    file: &'a [u8],
    /// Of inverse depth: metres are `a / (level - b)`.
    inverse: Option<[f32; 2]>,
}

/// Splits the head from a depth that ROS's compressed_depth_image_transport packed.
fn packed<'a>(picture: &Picture<'a>) -> Result<Packed<'a>, String> {
    // The number of the kind, then a and b.
    const HEAD: usize = 12;
    let &Picture { data, format, .. } = picture;
    if format.contains("rvl") {
        return Err("depth packed by RVL is not read; publish it as PNG".to_owned());
    }
    let Some((head, file)) = data.split_at_checked(HEAD).filter(|(_, file)| file.starts_with(PNG)) else {
        return Ok(Packed { file: data, inverse: None });
    };
    let number =
        |at: usize| head.get(at..at + 4).and_then(<[u8]>::first_chunk).map_or(0.0, |four| f32::from_le_bytes(*four));
    let numbers = [number(4), number(8)];
    if format.contains("32FC1") {
        return Ok(Packed { file, inverse: Some(numbers) });
    }
    if format.contains("16UC1") || numbers == [0.0; 2] {
        return Ok(Packed { file, inverse: None });
    }
    Err(format!("its format is {format:?}; it must say 16UC1 or 32FC1"))
}

#[cfg(test)]
mod tests {
    use mvt_images::image::{ImageBuffer, Luma};

    use super::*;

    fn picture<'a>(encoding: &'a str, width: u64, height: u64, step: u64, data: &'a [u8]) -> Picture<'a> {
        Picture { width, height, step, encoding: Some(encoding), format: "", data }
    }

    #[test]
    fn depths_have_metres_whatever_their_encoding() {
        let floats: Vec<u8> = [0.5_f32, f32::NAN, 2.0].iter().flat_map(|z| z.to_le_bytes()).collect();
        assert_eq!(depth_of(&picture("32FC1", 3, 1, 12, &floats), 1.0, (3, 1)).unwrap(), [0.5, 0.0, 2.0]);
        // Two rows with a byte behind each.
        let whole = [1, 0, 9, 0, 4, 9];
        assert_eq!(depth_of(&picture("16UC1", 1, 2, 3, &whole), 0.001, (1, 2)).unwrap(), [0.001, 1.024]);
        for encoding in ["16UC1", "Z16", "mono16"] {
            let depth = depth_of(&picture(encoding, 1, 3, 0, &whole), 0.001, (1, 3)).unwrap();
            assert_eq!(depth, [0.001, 0.009, 2.308], "rows without a stated step");
        }
        for (wrong, said) in [
            (picture("16UC1", 1, 2, 4, &whole[..4]), "shorter"),
            (picture("16UC1", 1, 2, 1, &whole), "shorter"),
            (picture("16UC1", u64::MAX, u64::MAX, u64::MAX, &whole), "x 18446744073709551615 pixels and its camera"),
            (picture("16UC1", 0, 0, 0, &whole), "shorter"),
            (picture("rgb8", 1, 2, 3, &whole), "no depth"),
            (picture("16FC1", 1, 2, 2, &whole), "no depth"),
            (picture("16UC1", 2, 1, 4, &whole), "2 x 1 pixels and its camera 1 x 2; the two are turned by 90 degrees"),
            (picture("16UC1", 1, 1, 2, &whole), "1 x 1 pixels and its camera 1 x 2; name the calibration"),
        ] {
            let error = depth_of(&wrong, 1.0, (1, 2)).unwrap_err();
            assert!(error.contains(said), "{error}");
        }
    }

    fn png(image: &DynamicImage) -> Vec<u8> {
        let mut file = Cursor::new(Vec::new());
        image.write_to(&mut file, ImageFormat::Png).unwrap();
        file.into_inner()
    }

    #[test]
    fn depth_files_are_read_with_and_without_the_head_of_ros() {
        let image = ImageBuffer::<Luma<u16>, _>::from_fn(3, 2, |x, y| Luma([500 * x as u16 + 7 * y as u16]));
        let bare = png(&DynamicImage::ImageLuma16(image));
        let read =
            |data: &[u8], format: &str, size| depth_of(&Picture { data, format, ..Picture::default() }, 0.001, size);
        let expected = [0.0, 0.5, 1.0, 0.007, 0.507, 1.007];
        assert_eq!(read(&bare, "png", (3, 2)).unwrap(), expected);
        let headed = [&[0; 12][..], &bare].concat();
        assert_eq!(read(&headed, "16UC1; compressedDepth png", (3, 2)).unwrap(), expected);
        assert_eq!(read(&headed, "png", (3, 2)).unwrap(), expected);
        let inverse = [&1_i32.to_le_bytes()[..], &600_f32.to_le_bytes(), &(-100_f32).to_le_bytes(), &bare].concat();
        let depth = read(&inverse, "32FC1; compressedDepth", (3, 2)).unwrap();
        assert_eq!(depth[..3], [0.0, 1.0, 600.0 / 1100.0]);
        for (data, format, said) in [
            (&inverse, "png", "it must say 16UC1 or 32FC1"),
            (&inverse, "16UC1; compressedDepth rvl", "RVL"),
            (&bare[..bare.len() / 2].to_vec(), "png", "damaged"),
            (&png(&DynamicImage::new_luma8(3, 2)), "png", "it has L8 pixels and not 16 bits"),
            (&png(&DynamicImage::new_luma16(2, 3)), "png", "turned by 90 degrees"),
        ] {
            let error = read(data, format, (3, 2)).unwrap_err();
            assert!(error.contains(said), "{error}");
        }
    }

    #[test]
    fn grey_touch_images_and_labels_in_colours_are_refused() {
        let touch = LogImage::Touch(2);
        let as_file = |file: &[u8], image| {
            file_of(&Picture { data: file, ..Picture::default() }, image, None, (240, 320)).map(Cow::into_owned)
        };
        let slopes = GrayImage::from_fn(240, 320, |x, y| Luma([(x + y / 2) as u8]));
        for grey in [DynamicImage::ImageLuma8(slopes.clone()), DynamicImage::ImageLuma8(slopes).into_rgb8().into()] {
            let file = png(&grey);
            assert!(as_file(&file, touch).unwrap_err().contains("grey image"));
            assert_eq!(as_file(&file, LogImage::Labels(0)).unwrap(), file);
        }
        let coloured = png(&RgbImage::from_fn(240, 320, |x, y| [x as u8, y as u8, 40].into()).into());
        assert_eq!(as_file(&coloured, touch).unwrap(), coloured);
        assert!(as_file(&coloured, LogImage::Labels(0)).unwrap_err().contains("8-bit grey"));
        assert!(as_file(&coloured[..coloured.len() - 40], LogImage::Colours(0)).unwrap_err().contains("damaged"));
        let small = png(&RgbImage::from_fn(24, 32, |x, y| [x as u8, y as u8, 40].into()).into());
        assert!(as_file(&small, LogImage::Colours(0)).unwrap_err().contains("24 x 32 and not 240 x 320"));
    }

    #[test]
    fn colours_are_put_in_order_and_upright() {
        let pixels = [10, 20, 30, 0, 40, 50, 60, 0];
        let image = raw(&picture("bgra8", 2, 1, 8, &pixels)).unwrap().into_rgb8();
        assert_eq!(image.as_raw(), &[30, 20, 10, 60, 50, 40]);
        let lying = RgbImage::from_fn(320, 240, |x, _| [if x < 160 { 200 } else { 0 }, 0, 50].into());
        let sent = picture("rgb8", 320, 240, 960, lying.as_raw());
        let refused = file_of(&sent, LogImage::Touch(2), None, (240, 320)).unwrap_err();
        assert!(refused.contains("quarter_turns"), "{refused}");
        let turned = TouchMapping { quarter_turns: 1, bgr: true, ..TouchMapping::default() };
        let file = file_of(&sent, LogImage::Touch(2), Some(&turned), (240, 320)).unwrap();
        let image = decode(&file, None).unwrap().into_rgb8();
        assert_eq!((image.dimensions(), image.get_pixel(5, 5).0), ((240, 320), [50, 0, 200]));
        // A file that lies as it should is kept to the byte.
        let again = Picture { data: &file, ..Picture::default() };
        assert!(matches!(file_of(&again, LogImage::Touch(2), None, (240, 320)).unwrap(), Cow::Borrowed(_)));
    }
}
