//! Bilinear resampling of maps.

use rayon::prelude::*;

use crate::tape::{Inputs, Kernel, Slopes};
use mvt_touch::network::WeightTensor;

/// Resamples `[images, rows, columns, channels]` to another size.
#[derive(Debug, Clone, Copy)]
pub struct Resample {
    /// Rows and columns of the result.
    pub size: [usize; 2],
    /// Whether the centres of the corner pixels coincide; otherwise the corners of the images do, and edges are clamped.
    pub aligned: bool,
}

/// Two neighbours on an axis and the share of the second.
type Tap = (usize, usize, f32);

impl Resample {
    /// Returns the neighbours among `from` pixels for each of `to` pixels.
    fn taps(self, from: usize, to: usize) -> Vec<Tap> {
        let last = from.saturating_sub(1);
        let place = |i: usize| {
            let at = if self.aligned {
                i as f32 * last as f32 / to.saturating_sub(1).max(1) as f32
            } else {
                ((i as f32 + 0.5) * from as f32 / to as f32 - 0.5).clamp(0.0, last as f32)
            };
            let low = (at as usize).min(last);
            (low, (low + 1).min(last), at - low as f32)
        };
        (0..to).map(place).collect()
    }

    /// Returns the resampling along an axis as a row-major matrix of `to` rows.
    pub fn matrix(self, from: usize, to: usize) -> Vec<f32> {
        let mut matrix = vec![0.0; to * from];
        for (row, (low, high, share)) in matrix.chunks_exact_mut(from).zip(self.taps(from, to)) {
            row[low] += 1.0 - share;
            row[high] += share;
        }
        matrix
    }

    /// Calls `each` with output pixel, input pixel and the share of the input in the output.
    fn pairs(self, [rows, columns]: [usize; 2], mut each: impl FnMut(usize, usize, f32)) {
        let [down, across] = [self.taps(rows, self.size[0]), self.taps(columns, self.size[1])];
        for (i, &(top, bottom, s)) in down.iter().enumerate() {
            for (j, &(left, right, t)) in across.iter().enumerate() {
                let out = i * self.size[1] + j;
                for (row, row_share) in [(top, 1.0 - s), (bottom, s)] {
                    for (column, share) in [(left, 1.0 - t), (right, t)] {
                        each(out, row * columns + column, row_share * share);
                    }
                }
            }
        }
    }
}

impl Kernel<1> for Resample {
    type Kept = ();

    fn forward(&self, [x]: Inputs<'_, 1>) -> (WeightTensor, ()) {
        let [images, rows, columns, channels] = x.sides();
        let pixels = self.size[0] * self.size[1];
        let mut values = vec![0.0; images * pixels * channels];
        let images_of = values.par_chunks_mut(pixels * channels).zip(x.values.par_chunks(rows * columns * channels));
        images_of.for_each(|(y, x)| {
            self.pairs([rows, columns], |to, from, share| {
                let from = &x[from * channels..][..channels];
                y[to * channels..][..channels].iter_mut().zip(from).for_each(|(y, x)| *y += share * x);
            });
        });
        (WeightTensor { shape: vec![images, self.size[0], self.size[1], channels], values }, ())
    }

    fn backward(&self, [x]: Inputs<'_, 1>, (): &(), gradient: &[f32], _: [bool; 1]) -> Slopes<1> {
        let [_, rows, columns, channels] = x.sides();
        let pixels = self.size[0] * self.size[1];
        let mut values = vec![0.0; x.values.len()];
        let image = rows * columns * channels;
        let images = values.par_chunks_mut(image).zip(gradient.par_chunks(pixels * channels));
        images.for_each(|(by_x, g)| {
            self.pairs([rows, columns], |to, from, share| {
                let g = &g[to * channels..][..channels];
                by_x[from * channels..][..channels].iter_mut().zip(g).for_each(|(by, g)| *by += share * g);
            });
        });
        [Some(x.like(values))]
    }
}
