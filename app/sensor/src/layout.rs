//! How the images of a touch sensor lie: upright or turned, in RGB or BGR order.

use image::RgbImage;
use image::imageops::{FilterType, flip_horizontal, resize, rotate90, rotate180, rotate270};

/// Turn and order of the colours of a sensor's images.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct ImageLayout {
    /// Number of clockwise quarter turns that put the image upright, 0 to 3.
    pub quarter_turns: u8,
    /// Whether red and blue are exchanged.
    pub is_bgr: bool,
    /// Whether left and right are exchanged once the image is upright.
    pub is_mirrored: bool,
}

/// Slope of red, green and blue of an untouched DIGIT towards the right and downwards, in shares of the colour's mean from the middle of
/// the image to its border, times a third. Mean of images of two real sensors.
const UPRIGHT: [[f32; 2]; 3] = [[-0.18, -0.10], [0.05, -0.09], [-0.07, 0.0]];
/// An image must fit another layout better by this, in the units of [`UPRIGHT`], before it counts as not upright.
const MARGIN: f32 = 0.08;

impl ImageLayout {
    /// Returns the layout of the untouched image of a sensor with upright images of this width and height. Where no other layout fits
    /// clearly better than upright and RGB, it is that. Only two turns are possible for an image that is not square.
    pub fn of(untouched: &RgbImage, size_px: [usize; 2]) -> Self {
        let (width, height) = untouched.dimensions();
        let found = slopes(untouched);
        let is_wide = size_px[0] > size_px[1];
        let possible = |turns: u8| width == height || (turns % 2 == 1) == ((width > height) != is_wide);
        let all = (0..4)
            .filter(|&turns| possible(turns))
            .flat_map(|quarter_turns| [false, true].map(|is_bgr| Self { quarter_turns, is_bgr, is_mirrored: false }));
        let misfit = |layout: &Self| layout.misfit(found);
        let mirrored = all.clone().map(|layout| Self { is_mirrored: true, ..layout });
        let best_of = |a: Option<Self>, b: Option<Self>| match (a, b) {
            (Some(a), Some(b)) if misfit(&b) + MARGIN < misfit(&a) => b,
            (a, _) => a.unwrap_or_default(),
        };
        let least = |a: &Self, b: &Self| misfit(a).total_cmp(&misfit(b));
        let best = best_of(all.clone().min_by(least), mirrored.min_by(least));
        // The least change of the image that its shape allows.
        let plain = all.min_by_key(|layout| (layout.is_bgr, layout.quarter_turns)).unwrap_or_default();
        if misfit(&best) + MARGIN < misfit(&plain) { best } else { plain }
    }

    /// Returns an image upright, in RGB order and of this width and height.
    pub fn upright(self, image: &RgbImage, size_px: [usize; 2]) -> RgbImage {
        let mut image = match self.quarter_turns {
            1 => rotate90(image),
            2 => rotate180(image),
            3 => rotate270(image),
            _ => image.clone(),
        };
        if self.is_mirrored {
            image = flip_horizontal(&image);
        }
        if self.is_bgr {
            image.pixels_mut().for_each(|pixel| pixel.0.swap(0, 2));
        }
        let [width, height] = size_px.map(|side| side as u32);
        if image.dimensions() == (width, height) { image } else { resize(&image, width, height, FilterType::Triangle) }
    }

    /// Returns how far the slopes of an image are from those of an upright sensor once the image is put upright.
    fn misfit(self, mut slopes: [[f32; 2]; 3]) -> f32 {
        if self.is_bgr {
            slopes.swap(0, 2);
        }
        for _ in 0..self.quarter_turns {
            // A clockwise turn makes down of right, and left of down.
            slopes = slopes.map(|[right, down]| [-down, right]);
        }
        if self.is_mirrored {
            slopes = slopes.map(|[right, down]| [-right, down]);
        }
        let square = |(a, b): (&[f32; 2], &[f32; 2])| (a[0] - b[0]).powi(2) + (a[1] - b[1]).powi(2);
        slopes.iter().zip(&UPRIGHT).map(square).sum::<f32>().sqrt()
    }
}

/// Returns the mean slope of each colour towards the right and downwards.
fn slopes(image: &RgbImage) -> [[f32; 2]; 3] {
    let (width, height) = image.dimensions();
    let (mut sums, mut moments) = ([0.0_f64; 3], [[0.0_f64; 2]; 3]);
    for (u, v, pixel) in image.enumerate_pixels() {
        let place = [(u, width), (v, height)].map(|(at, side)| (2.0 * f64::from(at) + 1.0) / f64::from(side) - 1.0);
        for c in 0..3 {
            let level = f64::from(pixel.0[c]);
            sums[c] += level;
            for (moment, place) in moments[c].iter_mut().zip(place) {
                *moment += level * place;
            }
        }
    }
    std::array::from_fn(|c| moments[c].map(|moment| (moment / sums[c].max(1.0)) as f32))
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::Rgb;

    const DIGIT: [usize; 2] = [240, 320];

    fn sensor() -> RgbImage {
        RgbImage::from_fn(240, 320, |u, v| {
            let place = [u as f32 / 120.0 - 1.0, v as f32 / 160.0 - 1.0];
            Rgb(UPRIGHT.map(|slope| (95.0 * (1.0 + 3.0 * (slope[0] * place[0] + slope[1] * place[1]))) as u8))
        })
    }

    #[test]
    fn turns_and_orders_of_colours_are_found() {
        let image = sensor();
        assert_eq!(ImageLayout::of(&image, DIGIT), ImageLayout::default());
        let layout = |quarter_turns, is_bgr| ImageLayout { quarter_turns, is_bgr, is_mirrored: false };
        assert_eq!(ImageLayout::of(&rotate90(&image), DIGIT), layout(3, false));
        assert_eq!(ImageLayout::of(&rotate180(&image), DIGIT), layout(2, false));
        assert_eq!(ImageLayout::of(&rotate270(&image), DIGIT), layout(1, false));
        // A mirror is no half turn, whichever sides it exchanges.
        let mirrored = |quarter_turns| ImageLayout { is_mirrored: true, ..layout(quarter_turns, false) };
        assert_eq!(ImageLayout::of(&flip_horizontal(&image), DIGIT), mirrored(0));
        assert_eq!(ImageLayout::of(&image::imageops::flip_vertical(&image), DIGIT), mirrored(2));
        assert_eq!(mirrored(2).upright(&image::imageops::flip_vertical(&image), DIGIT), image);
        let mut swapped = image;
        swapped.pixels_mut().for_each(|pixel| pixel.0.swap(0, 2));
        assert_eq!(ImageLayout::of(&swapped, DIGIT), layout(0, true));
        assert_eq!(ImageLayout::of(&rotate90(&swapped), DIGIT), layout(3, true));
    }

    #[test]
    fn an_even_image_stays_as_it_is() {
        assert_eq!(ImageLayout::of(&RgbImage::from_pixel(240, 320, Rgb([90; 3])), DIGIT), ImageLayout::default());
        // Only a quarter turn makes it upright.
        assert_eq!(ImageLayout::of(&RgbImage::from_pixel(320, 240, Rgb([90; 3])), DIGIT).quarter_turns, 1);
        // A sensor that is wider than tall.
        let wide = RgbImage::from_pixel(128, 96, Rgb([90; 3]));
        assert_eq!(ImageLayout::of(&wide, [64, 48]), ImageLayout::default());
        assert_eq!(ImageLayout::default().upright(&wide, [64, 48]).dimensions(), (64, 48));
    }
}
