//! The one matrix product behind linear layers, convolutions and attention.
//!
//! Left rows are windows of an image whose channels lie side by side (NHWC): a window is a number of segments, equally long and
//! equally far apart. A linear layer's window is one segment, a token; that of a 3 x 3 convolution three, each of three pixels with
//! all their channels, so that nothing is copied for it. The right operand is packed beforehand into panels of two vectors' width.
//! No crate offers bf16 products on x86, and none lets the left operand stay where it is; in f32 the packed kernel is as fast as
//! `gemm`'s.

#[cfg(target_arch = "x86_64")]
mod amx;
mod block;

use pulp::{Simd, WithSimd};

use super::{Instructions, math};

#[cfg(target_arch = "x86_64")]
pub(super) use amx::has_amx;
use block::Float;
#[cfg(target_arch = "x86_64")]
pub(super) use block::has_bf16;

/// Channels are stored in multiples of this, the widest vector: kernels need no tails.
pub(super) const LANES: usize = 16;
/// Columns of the widest panel.
const WIDTH: usize = 2 * LANES;

/// Left rows in order: `rows` times `columns` windows. Lengths and offsets are in numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Windows {
    /// Where the first window starts.
    pub(super) first: usize,
    /// From a window to the next in its row.
    pub(super) step: usize,
    /// From a row of windows to the next.
    pub(super) pitch: usize,
    /// Windows in a row.
    pub(super) columns: usize,
    /// Rows of windows.
    pub(super) rows: usize,
    /// From a segment of a window to the next.
    pub(super) segment_pitch: usize,
}

/// Where products go: number `n` of window (`row`, `column`) to `first + row * pitch + column * step + n`.
#[derive(Debug)]
pub(super) struct Target<'a> {
    pub(super) data: &'a mut [f32],
    pub(super) first: usize,
    pub(super) step: usize,
    pub(super) pitch: usize,
    pub(super) then: Then,
}

/// What becomes of a product with its bias.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Then {
    /// It is stored.
    Store,
    /// It is added to what is there.
    Add,
    /// max(x, 0) is stored.
    Relu,
    /// The Gaussian error linear unit of it is stored.
    Gelu,
    /// The softplus of it is stored.
    Softplus,
}

/// A right operand with a bias, packed for one instruction set.
#[derive(Debug, Clone)]
pub(super) struct Packed {
    instructions: Instructions,
    segments: usize,
    /// Numbers of a segment.
    length: usize,
    /// Columns, with those that fill the last vector.
    outputs: usize,
    /// Panel by panel, segment by segment, word by word: as many words as a panel has columns. A word is an f32 or, for bf16, two
    /// consecutive numbers of a column.
    words: Vec<u32>,
    bias: Vec<f32>,
}

impl Packed {
    /// A matrix of `segments * length` rows and as many columns as `bias` has; `weight` gives its entries by row and column.
    pub(super) fn new(
        instructions: Instructions,
        segments: usize,
        length: usize,
        bias: &[f32],
        weight: impl Fn(usize, usize) -> f32,
    ) -> Self {
        let outputs = bias.len().next_multiple_of(LANES);
        let mut packed = Self { instructions, segments, length, outputs, words: Vec::new(), bias: bias.to_vec() };
        packed.bias.resize(outputs, 0.0);
        packed.words.resize(segments * packed.words_of_segment() * outputs, 0);
        packed.fill(bias.len(), weight);
        packed
    }

    /// Replaces the entries of the first `columns` columns.
    pub(super) fn fill(&mut self, columns: usize, weight: impl Fn(usize, usize) -> f32) {
        let (words_of_segment, per_word) = (self.words_of_segment(), if self.instructions.is_bf16() { 2 } else { 1 });
        let width = 2 * lanes(self.instructions);
        let mut words = self.words.iter_mut();
        for panel in (0..self.outputs).step_by(width) {
            for segment in 0..self.segments {
                for word in 0..words_of_segment {
                    for column in panel..(panel + width).min(self.outputs) {
                        let number = |at: usize| {
                            let is_there = at < self.length && column < columns;
                            if is_there { weight(segment * self.length + at, column) } else { 0.0 }
                        };
                        let Some(to) = words.next() else { return };
                        *to = match per_word {
                            1 => number(word).to_bits(),
                            _ => pair(number(2 * word), number(2 * word + 1)),
                        };
                    }
                }
            }
        }
    }

    /// Words of a segment, with those that fill the last step of the kernel.
    fn words_of_segment(&self) -> usize {
        match self.instructions {
            #[cfg(target_arch = "x86_64")]
            Instructions::Amx => self.length.div_ceil(2).next_multiple_of(amx::STEP),
            set if set.is_bf16() => self.length.div_ceil(2),
            _ => self.length,
        }
    }
}

