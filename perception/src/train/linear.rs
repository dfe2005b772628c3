//! Linear maps and matrix products.

use ndarray::linalg::general_mat_mul;
use ndarray::{ArrayView2, ArrayViewMut2, ShapeBuilder as _};
use rayon::prelude::*;

use super::tape::{Kernel, View};
use crate::network::Tensor;

/// Rows that are multiplied together. Sums over rows are made per block and then in the blocks' order, so that the result does not
/// depend on the number of threads.
const BLOCK: usize = 1024;

/// A matrix over a slice: `rows` by `columns` with the given strides, which may overlap.
///
/// # Panics
/// If the slice is too short: a mistake in the caller.
pub(super) fn matrix(values: &[f32], [rows, columns]: [usize; 2], strides: [usize; 2]) -> ArrayView2<'_, f32> {
    match ArrayView2::from_shape((rows, columns).strides((strides[0], strides[1])), values) {
        Ok(view) => view,
        Err(error) => unreachable!("{rows} x {columns} by {strides:?} of {}: {error}", values.len()),
    }
}

/// A row-major matrix over all of a slice.
pub(super) fn matrix_mut(values: &mut [f32], columns: usize) -> ArrayViewMut2<'_, f32> {
    let (rows, len) = (values.len() / columns, values.len());
    match ArrayViewMut2::from_shape((rows, columns), values) {
        Ok(view) => view,
        Err(error) => unreachable!("{rows} x {columns} of {len}: {error}"),
    }
}

/// Adds the product of two matrices to a third.
#[expect(clippy::needless_pass_by_value, reason = "views are references already")]
pub(super) fn add_product(a: ArrayView2<'_, f32>, b: ArrayView2<'_, f32>, c: &mut ArrayViewMut2<'_, f32>) {
    general_mat_mul(1.0, &a, &b, 1.0, c);
}

/// Adds a slice to another.
pub(super) fn add_to(sum: &mut [f32], terms: &[f32]) {
    for (sum, term) in sum.iter_mut().zip(terms) {
        *sum += term;
    }
}

/// Sums of what each element gives, in the order of the elements.
pub(super) fn total(parts: Vec<Vec<f32>>, len: usize) -> Vec<f32> {
    parts.into_iter().fold(vec![0.0; len], |mut sum, part| {
        add_to(&mut sum, &part);
        sum
    })
}

/// `y = W x + b` over the last axis; inputs x, W `[out, in]`, b `[out]`.
#[derive(Debug, Clone)]
pub struct Linear;

impl Kernel<3> for Linear {
    type Kept = ();

    fn forward(&self, [x, weight, bias]: [View<'_>; 3]) -> (Tensor, ()) {
        let (outputs, inputs) = (weight.shape[0], weight.shape[1]);
        let mut shape = x.shape.to_vec();
        shape.pop();
        shape.push(outputs);
        let mut values = vec![0.0; x.values.len() / inputs * outputs];
        let transposed = matrix(weight.values, [inputs, outputs], [1, inputs]);
        let blocks = values.par_chunks_mut(BLOCK * outputs).zip(x.values.par_chunks(BLOCK * inputs));
        blocks.for_each(|(y, x)| {
            y.chunks_exact_mut(outputs).for_each(|row| row.copy_from_slice(bias.values));
            let x = matrix(x, [x.len() / inputs, inputs], [inputs, 1]);
            add_product(x, transposed, &mut matrix_mut(y, outputs));
        });
        (Tensor { shape, values }, ())
    }

    fn backward(
        &self,
        [x, weight, bias]: [View<'_>; 3],
        (): &(),
        gradient: View<'_>,
        [x_wanted, ..]: [bool; 3],
    ) -> [Option<Tensor>; 3] {
        let (outputs, inputs) = (weight.shape[0], weight.shape[1]);
        let by_x = x_wanted.then(|| {
            let mut values = vec![0.0; x.values.len()];
            let weight = matrix(weight.values, [outputs, inputs], [inputs, 1]);
            let blocks = values.par_chunks_mut(BLOCK * inputs).zip(gradient.values.par_chunks(BLOCK * outputs));
            blocks.for_each(|(by_x, g)| {
                let g = matrix(g, [g.len() / outputs, outputs], [outputs, 1]);
                add_product(g, weight, &mut matrix_mut(by_x, inputs));
            });
            Tensor { shape: x.shape.to_vec(), values }
        });
        let blocks = gradient.values.par_chunks(BLOCK * outputs).zip(x.values.par_chunks(BLOCK * inputs));
        let parts = blocks.map(|(g, x)| {
            let rows = x.len() / inputs;
            let mut sums = vec![0.0; outputs * (inputs + 1)];
            let (by_weight, by_bias) = sums.split_at_mut(outputs * inputs);
            let transposed = matrix(g, [outputs, rows], [1, outputs]);
            add_product(transposed, matrix(x, [rows, inputs], [inputs, 1]), &mut matrix_mut(by_weight, inputs));
            g.chunks_exact(outputs).for_each(|row| add_to(by_bias, row));
            sums
        });
        let mut sums = total(parts.collect(), outputs * (inputs + 1));
        let by_bias = sums.split_off(outputs * inputs);
        [
            by_x,
            Some(Tensor { shape: weight.shape.to_vec(), values: sums }),
            Some(Tensor { shape: bias.shape.to_vec(), values: by_bias }),
        ]
    }
}
