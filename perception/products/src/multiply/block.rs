//! Products of a few windows with one panel, summed in registers, for every instruction set but AMX.

use pulp::{Simd, WithSimd};

use super::packed::WIDTH;
use super::product::Product;
use crate::math::multiply_add;

/// Windows that are multiplied by all panels before the next ones, so that they stay in the cache.
const BLOCK: usize = 96;

/// Multiplication of words by one instruction set.
pub(super) trait Dot: Copy {
    type S: Simd;
    /// Greatest number of windows whose sums fit in the registers beside the operands.
    const ROWS: usize;

    fn simd(self) -> Self::S;

    /// Adds the products of a word with a vector of words.
    fn dot(self, sum: <Self::S as Simd>::f32s, left: u32, right: <Self::S as Simd>::u32s) -> <Self::S as Simd>::f32s;
}

/// Multiplication of f32 words.
#[derive(Clone, Copy)]
pub(super) struct Float<S>(pub(super) S);

impl<S: Simd> Dot for Float<S> {
    type S = S;
    const ROWS: usize = if S::F32_LANES == 16 { 12 } else { 6 };

    #[inline(always)]
    fn simd(self) -> S {
        self.0
    }

    #[inline(always)]
    fn dot(self, sum: S::f32s, left: u32, right: S::u32s) -> S::f32s {
        multiply_add(self.0, self.0.splat_f32s(f32::from_bits(left)), self.0.transmute_f32s_u32s(right), sum)
    }
}

#[cfg(target_arch = "x86_64")]
mod bf16 {
    use std::arch::x86_64::{
        __m512, __m512bh, __m512i, _mm512_cvtne2ps_pbh, _mm512_dpbf16_ps, _mm512_max_ps, _mm512_set1_epi32,
        _mm512_set1_ps,
    };

    use pulp::{NullaryFnOnce, f32x16, u32x16, x86::V4};

    use super::super::packed::pair;
    use super::{Dot, Product, run};
    use crate::detect::Bf16Features;

    /// Multiplication of words of two bf16 numbers.
    #[derive(Clone, Copy)]
    struct Bf16(V4);

    impl Dot for Bf16 {
        type S = V4;
        const ROWS: usize = 12;

        #[inline(always)]
        fn simd(self) -> V4 {
            self.0
        }

        #[inline(always)]
        fn dot(self, sum: f32x16, left: u32, right: u32x16) -> f32x16 {
            // SAFETY: only `run_bf16` creates a `Bf16`, on a machine with the features; vectors of one size may be reinterpreted.
            unsafe {
                let sum = std::mem::transmute::<f32x16, __m512>(sum);
                let left = std::mem::transmute::<__m512i, __m512bh>(_mm512_set1_epi32(left.cast_signed()));
                let right = std::mem::transmute::<u32x16, __m512bh>(right);
                std::mem::transmute::<__m512, f32x16>(_mm512_dpbf16_ps(sum, left, right))
            }
        }
    }

    struct Round<'a> {
        numbers: &'a [f32],
        words: &'a mut [u32],
        rectified: bool,
    }

    impl NullaryFnOnce for Round<'_> {
        type Output = ();

        #[inline(always)]
        fn call(self) {
            let least = if self.rectified { 0.0 } else { f32::NEG_INFINITY };
            let (numbers, rest) = self.numbers.as_chunks::<32>();
            let (words, words_of_rest) = self.words.split_at_mut(16 * numbers.len());
            for (to, numbers) in words.as_chunks_mut::<16>().0.iter_mut().zip(numbers) {
                // SAFETY: `round` calls this with the features that it needs; vectors of one size may be reinterpreted.
                *to = unsafe {
                    let [low, high] = std::mem::transmute::<[f32; 32], [__m512; 2]>(*numbers)
                        .map(|x| _mm512_max_ps(x, _mm512_set1_ps(least)));
                    std::mem::transmute::<__m512bh, [u32; 16]>(_mm512_cvtne2ps_pbh(high, low))
                };
            }
            for (to, two) in words_of_rest.iter_mut().zip(rest.chunks(2)) {
                *to = pair(two[0].max(least), two.get(1).map_or(0.0, |x| x.max(least)));
            }
        }
    }

    /// Rounds numbers to bf16, two to a word; negative ones to zero if `rectified`.
    pub(in super::super) fn round(numbers: &[f32], words: &mut [u32], rectified: bool) {
        if let Some(features) = Bf16Features::try_new() {
            features.vectorize(Round { numbers, words, rectified });
        }
    }

    struct Job<'a>(V4, Product<'a>);

    impl NullaryFnOnce for Job<'_> {
        type Output = ();

        #[inline(always)]
        fn call(self) {
            run(Bf16(self.0), self.1);
        }
    }

    /// Multiplies words of bf16. Does nothing on a machine without bf16, where no matrix is packed for it.
    pub(in super::super) fn run_bf16(product: Product<'_>) {
        if let (Some(features), Some(simd)) = (Bf16Features::try_new(), V4::try_new()) {
            features.vectorize(Job(simd, product));
        }
    }
}
#[cfg(target_arch = "x86_64")]
pub(super) use bf16::{round, run_bf16};

