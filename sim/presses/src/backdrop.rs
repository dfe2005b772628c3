//! Backgrounds of training images: many more kinds than synthetic sensors have, so that a real one is no surprise to
//! the network.

// Why: notes/decisions/touch.md, "Training backgrounds are never real".

use std::f32::consts::TAU;

use image::RgbImage;
use rand::RngExt as _;
use rand_chacha::ChaCha8Rng;

/// Shape of light on the gel. Places are shares of the image's width and height.
enum Shape {
    /// Frequency along both axes, phase.
    Wave([f32; 2], f32),
    /// Centre and radii of a pool of light.
    Pool([f32; 2], [f32; 2]),
    /// Normal, offset and width of a soft step: a lens's or a gel's border.
    Step([f32; 2], f32, f32),
}

impl Shape {
    /// Returns the share of its height at a place, -1 to 1.
    fn share(&self, [x, y]: [f32; 2]) -> f32 {
        match self {
            Self::Wave([fx, fy], phase) => (TAU * (fx * x + fy * y) + phase).cos(),
            Self::Pool([cx, cy], [rx, ry]) => (-0.5 * (((x - cx) / rx).powi(2) + ((y - cy) / ry).powi(2))).exp(),
            Self::Step([nx, ny], offset, width) => ((nx * x + ny * y - offset) / width).tanh(),
        }
    }

    /// Draws the shapes of an image, each with the share of the greatest height that it may have. A narrow shape is
    /// low, because a high one looks like contact.
    fn draw(rng: &mut ChaCha8Rng) -> Vec<(Self, f32)> {
        let mut shapes = Vec::new();
        let mut wave = |frequency: f32, rng: &mut ChaCha8Rng| {
            let along = rng.random::<f32>() * TAU;
            let height = (1.0 / frequency).min(1.0);
            shapes.push((
                Self::Wave([frequency * along.cos(), frequency * along.sin()], rng.random::<f32>() * TAU),
                if frequency > 1.5 { 0.4 * height } else { 1.0 },
            ));
        };
        for _ in 0..3 {
            wave(rng.random_range(0.2..1.5), rng);
        }
        for _ in 0..rng.random_range(0..4) {
            wave(rng.random_range(1.5..6.0), rng);
        }
        for _ in 0..rng.random_range(0..4) {
            let centre = [rng.random_range(-0.1..1.1), rng.random_range(-0.1..1.1)];
            let radius = [rng.random_range(0.05..0.4_f32), rng.random_range(0.05..0.4_f32)];
            shapes.push((Self::Pool(centre, radius), (5.0 * radius[0].min(radius[1])).min(1.0)));
        }
        for _ in 0..rng.random_range(0..3) {
            let (sin, cos) = (rng.random::<f32>() * TAU).sin_cos();
            let through = [rng.random::<f32>(), rng.random::<f32>()];
            let width = rng.random_range(0.02..0.2_f32);
            shapes.push((Self::Step([cos, sin], cos * through[0] + sin * through[1], width), (3.0 * width).min(0.4)));
        }
        shapes
    }
}

/// Width of a stripe, pixels, and its height as a share of the greatest change.
const STRIPE: usize = 3;
const STRIPES: f32 = 0.5;

/// Changes an image as a sensor changes by itself, with warmth and time: colours and their slow course over the image change by up to
/// `height` grey levels. Some cameras add faint stripes along the columns, and a gel that is dragged shows long soft folds.
pub fn drift(image: &mut RgbImage, height: f32, rng: &mut ChaCha8Rng) {
    let [width, rows] = size(image);
    let mut color = |height: f32| -> [f32; 3] { std::array::from_fn(|_| height * (2.0 * rng.random::<f32>() - 1.0)) };
    // Offset and slopes; together they reach the height at a corner.
    let [offset, across, down] = [color(0.5 * height), color(0.25 * height), color(0.25 * height)];
    let stripes: Vec<[f32; 3]> = (0..width.div_ceil(STRIPE) + 1).map(|_| color(STRIPES * height)).collect();
    let folds = rng.random_range(0..4);
    for _ in 0..folds {
        fold(image, height, rng);
    }
    let striped = if rng.random_bool(0.4) { 1.0 } else { 0.0 };
    for (u, v, pixel) in image.enumerate_pixels_mut() {
        let stripe = stripes[u as usize / STRIPE];
        let [x, y] = [2.0 * u as f32 / width as f32 - 1.0, 2.0 * v as f32 / rows as f32 - 1.0];
        for (c, level) in pixel.0.iter_mut().enumerate() {
            *level = grey_level(f32::from(*level) + offset[c] + x * across[c] + y * down[c] + striped * stripe[c]);
        }
    }
}

