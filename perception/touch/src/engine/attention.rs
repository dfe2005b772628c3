//! Softmax attention of every token to every other, one head after the other.

use pulp::{Simd, WithSimd};

use super::layers::{Linear, Matrix};
use super::map::FeatureMap;
use crate::network::Weights;
use mvt_products::Instructions;
use mvt_products::math::exp;
use mvt_products::multiply::{LANES, Left, Packed, Target, Then, Windows, multiply};

/// Attention with its linear maps.
#[derive(Debug)]
pub(super) struct Attention {
    instructions: Instructions,
    qkv: Linear,
    proj: Linear,
    heads: usize,
    /// Channels of a head.
    size: usize,
    /// Channels of a head with those that fill the last vector.
    stored: usize,
}

/// Memory of attention.
#[derive(Debug, Clone)]
pub(super) struct AttentionBuffers {
    /// Queries, keys and values, each head by head.
    qkv: FeatureMap,
    /// Keys of a head as columns.
    keys: Packed,
    values: Packed,
    /// Scores of a head, then weights.
    scores: FeatureMap,
    result: FeatureMap,
}

impl Attention {
    pub(super) fn new(instructions: Instructions, weights: &Weights, name: &str, heads: usize) -> Self {
        let (qkv, proj) = (Matrix::of(weights, &format!("{name}.qkv")), Matrix::of(weights, &format!("{name}.proj")));
        let size = proj.inputs / heads;
        let stored = size.next_multiple_of(LANES);
        let head = |n: usize| (n % stored < size).then_some(n / stored * size + n % stored);
        Self {
            instructions,
            qkv: Linear::spread(instructions, &qkv, 3 * heads * stored, head, qkv.inputs, Some),
            proj: Linear::spread(instructions, &proj, proj.outputs, Some, heads * stored, head),
            heads,
            size,
            stored,
        }
    }

    /// Returns memory for `count` tokens.
    pub(super) fn buffers(&self, count: usize) -> AttentionBuffers {
        let packed =
            |length, outputs: usize| Packed::new(self.instructions, 1, length, &vec![0.0; outputs], |_, _| 0.0);
        AttentionBuffers {
            qkv: FeatureMap::tokens([1, count], 0, 3 * self.heads * self.stored),
            keys: packed(self.stored, count),
            values: packed(count, self.stored),
            scores: FeatureMap::tokens([1, count], 0, count),
            result: FeatureMap::tokens([1, count], 0, self.heads * self.stored),
        }
    }

    /// Adds the result to `to`.
    pub(super) fn apply(
        &self,
        from: &FeatureMap,
        buffers: &mut AttentionBuffers,
        words: &mut Vec<u32>,
        to: &mut FeatureMap,
    ) {
        let AttentionBuffers { qkv, keys, values, scores, result } = buffers;
        let &Self { heads, size, stored, .. } = self;
        self.qkv.apply(from, Then::Store, words, qkv);
        let count = from.count();
        let scale = 1.0 / (size as f32).sqrt();
        for head in 0..heads {
            let [query, key, value] = [0, 1, 2].map(|part| (part * heads + head) * stored);
            let number = |token: usize, at: usize| qkv.data[token * qkv.channels + at];
            keys.fill(count, |k, token| scale * number(token, key + k));
            values.fill(stored, |token, k| number(token, value + k));
            let windows = Windows { first: query, ..qkv.pixels() };
            let target =
                Target { first: 0, step: scores.channels, pitch: 0, then: Then::Store, data: &mut scores.data };
            multiply(keys, Left { data: &qkv.data, windows, rectified: false }, words, target);
            self.instructions.run(Softmax { count, scores });
            let left = Left { data: &scores.data, windows: scores.pixels(), rectified: false };
            let (first, step) = (head * stored, result.channels);
            multiply(values, left, words, Target { data: &mut result.data, first, step, pitch: 0, then: Then::Store });
        }
        self.proj.apply(result, Then::Add, words, to);
    }
}

/// Softmax of the first `count` numbers of each row; the others become nearly zero.
struct Softmax<'a> {
    count: usize,
    scores: &'a mut FeatureMap,
}

impl WithSimd for Softmax<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let channels = self.scores.channels;
        for row in self.scores.data.chunks_exact_mut(channels) {
            row[self.count..].fill(f32::MIN);
            let row = S::as_mut_simd_f32s(row).0;
            let greatest = row.iter().fold(simd.splat_f32s(f32::MIN), |most, &x| simd.max_f32s(most, x));
            let greatest = simd.splat_f32s(simd.reduce_max_f32s(greatest));
            let mut sum = simd.splat_f32s(0.0);
            for x in row.iter_mut() {
                *x = exp(simd, simd.sub_f32s(*x, greatest));
                sum = simd.add_f32s(sum, *x);
            }
            let scale = simd.splat_f32s(1.0 / simd.reduce_sum_f32s(sum));
            for x in row {
                *x = simd.mul_f32s(*x, scale);
            }
        }
    }
}
