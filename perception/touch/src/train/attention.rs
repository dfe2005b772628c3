//! Attention between all tokens of an image.

use ndarray::ArrayView2;
use rayon::prelude::*;

use super::lanes::{LANES, each, exp, load, store};
use super::linear::{add_product, matrix, matrix_mut};
use super::tape::{Inputs, Kernel, Slopes, TensorView};
use crate::network::WeightTensor;

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

impl Attention {
    fn sizes(self, qkv: TensorView<'_>) -> Sizes {
        let width = qkv.shape[2] / 3;
        Sizes { tokens: qkv.shape[1], width, head: width / self.heads }
    }
}

impl Sizes {
    /// Returns queries (0), keys (1) or values (2) of a head: `[tokens, head]`.
    fn part(self, qkv: &[f32], part: usize, head: usize) -> ArrayView2<'_, f32> {
        let start = part * self.width + head * self.head;
        matrix(&qkv[start..], [self.tokens, self.head], [3 * self.width, 1])
    }

    /// Returns the weight of each token (column) for each token (row).
    fn probabilities(self, qkv: &[f32], head: usize) -> Vec<f32> {
        let mut scores = vec![0.0; self.tokens * self.tokens];
        let keys = self.part(qkv, 1, head).reversed_axes();
        add_product(self.part(qkv, 0, head), keys, &mut matrix_mut(&mut scores, self.tokens));
        let scale = 1.0 / (self.head as f32).sqrt();
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

impl Kernel<1> for Attention {
    type Kept = ();

    fn forward(&self, [qkv]: Inputs<'_, 1>) -> (WeightTensor, ()) {
        let sizes = self.sizes(qkv);
        let Sizes { tokens, width, head: size } = sizes;
        let mut values = vec![0.0; qkv.values.len() / 3];
        let images = values.par_chunks_mut(tokens * width).zip(qkv.values.par_chunks(3 * tokens * width));
        images.for_each(|(out, qkv)| {
            for head in 0..self.heads {
                let shares = sizes.probabilities(qkv, head);
                let mut mixed = vec![0.0; tokens * size];
                let shares = matrix(&shares, [tokens, tokens], [tokens, 1]);
                add_product(shares, sizes.part(qkv, 2, head), &mut matrix_mut(&mut mixed, size));
                for (row, mixed) in out.chunks_exact_mut(width).zip(mixed.chunks_exact(size)) {
                    row[head * size..][..size].copy_from_slice(mixed);
                }
            }
        });
        (WeightTensor { shape: vec![qkv.shape[0], tokens, width], values }, ())
    }

    fn backward(&self, [qkv]: Inputs<'_, 1>, (): &(), gradient: &[f32], _: [bool; 1]) -> Slopes<1> {
        let sizes = self.sizes(qkv);
        let Sizes { tokens, width, head: size } = sizes;
        let scale = 1.0 / (size as f32).sqrt();
        let mut values = vec![0.0; qkv.values.len()];
        let image = tokens * width;
        let images = values.par_chunks_mut(3 * image).zip(qkv.values.par_chunks(3 * image));
        images.zip(gradient.par_chunks(image)).for_each(|((out, qkv), gradient)| {
            for head in 0..self.heads {
                let shares = sizes.probabilities(qkv, head);
                let g = matrix(&gradient[head * size..], [tokens, size], [width, 1]);
                let mut by_scores = vec![0.0; tokens * tokens];
                let values = sizes.part(qkv, 2, head).reversed_axes();
                add_product(g, values, &mut matrix_mut(&mut by_scores, tokens));
                for (by, share) in by_scores.chunks_exact_mut(tokens).zip(shares.chunks_exact(tokens)) {
                    let mean: f32 = by.iter().zip(share).map(|(by, share)| by * share).sum();
                    by.iter_mut().zip(share).for_each(|(by, share)| *by = share * (*by - mean) * scale);
                }
                let shares = matrix(&shares, [tokens, tokens], [tokens, 1]);
                let by_scores = matrix(&by_scores, [tokens, tokens], [tokens, 1]);
                let products = [
                    (by_scores, sizes.part(qkv, 1, head)),
                    (by_scores.reversed_axes(), sizes.part(qkv, 0, head)),
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
        });
        [Some(qkv.like(values))]
    }
}