/// Light is computed at every Nth pixel along both axes and interpolated.
const SPACING: usize = 4;

/// Disturbs the background of an image: several shapes change brightness and colour by up to about `height` grey levels
/// each, and specks are added.
pub fn disturb(image: &mut RgbImage, height: f32, rng: &mut ChaCha8Rng) {
    let color = |height: f32, rng: &mut ChaCha8Rng| -> [f32; 3] {
        std::array::from_fn(|_| height * (2.0 * rng.random::<f32>() - 1.0))
    };
    let offset = color(height, rng);
    let shapes: Vec<(Shape, [f32; 3])> =
        Shape::draw(rng).into_iter().map(|(shape, share)| (shape, color(share * height, rng))).collect();
    let [width, rows] = size(image);
    let columns = width.div_ceil(SPACING) + 1;
    let light: Vec<[f32; 3]> = (0..columns * (rows.div_ceil(SPACING) + 1))
        .map(|i| {
            let place = [i % columns * SPACING, i / columns * SPACING];
            let place = [place[0] as f32 / width as f32, place[1] as f32 / rows as f32];
            shapes.iter().fold(offset, |sum, (shape, color)| {
                let share = shape.share(place);
                std::array::from_fn(|c| sum[c] + share * color[c])
            })
        })
        .collect();
    let between =
        |a: &[f32; 3], b: &[f32; 3], t: f32| -> [f32; 3] { std::array::from_fn(|c| a[c] + t * (b[c] - a[c])) };
    let pixels: &mut [u8] = image;
    for (v, row) in pixels.chunks_exact_mut(3 * width).enumerate() {
        let upper = v / SPACING * columns;
        let down = (v % SPACING) as f32 / SPACING as f32;
        let knots: Vec<[f32; 3]> =
            (upper..upper + columns).map(|i| between(&light[i], &light[i + columns], down)).collect();
        for (u, pixel) in row.as_chunks_mut::<3>().0.iter_mut().enumerate() {
            let across = (u % SPACING) as f32 / SPACING as f32;
            let added = between(&knots[u / SPACING], &knots[u / SPACING + 1], across);
            for (level, added) in pixel.iter_mut().zip(added) {
                *level = grey_level(f32::from(*level) + added);
            }
        }
    }
    for _ in 0..rng.random_range(0..12) {
        speck(image, rng);
    }
}

/// Adds a fold: a long soft streak in any colour.
fn fold(image: &mut RgbImage, height: f32, rng: &mut ChaCha8Rng) {
    let [width, rows] = size(image);
    let (x, y) = (rng.random::<f32>() * width as f32, rng.random::<f32>() * rows as f32);
    let (sin, cos) = (rng.random::<f32>() * TAU).sin_cos();
    let (length, breadth) = (rng.random_range(30.0..120.0_f32), rng.random_range(8.0..30.0_f32));
    let heights: [f32; 3] = std::array::from_fn(|_| height * (2.0 * rng.random::<f32>() - 1.0));
    for (u, v, pixel) in image.enumerate_pixels_mut() {
        let (dx, dy) = (u as f32 - x, v as f32 - y);
        let (along, across) = ((dx * cos + dy * sin) / length, (dy * cos - dx * sin) / breadth);
        let square = along * along + across * across;
        if square < 9.0 {
            let share = (-0.5 * square).exp();
            for (level, height) in pixel.0.iter_mut().zip(heights) {
                *level = grey_level(f32::from(*level) + share * height);
            }
        }
    }
}

