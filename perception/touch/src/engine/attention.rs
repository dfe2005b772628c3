//! Softmax attention of every token to every other, or to those in its window, one head after the other.

use pulp::{Simd, WithSimd};

use super::layers::{Linear, Matrix};
use super::map::FeatureMap;
use crate::network::{Weights, relative_position};
use mvt_products::Instructions;
use mvt_products::math::{exp, multiply_add};
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
    /// Numbers that are added to the scores of a window: head by head, a row per query. Empty if there are none.
    bias: Vec<f32>,
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
            bias: Vec::new(),
        }
    }

    /// Packs attention in windows of `side` tokens a side.
    pub(super) fn windowed(
        instructions: Instructions,
        weights: &Weights,
        name: &str,
        heads: usize,
        side: usize,
    ) -> Self {
        let table = weights.values(&format!("{name}.relative_position_bias_table"));
        let count = side * side;
        let stored = count.next_multiple_of(LANES);
        let entry = |at: usize| {
            let (head, query, key) = (at / (count * stored), at / stored % count, at % stored);
            if key < count { table[relative_position(side, query, key) * heads + head] } else { 0.0 }
        };
        let bias = (0..heads * count * stored).map(entry).collect();
        Self { bias, ..Self::new(instructions, weights, name, heads) }
    }

    /// Returns memory for windows of `count` tokens.
    pub(super) fn buffers(&self, count: usize, windows: usize) -> AttentionBuffers {
        let packed =
            |length, outputs: usize| Packed::new(self.instructions, 1, length, &vec![0.0; outputs], |_, _| 0.0);
        AttentionBuffers {
            qkv: FeatureMap::tokens([windows, count], 0, 3 * self.heads * self.stored),
            keys: packed(self.stored, count),
            values: packed(count, self.stored),
            scores: FeatureMap::tokens([1, count], 0, count),
            result: FeatureMap::tokens([windows, count], 0, self.heads * self.stored),
        }
    }

    /// Stores the result in `to` or adds it. The tokens lie window by window; `regions` has a number for each, with those that fill the
    /// rows of scores, and tokens of other numbers are not attended to. Attention without windows has none.
    pub(super) fn apply(
        &self,
        from: &FeatureMap,
        regions: &[f32],
        buffers: &mut AttentionBuffers,
        then: Then,
        words: &mut Vec<u32>,
        to: &mut FeatureMap,
    ) {
        let AttentionBuffers { qkv, keys, values, scores, result } = buffers;
        let &Self { heads, size, stored, .. } = self;
        self.qkv.apply(from, Then::Store, words, qkv);
        let (count, columns) = (scores.count(), scores.channels);
        let scale = 1.0 / (size as f32).sqrt();
        let windows = Windows { columns: count, ..qkv.pixels() };
        let of_window =
            qkv.data.chunks_exact(count * qkv.channels).zip(result.data.chunks_exact_mut(count * result.channels));
        for (window, (qkv_data, result_data)) in of_window.enumerate() {
            for head in 0..heads {
                let [query, key, value] = [0, 1, 2].map(|part| (part * heads + head) * stored);
                let number = |token: usize, at: usize| qkv_data[token * windows.step + at];
                keys.fill(count, |k, token| scale * number(token, key + k));
                values.fill(stored, |token, k| number(token, value + k));
                let left = Left { data: qkv_data, windows: Windows { first: query, ..windows }, rectified: false };
                let target = Target { first: 0, step: columns, pitch: 0, then: Then::Store, data: &mut scores.data };
                multiply(keys, left, words, target);
                if let (Some(bias), Some(regions)) =
                    (self.bias.chunks_exact(count * columns).nth(head), regions.chunks_exact(columns).nth(window))
                {
                    self.instructions.run(AddBias { bias, regions, scores: &mut scores.data });
                }
                self.instructions.run(Softmax { count, scores });
                let left = Left { data: &scores.data, windows: scores.pixels(), rectified: false };
                let (first, step) = (head * stored, result.channels);
                let target = Target { data: &mut *result_data, first, step, pitch: 0, then: Then::Store };
                multiply(values, left, words, target);
            }
        }
        self.proj.apply(result, then, words, to);
    }
}

/// Adds numbers to the scores of a window, a row of `regions.len()` each, and subtracts so much from those between regions that their weight
/// vanishes.
struct AddBias<'a> {
    bias: &'a [f32],
    regions: &'a [f32],
    scores: &'a mut [f32],
}

impl WithSimd for AddBias<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { bias, regions, scores } = self;
        let far = simd.splat_f32s(-1e9);
        let rows = scores.chunks_exact_mut(regions.len()).zip(bias.chunks_exact(regions.len()));
        for ((row, bias), &own) in rows.zip(regions) {
            let own = simd.splat_f32s(own);
            let [bias, regions] = [bias, regions].map(|values| S::as_simd_f32s(values).0);
            for ((x, &bias), &region) in S::as_mut_simd_f32s(row).0.iter_mut().zip(bias).zip(regions) {
                let apart = simd.sub_f32s(region, own);
                *x = multiply_add(simd, simd.mul_f32s(apart, apart), far, simd.add_f32s(*x, bias));
            }
        }
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
