//! Attention between all tokens of an image, or those of a window.

use std::sync::Arc;

use ndarray::ArrayView2;
use rayon::prelude::*;

use crate::lanes::{LANES, each, exp, load, store, total};
use crate::linear::{add_product, matrix, matrix_mut};
use crate::tape::{Inputs, Kernel, Slopes, TensorView};
use mvt_touch::network::{WeightTensor, relative_position};

/// Softmax attention of `heads` heads; input queries, keys and values `[images, tokens, 3 width]`, output `[images, tokens, width]`.
#[derive(Debug, Clone, Copy)]
pub struct Attention {
    /// Heads, which share the width evenly.
    pub heads: usize,
}

/// Sizes of one image.
#[derive(Clone, Copy)]
struct Sizes {
    tokens: usize,
    width: usize,
    head: usize,
}

/// Attention in windows; inputs queries, keys and values `[windows, tokens, 3 width]`, image by image, and the table of relative positions
/// `[(2 side - 1)^2, heads]`; output `[windows, tokens, width]`.
#[derive(Debug, Clone)]
pub struct WindowAttention {
    /// Heads, which share the width evenly.
    pub heads: usize,
    /// Side of a window, tokens.
    pub side: usize,
    /// Region of each token of an image, see [`mvt_touch::network::ShiftedWindows`].
    pub regions: Arc<[u8]>,
}

/// Numbers that are added to the scores of a window.
#[derive(Clone, Copy)]
struct Bias<'a> {
    /// Head by head, `[tokens, tokens]`.
    values: &'a [f32],
    /// Region of each token.
    regions: &'a [u8],
}

impl Bias<'_> {
    /// Adds the numbers of a head, divided by `scale`, which is applied later.
    fn add(self, scores: &mut [f32], head: usize, scale: f32) {
        let count = self.regions.len();
        let rows = scores.chunks_exact_mut(count).zip(self.values[head * count * count..].chunks_exact(count));
        for ((row, bias), own) in rows.zip(self.regions) {
            for ((score, bias), region) in row.iter_mut().zip(bias).zip(self.regions) {
                *score += if region == own { bias / scale } else { -1e9 };
            }
        }
    }
}

impl WindowAttention {
    /// Calls `each` with the index of a number in the table and in the biases.
    fn pairs(&self, mut each: impl FnMut(usize, usize)) {
        let count = self.side * self.side;
        for at in 0..self.heads * count * count {
            let position = relative_position(self.side, at / count % count, at % count);
            each(position * self.heads + at / (count * count), at);
        }
    }

    fn bias(&self, table: &[f32]) -> Vec<f32> {
        let mut bias = vec![0.0; self.heads * self.side.pow(4)];
        self.pairs(|from, to| bias[to] = table[from]);
        bias
    }

    /// Returns the regions of a window.
    fn regions(&self, window: usize) -> &[u8] {
        let count = self.side * self.side;
        &self.regions[window * count % self.regions.len()..][..count]
    }
}

impl Sizes {
    fn new(qkv: TensorView<'_>, heads: usize) -> Self {
        let width = qkv.shape[2] / 3;
        Self { tokens: qkv.shape[1], width, head: width / heads }
    }

    /// Returns queries (0), keys (1) or values (2) of a head: `[tokens, head]`.
    fn part(self, qkv: &[f32], part: usize, head: usize) -> ArrayView2<'_, f32> {
        let start = part * self.width + head * self.head;
        matrix(&qkv[start..], [self.tokens, self.head], [3 * self.width, 1])
    }

    /// Returns the weight of each token (column) for each token (row).
    fn probabilities(self, qkv: &[f32], head: usize, bias: Option<Bias<'_>>) -> Vec<f32> {
        let mut scores = vec![0.0; self.tokens * self.tokens];
        let keys = self.part(qkv, 1, head).reversed_axes();
        add_product(self.part(qkv, 0, head), keys, &mut matrix_mut(&mut scores, self.tokens));
        let scale = 1.0 / (self.head as f32).sqrt();
        if let Some(bias) = bias {
            bias.add(&mut scores, head, scale);
        }
        for row in scores.chunks_exact_mut(self.tokens) {
            let most = row.iter().copied().fold(f32::NEG_INFINITY, f32::max);
            for at in (0..row.len()).step_by(LANES) {
                let scores = load(row, at);
                store(row, at, exp(each(|j| (scores[j] - most) * scale)));
            }
            let sum: f32 = row.iter().sum();
            row.iter_mut().for_each(|share| *share /= sum);
        }
        scores
    }
}

impl Sizes {
    /// Computes the result for an image or a window.
    fn mix(self, qkv: &[f32], bias: Option<Bias<'_>>, out: &mut [f32]) {
        let Self { tokens, width, head: size } = self;
        for head in 0..width / size {
            let shares = self.probabilities(qkv, head, bias);
            let mut mixed = vec![0.0; tokens * size];
            let shares = matrix(&shares, [tokens, tokens], [tokens, 1]);
            add_product(shares, self.part(qkv, 2, head), &mut matrix_mut(&mut mixed, size));
            for (row, mixed) in out.chunks_exact_mut(width).zip(mixed.chunks_exact(size)) {
                row[head * size..][..size].copy_from_slice(mixed);
            }
        }
    }

