//! The one matrix product behind linear layers, convolutions and attention.
//!
//! Left rows are windows of an image whose channels lie side by side (NHWC): a window is a number of segments, equally long and
//! equally far apart. The window of a linear layer is one segment, a token. The window of a 3 x 3 convolution is three segments of
//! three pixels with all their channels, so no pixel is copied. The right operand is packed beforehand into panels as wide as two
//! vectors. No other crate offers bf16 products on x86 or leaves the left operand in place; in f32 the packed kernel is as fast as
//! that of `gemm`.

// Why: notes/decisions/touch.md, "One matrix product".

#[cfg(target_arch = "x86_64")]
mod amx;
mod block;
mod packed;
mod product;

use pulp::{Simd, WithSimd};

use crate::Instructions;
pub use packed::{LANES, Packed};
use product::Product;
pub use product::{Target, Then, Windows};

/// Left operand of a product.
#[derive(Debug, Clone, Copy)]
pub struct Left<'a> {
    /// Numbers from which windows select.
    pub data: &'a [f32],
    /// Places of the windows.
    pub windows: Windows,
    /// Whether max(x, 0) is multiplied instead of x.
    pub rectified: bool,
}

impl<'a> Left<'a> {
    /// Takes the rows of a matrix, `length` numbers each, one behind the other.
    pub fn rows(data: &'a [f32], length: usize) -> Self {
        let columns = data.len() / length.max(1);
        let windows = Windows { first: 0, step: length, pitch: 0, columns, rows: 1, segment_pitch: 0 };
        Self { data, windows, rectified: false }
    }
}

/// Multiplies the windows of `left` by a packed matrix and writes the products, whole vectors of them, to `target`. `words` is room
/// for `left` in another form; its length and contents do not matter.
///
/// # Panics
/// If a window or its target lies outside its slice, or if bf16 is used and a window or segment begins at an odd place.
pub fn multiply(weights: &Packed, left: Left<'_>, words: &mut Vec<u32>, target: Target<'_>) {
    let Left { data, windows, rectified } = left;
    if windows.rows == 0 || windows.columns == 0 {
        return;
    }
    let counts = [windows.rows, windows.columns, weights.segments];
    let end = end_of(windows.first, counts, [windows.pitch, windows.step, windows.segment_pitch], weights.length);
    assert!(end <= data.len(), "a window ends outside its operand");
    let end = end_of(target.first, [windows.rows, windows.columns, 1], [target.pitch, target.step, 0], weights.outputs);
    assert!(end <= target.data.len(), "a product ends outside the target");
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

/// Returns the end of the last of several pieces of some length; of pieces beyond all memory, the greatest number.
fn end_of(first: usize, counts: [usize; 3], distances: [usize; 3], length: usize) -> usize {
    let ends = counts.into_iter().zip(distances);
    ends.fold(first.saturating_add(length), |end, (count, distance)| {
        end.saturating_add(count.saturating_sub(1).saturating_mul(distance))
    })
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

/// Rounds the left operand into `words` and returns the number of words that are used. Windows are `step` words apart.
#[cfg(target_arch = "x86_64")]
fn round(data: &[f32], rectified: bool, step: usize, words: &mut Vec<u32>) -> usize {
    let count = data.len().div_ceil(2);
    let used = (count + packed::TILE_WORDS).saturating_add(amx::OVERHANG.saturating_mul(step));
    words.resize(words.len().max(used), 0);
    block::round(data, &mut words[..count], rectified);
    // Tiles reach past the last window and the end of a segment. The words there are multiplied by zero or not used, but zero times
    // NaN would not be zero.
    words[count..count + packed::TILE_WORDS].fill(0);
    used
}

#[cfg(not(target_arch = "x86_64"))]
fn round(_: &[f32], _: bool, _: usize, words: &mut Vec<u32>) -> usize {
    words.len()
}

/// Left operand of several products, whose windows may begin anywhere.
#[derive(Debug, Default)]
pub struct SharedLeft {
    words: Vec<u32>,
    /// The same numbers from the second on: bf16 words of windows that begin at odd places.
    shifted: Vec<u32>,
}

impl SharedLeft {
    /// Copies numbers. Their windows will be `step` apart, an even number.
    pub fn load(&mut self, instructions: Instructions, data: &[f32], step: usize) {
        if instructions.is_bf16() {
            let used = round(data, false, step / 2, &mut self.words);
            self.shifted.resize(self.words.len(), 0);
            // The words beyond the numbers are not used.
            let words = self.words[..used.min(data.len() / 2 + 2 * LANES)].windows(2);
            let shifted = words.map(|pair| pair[0] >> 16 | pair[1] << 16);
            self.shifted.iter_mut().zip(shifted).for_each(|(to, word)| *to = word);
        } else {
            self.words.clear();
            self.words.extend(data.iter().map(|x| x.to_bits()));
        }
    }

    /// Multiplies a row of windows by a matrix of one segment, packed for the instructions with which the numbers were loaded. The
    /// first window begins at `first`; each is as long as the matrix has rows.
    ///
    /// # Panics
    /// If there are no windows, or a window or its target lies outside its slice.
    pub fn multiply(&self, weights: &Packed, first: usize, step: usize, columns: usize, target: Target<'_>) {
        let windows = Windows { first, step, pitch: 0, columns, rows: 1, segment_pitch: 0 };
        let end = end_of(target.first, [columns, 1, 1], [target.step, 0, 0], weights.outputs);
        assert!(end <= target.data.len(), "a product ends outside the target");
        let (left, windows) = match weights.instructions.is_bf16() {
            true if first.is_multiple_of(2) => (&self.words, windows.in_words()),
            true => (&self.shifted, windows.in_words()),
            false => (&self.words, windows),
        };
        let end = end_of(windows.first, [columns, 1, 1], [windows.step, 0, 0], weights.words_of_segment());
        assert!(columns > 0 && end <= left.len(), "a window ends outside its operand");
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

#[cfg(test)]
mod tests;
