//! Linear maps and matrix products.

use std::cell::RefCell;

use ndarray::linalg::general_mat_mul;
use ndarray::{ArrayView2, ArrayViewMut2, ShapeBuilder as _};
use rayon::prelude::*;

use crate::lanes::{add_to, total};
use crate::tape::{Inputs, Kernel, Slopes};
use mvt_products::Instructions;
use mvt_products::multiply::{LANES, Left, Packed, SharedLeft, Target, Then, Windows, multiply};
use mvt_touch::network::WeightTensor;

// Why: notes/decisions/touch.md, "Sums in a fixed order, per image or block of rows".
/// Rows that are multiplied together. Rows are summed per block and then in the order of the blocks, so that the result does not depend
/// on the number of threads.
const BLOCK: usize = 1024;

/// Returns a matrix over a slice: `rows` by `columns` with the given strides, which may overlap.
///
/// # Panics
/// If the slice is too short. Kernels compute sizes from shapes that the architecture fixes, so this is a mistake in a kernel.
pub(crate) fn matrix(values: &[f32], [rows, columns]: [usize; 2], strides: [usize; 2]) -> ArrayView2<'_, f32> {
    match ArrayView2::from_shape((rows, columns).strides((strides[0], strides[1])), values) {
        Ok(view) => view,
        Err(error) => unreachable!("{rows} x {columns} by {strides:?} of {}: {error}", values.len()),
    }
}

/// Returns a row-major matrix over all of a slice.
///
/// # Panics
/// If `columns` does not divide the length of the slice: a mistake in a kernel.
pub(crate) fn matrix_mut(values: &mut [f32], columns: usize) -> ArrayViewMut2<'_, f32> {
    let (rows, len) = (values.len() / columns, values.len());
    match ArrayViewMut2::from_shape((rows, columns), values) {
        Ok(view) => view,
        Err(error) => unreachable!("{rows} x {columns} of {len}: {error}"),
    }
}

/// Adds the product of two matrices to a third.
#[expect(clippy::needless_pass_by_value, reason = "views are references already")]
pub(crate) fn add_product(a: ArrayView2<'_, f32>, b: ArrayView2<'_, f32>, c: &mut ArrayViewMut2<'_, f32>) {
    general_mat_mul(1.0, &a, &b, 1.0, c);
}

/// Room of a thread for operands and results in other forms.
#[derive(Default)]
pub(crate) struct ProductBuffers {
    pub(crate) padded: Vec<f32>,
    pub(crate) shared: SharedLeft,
    words: Vec<u32>,
    block: Vec<f32>,
}

/// Runs a function that needs room. The function must not call rayon: work stolen by this thread might need the same room.
pub(crate) fn with_buffers<R>(run: impl FnOnce(&mut ProductBuffers) -> R) -> R {
    thread_local!(static BUFFERS: RefCell<ProductBuffers> = RefCell::default());
    BUFFERS.with_borrow_mut(run)
}

impl ProductBuffers {
    /// Multiplies the windows of `left`, row by row, by a packed matrix of `columns` columns and writes the products to `out`.
    pub(crate) fn multiply(&mut self, left: Left<'_>, packed: &Packed, columns: usize, out: &mut [f32]) {
        let words = &mut self.words;
        into_columns(left.windows, columns, out, &mut self.block, |target| multiply(packed, left, words, target));
    }

    /// Multiplies `rows` rows of `shared`, `step` apart from `first` on, by a packed matrix of `columns` columns and writes the products
    /// to `out`.
    pub(crate) fn multiply_shared(
        &mut self,
        packed: &Packed,
        first: usize,
        step: usize,
        rows: usize,
        columns: usize,
        out: &mut [f32],
    ) {
        let windows = Windows { first, step, pitch: 0, columns: rows, rows: 1, segment_pitch: 0 };
        let shared = &self.shared;
        into_columns(windows, columns, out, &mut self.block, |target| {
            shared.multiply(packed, first, step, rows, target);
        });
    }
}

