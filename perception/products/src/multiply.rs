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
pub const LANES: usize = 16;
/// Columns of the widest panel.
const WIDTH: usize = 2 * LANES;

/// Left rows in order: `rows` times `columns` windows. Lengths and offsets are in numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Windows {
    /// Where the first window starts.
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

/// Where products go: number `n` of window (`row`, `column`) to `first + row * pitch + column * step + n`.
#[derive(Debug)]
pub struct Target<'a> {
    /// Where products are written.
    pub data: &'a mut [f32],
    /// Index of the first number of window (0, 0).
    pub first: usize,
    /// From the first number of a window to that of the next column.
    pub step: usize,
    /// From the first number of a window to that of the next row.
    pub pitch: usize,
    /// How products are combined with the numbers in `data`.
    pub then: Then,
}

/// What becomes of a product with its bias.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Then {
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
pub struct Packed {
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
    pub fn new(
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
    pub fn fill(&mut self, columns: usize, weight: impl Fn(usize, usize) -> f32) {
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

    /// A matrix whose rows lie `pitch` numbers apart, without a bias: its first `length` rows, of `columns` columns.

    pub fn of_rows(instructions: Instructions, rows: &[f32], length: usize, columns: usize) -> Self {
        let outputs = columns.next_multiple_of(LANES);
        let mut packed =
            Self { instructions, segments: 1, length, outputs, words: Vec::new(), bias: vec![0.0; outputs] };
        let words_of_segment = packed.words_of_segment();
        packed.words.resize(words_of_segment * outputs, 0);
        let width = 2 * lanes(instructions);
        let row = |k: usize| if k < length { &rows[k * columns..][..columns] } else { &[] };
        for panel in (0..columns).step_by(width) {
            let width = width.min(outputs - panel);
            let words = packed.words[panel * words_of_segment..].chunks_exact_mut(width);
            let part = |k: usize| row(k).get(panel..(panel + width).min(columns)).unwrap_or_default();
            if instructions.is_bf16() {
                for (k, words) in words.take(length.div_ceil(2)).enumerate() {
                    words.iter_mut().zip(part(2 * k)).for_each(|(word, x)| *word = bf16(*x));
                    words.iter_mut().zip(part(2 * k + 1)).for_each(|(word, x)| *word |= bf16(*x) << 16);
                }
            } else {
                for (k, words) in words.take(length).enumerate() {
                    words.iter_mut().zip(part(k)).for_each(|(word, x)| *word = x.to_bits());
                }
            }
        }
        packed
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
pub struct Left<'a> {
    /// The numbers that windows select from.
    pub data: &'a [f32],
    /// Where the windows lie.
    pub windows: Windows,
    /// Whether max(x, 0) takes part in place of x.
    pub rectified: bool,
}

/// Multiplies the windows of `left` by a packed matrix. `words` is room for `left` in another form; its length and contents do not
/// matter.
///
/// # Panics
/// If a window or the target of one lies outside its slice, or bf16 words would have to be split.
pub fn multiply(weights: &Packed, left: Left<'_>, words: &mut Vec<u32>, target: Target<'_>) {
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
        assert!(windows.has_whole_words(), "a window begins within a word");
        let count = round(data, rectified, windows.step / 2, words);
        (&words[..count], windows.in_words())
    } else if rectified {
        words.resize(words.len().max(data.len()), 0);
        instructions.run(Rectify(data, bytemuck::cast_slice_mut(&mut words[..data.len()])));
        (&words[..], windows)
    } else {
        (bytemuck::cast_slice(data), windows)
    };
    run(Product { weights, left, windows, target });
}

/// Forms products with the instructions for which the matrix is packed.
fn run(product: Product<'_>) {
    match product.weights.instructions {
        #[cfg(target_arch = "x86_64")]
        Instructions::Amx => amx::run(product),
        #[cfg(target_arch = "x86_64")]
        Instructions::Avx512Bf16 => block::run_bf16(product),
        set => set.run(product),
    }
}

impl Windows {
    /// Whether bf16 words need not be split.
    fn has_whole_words(&self) -> bool {
        let Self { first, step, pitch, segment_pitch, .. } = self;
        (first | step | pitch | segment_pitch).is_multiple_of(2)
    }

    /// Places as those of words of bf16.
    fn in_words(self) -> Self {
        let Self { first, step, pitch, columns, rows, segment_pitch } = self;
        Self { first: first / 2, step: step / 2, pitch: pitch / 2, columns, rows, segment_pitch: segment_pitch / 2 }
    }
}

/// Rounds the left operand into `words`; returns how many are used. Windows are `step` words apart.
#[cfg(target_arch = "x86_64")]
fn round(data: &[f32], rectified: bool, step: usize, words: &mut Vec<u32>) -> usize {
    let count = data.len().div_ceil(2);
    let used = count + amx::OVERHANG * step + amx::STEP;
    words.resize(words.len().max(used), 0);
    block::round(data, &mut words[..count], rectified);
    // Tiles reach past the last window and the end of a segment. What lies there is multiplied by zero or not used, but zero times
    // what is not a number would not be zero.
    words[count..count + amx::STEP].fill(0);
    used
}

#[cfg(not(target_arch = "x86_64"))]
fn round(_: &[f32], _: bool, _: usize, words: &mut Vec<u32>) -> usize {
    words.len()
}

/// A left operand that takes part in several products, whose windows may begin anywhere.

#[derive(Debug, Default)]
pub struct Shared {
    words: Vec<u32>,
    /// The same from the second number on: bf16 words of windows that begin at odd places.
    shifted: Vec<u32>,
}

impl Shared {
    /// Takes numbers whose windows will be `step` apart, which must be even.
    pub fn load(&mut self, instructions: Instructions, data: &[f32], step: usize) {
        if instructions.is_bf16() {
            let used = round(data, false, step / 2, &mut self.words);
            self.shifted.resize(self.words.len(), 0);
            // Beyond the numbers is what is not used.
            let words = self.words[..used.min(data.len() / 2 + 2 * LANES)].windows(2);
            let shifted = words.map(|pair| pair[0] >> 16 | pair[1] << 16);
            self.shifted.iter_mut().zip(shifted).for_each(|(to, word)| *to = word);
        } else {
            self.words.clear();
            self.words.extend(data.iter().map(|x| x.to_bits()));
        }
    }

    /// Multiplies a row of windows by a matrix packed for the same instructions; the first begins at `first`, and all have the matrix'
    /// rows for a length.
    ///
    /// # Panics
    /// If a window or the target of one lies outside its slice.
    pub fn multiply(&self, weights: &Packed, first: usize, step: usize, columns: usize, target: Target<'_>) {
        let windows = Windows { first, step, pitch: 0, columns, rows: 1, segment_pitch: 0 };
        assert!(target.first + (columns - 1) * target.step + weights.outputs <= target.data.len(), "no place");
        let (left, windows) = match weights.instructions.is_bf16() {
            true if first.is_multiple_of(2) => (&self.words, windows.in_words()),
            true => (&self.shifted, windows.in_words()),
            false => (&self.words, windows),
        };
        let last = windows.first + (columns - 1) * windows.step;
        assert!(columns > 0 && last + weights.words_of_segment() <= left.len(), "a window ends outside its operand");
        run(Product { weights, left, windows, target });
    }
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
