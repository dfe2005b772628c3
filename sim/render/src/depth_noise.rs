//! Noise of a consumer depth camera, after the Redwood noise model (Choi, Zhou and Koltun, "Robust Reconstruction of
//! Indoor Scenes", 2015; the disparity step is that of Barron and Malik, 2013), with NeuralFeels' multiplier.
//!
//! Three things happen to each pixel. It shows the depth of a pixel nearby, which frays edges. That depth is read from
//! a grid of half the resolution, as a stereo matcher has it. And its disparity is disturbed and rounded to an eighth
//! of a pixel, so that errors grow with the square of the distance. The model's table of lens distortion was measured
//! on one camera and has a licence of its own: its factor is 1 here.
//!
//! The constants of the model are those of `simdepth.py`, the script of the Redwood data set, which Habitat-Sim (class
//! `RedwoodDepthNoiseModel`) and NeuralFeels use.

use std::ops::Range;
use std::sync::LazyLock;

use ndarray::Array2;
use rand::{Rng as _, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Focal length times baseline of the modelled camera, pixels times metres (`simdepth.py`): disparity in pixels is this
/// over the depth in metres.
const DISPARITY_M: f64 = 35.130;
/// Steps of disparity per pixel (`simdepth.py`): the stereo matcher interpolates to an eighth of a pixel.
const STEPS: f64 = 8.0;
/// Standard deviation of a pixel's displacement for multiplier 1, pixels (`simdepth.py`).
const JITTER_PX: f64 = 0.25;
/// Standard deviation of the disparity for multiplier 1, pixels (`simdepth.py`): 1/36.
const DISPARITY_NOISE_PX: f64 = 0.027_778;
/// Words of the random stream that belong to each pixel: 16 bits for each of three normal numbers, two for the displacement
/// and one for the disparity, and 16 that are dropped.
const WORDS: u128 = 2;
/// Depth at and above which the camera measures nothing, metres (`simdepth.py`).
const FARTHEST_M: f32 = 10.0;

/// Identity of a frame. Its noise depends on these numbers alone, not on the order in which frames are rendered.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FrameId {
    /// Seed of the episode.
    pub seed: u64,
    /// Index of the camera.
    pub camera: u32,
    /// Index of the frame.
    pub frame: u32,
}

/// Returns the measured version of a true depth image: metres, rows by columns, 0 where nothing is measured.
/// `multiplier` scales the noise (NeuralFeels simulates with 5); with 0 the half-resolution lookup and the rounding of
/// the disparity remain.
pub fn disturb(depth_m: &Array2<f32>, multiplier: f64, id: FrameId) -> Array2<f32> {
    let mut random = ChaCha8Rng::seed_from_u64(id.seed);
    random.set_stream(u64::from(id.camera) << 32 | u64::from(id.frame));
    let (height, width) = depth_m.dim();
    let near = Near::new(depth_m, multiplier);
    let mut noisy = Array2::zeros((height, width));
    for (v, mut row) in noisy.rows_mut().into_iter().enumerate() {
        for columns in near.columns(v, width) {
            // The position of the stream after all pixels before this one.
            random.set_word_pos(WORDS * (v * width + columns.start) as u128);
            for u in columns {
                row[u] = measure(depth_m, multiplier, [v, u], &mut random);
            }
        }
    }
    noisy
}

/// Returns the measured depth of a pixel, and uses the next [`WORDS`] of the stream.
fn measure(depth_m: &Array2<f32>, multiplier: f64, [v, u]: [usize; 2], random: &mut ChaCha8Rng) -> f32 {
    let (height, width) = depth_m.dim();
    let bits = random.next_u64();
    let [jitter_v, jitter_u, disparity_noise] = [0, 16, 32].map(|shift| f64::from(normal((bits >> shift) as u16)));
    let (v, u) = (moved(v, jitter_v, multiplier, height), moved(u, jitter_u, multiplier, width));
    let depth = depth_m[(v - v % 2, u - u % 2)];
    if !is_measured(depth) {
        return 0.0;
    }
    let disparity = DISPARITY_M / f64::from(depth) + DISPARITY_NOISE_PX * multiplier * disparity_noise;
    let steps = (disparity * STEPS).round_ties_even();
    if steps > 0.0 { (DISPARITY_M * STEPS / steps) as f32 } else { 0.0 }
}

/// Returns whether the camera measures anything at a depth.
fn is_measured(depth_m: f32) -> bool {
    depth_m > 0.0 && depth_m < FARTHEST_M
}

/// Blocks of pixels that may show a measured depth. Most of an image is empty, and noise leaves empty pixels empty.
struct Near {
    blocks: Array2<bool>,
}