/// Lanes of a vector.
fn lanes(instructions: Instructions) -> usize {
    match instructions {
        Instructions::Amx | Instructions::Avx512Bf16 | Instructions::Avx512 => 16,
        Instructions::Avx2 => 8,
        Instructions::Scalar => 4,
    }
}

/// The number rounded to bf16, ties to even.
fn bf16(x: f32) -> u32 {
    let bits = x.to_bits();
    (bits + 0x7fff + (bits >> 16 & 1)) >> 16
}

/// Two numbers as one word, the first in its lower half.
fn pair(low: f32, high: f32) -> u32 {
    bf16(low) | bf16(high) << 16
}

/// The left operand of a product.
#[derive(Debug, Clone, Copy)]
pub(super) struct Left<'a> {
    pub(super) data: &'a [f32],
    pub(super) windows: Windows,
    /// Whether max(x, 0) takes part in place of x.
    pub(super) rectified: bool,
}

/// Multiplies the windows of `left` by a packed matrix. `words` is room for `left` in another form; its length and contents do not
/// matter.
///
/// # Panics
/// If a window or the target of one lies outside its slice, or bf16 words would have to be split.
pub(super) fn multiply(weights: &Packed, left: Left<'_>, words: &mut Vec<u32>, target: Target<'_>) {
    let Left { data, windows, rectified } = left;
    if windows.rows == 0 || windows.columns == 0 {
        return;
    }
    let last = windows.first
        + (windows.rows - 1) * windows.pitch
        + (windows.columns - 1) * windows.step
        + (weights.segments - 1) * windows.segment_pitch;
    assert!(last + weights.length <= data.len(), "a window ends outside its operand");
    let last = target.first + (windows.rows - 1) * target.pitch + (windows.columns - 1) * target.step;
    assert!(last + weights.outputs <= target.data.len(), "a product has no place");
    let instructions = weights.instructions;
    let (left, windows) = if instructions.is_bf16() {
        words_of_bf16(data, &windows, rectified, words)
    } else if rectified {
        words.resize(words.len().max(data.len()), 0);
        instructions.run(Rectify(data, bytemuck::cast_slice_mut(&mut words[..data.len()])));
        (&words[..], windows)
    } else {
        (bytemuck::cast_slice(data), windows)
    };
    let product = Product { weights, left, windows, target };
    match instructions {
        #[cfg(target_arch = "x86_64")]
        Instructions::Amx => amx::run(product),
        #[cfg(target_arch = "x86_64")]
        Instructions::Avx512Bf16 => block::run_bf16(product),
        set => set.run(product),
    }
}

/// Rounds the left operand into `words`; returns them with the windows' places in them.
#[cfg(target_arch = "x86_64")]
fn words_of_bf16<'a>(
    data: &[f32],
    windows: &Windows,
    rectified: bool,
    words: &'a mut Vec<u32>,
) -> (&'a [u32], Windows) {
    let &Windows { first, step, pitch, columns, rows, segment_pitch } = windows;
    assert!((first | step | pitch | segment_pitch).is_multiple_of(2), "a window begins within a word");
    let windows =
        Windows { first: first / 2, step: step / 2, pitch: pitch / 2, columns, rows, segment_pitch: segment_pitch / 2 };
    let count = data.len().div_ceil(2);
    words.resize(words.len().max(count + amx::OVERHANG * windows.step + amx::STEP), 0);
    block::round(data, &mut words[..count], rectified);
    // Tiles reach past the last window and the end of a segment. What lies there is multiplied by zero or not used, but zero times
    // what is not a number would not be zero.
    words[count..count + amx::STEP].fill(0);
    (words, windows)
}

#[cfg(not(target_arch = "x86_64"))]
fn words_of_bf16<'a>(_: &[f32], windows: &Windows, _: bool, words: &'a mut Vec<u32>) -> (&'a [u32], Windows) {
    (words, *windows)
}

/// Stores max(x, 0).
struct Rectify<'a>(&'a [f32], &'a mut [f32]);

impl WithSimd for Rectify<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        for (to, &x) in self.1.iter_mut().zip(self.0) {
            *to = x.max(0.0);
        }
    }
}

/// A multiplication whose operands have been checked.
struct Product<'a> {
    weights: &'a Packed,
    left: &'a [u32],
    /// In words.
    windows: Windows,
    target: Target<'a>,
}

impl WithSimd for Product<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        block::run(Float(simd), self);
    }
}

impl Product<'_> {
    /// Puts products with their bias where they belong: those of the windows from (`row`, `column`) on, one per row of `block`, and of
    /// the columns from `output` on.
    #[inline(always)]
    fn finish<S: Simd, const VECTORS: usize>(
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

#[cfg(test)]
mod tests;
