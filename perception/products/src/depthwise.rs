//! Depthwise convolutions: each channel by itself.

use pulp::{Simd, WithSimd};

use crate::Instructions;
use crate::math::multiply_add;
use crate::multiply::LANES;

/// Pixels of a row that are computed together: with a tap and an input they fit in the registers of AVX2.
const BLOCK: usize = 8;

/// Depthwise convolution with packed weights.
#[derive(Debug, Clone)]
pub struct Depthwise {
    instructions: Instructions,
    side: usize,
    /// Channels, with those that fill the last vector.
    channels: usize,
    /// `[side][side][channels]`.
    weights: Vec<f32>,
    bias: Vec<f32>,
}

impl Depthwise {
    /// Packs weights `[channels, side, side]` and a bias per channel for an instruction set. Missing weights are zero.
    pub fn new(instructions: Instructions, side: usize, weights: &[f32], bias: &[f32]) -> Self {
        let channels = bias.len().next_multiple_of(LANES);
        let taps = side * side;
        let weight = |at: usize| match at % channels {
            channel if channel < bias.len() => weights.get(channel * taps + at / channels).copied().unwrap_or(0.0),
            _ => 0.0,
        };
        let mut padded = bias.to_vec();
        padded.resize(channels, 0.0);
        Self {
            instructions,
            side,
            channels,
            weights: (0..if channels > 0 { taps * channels } else { 0 }).map(weight).collect(),
            bias: padded,
        }
    }

    /// Returns the channels of a pixel, a multiple of [`LANES`].
    pub fn channels(&self) -> usize {
        self.channels
    }

    /// Returns the side of a window, pixels.
    pub fn side(&self) -> usize {
        self.side
    }

    /// Correlates a framed map `[rows + side - 1, columns + side - 1, channels]` with the weights and adds the bias; `to` is `[rows, columns,
    /// channels]`.
    ///
    /// # Panics
    /// If a slice is too short.
    pub fn apply(&self, size: [usize; 2], framed: &[f32], to: &mut [f32]) {
        self.instructions.run(Convolve { layer: self, size, framed, to });
    }
}

struct Convolve<'a> {
    layer: &'a Depthwise,
    size: [usize; 2],
    framed: &'a [f32],
    to: &'a mut [f32],
}

impl WithSimd for Convolve<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, simd: S) {
        let [rows, columns] = self.size;
        for row in 0..rows {
            let blocks = columns / BLOCK;
            for block in 0..blocks {
                self.block::<S, BLOCK>(simd, row, block * BLOCK);
            }
            for column in blocks * BLOCK..columns {
                self.block::<S, 1>(simd, row, column);
            }
        }
    }
}

impl Convolve<'_> {
    /// Computes `PIXELS` pixels of a row.
    #[inline(always)]
    fn block<S: Simd, const PIXELS: usize>(&mut self, simd: S, row: usize, column: usize) {
        let Self { layer: Depthwise { side, channels, weights, bias, .. }, size: [_, columns], framed, to } = self;
        let [weights, bias, framed] = [weights.as_slice(), bias.as_slice(), *framed].map(|x| S::as_simd_f32s(x).0);
        let to = S::as_mut_simd_f32s(to).0;
        let (side, columns, vectors) = (*side, *columns, *channels / S::F32_LANES);
        for vector in 0..vectors {
            let mut sums = [bias[vector]; PIXELS];
            for (tap, weights) in weights.chunks_exact(vectors).enumerate() {
                let first = (row + tap / side) * (columns + side - 1) + column + tap % side;
                let inputs = &framed[first * vectors..(first + PIXELS) * vectors];
                for (k, sum) in sums.iter_mut().enumerate() {
                    *sum = multiply_add(simd, weights[vector], inputs[k * vectors + vector], *sum);
                }
            }
            for (k, sum) in sums.into_iter().enumerate() {
                to[(row * columns + column + k) * vectors + vector] = sum;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// All instruction sets against sums in f64: rows with and without a rest, channels that fill vectors and that do not.
    #[test]
    fn every_path_adds_up() {
        for ([rows, columns], side, channels) in [([3, 11], 7, 5), ([2, 8], 3, 16), ([1, 1], 7, 33), ([4, 17], 5, 48)] {
            let number = |seed: usize| ((seed * 2_654_435_761) % 1009) as f32 / 504.5 - 1.0;
            let weights: Vec<f32> = (0..channels * side * side).map(number).collect();
            let bias: Vec<f32> = (0..channels).map(|k| number(k + 7)).collect();
            for set in Instructions::available() {
                let layer = Depthwise::new(set, side, &weights, &bias);
                let (stored, pitch) = (layer.channels(), columns + side - 1);
                let framed: Vec<f32> = (0..(rows + side - 1) * pitch * stored).map(|k| number(3 * k + 1)).collect();
                let mut to = vec![9.0; rows * columns * stored];
                layer.apply([rows, columns], &framed, &mut to);
                for (at, found) in to.iter().enumerate() {
                    let (pixel, channel) = (at / stored, at % stored);
                    let tap = |k: usize| {
                        let place = (pixel / columns + k / side) * pitch + pixel % columns + k % side;
                        f64::from(weights[channel * side * side + k]) * f64::from(framed[place * stored + channel])
                    };
                    let exact = if channel < channels {
                        f64::from(bias[channel]) + (0..side * side).map(tap).sum::<f64>()
                    } else {
                        0.0
                    };
                    assert!((f64::from(*found) - exact).abs() < 1e-5, "{found} for {exact} ({set:?})");
                }
            }
        }
    }
}
