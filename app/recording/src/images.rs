//! Blocks of images, small and quickly encoded: colours as JPEG, depth as deflated differences to the left neighbour.
//!
//! The images of a frame are one block: for each image its kind and sensor (one byte each), its length (u32) and its
//! bytes. Numbers are little-endian.

use mvt_frames::depth::Label;
use std::io::{Cursor, Read as _, Write as _};

use flate2::Compression;
use flate2::read::ZlibDecoder;
use flate2::write::ZlibEncoder;
use image::{ImageReader, RgbImage};
use mvt_frames::camera::Intrinsics;
use mvt_images::{Chroma, encode_jpeg};
use mvt_robot::hand::PerPad;
use ndarray::Array2;

use super::{CameraImages, FrameImages, TouchImages};

/// Longest side of a recorded camera image, pixels.
const CAMERA_SIDE: usize = 320;
/// Longest side of an image that is read, pixels.
const LARGEST_SIDE: u32 = 4096;
/// Step of recorded depth, metres: a fraction of a camera's noise.
const CAMERA_STEP_M: f32 = 1e-4;
/// Step of recorded indentation, millimetres: a hundredth of a press.
const TOUCH_STEP_MM: f32 = 5e-3;
/// Marks a depth that was not measured.
const NOTHING: i16 = i16::MIN;
/// Quality of JPEG, percent.
const QUALITY: u8 = 85;

#[derive(Clone, Copy, PartialEq, Eq)]
enum Kind {
    Colour,
    Depth,
    Segmentation,
    Touch,
    Indentation,
    Contact,
    TrueIndentation,
}

impl Kind {
    const ALL: [Self; 7] = [
        Self::Colour,
        Self::Depth,
        Self::Segmentation,
        Self::Touch,
        Self::Indentation,
        Self::Contact,
        Self::TrueIndentation,
    ];
}

/// Returns N, where every Nth row and column of a camera's images is recorded.
pub fn stride(intrinsics: &Intrinsics) -> usize {
    intrinsics.width.max(intrinsics.height).div_ceil(CAMERA_SIDE).max(1)
}

/// Returns the intrinsics of a camera's recorded images.
pub fn shrunk(intrinsics: &Intrinsics) -> Intrinsics {
    let stride = stride(intrinsics);
    let by = stride as f64;
    Intrinsics {
        width: intrinsics.width.div_ceil(stride),
        height: intrinsics.height.div_ceil(stride),
        fx: intrinsics.fx / by,
        fy: intrinsics.fy / by,
        cx: intrinsics.cx / by,
        cy: intrinsics.cy / by,
    }
}

/// Returns every `stride`-th row and column.
pub fn thinned(image: &RgbImage, stride: usize) -> RgbImage {
    let step = stride as u32;
    let (width, height) = (image.width().div_ceil(step), image.height().div_ceil(step));
    RgbImage::from_fn(width, height, |x, y| *image.get_pixel(x * step, y * step))
}

/// Returns every `stride`-th row and column.
pub fn thinned_array<T: Clone>(array: &Array2<T>, stride: usize) -> Array2<T> {
    array.slice(ndarray::s![..;stride, ..;stride]).to_owned()
}

/// Encodes the images of a frame.
pub fn encode(images: &FrameImages) -> Result<Vec<u8>, String> {
    let mut block = Vec::new();
    let mut put = |kind: Kind, sensor: usize, bytes: &[u8]| {
        block.extend([kind as u8, sensor as u8]);
        block.extend((bytes.len() as u32).to_le_bytes());
        block.extend_from_slice(bytes);
    };
    for (k, camera) in images.cameras.iter().enumerate() {
        let Some(CameraImages { colour, depth_m, labels }) = camera else { continue };
        if !colour.is_empty() {
            put(Kind::Colour, k, &jpeg(colour)?);
        }
        put(Kind::Depth, k, &pack_depth(depth_m)?);
        put(Kind::Segmentation, k, &pack_levels(labels, |label| label.grey())?);
    }
    for (k, touch) in images.touch.iter().enumerate() {
        let Some(TouchImages { image, indentation_mm, contact, true_indentation_mm }) = touch else { continue };
        if !image.is_empty() {
            put(Kind::Touch, k, &jpeg(image)?);
        }
        // Of a sensor that touches nothing the image is recorded alone.
        let is_flat = indentation_mm.iter().all(|mm| mm.abs() < 0.5 * TOUCH_STEP_MM);
        if image.is_empty() || contact.iter().any(|&touches| touches) || !is_flat {
            put(Kind::Indentation, k, &pack_touch(indentation_mm)?);
            put(Kind::Contact, k, &pack_levels(contact, grey_of_mask)?);
        }
        if let Some(indentation_mm) = true_indentation_mm {
            put(Kind::TrueIndentation, k, &pack_touch(indentation_mm)?);
        }
    }
    Ok(block)
}