impl Near {
    /// Edge of a block, pixels.
    const BLOCK: usize = 16;

    fn new(depth_m: &Array2<f32>, multiplier: f64) -> Self {
        // One pixel for rounding, one for the grid of half the resolution.
        let reach_px = f64::from(normal(u16::MAX >> 1)) * JITTER_PX * multiplier.abs() + 2.0;
        let reach = (reach_px / Self::BLOCK as f64).ceil().min(1e6) as usize;
        let (rows, columns) = depth_m.dim();
        let mut blocks = Array2::from_elem((rows.div_ceil(Self::BLOCK), columns.div_ceil(Self::BLOCK)), false);
        for ((v, u), _) in depth_m.indexed_iter().filter(|&(_, &depth)| is_measured(depth)) {
            blocks[(v / Self::BLOCK, u / Self::BLOCK)] = true;
        }
        let (rows, columns) = blocks.dim();
        let around = |k: usize, count: usize| k.saturating_sub(reach)..(k + reach + 1).min(count);
        let any = |(v, u)| around(v, rows).any(|v| around(u, columns).any(|u| blocks[(v, u)]));
        Self { blocks: Array2::from_shape_fn((rows, columns), any) }
    }

    /// Returns the columns of a row to which the noise may move a measured depth, from left to right.
    fn columns(&self, v: usize, width: usize) -> impl Iterator<Item = Range<usize>> {
        let blocks = self.blocks.row(v / Self::BLOCK);
        let mut next = 0;
        std::iter::from_fn(move || {
            let start = (next..blocks.len()).find(|&k| blocks[k])?;
            let end = (start..blocks.len()).find(|&k| !blocks[k]).unwrap_or(blocks.len());
            next = end;
            Some(start * Self::BLOCK..(end * Self::BLOCK).min(width))
        })
    }
}

/// Returns the pixel that is read in place of pixel `at` of `count`.
fn moved(at: usize, jitter: f64, multiplier: f64, count: usize) -> usize {
    let position = (at as f64 + JITTER_PX * multiplier * jitter).clamp(0.0, count as f64 - 1.0);
    // A conversion to u32 is faster than one to usize.
    (position + 0.5) as u32 as usize
}

/// Magnitudes of standard normal numbers of equal probability, from small to large: the quantiles (k + 1/2) / 2^15 of the
/// magnitude. The largest is 4.2. A table takes a tenth of the time of logarithm and cosine.
static MAGNITUDES: LazyLock<Vec<f32>> = LazyLock::new(|| {
    const COUNT: usize = 1 << 15;
    /// Step of the midpoint rule; its error is far below the spacing of the quantiles.
    const STEP: f64 = 1e-5;
    let density = |x: f64| (-0.5 * x * x).exp() * (2.0 / std::f64::consts::PI).sqrt();
    let (mut x, mut probability) = (0.0, 0.0);
    let quantile = |k| {
        while probability < (k as f64 + 0.5) / COUNT as f64 {
            probability += STEP * density(x + 0.5 * STEP);
            x += STEP;
        }
        x as f32
    };
    (0..COUNT).map(quantile).collect()
});

