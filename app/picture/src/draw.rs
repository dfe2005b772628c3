//! Rectangles, lines and single pixels on images.

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

/// Draws a straight line between two points, columns and rows of pixel centres. Parts outside the image are skipped.
pub fn line(image: &mut RgbImage, from: [f32; 2], to: [f32; 2], width: f32, colour: Rgb<u8>) {
    let way = [to[0] - from[0], to[1] - from[1]];
    let square = (way[0] * way[0] + way[1] * way[1]).max(1e-6);
    let half = 0.5 * width.max(0.0);
    // Conversions of negative numbers saturate at 0.
    let span = |axis: usize| {
        let (low, high) = (from[axis].min(to[axis]), from[axis].max(to[axis]));
        (low - half - 1.0) as u32..=(high + half + 1.0) as u32
    };
    let (width, height) = image.dimensions();
    for y in span(1).take_while(|y| *y < height) {
        for x in span(0).take_while(|x| *x < width) {
            let here = [x as f32 - from[0], y as f32 - from[1]];
            let along = ((here[0] * way[0] + here[1] * way[1]) / square).clamp(0.0, 1.0);
            let beside = (here[0] - along * way[0]).hypot(here[1] - along * way[1]);
            blend(image, x, y, colour, half + 0.5 - beside);
        }
    }
}

/// Draws an arrow. Its head is a third of its length, at most 6 pixels.
pub fn arrow(image: &mut RgbImage, from: [f32; 2], to: [f32; 2], width: f32, colour: Rgb<u8>) {
    line(image, from, to, width, colour);
    let way = [to[0] - from[0], to[1] - from[1]];
    let length = way[0].hypot(way[1]);
    if length < 1.0 {
        return;
    }
    let head = (length / 3.0).min(6.0) / length;
    for side in [-0.6, 0.6] {
        let back = [way[0] - side * way[1], way[1] + side * way[0]];
        line(image, to, [to[0] - head * back[0], to[1] - head * back[1]], width, colour);
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_cover_their_pixels_and_are_cut_off_at_the_border() {
        let mut image = RgbImage::new(20, 10);
        line(&mut image, [-5.0, 4.0], [30.0, 4.0], 1.0, Rgb([200; 3]));
        for (x, y, pixel) in image.enumerate_pixels() {
            assert_eq!(pixel.0[0] > 0, y == 4, "({x}, {y}): {pixel:?}");
        }
        arrow(&mut image, [2.0, 8.0], [14.0, 8.0], 1.0, Rgb([90, 0, 0]));
        assert_eq!(image.get_pixel(8, 8).0, [90, 0, 0]);
        assert!(image.get_pixel(11, 6).0[0] > 0 && image.get_pixel(5, 6).0[0] == 0, "the head is at the end");
    }
}
