//! Right operands, packed for one instruction set.

use crate::Instructions;

/// Channels are stored in multiples of this, the lanes of the widest vector, so that kernels need no tails.
pub const LANES: usize = 16;
/// Columns of the widest panel.
pub(super) const WIDTH: usize = 2 * LANES;
/// Words of a segment that one instruction of AMX takes, 32 numbers.
pub(super) const TILE_WORDS: usize = 16;

/// Right operand with a bias, packed for one instruction set.
#[derive(Debug, Clone)]
pub struct Packed {
    pub(super) instructions: Instructions,
    pub(super) segments: usize,
    /// Numbers of a segment.
    pub(super) length: usize,
    /// Columns, with those that fill the last vector.
    pub(super) outputs: usize,
    /// Panel by panel, segment by segment, word by word: one word per column of the panel. A word is an f32 or, for bf16, two
    /// consecutive numbers of a column.
    pub(super) words: Vec<u32>,
    pub(super) bias: Vec<f32>,
}

impl Packed {
    /// Packs a matrix of `segments * length` rows and one column per number of `bias`; `weight` returns its entries by row and column.
    ///
    /// # Panics
    /// If there are no segments.
    pub fn new(
        instructions: Instructions,
        segments: usize,
        length: usize,
        bias: &[f32],
        weight: impl Fn(usize, usize) -> f32,
    ) -> Self {
        assert!(segments > 0, "a matrix has one segment at least");
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

    /// Packs a matrix of `length` rows of `columns` numbers, one behind the other in `rows`, without a bias.
    ///
    /// # Panics
    /// If `rows` is too short.
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

    /// Returns the number of words of a segment, with those that fill the last step of the kernel.
    pub(super) fn words_of_segment(&self) -> usize {
        match self.instructions {
            #[cfg(target_arch = "x86_64")]
            Instructions::Amx => self.length.div_ceil(2).next_multiple_of(TILE_WORDS),
            set if set.is_bf16() => self.length.div_ceil(2),
            _ => self.length,
        }
    }
}

/// Returns the lanes of a vector.
fn lanes(instructions: Instructions) -> usize {
    match instructions {
        Instructions::Amx | Instructions::Avx512Bf16 | Instructions::Avx512 => 16,
        Instructions::Avx2 => 8,
        Instructions::Scalar => 4,
    }
}

/// Returns the number rounded to bf16, ties to even.
fn bf16(x: f32) -> u32 {
    let bits = x.to_bits();
    (bits + 0x7fff + (bits >> 16 & 1)) >> 16
}

/// Returns two numbers as one word, the first in its lower half.
pub(super) fn pair(low: f32, high: f32) -> u32 {
    bf16(low) | bf16(high) << 16
}
