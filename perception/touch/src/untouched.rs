//! Untouched images of a sensor, and their subtraction from touch images.
//!
//! No two DIGITs look alike: LEDs, paint and camera differ. A contact changes the images of all DIGITs in the same way. A network that
//! sees only the change therefore works for any of them.

use image::RgbImage;
use ndarray::{Array2, Axis, s};

use crate::engine::{Engine, ImageSizeError, Prediction};

/// Grey level that a network sees where nothing touches: about the mean of a DIGIT's image, so that few differences are cut off.
pub const EVEN: u8 = 96;

/// Subtracts the untouched image of the same sensor from an image and adds [`EVEN`]. Both hold levels in the same order.
pub fn subtract_untouched(untouched: &[u8], image: &mut [u8]) {
    // Why: notes/decisions/touch.md, "The untouched image is subtracted".
    for (level, &empty) in image.iter_mut().zip(untouched) {
        *level = (i16::from(*level) - i16::from(empty) + i16::from(EVEN)).clamp(0, 255) as u8;
    }
}

/// Rounds of finding contacts and leaving them out.
const ROUNDS: usize = 3;
/// Distance from a contact within which pixels are left out, too, pixels: the gel bends around a contact.
const MARGIN: usize = 8;
/// A pixel that fewer images show without contact keeps the colour of the round before.
const LEAST_IMAGES: usize = 4;
/// Images of a call of the network: enough for all cores, and little memory.
const BATCH: usize = 32;

/// Estimates the untouched image of a sensor from its images: the median of each pixel and colour, first over all images, then over
/// those without contact at the pixel. A network finds the contacts after the estimate of the round before is subtracted. Returns `None`
/// without images, or if their sizes differ.
///
/// Contacts must lie at different places: a pixel may be in contact in most images, but not in all.
///
/// # Errors
/// [`ImageSizeError`] if the network cannot work with images of that size.
pub fn estimate(engine: &Engine, images: &[RgbImage]) -> Result<Option<RgbImage>, ImageSizeError> {
    let Some(first) = images.first() else { return Ok(None) };
    if images.iter().any(|image| image.dimensions() != first.dimensions()) {
        return Ok(None);
    }
    let mut untouched = first.clone();
    median(images, |_, _| true, &mut untouched);
    let mut predictions = Vec::new();
    for _ in 0..ROUNDS {
        let mut touches: Vec<Array2<bool>> = Vec::with_capacity(images.len());
        for batch in images.chunks(BATCH) {
            let mut seen = batch.to_vec();
            seen.iter_mut().for_each(|image| subtract_untouched(&untouched, image));
            engine.infer_each(&seen.iter().collect::<Vec<_>>(), &mut predictions)?;
            touches.extend(predictions.iter().map(touched));
        }
        median(images, |k, place| !touches[k][place], &mut untouched);
    }
    Ok(Some(untouched))
}

/// Writes the median of each pixel and colour over the images that show it; `shows` takes the image's number, row and column. Where too
/// few images do, the colour in `to` stays.
fn median(images: &[RgbImage], shows: impl Fn(usize, [usize; 2]) -> bool, to: &mut RgbImage) {
    let mut colors = Vec::new();
    for (column, row, median) in to.enumerate_pixels_mut() {
        let place = [row as usize, column as usize];
        colors.clear();
        colors.extend(
            images.iter().enumerate().filter(|(k, _)| shows(*k, place)).map(|(_, i)| i.get_pixel(column, row).0),
        );
        if colors.len() < LEAST_IMAGES.min(images.len()) {
            continue;
        }
        for (c, level) in median.0.iter_mut().enumerate() {
            let middle = colors.len() / 2;
            *level = colors.select_nth_unstable_by_key(middle, |color| color[c]).1[c];
        }
    }
}

/// Returns the pixels in and around predicted contact.
fn touched(prediction: &Prediction) -> Array2<bool> {
    let touches = prediction.contact_logit.mapv(|logit| logit > 0.0);
    // A square around a pixel is a stretch along rows and then along columns.
    [Axis(1), Axis(0)].into_iter().fold(touches, |from, axis| {
        let mut to = from.clone();
        for (line, mut wide) in from.lanes(axis).into_iter().zip(to.lanes_mut(axis)) {
            for (i, _) in line.iter().enumerate().filter(|(_, touches)| **touches) {
                let end = (i + MARGIN + 1).min(line.len());
                wide.slice_mut(s![i.saturating_sub(MARGIN)..end]).fill(true);
            }
        }
        to
    })
}

/// Greatest difference between mean colours over squares without contact and those of the untouched image, grey levels.
const SAME_SENSOR: f32 = 1.5;

