//! Pixels of depth, colours and masks.

use std::collections::BTreeMap;
use std::path::Path;

use image::imageops::{FilterType, resize};
use image::{DynamicImage, RgbImage};
use mvt_feelsight::npy;
use mvt_files::input;
use ndarray::Array2;

use crate::error::RgbdError;

/// Largest image file that is read, bytes.
const LARGEST_IMAGE: u64 = 256 << 20;

/// How files hold depth.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum DepthCode {
    /// Levels of so many metres; numbers with fractions are metres.
    Levels { unit_m: f64 },
    /// 16 bits in the red and green of a PNG image, as HO3D has it.
    Ho3d,
}

/// Metres per level of HO3D's depth.
const HO3D_UNIT_M: f64 = 0.000_124_986_647_279_001_77;

fn decoded(path: &Path) -> Result<DynamicImage, RgbdError> {
    let bytes = input::read(path, LARGEST_IMAGE).map_err(RgbdError::io(path))?;
    mvt_images::decode(&bytes, None).map_err(|reason| RgbdError::fault(path, reason.to_string()))
}

/// Returns pixels as an array of rows and columns.
fn array<T: Copy + Default>(width: u32, height: u32, pixels: impl Iterator<Item = T>) -> Array2<T> {
    // There are as many pixels as the image has.
    Array2::from_shape_vec((height as usize, width as usize), pixels.collect()).unwrap_or_default()
}

/// Reads a depth image, metres, 0 where nothing was measured.
pub(crate) fn depth_m(path: &Path, code: DepthCode) -> Result<Array2<f32>, RgbdError> {
    if path.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("npy")) {
        return depth_of_npy(path, code);
    }
    match (decoded(path)?, code) {
        (DynamicImage::ImageLuma16(image), DepthCode::Levels { unit_m }) => {
            let metres = image.iter().map(|&level| (f64::from(level) * unit_m) as f32);
            Ok(array(image.width(), image.height(), metres))
        }
        (DynamicImage::ImageRgb8(image), DepthCode::Ho3d) => {
            let level = |pixel: &image::Rgb<u8>| f64::from(pixel[0]) + 256.0 * f64::from(pixel[1]);
            Ok(array(image.width(), image.height(), image.pixels().map(|pixel| (level(pixel) * HO3D_UNIT_M) as f32)))
        }
        (image, DepthCode::Levels { .. }) => {
            let fault = format!("a depth image has one channel of 16 bits; this one is {:?}", image.color());
            Err(RgbdError::fault(path, fault))
        }
        (image, DepthCode::Ho3d) => {
            let fault =
                format!("depth of HO3D stands in the red and green of 8 bits; this image is {:?}", image.color());
            Err(RgbdError::fault(path, fault))
        }
    }
}

fn depth_of_npy(path: &Path, code: DepthCode) -> Result<Array2<f32>, RgbdError> {
    let array = npy::read(path).map_err(|reason| RgbdError::fault(path, reason.to_string()))?;
    let &[height, width] = array.shape() else {
        return Err(RgbdError::fault(path, "a depth image has rows and columns"));
    };
    let unit_m = match code {
        DepthCode::Levels { unit_m } if !array.kind().code().starts_with('f') => unit_m,
        _ => 1.0,
    };
    let metres = array.to_f64().map(|value| if value.is_finite() { (value * unit_m) as f32 } else { 0.0 });
    Ok(Array2::from_shape_vec((height, width), metres.collect()).unwrap_or_default())
}

/// Reads a colour image, resized to the width and height of the depth image.
pub(crate) fn colour(path: &Path, [width, height]: [usize; 2]) -> Result<RgbImage, RgbdError> {
    let image = decoded(path)?.to_rgb8();
    let size = (width as u32, height as u32);
    Ok(if image.dimensions() == size { image } else { resize(&image, size.0, size.1, FilterType::Triangle) })
}

/// Reads width and height of an image, pixels.
pub(crate) fn size(path: &Path) -> Result<[usize; 2], RgbdError> {
    let bytes = input::read(path, LARGEST_IMAGE).map_err(RgbdError::io(path))?;
    let (width, height) =
        mvt_images::dimensions(&bytes).map_err(|reason| RgbdError::fault(path, reason.to_string()))?;
    Ok([width as usize, height as usize])
}

/// Reads a mask of the object, resized to the width and height of the depth image. `object` is the level that stands for the object in an image of
/// labels; without it the image has two levels, or the object is where it is opaque.
pub(crate) fn mask(path: &Path, object: Option<u32>, size: [usize; 2]) -> Result<Array2<bool>, RgbdError> {
    let mask = mask_as_drawn(path, object)?;
    let (width, height) = (mask.ncols() as u32, mask.nrows() as u32);
    let [columns, rows] = size;
    if (rows, columns) == mask.dim() {
        return Ok(mask);
    }
    if columns * height as usize != rows * width as usize {
        let fault = format!(
            "the mask is {width} x {height} pixels and depth {columns} x {rows}: they show different parts of the scene"
        );
        return Err(RgbdError::fault(path, fault));
    }
    let nearest = |at: usize, of: usize, from: u32| ((2 * at + 1) * from as usize) / (2 * of);
    Ok(Array2::from_shape_fn((rows, columns), |(v, u)| mask[(nearest(v, rows, height), nearest(u, columns, width))]))
}

