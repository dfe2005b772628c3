//! Depthwise convolutions.

use mvt_products::Instructions;
use mvt_products::depthwise::Depthwise as Packed;
use mvt_touch::network::WeightTensor;
use pulp::WithSimd;
use rayon::prelude::*;

use crate::lanes::{LANES, add_to, each, load, store, total};
use crate::tape::{Inputs, Kernel, Slopes, TensorView};

/// Correlation of each channel by itself with zeros around the map, and bias; inputs x `[images, rows, columns, channels]`, W
/// `[channels, side, side]` with an odd side, b `[channels]`.
#[derive(Debug, Clone, Copy)]
pub struct Depthwise {
    /// Instructions of the convolution.
    pub instructions: Instructions,
}

/// Sides of one image's map, its channels, and the side of a window.
#[derive(Clone, Copy)]
struct Sizes {
    rows: usize,
    columns: usize,
    channels: usize,
    side: usize,
}

impl Sizes {
    fn new(x: TensorView<'_>, weight: TensorView<'_>) -> Self {
        let [_, rows, columns, channels] = x.sides();
        Self { rows, columns, channels, side: weight.shape[1] }
    }

    fn len(self) -> usize {
        self.rows * self.columns * self.channels
    }

    /// Returns the channels of a pixel, with those that fill the last vector.
    fn stored(self) -> usize {
        self.channels.next_multiple_of(LANES)
    }

    /// Returns the map in a frame of `margin` zeros, with whole vectors of channels.
    fn framed(self, values: &[f32], margin: usize) -> Vec<f32> {
        let (stored, pitch) = (self.stored(), self.columns + 2 * margin);
        let mut framed = vec![0.0; (self.rows + 2 * margin) * pitch * stored];
        for (k, from) in values.chunks_exact(self.channels).enumerate() {
            let pixel = (k / self.columns + margin) * pitch + k % self.columns + margin;
            framed[pixel * stored..][..self.channels].copy_from_slice(from);
        }
        framed
    }

    /// Convolves a map.
    fn convolve(self, packed: &Packed, from: &[f32], to: &mut [f32]) {
        let mut result = vec![0.0; self.rows * self.columns * self.stored()];
        packed.apply([self.rows, self.columns], &self.framed(from, self.side / 2), &mut result);
        for (to, from) in to.chunks_exact_mut(self.channels).zip(result.chunks_exact(self.stored())) {
            to.copy_from_slice(&from[..self.channels]);
        }
    }
}

impl Kernel<3> for Depthwise {
    type Kept = ();

    fn forward(&self, [x, weight, bias]: Inputs<'_, 3>) -> (WeightTensor, ()) {
        let sizes = Sizes::new(x, weight);
        let packed = Packed::new(self.instructions, sizes.side, weight.values, bias.values);
        let mut values = vec![0.0; x.values.len()];
        let images = values.par_chunks_mut(sizes.len()).zip(x.values.par_chunks(sizes.len()));
        images.for_each(|(to, from)| sizes.convolve(&packed, from, to));
        (x.like(values), ())
    }

    fn backward(&self, [x, weight, bias]: Inputs<'_, 3>, (): &(), gradient: &[f32], _: [bool; 3]) -> Slopes<3> {
        let sizes = Sizes::new(x, weight);
        let Sizes { channels, side, .. } = sizes;
        // The transpose of a convolution turns the window by 180 degrees.
        let turned: Vec<f32> =
            weight.values.chunks_exact(side * side).flat_map(|window| window.iter().rev()).copied().collect();
        let packed = Packed::new(self.instructions, side, &turned, &vec![0.0; channels]);
        let mut values = vec![0.0; x.values.len()];
        let images = values
            .par_chunks_mut(sizes.len())
            .zip(x.values.par_chunks(sizes.len()))
            .zip(gradient.par_chunks(sizes.len()));
        let parts = images.map(|((by_x, x), g)| {
            sizes.convolve(&packed, g, by_x);
            let (framed, g) = (sizes.framed(x, side / 2), sizes.framed(g, 0));
            self.instructions.run(Slope { sizes, framed: &framed, gradient: &g })
        });
        let size = (side * side + 1) * sizes.stored();
        let sums = total(parts.collect(), size);
        // Tap by tap, then the bias.
        let tap = |k: usize| sums[k * sizes.stored()..][..channels].iter();
        let by_weight = (0..channels).flat_map(|c| (0..side * side).filter_map(move |k| tap(k).nth(c))).copied();
        let by_bias = tap(side * side).copied().collect();
        [Some(x.like(values)), Some(weight.like(by_weight.collect())), Some(bias.like(by_bias))]
    }
}

/// Gradients of one image by weights and bias.
struct Slope<'a> {
    sizes: Sizes,
    framed: &'a [f32],
    gradient: &'a [f32],
}

impl WithSimd for Slope<'_> {
    type Output = Vec<f32>;

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) -> Vec<f32> {
        let Self { sizes: sizes @ Sizes { rows, columns, side, .. }, framed, gradient } = self;
        let (stored, pitch) = (sizes.stored(), columns + side - 1);
        let mut sums = vec![0.0; (side * side + 1) * stored];
        let (taps, by_bias) = sums.split_at_mut(side * side * stored);
        for (tap, sums) in taps.chunks_exact_mut(stored).enumerate() {
            for row in 0..rows {
                let first = (row + tap / side) * pitch + tap % side;
                let inputs = framed[first * stored..][..columns * stored].chunks_exact(stored);
                let slopes = gradient[row * columns * stored..][..columns * stored].chunks_exact(stored);
                for (x, g) in inputs.zip(slopes) {
                    for at in (0..stored).step_by(LANES) {
                        let (sum, x, g) = (load(sums, at), load(x, at), load(g, at));
                        store(sums, at, each(|j| x[j].mul_add(g[j], sum[j])));
                    }
                }
            }
        }
        gradient.chunks_exact(stored).for_each(|pixel| add_to(by_bias, pixel));
        sums
    }
}