impl WithSimd for Product<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        run(Float(simd), self);
    }
}

/// Forms all products.
#[inline(always)]
pub(super) fn run<D: Dot>(dot: D, mut product: Product<'_>) {
    let lanes = D::S::F32_LANES;
    let windows = product.windows;
    for row in 0..windows.rows {
        for begin in (0..windows.columns).step_by(BLOCK) {
            let end = (begin + BLOCK).min(windows.columns);
            for output in (0..product.weights.outputs).step_by(2 * lanes) {
                if output + 2 * lanes <= product.weights.outputs {
                    strip::<D, 2>(dot, &mut product, row, begin..end, output);
                } else {
                    strip::<D, 1>(dot, &mut product, row, begin..end, output);
                }
            }
        }
    }
}

/// Forms the products of some windows of a row with a panel.
#[inline(always)]
fn strip<D: Dot, const VECTORS: usize>(
    dot: D,
    product: &mut Product<'_>,
    row: usize,
    columns: std::ops::Range<usize>,
    output: usize,
) {
    let mut block = [[0.0; WIDTH]; 12];
    let mut column = columns.start;
    while column < columns.end {
        let rows = match columns.end - column {
            12.. if D::ROWS >= 12 => tile::<D, 12, VECTORS>(dot, product, row, column, output, &mut block),
            6.. => tile::<D, 6, VECTORS>(dot, product, row, column, output, &mut block),
            4.. => tile::<D, 4, VECTORS>(dot, product, row, column, output, &mut block),
            2.. => tile::<D, 2, VECTORS>(dot, product, row, column, output, &mut block),
            _ => tile::<D, 1, VECTORS>(dot, product, row, column, output, &mut block),
        };
        product.finish::<D::S, VECTORS>(dot.simd(), &block[..rows], row, column, output);
        column += rows;
    }
}

/// Forms the products of `ROWS` windows with a panel of `VECTORS` vectors. Returns `ROWS`.
#[inline(always)]
fn tile<D: Dot, const ROWS: usize, const VECTORS: usize>(
    dot: D,
    product: &Product<'_>,
    row: usize,
    column: usize,
    output: usize,
    block: &mut [[f32; WIDTH]],
) -> usize {
    let simd = dot.simd();
    let (left, windows) = (product.left, product.windows);
    let (segments, length) = (product.weights.segments, product.weights.words_of_segment());
    let left = &left[windows.first + row * windows.pitch + column * windows.step..];
    let reach = (ROWS - 1).saturating_mul(windows.step).saturating_add((segments - 1) * windows.segment_pitch + length);
    assert!(reach <= left.len());
    let panel = &product.weights.words[segments * length * output..];
    assert!(segments * length * VECTORS * D::S::F32_LANES <= panel.len());

    let mut sums = [[simd.splat_f32s(0.0); VECTORS]; ROWS];
    let mut right = panel.as_ptr().cast::<<D::S as Simd>::u32s>();
    for segment in 0..segments {
        let left = left[segment * windows.segment_pitch..].as_ptr();
        for word in 0..length {
            // SAFETY: the assertions above bound both reads; vectors of u32 may lie at any address where a u32 may lie.
            unsafe {
                let vectors: [_; VECTORS] = std::array::from_fn(|v| right.add(v).read_unaligned());
                right = right.add(VECTORS);
                for (r, sums) in sums.iter_mut().enumerate() {
                    let left = *left.add(r * windows.step + word);
                    for (sum, vector) in sums.iter_mut().zip(vectors) {
                        *sum = dot.dot(*sum, left, vector);
                    }
                }
            }
        }
    }
    for (row, sums) in block.iter_mut().zip(sums) {
        for (to, sum) in D::S::as_mut_simd_f32s(row).0.iter_mut().zip(sums) {
            *to = sum;
        }
    }
    ROWS
}