/// Reads a mask as [`mask`] does, in its own size.
pub(crate) fn mask_as_drawn(path: &Path, object: Option<u32>) -> Result<Array2<bool>, RgbdError> {
    let image = decoded(path)?;
    let inside = inside(&image, object).map_err(|fault| RgbdError::fault(path, fault))?;
    Ok(array(image.width(), image.height(), inside.into_iter()))
}

/// Least share of the pixels that have an extreme level in a mask with soft edges.
const EXTREME: f64 = 0.9;

fn inside(image: &DynamicImage, object: Option<u32>) -> Result<Vec<bool>, String> {
    if image.color().has_alpha() && object.is_none() {
        let rgba = image.to_rgba8();
        if rgba.pixels().any(|pixel| pixel[3] != u8::MAX) {
            return Ok(rgba.pixels().map(|pixel| pixel[3] > 127).collect());
        }
    }
    let levels: Vec<u32> = match image {
        DynamicImage::ImageLuma16(grey) => grey.iter().map(|&level| u32::from(level)).collect(),
        other => {
            let rgb = other.to_rgb8();
            if rgb.pixels().any(|pixel| pixel[0].abs_diff(pixel[1]).max(pixel[1].abs_diff(pixel[2])) > 8) {
                return Ok(coloured(&rgb));
            }
            rgb.pixels().map(|pixel| u32::from(pixel[1])).collect()
        }
    };
    if let Some(object) = object {
        return Ok(levels.into_iter().map(|level| level == object).collect());
    }
    let mut counts: BTreeMap<u32, usize> = BTreeMap::new();
    levels.iter().for_each(|&level| *counts.entry(level).or_default() += 1);
    let most = counts.keys().next_back().copied().unwrap_or(0);
    if counts.len() <= 2 {
        return Ok(levels.into_iter().map(|level| level > 0).collect());
    }
    // Edges of a mask that was scaled, or a JPEG file.
    let near = most / 16;
    let extreme: usize =
        counts.iter().filter(|(level, _)| **level <= near || **level >= most - near).map(|(_, n)| n).sum();
    if extreme as f64 >= EXTREME * levels.len() as f64 && most > 127 {
        return Ok(levels.into_iter().map(|level| 2 * level > most).collect());
    }
    let names: Vec<String> = counts.keys().filter(|level| **level > 0).take(12).map(u32::to_string).collect();
    Err(format!(
        "it holds several labels ({}): say which is the object by `object = LABEL` in rgbd.toml",
        names.join(", ")
    ))
}

/// The object in a coloured image of labels as HO3D has it: the hand is blue, the object another colour.
fn coloured(rgb: &RgbImage) -> Vec<bool> {
    rgb.pixels().map(|pixel| pixel[0].max(pixel[1]) > 127 && pixel[2] < 128).collect()
}

#[cfg(test)]
mod tests {
    use image::{GrayImage, ImageBuffer, Luma, RgbaImage};

    use super::*;

    fn grey(levels: &[u8]) -> DynamicImage {
        DynamicImage::ImageLuma8(GrayImage::from_vec(levels.len() as u32, 1, levels.to_vec()).unwrap())
    }

    #[test]
    fn masks_have_two_levels_or_a_label() {
        for levels in [[0, 1, 0], [0, 255, 0], [0, 38, 0]] {
            assert_eq!(inside(&grey(&levels), None).unwrap(), [false, true, false]);
        }
        assert_eq!(inside(&grey(&[0, 12, 5]), Some(12)).unwrap(), [false, true, false]);
        assert!(inside(&grey(&[0, 12, 5]), None).unwrap_err().contains("several labels (5, 12)"));
        assert_eq!(inside(&grey(&[0; 3]), None).unwrap(), [false; 3]);
        let labels = DynamicImage::ImageLuma16(ImageBuffer::<Luma<u16>, _>::from_vec(3, 1, vec![0, 700, 3]).unwrap());
        assert_eq!(inside(&labels, Some(700)).unwrap(), [false, true, false]);
    }

    #[test]
    fn soft_edges_and_alpha_are_masks() {
        let mut soft = vec![0; 60];
        soft.extend([3, 120, 140, 250]);
        soft.extend([255; 60]);
        let mask = inside(&grey(&soft), None).unwrap();
        assert_eq!(mask.iter().filter(|inside| **inside).count(), 62);
        let cut = RgbaImage::from_fn(2, 1, |x, _| image::Rgba([9, 200, 9, if x == 0 { 0 } else { 255 }]));
        assert_eq!(inside(&DynamicImage::ImageRgba8(cut), None).unwrap(), [false, true]);
    }

    #[test]
    fn the_hand_of_ho3d_is_blue() {
        let labels =
            RgbImage::from_fn(4, 1, |x, _| image::Rgb([[0, 0, 0], [0, 0, 255], [0, 255, 0], [255, 0, 0]][x as usize]));
        assert_eq!(inside(&DynamicImage::ImageRgb8(labels), None).unwrap(), [false, false, true, true]);
    }
}