/// Returns whether an image seems to come from the sensor of an untouched image: the two agree in a quarter of the image.
pub fn is_of_same_sensor(image: &RgbImage, untouched: &RgbImage) -> bool {
    image.dimensions() == untouched.dimensions() && differences(&squares(image), &squares(untouched)).1 < SAME_SENSOR
}

/// Returns by how many grey levels an image differs from an untouched one where nothing touches: the lower quartile over squares of the
/// greatest difference of a mean colour. Both have the same size.
pub fn difference_from_untouched(image: &RgbImage, untouched: &RgbImage) -> f32 {
    differences(&squares(image), &squares(untouched)).1
}

/// Side of the squares whose means are compared, pixels. It divides both sides of a DIGIT's image; of others the last pixels are left out.
const SQUARE: usize = 16;

/// Mean colours of the squares of an image, row by row.
pub(crate) type Squares = Vec<[f32; 3]>;

/// Returns the mean colours of squares.
pub(crate) fn squares(image: &RgbImage) -> Squares {
    let (width, columns) = (image.width() as usize, image.width() as usize / SQUARE);
    let rows = image.as_chunks::<3>().0.chunks_exact((width * SQUARE).max(1));
    rows.flat_map(|rows| {
        let mut sums = vec![[0_u32; 3]; columns];
        for row in rows.chunks_exact(width) {
            for (sum, pixels) in sums.iter_mut().zip(row.chunks_exact(SQUARE)) {
                for rgb in pixels {
                    for (sum, &level) in sum.iter_mut().zip(rgb) {
                        *sum += u32::from(level);
                    }
                }
            }
        }
        sums.into_iter().map(|sum| sum.map(|s| s as f32 / (SQUARE * SQUARE) as f32))
    })
    .collect()
}

/// Returns the greatest difference of a mean colour, and the lower quartile of the greatest differences of the squares. The quartile lies
/// outside contact unless contact covers three quarters of the image.
pub(crate) fn differences(a: &Squares, b: &Squares) -> (f32, f32) {
    let greatest = |(a, b): (&[f32; 3], &[f32; 3])| a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    let mut of_squares: Vec<f32> = a.iter().zip(b).map(greatest).collect();
    of_squares.sort_unstable_by(f32::total_cmp);
    (of_squares.last().copied().unwrap_or(0.0), of_squares.get(of_squares.len() / 4).copied().unwrap_or(0.0))
}

#[cfg(test)]
mod tests {
    use image::Rgb;
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn subtraction_keeps_the_change(empty in 0..200_u8, added in -90..50_i16) {
            let mut image = [(i16::from(empty) + added).clamp(0, 255) as u8];
            let added = i16::from(image[0]) - i16::from(empty);
            subtract_untouched(&[empty], &mut image);
            prop_assert_eq!(i16::from(image[0]) - i16::from(EVEN), added);
        }
    }

    #[test]
    fn contacts_at_different_places_leave_no_trace() {
        let empty = |u: u32, v: u32| Rgb([100 + u as u8, 50 + v as u8, 7]);
        let images: Vec<RgbImage> = (0..5)
            .map(|k| RgbImage::from_fn(10, 6, |u, v| if u / 2 == k { Rgb([255, 0, 200]) } else { empty(u, v) }))
            .collect();
        let mut untouched = RgbImage::new(10, 6);
        median(&images, |_, _| true, &mut untouched);
        assert_eq!(untouched, RgbImage::from_fn(10, 6, empty));
        // Most images touch the first column; the others determine the median, unless they are too few.
        let images: Vec<RgbImage> = (0..9)
            .map(|k| RgbImage::from_fn(10, 6, |u, v| if u == 0 && k < 5 { Rgb([255; 3]) } else { empty(u, v) }))
            .collect();
        median(&images, |_, _| true, &mut untouched);
        assert_eq!(*untouched.get_pixel(0, 0), Rgb([255; 3]));
        median(&images, |k, _| k > 5, &mut untouched);
        assert_eq!(*untouched.get_pixel(0, 0), Rgb([255; 3]));
        median(&images, |k, [_, u]| u > 0 || k > 4, &mut untouched);
        assert_eq!(untouched, RgbImage::from_fn(10, 6, empty));
    }

    #[test]
    fn contact_reaches_beyond_its_pixels() {
        let mut contact_logit = Array2::from_elem((40, 30), -1.0);
        contact_logit[[20, 3]] = 1.0;
        let indentation_mm = Array2::zeros((40, 30));
        let reached = touched(&Prediction { indentation_mm, contact_logit });
        for ((v, u), reached) in reached.indexed_iter() {
            assert_eq!(*reached, v.abs_diff(20) <= MARGIN && u.abs_diff(3) <= MARGIN, "{v}, {u}");
        }
    }
}
