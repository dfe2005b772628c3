//! Rectangles and single pixels on images.

use image::{Rgb, RgbImage};

/// Rectangle of pixels.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Area {
    /// First column.
    pub x: u32,
    /// First row.
    pub y: u32,
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
}

/// Fills a rectangle with a colour. Pixels outside the image are skipped.
pub fn fill(image: &mut RgbImage, area: Area, colour: Rgb<u8>) {
    for y in area.y..area.y.saturating_add(area.height).min(image.height()) {
        for x in area.x..area.x.saturating_add(area.width).min(image.width()) {
            image.put_pixel(x, y, colour);
        }
    }
}

/// Blends a colour over a pixel; a coverage of 0 keeps the pixel, 1 replaces it. Pixels outside the image are skipped.
pub fn blend(image: &mut RgbImage, x: u32, y: u32, colour: Rgb<u8>, coverage: f32) {
    let Some(pixel) = image.get_pixel_mut_checked(x, y) else { return };
    let coverage = coverage.clamp(0.0, 1.0);
    for (below, above) in pixel.0.iter_mut().zip(colour.0) {
        *below = (f32::from(*below) + (f32::from(above) - f32::from(*below)) * coverage).round() as u8;
    }
}

/// Returns the image reduced by a whole factor: each pixel is the mean of a square of `factor` x `factor` pixels.
pub fn shrink(image: &RgbImage, factor: u32) -> RgbImage {
    let factor = factor.max(1);
    RgbImage::from_fn(image.width() / factor, image.height() / factor, |x, y| {
        let mut sum = [0u32; 3];
        for (dx, dy) in (0..factor).flat_map(|dx| (0..factor).map(move |dy| (dx, dy))) {
            let pixel = image.get_pixel(x * factor + dx, y * factor + dy).0;
            sum.iter_mut().zip(pixel).for_each(|(sum, c)| *sum += u32::from(c));
        }
        Rgb(sum.map(|c| (c / (factor * factor)) as u8))
    })
}