/// Decodes the images of a frame.
pub fn decode(block: &[u8], frame: usize, cameras: usize, pads: usize) -> Result<FrameImages, String> {
    let mut images = FrameImages { frame, cameras: vec![None; cameras], touch: PerPad(vec![None; pads]) };
    let mut rest = block;
    while !rest.is_empty() {
        let (head, after) = rest.split_at_checked(6).ok_or("a block of images ends in the middle")?;
        let (kind, sensor) = (Kind::ALL.get(usize::from(head[0])), usize::from(head[1]));
        let length = u32::from_le_bytes([head[2], head[3], head[4], head[5]]) as usize;
        let (bytes, after) = after.split_at_checked(length).ok_or("an image ends in the middle")?;
        rest = after;
        let kind = *kind.ok_or_else(|| format!("unknown kind of image {}", head[0]))?;
        match kind {
            Kind::Colour => camera(&mut images, sensor)?.colour = unjpeg(bytes)?,
            Kind::Segmentation => camera(&mut images, sensor)?.labels = unpack_levels(bytes, label)?,
            Kind::Depth => camera(&mut images, sensor)?.depth_m = unpack_depth(bytes)?,
            Kind::Touch => {
                let touch = touch(&mut images, sensor)?;
                touch.image = unjpeg(bytes)?;
                let (width, height) = touch.image.dimensions();
                touch.indentation_mm = Array2::zeros((height as usize, width as usize));
                touch.contact = Array2::default(touch.indentation_mm.dim());
            }
            Kind::Indentation => touch(&mut images, sensor)?.indentation_mm = unpack_touch(bytes)?,
            Kind::Contact => touch(&mut images, sensor)?.contact = unpack_levels(bytes, |grey| Ok(grey > 127))?,
            Kind::TrueIndentation => touch(&mut images, sensor)?.true_indentation_mm = Some(unpack_touch(bytes)?),
        }
    }
    Ok(images)
}

fn camera(images: &mut FrameImages, sensor: usize) -> Result<&mut CameraImages, String> {
    let camera = images.cameras.get_mut(sensor).ok_or_else(|| format!("there is no camera {sensor}"))?;
    Ok(camera.get_or_insert_default())
}

fn touch(images: &mut FrameImages, sensor: usize) -> Result<&mut TouchImages, String> {
    let touch = images.touch.get_mut(sensor).ok_or_else(|| format!("there is no pad {sensor}"))?;
    Ok(touch.get_or_insert_default())
}

fn jpeg(image: &RgbImage) -> Result<Vec<u8>, String> {
    encode_jpeg(image, QUALITY, Chroma::Half).map_err(|error| error.to_string())
}

fn unjpeg(bytes: &[u8]) -> Result<RgbImage, String> {
    let mut reader = ImageReader::with_format(Cursor::new(bytes), image::ImageFormat::Jpeg);
    let mut limits = image::Limits::default();
    (limits.max_image_width, limits.max_image_height) = (Some(LARGEST_SIDE), Some(LARGEST_SIDE));
    reader.limits(limits);
    Ok(reader.decode().map_err(|error| error.to_string())?.into_rgb8())
}

/// Columns and rows.
type Size = [usize; 2];

fn size<T>(array: &Array2<T>) -> Size {
    [array.ncols(), array.nrows()]
}

fn array<T>(values: Vec<T>, [columns, rows]: Size) -> Result<Array2<T>, String> {
    Array2::from_shape_vec((rows, columns), values).map_err(|error| error.to_string())
}

/// Packs the numbers of an image, row by row. High bytes follow the low bytes, because nearly all high bytes are equal.
fn pack(values: impl Iterator<Item = i16>, size: Size) -> Result<Vec<u8>, String> {
    let mut left = 0i16;
    let (mut bytes, mut high) = (Vec::new(), Vec::new());
    for value in values {
        let difference = value.wrapping_sub(left);
        left = value;
        // Zigzag: small differences of either sign become small numbers.
        let [low_byte, high_byte] = ((difference << 1) ^ (difference >> 15)).to_le_bytes();
        bytes.push(low_byte);
        high.push(high_byte);
    }
    bytes.append(&mut high);
    deflate(&bytes, size)
}