/// Adds a grain of dust or the end of a scratch: a small round spot, darker or lighter.
fn speck(image: &mut RgbImage, rng: &mut ChaCha8Rng) {
    let [width, rows] = size(image);
    let (x, y) = (rng.random_range(0..width) as f32, rng.random_range(0..rows) as f32);
    let radius = rng.random_range(1.0..4.0_f32);
    let heights: [f32; 3] = std::array::from_fn(|_| rng.random_range(-10.0..6.0_f32));
    let reach = (3.0 * radius).ceil();
    let span = |at: f32, side: usize| ((at - reach).max(0.0) as u32)..((at + reach) as u32 + 1).min(side as u32);
    for (v, u) in span(y, rows).flat_map(|v| span(x, width).map(move |u| (v, u))) {
        let (dx, dy) = (u as f32 - x, v as f32 - y);
        let share = (-(dx * dx + dy * dy) / (2.0 * radius * radius)).exp();
        for (level, height) in image.get_pixel_mut(u, v).0.iter_mut().zip(heights) {
            *level = grey_level(f32::from(*level) + share * height);
        }
    }
}

/// Rounds to a grey level, halves upwards. Unlike [`f32::round`] it is no call of a function for each pixel.
pub fn grey_level(value: f32) -> u8 {
    let whole = value as i32;
    (whole + i32::from(value - whole as f32 >= 0.5)).clamp(0, 255) as u8
}

/// Returns width and height of an image.
fn size(image: &RgbImage) -> [usize; 2] {
    [image.width() as usize, image.height() as usize]
}

/// Encodes and decodes an image as JPEG, since TACTO's backgrounds are JPEG files.
pub fn through_jpeg(image: &RgbImage, quality: u8) -> image::ImageResult<RgbImage> {
    let mut file = Vec::new();
    image::codecs::jpeg::JpegEncoder::new_with_quality(&mut file, quality).encode_image(image)?;
    Ok(image::load_from_memory_with_format(&file, image::ImageFormat::Jpeg)?.into_rgb8())
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng as _;

    use mvt_robot::digit::{HEIGHT, WIDTH};

    use super::*;

    #[test]
    fn images_of_any_size_are_disturbed() {
        let mut image = RgbImage::from_pixel(97, 33, image::Rgb([128; 3]));
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        disturb(&mut image, 20.0, &mut rng);
        drift(&mut image, 20.0, &mut rng);
        assert!(image.pixels().any(|pixel| pixel.0 != [128; 3]));
    }

    fn disturbed(height: f32, seed: u64) -> RgbImage {
        let mut image = RgbImage::from_pixel(WIDTH as u32, HEIGHT as u32, image::Rgb([128; 3]));
        disturb(&mut image, height, &mut ChaCha8Rng::seed_from_u64(seed));
        image
    }

    #[test]
    fn light_is_smooth_and_as_high_as_asked_for() {
        assert_eq!(disturbed(20.0, 1), disturbed(20.0, 1));
        for seed in 0..20 {
            let image = disturbed(20.0, seed);
            let levels: Vec<f32> = image.pixels().map(|p| f32::from(p.0[0])).collect();
            let rms = (levels.iter().map(|x| (x - 128.0).powi(2)).sum::<f32>() / levels.len() as f32).sqrt();
            assert!(rms > 1.0 && rms < 50.0, "seed {seed}: {rms}");
            let steps = image.pixels().zip(image.pixels().skip(1)).filter(|(a, b)| a.0[0].abs_diff(b.0[0]) > 4).count();
            // Only specks and the ends of rows are steep.
            assert!(steps < 3 * HEIGHT, "seed {seed}: {steps}");
        }
    }

    #[test]
    fn jpeg_changes_little() {
        let image = disturbed(20.0, 3);
        let saved = through_jpeg(&image, 90).unwrap();
        assert_ne!(saved, image);
        assert!(saved.iter().zip(image.iter()).all(|(a, b)| a.abs_diff(*b) < 16));
    }
}
