//! Whether colours lie on depth.
//!
//! Masks of a sequence belong to its depth. Where they end, an object ends in the colours, too, so that brightness changes there more than it
//! does a few pixels beside. If it does not, the colour camera stands elsewhere and its images are not registered.

use image::RgbImage;
use ndarray::{Array2, s};

/// Displacements that are compared reach so many pixels to each side.
const REACH_PX: usize = 16;
/// Masks may err by so many pixels.
const NEAR_PX: usize = 4;
/// Masks of fewer pixels show no edges.
const FEWEST_PIXELS: usize = 500;

/// Frames in which colours are compared with masks.
const COMPARED: usize = 12;
/// Colours lie on depth above this score: sequences that are registered have 2.9 to 6, those of 7-Scenes, which are not, 0.6 at most.
const REGISTERED: f64 = 1.5;

/// What is said of a sequence whose colours do not lie on depth.
pub const UNREGISTERED: &str = "the colours do not lie on depth (they show no edges where the masks end), so that they are not used, and the intrinsics are doubted: register them to depth, and calibrate the camera";

/// Returns whether the colours of a sequence show edges where its masks end. Reads some of the frames with these numbers, which have a mask.
///
/// # Errors
/// Those of `read`.
pub fn are_colours_registered<E>(
    masked: &[usize],
    mut read: impl FnMut(usize) -> Result<(RgbImage, Array2<bool>), E>,
) -> Result<bool, E> {
    let mut registration = Registration::new();
    for &k in masked.iter().step_by(masked.len().div_ceil(COMPARED).max(1)) {
        let (color, mask) = read(k)?;
        registration.take(&color, &mask);
    }
    Ok(registration.score().is_none_or(|score| score > REGISTERED))
}

/// Evidence from frames of a sequence.
#[derive(Debug, Clone)]
struct Registration {
    /// How far the brightness changes where masks end, by displacement, each frame in standard deviations over all displacements.
    scores: Array2<f64>,
    frames: usize,
}

impl Registration {
    fn new() -> Self {
        Self { scores: Array2::zeros([2 * REACH_PX + 1; 2]), frames: 0 }
    }

    /// Takes a frame, unless its mask is small or touches the border of the image.
    fn take(&mut self, color: &RgbImage, mask: &Array2<bool>) {
        let (rows, columns) = mask.dim();
        let grey = |u: usize, v: usize| {
            color.get_pixel_checked(u as u32, v as u32).map_or(0.0, |p| p.0.iter().map(|&c| f32::from(c)).sum::<f32>())
        };
        let inside = |u: usize, v: usize| mask.get((v, u)).copied().unwrap_or(false);
        let mut edge = Vec::new();
        for v in 1..rows.saturating_sub(1) {
            for u in 1..columns.saturating_sub(1) {
                if inside(u, v) && !(inside(u - 1, v) && inside(u + 1, v) && inside(u, v - 1) && inside(u, v + 1)) {
                    edge.push([u, v]);
                }
            }
        }
        let border = REACH_PX + 1;
        let is_far = |&[u, v]: &[usize; 2]| u >= border && v >= border && u + border < columns && v + border < rows;
        if mask.iter().filter(|inside| **inside).count() < FEWEST_PIXELS || edge.is_empty() || !edge.iter().all(is_far)
        {
            return;
        }
        let slope = |u: usize, v: usize| {
            let (x, y) = (grey(u + 1, v) - grey(u - 1, v), grey(u, v + 1) - grey(u, v - 1));
            f64::from(1.0 + x.hypot(y)).ln()
        };
        let scores = Array2::from_shape_fn(self.scores.dim(), |(dv, du)| {
            edge.iter().map(|[u, v]| slope(u + du - REACH_PX, v + dv - REACH_PX)).sum::<f64>() / edge.len() as f64
        });
        let (mean, deviation) = (scores.mean().unwrap_or(0.0), scores.std(0.0));
        if deviation > 0.0 {
            self.scores += &((scores - mean) / deviation);
            self.frames += 1;
        }
    }

    /// How far the brightness changes where masks end, give or take some pixels, standard deviations above its changes at all displacements;
    /// `None` before a frame.
    fn score(&self) -> Option<f64> {
        let near = REACH_PX - NEAR_PX..=REACH_PX + NEAR_PX;
        let greatest = self.scores.slice(s![near.clone(), near]).iter().copied().max_by(f64::total_cmp)?;
        (self.frames > 0).then(|| greatest / self.frames as f64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The score of a disc whose colours are displaced, on ground with stripes.
    fn score(shift: usize) -> f64 {
        let is_disc = |u: usize, v: usize| (u as f64 - 60.0).powi(2) + (v as f64 - 50.0).powi(2) < 400.0;
        let mask = Array2::from_shape_fn((100, 130), |(v, u)| is_disc(u, v));
        let color = RgbImage::from_fn(130, 100, |u, v| {
            let level = if is_disc(u as usize + shift, v as usize + shift) { 200 } else { 90 + 20 * (u / 9 % 2) as u8 };
            image::Rgb([level; 3])
        });
        let mut registration = Registration::new();
        registration.take(&color, &mask);
        registration.score().unwrap()
    }

    #[test]
    fn colours_that_are_displaced_show_no_edges_where_masks_end() {
        assert!(score(0) > 3.0, "{}", score(0));
        assert!(score(2) > 3.0, "masks err: {}", score(2));
        assert!(score(12) < 1.0, "{}", score(12));
    }

    #[test]
    fn small_masks_and_those_at_the_border_say_nothing() {
        let mut registration = Registration::new();
        registration.take(&RgbImage::new(130, 100), &Array2::from_shape_fn((100, 130), |(v, u)| u < 40 && v < 40));
        registration.take(&RgbImage::new(130, 100), &Array2::from_shape_fn((100, 130), |(v, u)| u == v));
        assert_eq!(registration.score(), None);
    }
}