fn unpack(bytes: &[u8]) -> Result<(Vec<i16>, Size), String> {
    let (bytes, size) = inflate(bytes, 2)?;
    let (low, high) = bytes.split_at(bytes.len() / 2);
    let mut left = 0i16;
    let undo = |(&low, &high): (&u8, &u8)| {
        let folded = u16::from_le_bytes([low, high]);
        let difference = ((folded >> 1) as i16) ^ -((folded & 1) as i16);
        left = left.wrapping_add(difference);
        left
    };
    Ok((low.iter().zip(high).map(undo).collect(), size))
}

/// Packs the depth of a camera; values that are not above 0 are not measured.
pub fn pack_depth(depth_m: &Array2<f32>) -> Result<Vec<u8>, String> {
    let step = |&z: &f32| if z > 0.0 { (z / CAMERA_STEP_M).round() as i16 } else { NOTHING };
    pack(depth_m.iter().map(step), size(depth_m))
}

/// Unpacks the depth of a camera, metres; 0 where it was not measured.
pub fn unpack_depth(bytes: &[u8]) -> Result<Array2<f32>, String> {
    let (steps, shape) = unpack(bytes)?;
    let metres = |step| if step == NOTHING { 0.0 } else { f32::from(step) * CAMERA_STEP_M };
    array(steps.into_iter().map(metres).collect(), shape)
}

/// Packs the indentation of a touch sensor.
fn pack_touch(indentation_mm: &Array2<f32>) -> Result<Vec<u8>, String> {
    pack(indentation_mm.iter().map(|mm| (mm / TOUCH_STEP_MM).round() as i16), size(indentation_mm))
}

/// Unpacks the indentation of a touch sensor, millimetres; 0 where it was not measured.
fn unpack_touch(bytes: &[u8]) -> Result<Array2<f32>, String> {
    let (steps, shape) = unpack(bytes)?;
    let millimetres = |step| if step == NOTHING { 0.0 } else { f32::from(step) * TOUCH_STEP_MM };
    array(steps.into_iter().map(millimetres).collect(), shape)
}

/// Packs an array of grey levels.
fn pack_levels<T>(array: &Array2<T>, grey: impl Fn(&T) -> u8) -> Result<Vec<u8>, String> {
    let levels: Vec<u8> = array.iter().map(grey).collect();
    deflate(&levels, size(array))
}

/// Unpacks an array of grey levels.
fn unpack_levels<T>(bytes: &[u8], value: impl Fn(u8) -> Result<T, String>) -> Result<Array2<T>, String> {
    let (levels, shape) = inflate(bytes, 1)?;
    array(levels.into_iter().map(value).collect::<Result<_, _>>()?, shape)
}

/// Grey level of a pixel of a mask.
fn grey_of_mask(&touches: &bool) -> u8 {
    if touches { u8::MAX } else { 0 }
}

/// Label of a grey level.
fn label(grey: u8) -> Result<Label, String> {
    Label::from_grey(grey).ok_or_else(|| format!("no label has the grey level {grey}"))
}

/// Returns width and height (u16), then the deflated bytes.
fn deflate(bytes: &[u8], [width, height]: Size) -> Result<Vec<u8>, String> {
    let side = |n: usize| u16::try_from(n).map_err(|_| format!("an image of {width} x {height} pixels is too large"));
    let mut out = Vec::with_capacity(bytes.len() / 8);
    out.extend(side(width)?.to_le_bytes());
    out.extend(side(height)?.to_le_bytes());
    let mut encoder = ZlibEncoder::new(out, Compression::fast());
    encoder.write_all(bytes).and_then(|()| encoder.finish()).map_err(|error| error.to_string())
}