    /// Computes the gradient by queries, keys and values, and, where there is a bias, by that.
    fn unmix(self, qkv: &[f32], bias: Option<Bias<'_>>, gradient: &[f32], out: &mut [f32]) -> Vec<f32> {
        let Self { tokens, width, head: size } = self;
        let scale = 1.0 / (size as f32).sqrt();
        let mut by_bias = Vec::new();
        for head in 0..width / size {
            let shares = self.probabilities(qkv, head, bias);
            let g = matrix(&gradient[head * size..], [tokens, size], [width, 1]);
            let mut by_scores = vec![0.0; tokens * tokens];
            let values = self.part(qkv, 2, head).reversed_axes();
            add_product(g, values, &mut matrix_mut(&mut by_scores, tokens));
            for (by, share) in by_scores.chunks_exact_mut(tokens).zip(shares.chunks_exact(tokens)) {
                let mean: f32 = by.iter().zip(share).map(|(by, share)| by * share).sum();
                if bias.is_some() {
                    by_bias.extend(by.iter().zip(share).map(|(by, share)| share * (by - mean)));
                }
                by.iter_mut().zip(share).for_each(|(by, share)| *by = share * (*by - mean) * scale);
            }
            let shares = matrix(&shares, [tokens, tokens], [tokens, 1]);
            let by_scores = matrix(&by_scores, [tokens, tokens], [tokens, 1]);
            let products = [
                (by_scores, self.part(qkv, 1, head)),
                (by_scores.reversed_axes(), self.part(qkv, 0, head)),
                (shares.reversed_axes(), g),
            ];
            for (part, (left, right)) in products.into_iter().enumerate() {
                let mut sum = vec![0.0; tokens * size];
                add_product(left, right, &mut matrix_mut(&mut sum, size));
                for (row, sum) in out.chunks_exact_mut(3 * width).zip(sum.chunks_exact(size)) {
                    row[part * width + head * size..][..size].copy_from_slice(sum);
                }
            }
        }
        by_bias
    }
}

impl Kernel<1> for Attention {
    type Kept = ();

    fn forward(&self, [qkv]: Inputs<'_, 1>) -> (WeightTensor, ()) {
        let sizes = Sizes::new(qkv, self.heads);
        let mut values = vec![0.0; qkv.values.len() / 3];
        let image = sizes.tokens * sizes.width;
        let images = values.par_chunks_mut(image).zip(qkv.values.par_chunks(3 * image));
        images.for_each(|(out, qkv)| sizes.mix(qkv, None, out));
        (WeightTensor { shape: vec![qkv.shape[0], sizes.tokens, sizes.width], values }, ())
    }

    fn backward(&self, [qkv]: Inputs<'_, 1>, (): &(), gradient: &[f32], _: [bool; 1]) -> Slopes<1> {
        let sizes = Sizes::new(qkv, self.heads);
        let mut values = vec![0.0; qkv.values.len()];
        let image = sizes.tokens * sizes.width;
        let images = values.par_chunks_mut(3 * image).zip(qkv.values.par_chunks(3 * image));
        images.zip(gradient.par_chunks(image)).for_each(|((out, qkv), gradient)| {
            sizes.unmix(qkv, None, gradient, out);
        });
        [Some(qkv.like(values))]
    }
}

impl Kernel<2> for WindowAttention {
    type Kept = ();

    fn forward(&self, [qkv, table]: Inputs<'_, 2>) -> (WeightTensor, ()) {
        let sizes = Sizes::new(qkv, self.heads);
        let bias = self.bias(table.values);
        let mut values = vec![0.0; qkv.values.len() / 3];
        let window = sizes.tokens * sizes.width;
        let windows = values.par_chunks_mut(window).zip(qkv.values.par_chunks(3 * window)).enumerate();
        windows.for_each(|(k, (out, qkv))| {
            sizes.mix(qkv, Some(Bias { values: &bias, regions: self.regions(k) }), out);
        });
        (WeightTensor { shape: vec![qkv.shape[0], sizes.tokens, sizes.width], values }, ())
    }

    fn backward(&self, [qkv, table]: Inputs<'_, 2>, (): &(), gradient: &[f32], _: [bool; 2]) -> Slopes<2> {
        let sizes = Sizes::new(qkv, self.heads);
        let bias = self.bias(table.values);
        let mut values = vec![0.0; qkv.values.len()];
        let window = sizes.tokens * sizes.width;
        let windows = values.par_chunks_mut(3 * window).zip(qkv.values.par_chunks(3 * window));
        let parts = windows.zip(gradient.par_chunks(window)).enumerate().map(|(k, ((out, qkv), gradient))| {
            sizes.unmix(qkv, Some(Bias { values: &bias, regions: self.regions(k) }), gradient, out)
        });
        let by_bias = total(parts.collect(), bias.len());
        let mut by_table = vec![0.0; table.values.len()];
        self.pairs(|to, from| by_table[to] += by_bias[from]);
        [Some(qkv.like(values)), Some(table.like(by_table))]
    }
}