/// Lets `multiply` write products, a row of `columns` numbers per window, to `out`; first to `block` where rows do not fill vectors.
fn into_columns(
    windows: Windows,
    columns: usize,
    out: &mut [f32],
    block: &mut Vec<f32>,
    multiply: impl FnOnce(Target<'_>),
) {
    let step = columns.next_multiple_of(LANES);
    let (first, pitch, then) = (0, windows.columns * step, Then::Store);
    if step == columns {
        return multiply(Target { data: out, first, step, pitch, then });
    }
    block.resize(block.len().max(windows.rows * pitch), 0.0);
    multiply(Target { data: block, first, step, pitch, then });
    for (to, from) in out.chunks_exact_mut(columns).zip(block.chunks_exact(step)) {
        to.copy_from_slice(&from[..columns]);
    }
}

/// Returns the instructions for rows of this length. An odd length rules out bf16, since a pair of numbers would span two rows.
pub(crate) fn for_length(instructions: Instructions, length: usize) -> Instructions {
    if length.is_multiple_of(2) { instructions } else { instructions.exact() }
}

/// `y = W x + b` over the last axis; inputs x, W `[out, in]`, b `[out]`.
#[derive(Debug, Clone)]
pub struct Linear {
    /// Instructions of the products.
    pub instructions: Instructions,
}

impl Kernel<3> for Linear {
    type Kept = ();

    fn forward(&self, [x, weight, bias]: Inputs<'_, 3>) -> (WeightTensor, ()) {
        let (outputs, inputs) = (weight.shape[0], weight.shape[1]);
        let mut shape = x.shape.to_vec();
        shape.pop();
        shape.push(outputs);
        let mut values = vec![0.0; x.values.len() / inputs * outputs];
        let packed = weight.forwards(|| {
            let instructions = for_length(self.instructions, inputs);
            Packed::new(instructions, 1, inputs, bias.values, |i, o| weight.values[o * inputs + i])
        });
        let blocks = values.par_chunks_mut(BLOCK * outputs).zip(x.values.par_chunks(BLOCK * inputs));
        blocks.for_each(|(y, x)| {
            with_buffers(|buffers| buffers.multiply(Left::rows(x, inputs), packed, outputs, y));
        });
        (WeightTensor { shape, values }, ())
    }

    fn backward(&self, [x, weight, bias]: Inputs<'_, 3>, (): &(), gradient: &[f32], wanted: [bool; 3]) -> Slopes<3> {
        let (outputs, inputs) = (weight.shape[0], weight.shape[1]);
        let by_x = wanted[0].then(|| {
            let mut values = vec![0.0; x.values.len()];
            let packed = weight.backwards(|| {
                let instructions = for_length(self.instructions, outputs);
                Packed::new(instructions, 1, outputs, &vec![0.0; inputs], |o, i| weight.values[o * inputs + i])
            });
            let blocks = values.par_chunks_mut(BLOCK * inputs).zip(gradient.par_chunks(BLOCK * outputs));
            blocks.for_each(|(by_x, g)| {
                with_buffers(|buffers| buffers.multiply(Left::rows(g, outputs), packed, inputs, by_x));
            });
            x.like(values)
        });
        let blocks = gradient.par_chunks(BLOCK * outputs).zip(x.values.par_chunks(BLOCK * inputs));
        let parts = blocks.map(|(g, x)| {
            let rows = x.len() / inputs;
            let mut sums = vec![0.0; outputs * (inputs + 1)];
            let (by_weight, by_bias) = sums.split_at_mut(outputs * inputs);
            let packed = Packed::of_rows(self.instructions, x, rows, inputs);
            let step = rows.next_multiple_of(2);
            with_buffers(|buffers| {
                // Output by output.
                buffers.padded.clear();
                buffers.padded.resize(outputs * step, 0.0);
                for (o, to) in buffers.padded.chunks_exact_mut(step).enumerate() {
                    to.iter_mut().zip(g[o..].iter().step_by(outputs)).for_each(|(to, from)| *to = *from);
                }
                buffers.shared.load(self.instructions, &buffers.padded, step);
                buffers.multiply_shared(&packed, 0, step, outputs, inputs, by_weight);
            });
            g.chunks_exact(outputs).for_each(|row| add_to(by_bias, row));
            sums
        });
        let mut sums = total(parts.collect(), outputs * (inputs + 1));
        let by_bias = sums.split_off(outputs * inputs);
        [by_x, Some(weight.like(sums)), Some(bias.like(by_bias))]
    }
}