fn inflate(bytes: &[u8], bytes_per_pixel: usize) -> Result<(Vec<u8>, Size), String> {
    let (head, body) = bytes.split_at_checked(4).ok_or("an image has no size")?;
    let size = [u16::from_le_bytes([head[0], head[1]]), u16::from_le_bytes([head[2], head[3]])].map(usize::from);
    if size.iter().any(|&side| side > LARGEST_SIDE as usize) {
        return Err(format!("an image of {} x {} pixels is too large", size[0], size[1]));
    }
    let expected = size[0] * size[1] * bytes_per_pixel;
    let mut out = Vec::with_capacity(expected);
    let read = ZlibDecoder::new(body).take(expected as u64 + 1).read_to_end(&mut out);
    read.map_err(|error| error.to_string())?;
    if out.len() == expected { Ok((out, size)) } else { Err("the size of an image differs from its head".to_owned()) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn example() -> FrameImages {
        let camera = CameraImages {
            colour: RgbImage::from_fn(32, 24, |x, y| image::Rgb([4 * x as u8, 8 * y as u8, 90])),
            depth_m: Array2::from_shape_fn((24, 32), |(r, c)| if r < 3 { 0.0 } else { 0.3 + 0.001 * (r * c) as f32 }),
            labels: Array2::from_shape_fn((24, 32), |(_, c)| if c > 9 { Label::Object } else { Label::Hand }),
        };
        let pressed = Array2::from_shape_fn((320, 240), |(r, c)| if r > 200 { 0.002 * c as f32 } else { 0.0 });
        let touch = TouchImages {
            image: RgbImage::from_pixel(240, 320, image::Rgb([90, 120, 60])),
            contact: pressed.mapv(|_| true),
            indentation_mm: pressed.clone(),
            true_indentation_mm: Some(pressed.mapv(|mm| 0.5 * mm)),
        };
        FrameImages { frame: 7, cameras: vec![None, Some(camera)], touch: PerPad(vec![None, None, Some(touch), None]) }
    }

    #[test]
    fn images_are_decoded_up_to_their_steps() {
        let images = example();
        let block = encode(&images).unwrap();
        let read = decode(&block, 7, 2, 4).unwrap();
        let [before, after] = [&images, &read].map(|images| images.cameras[1].clone().unwrap());
        assert!(read.cameras[0].is_none() && read.touch[3].is_none());
        assert_eq!(before.labels, after.labels);
        let close = |a: &Array2<f32>, b: &Array2<f32>, step: f32| {
            assert!(a.iter().zip(b).all(|(a, b)| (a - b).abs() < 0.51 * step));
        };
        close(&before.depth_m, &after.depth_m, CAMERA_STEP_M);
        assert!(before.depth_m.iter().zip(&after.depth_m).all(|(a, b)| (*a == 0.0) == (*b == 0.0)));
        let off = before.colour.iter().zip(after.colour.iter()).map(|(a, b)| a.abs_diff(*b)).max();
        assert!(off < Some(24), "{off:?}");
        let [before, after] = [&images, &read].map(|images| images.touch[2].clone().unwrap());
        close(&before.indentation_mm, &after.indentation_mm, TOUCH_STEP_MM);
        close(&before.true_indentation_mm.unwrap(), &after.true_indentation_mm.unwrap(), TOUCH_STEP_MM);
        assert_eq!(before.contact, after.contact);
    }

    #[test]
    fn a_digit_without_contact_takes_no_space() {
        let untouched = TouchImages {
            image: RgbImage::from_pixel(240, 320, image::Rgb([90, 120, 60])),
            indentation_mm: Array2::zeros((320, 240)),
            contact: Array2::default((320, 240)),
            true_indentation_mm: None,
        };
        let mut images = FrameImages { frame: 0, cameras: vec![], touch: PerPad(vec![None; 2]) };
        images.touch[0] = Some(TouchImages { image: RgbImage::default(), ..untouched.clone() });
        assert_eq!(decode(&encode(&images).unwrap(), 0, 0, 2).unwrap(), images);
        images.touch[0] = Some(untouched);
        let block = encode(&images).unwrap();
        let read = decode(&block, 0, 0, 2).unwrap().touch[0].clone().unwrap();
        assert!(
            read.indentation_mm == Array2::<f32>::zeros((320, 240)) && !read.contact.iter().any(|&touches| touches)
        );
        assert_eq!(block.len(), 6 + jpeg(&read.image).unwrap().len());
    }

    #[test]
    fn a_thinned_image_fits_the_thinned_camera() {
        let whole = Intrinsics::from_fov_y(641, 480, 0.7);
        let small = shrunk(&whole);
        assert_eq!((small.width, small.height, stride(&whole)), (214, 160, 3));
        let (point, again) = (whole.unproject(300.0, 123.0, 0.4), small.unproject(100.0, 41.0, 0.4));
        assert!((point.coords() - again.coords()).norm() < 1e-12);
        let depth_m = Array2::from_shape_fn((480, 641), |(r, c)| (1000 * r + c) as f32);
        assert_eq!(thinned_array(&depth_m, 3)[(41, 100)], depth_m[(123, 300)]);
        assert_eq!(thinned_array(&depth_m, 3).dim(), (160, 214));
    }

    proptest! {
        #[test]
        fn numbers_are_packed_without_loss(values in prop::collection::vec(any::<i16>(), 6..=6)) {
            let packed = pack(values.iter().copied(), [3, 2]).unwrap();
            prop_assert_eq!(unpack(&packed).unwrap(), (values, [3, 2]));
        }

        #[test]
        fn damaged_blocks_are_errors_or_other_images(
            at in any::<prop::sample::Index>(),
            byte in any::<u8>(),
            cut in any::<bool>(),
        ) {
            let mut block = encode(&example()).unwrap();
            let at = at.index(block.len());
            if cut { block.truncate(at) } else { block[at] = byte }
            let _ = decode(&block, 0, 2, 4);
        }
    }
}
