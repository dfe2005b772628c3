//! Windows of the left operand, targets of the products, and the end that all kernels share.

use pulp::Simd;

use super::packed::{Packed, WIDTH};
use crate::math;

/// Places of `rows` times `columns` windows, the left rows in order. Lengths and offsets count numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Windows {
    /// Start of the first window.
    pub first: usize,
    /// From a window to the next in its row.
    pub step: usize,
    /// From a row of windows to the next.
    pub pitch: usize,
    /// Windows in a row.
    pub columns: usize,
    /// Rows of windows.
    pub rows: usize,
    /// From a segment of a window to the next.
    pub segment_pitch: usize,
}

/// Places of products: number `n` of window (`row`, `column`) is written to `first + row * pitch + column * step + n`.
#[derive(Debug)]
pub struct Target<'a> {
    /// Slice to which products are written.
    pub data: &'a mut [f32],
    /// Index of the first number of window (0, 0).
    pub first: usize,
    /// From the first number of a window to that of the next column.
    pub step: usize,
    /// From the first number of a window to that of the next row.
    pub pitch: usize,
    /// Use of a product.
    pub then: Then,
}

/// Use of a product x, its bias included.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Then {
    /// x is stored.
    Store,
    /// x is added to the number in the target.
    Add,
    /// max(x, 0) is stored.
    Relu,
    /// The Gaussian error linear unit of x is stored.
    Gelu,
    /// The softplus of x is stored.
    Softplus,
}

impl Windows {
    /// Returns whether every window and segment begins with a whole bf16 word.
    pub(super) fn has_whole_words(&self) -> bool {
        let Self { first, step, pitch, segment_pitch, .. } = self;
        (first | step | pitch | segment_pitch).is_multiple_of(2)
    }

    /// Returns the places in words of bf16.
    pub(super) fn in_words(self) -> Self {
        let Self { first, step, pitch, columns, rows, segment_pitch } = self;
        Self { first: first / 2, step: step / 2, pitch: pitch / 2, columns, rows, segment_pitch: segment_pitch / 2 }
    }
}

/// Multiplication with checked operands.
pub(super) struct Product<'a> {
    pub(super) weights: &'a Packed,
    pub(super) left: &'a [u32],
    /// In words.
    pub(super) windows: Windows,
    pub(super) target: Target<'a>,
}

impl Product<'_> {
    /// Adds the bias and writes to the target: products of the windows from (`row`, `column`) on, one per row of `block`, and of the
    /// columns from `output` on.
    #[inline(always)]
    pub(super) fn finish<S: Simd, const VECTORS: usize>(
        &mut self,
        simd: S,
        block: &[[f32; WIDTH]],
        row: usize,
        column: usize,
        output: usize,
    ) {
        let width = VECTORS * S::F32_LANES;
        let zero = simd.splat_f32s(0.0);
        let bias = S::as_simd_f32s(&self.weights.bias[output..output + width]).0;
        let Target { data, first, step, pitch, then } = &mut self.target;
        let mut at = *first + row * *pitch + column * *step + output;
        for sums in block {
            let sums = S::as_simd_f32s(&sums[..width]).0;
            let to = S::as_mut_simd_f32s(&mut data[at..at + width]).0;
            for ((to, &sum), &bias) in to.iter_mut().zip(sums).zip(bias) {
                let sum = simd.add_f32s(sum, bias);
                *to = match then {
                    Then::Store => sum,
                    Then::Add => simd.add_f32s(*to, sum),
                    Then::Relu => simd.max_f32s(sum, zero),
                    Then::Gelu => math::gelu(simd, sum),
                    Then::Softplus => math::softplus(simd, sum),
                };
            }
            at += *step;
        }
    }
}