/// Turns 16 uniform bits into a standard normal number: a sign and a magnitude.
fn normal(bits: u16) -> f32 {
    let magnitude = MAGNITUDES[usize::from(bits & 0x7fff)];
    if bits >> 15 == 0 { magnitude } else { -magnitude }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ID: FrameId = FrameId { seed: 7, camera: 1, frame: 30 };

    fn spread(values: impl Iterator<Item = f64>) -> (f64, f64) {
        let values: Vec<f64> = values.collect();
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        (mean, (values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / values.len() as f64).sqrt())
    }

    #[test]
    fn normal_numbers_have_the_moments_and_tails_of_the_distribution() {
        let all: Vec<f64> = (0..=u16::MAX).map(|bits| f64::from(normal(bits))).collect();
        let moment = |power| all.iter().map(|x| x.powi(power)).sum::<f64>() / all.len() as f64;
        assert_eq!(moment(1), 0.0);
        assert!((moment(2) - 1.0).abs() < 1e-3 && (moment(4) - 3.0).abs() < 0.02, "{} {}", moment(2), moment(4));
        // 0.27 % of normal numbers lie beyond 3 deviations, 31.7 % beyond 1.
        for (bar, share) in [(3.0, 0.002_700), (1.0, 0.317_311)] {
            let found = all.iter().filter(|x| x.abs() > bar).count() as f64 / all.len() as f64;
            assert!((found - share).abs() < 1e-4, "{found} beyond {bar}");
        }
    }

    #[test]
    fn flat_wall_spreads_as_the_model_says() {
        for (depth, multiplier) in [(0.35, 5.0), (0.35, 1.0), (1.0, 5.0)] {
            let wall = Array2::from_elem((240, 320), depth as f32);
            let noisy = disturb(&wall, multiplier, ID);
            // In disparity: the Gaussian, and rounding to steps of 1/8 pixel, whose variance is step^2 / 12.
            let (mean, deviation) = spread(noisy.iter().map(|&d| DISPARITY_M / f64::from(d)));
            let expected = (DISPARITY_NOISE_PX * multiplier).hypot(0.125 / 12f64.sqrt());
            assert!((mean - DISPARITY_M / depth).abs() < 0.04, "{mean}");
            if multiplier > 1.0 {
                assert!((deviation / expected - 1.0).abs() < 0.03, "{deviation} instead of {expected}");
            }
            for &d in &noisy {
                let steps = DISPARITY_M * STEPS / f64::from(d);
                assert!((steps - steps.round()).abs() < 1e-3, "not on the disparity grid: {d}");
            }
        }
    }

    #[test]
    fn pixels_move_by_a_quarter_times_the_multiplier() {
        // A ramp: the depth of a pixel is that of one column alone.
        let columns = 512;
        let ramp = Array2::from_shape_fn((300, columns), |(_, u)| (DISPARITY_M / (100.0 + u as f64)) as f32);
        let noisy = disturb(&ramp, 5.0, ID);
        let shift = noisy
            .indexed_iter()
            .filter(|((_, u), _)| (20..columns - 20).contains(u))
            .map(|((_, u), &d)| DISPARITY_M / f64::from(d) - 100.0 - u as f64);
        let (mean, deviation) = spread(shift);
        // The lookup rounds the column down to an even one: half a pixel on average, variance 1/4. Rounding to a pixel
        // adds 1/12, and the disparity adds its own noise.
        let expected = ((0.25f64 * 5.0).powi(2) + 0.25 + 1.0 / 12.0 + (DISPARITY_NOISE_PX * 5.0).powi(2)).sqrt();
        assert!((mean + 0.5).abs() < 0.02, "{mean}");
        assert!((deviation / expected - 1.0).abs() < 0.02, "{deviation} instead of {expected}");
    }

    #[test]
    fn without_noise_half_resolution_and_rounding_remain() {
        let depth = Array2::from_shape_fn((5, 7), |(v, u)| 0.3 + 0.01 * (7 * v + u) as f32);
        let exact = disturb(&depth, 0.0, ID);
        for ((v, u), &d) in exact.indexed_iter() {
            let source = f64::from(depth[(v - v % 2, u - u % 2)]);
            assert!((DISPARITY_M / f64::from(d) - DISPARITY_M / source).abs() <= 1.0 / 16.0 + 1e-4, "({v}, {u})");
        }
    }

    #[test]
    fn empty_space_changes_nothing_elsewhere() {
        // With depth everywhere no pixel is skipped. Both images must agree wherever they show the patch.
        let patch = |v: usize, u: usize| (60..90).contains(&v) && (101..140).contains(&u);
        for multiplier in [0.0, 1.0, 5.0, 20.0] {
            let full = Array2::from_shape_fn((200, 240), |(v, u)| if patch(v, u) { 0.4f32 } else { 5.0 });
            let sparse = full.mapv(|z| if z < 1.0 { z } else { 0.0 });
            let (full, sparse) = (disturb(&full, multiplier, ID), disturb(&sparse, multiplier, ID));
            assert!(sparse.iter().any(|&z| z > 0.0));
            for (&with, &without) in full.iter().zip(&sparse) {
                assert_eq!(without, if with < 1.0 { with } else { 0.0 });
            }
        }
    }

    #[test]
    fn frames_are_independent_and_reproducible() {
        let wall = Array2::from_elem((48, 64), 0.4f32);
        let of = |seed, camera, frame| disturb(&wall, 5.0, FrameId { seed, camera, frame });
        let first = of(1, 0, 0);
        assert_eq!(first, of(1, 0, 0));
        for other in [of(2, 0, 0), of(1, 1, 0), of(1, 0, 1)] {
            let same = first.iter().zip(&other).filter(|(a, b)| a == b).count();
            assert!(same < 48 * 64 / 2, "{same} equal pixels");
        }
        // Holes stay holes, far walls become holes, and an image without pixels is valid.
        for depth in [0.0, 10.0, f32::INFINITY, f32::NAN, -1.0] {
            assert!(disturb(&Array2::from_elem((4, 4), depth), 5.0, ID).iter().all(|&d| d == 0.0), "{depth}");
        }
        assert!(disturb(&Array2::zeros((0, 4)), 5.0, ID).is_empty());
    }
}
