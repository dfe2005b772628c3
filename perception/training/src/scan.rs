//! The inside of a Mamba block as one op: from the input projection to the gate.
//!
//! The forward pass keeps its small intermediate results. The hidden states are many; the backward pass computes them again, sixteen
//! channels at a time.

use std::sync::Arc;

use ndarray::ArrayView2;
use pulp::WithSimd;
use rayon::prelude::*;

use crate::lanes::{LANES, Lanes, add_to, each, exp, load, sigmoid, softplus, store, total};
use crate::linear::{add_product, matrix, matrix_mut};
use crate::tape::{Inputs, Kernel, Slopes, TensorView};
use mvt_touch::network::WeightTensor;

/// Everything between the outer projections of a Mamba block, see [`mvt_touch::network`]. Inputs: `in_proj`'s result `[images, tokens, 2 E]`,
/// `conv1d.weight`, `conv1d.bias`, `x_proj.weight`, `dt_proj.weight`, `dt_proj.bias`, `A_log`, `D`; output `[images, tokens, E]`.
#[derive(Debug, Clone)]
pub struct Selective {
    /// Index of the k-th token.
    pub order: Arc<[usize]>,
}

/// An image's intermediate results, in the order of the scan: `[tokens, E]` each, `projected` `[tokens, R + 2 N]`.
#[derive(Debug, Clone)]
pub struct Kept {
    /// Sum of the causal convolution.
    convolved: Vec<f32>,
    /// SiLU of that sum, the input of the scan.
    scanned: Vec<f32>,
    /// Source of the step sizes, B and C.
    projected: Vec<f32>,
    /// Step sizes.
    delta: Vec<f32>,
    /// Result of the scan, skip included, before the gate.
    read: Vec<f32>,
}

/// Sizes of a block.
#[derive(Clone, Copy)]
struct Sizes {
    tokens: usize,
    inner: usize,
    state: usize,
    taps: usize,
    rank: usize,
}

/// Parameters as slices.
#[derive(Clone, Copy)]
struct Parameters<'a> {
    taps: &'a [f32],
    bias: &'a [f32],
    projection: &'a [f32],
    step: &'a [f32],
    step_bias: &'a [f32],
    skip: &'a [f32],
}

impl Sizes {
    fn new(order: &[usize], inputs: &[TensorView<'_>; 8]) -> Self {
        Self {
            tokens: order.len(),
            inner: inputs[1].shape[0],
            state: inputs[6].shape[1],
            taps: inputs[1].shape[1],
            rank: inputs[4].shape[1],
        }
    }

    /// Returns the columns of the projection: sources of the step sizes, B and C.
    fn projected(self) -> usize {
        self.rank + 2 * self.state
    }
}

/// Returns `-exp(A_log)` by state, sixteen channels from `at` on.
fn decay(a_log: &[f32], Sizes { inner, state, .. }: Sizes, at: usize) -> Vec<Lanes> {
    let a = |n: usize, e: usize| if e < inner { -a_log[e * state + n].exp() } else { 0.0 };
    (0..state).map(|n| std::array::from_fn(|j| a(n, at + j))).collect()
}

/// Forward pass of one image.
struct Forward<'a> {
    sizes: Sizes,
    order: &'a [usize],
    parameters: Parameters<'a>,
    decays: &'a [Vec<Lanes>],
    xz: &'a [f32],
    out: &'a mut [f32],
}

impl WithSimd for Forward<'_> {
    type Output = Kept;

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) -> Kept {
        let Self { sizes, order, parameters, decays, xz, out } = self;
        let Sizes { tokens, inner, state, taps, rank } = sizes;
        let zeros = || vec![0.0f32; tokens * inner];
        let (mut convolved, mut scanned, mut delta, mut read) = (zeros(), zeros(), zeros(), zeros());
        for at in (0..inner).step_by(LANES) {
            let weights: Vec<Lanes> = (0..taps).map(|k| tap(parameters.taps, sizes, at, k)).collect();
            let bias = load(parameters.bias, at);
            for t in 0..tokens {
                let mut sum = bias;
                for (k, weight) in weights.iter().enumerate() {
                    if let Some(&token) = (t + k + 1).checked_sub(taps).and_then(|past| order.get(past)) {
                        let x = load(&xz[token * 2 * inner..][..inner], at);
                        sum = each(|j| x[j].mul_add(weight[j], sum[j]));
                    }
                }
                let gate = sigmoid(sum);
                store(&mut convolved[t * inner..][..inner], at, sum);
                store(&mut scanned[t * inner..][..inner], at, each(|j| sum[j] * gate[j]));
            }
        }
        let columns = sizes.projected();
        let mut projected = vec![0.0; tokens * columns];
        let projection = matrix(parameters.projection, [inner, columns], [1, inner]);
        add_product(rows(&scanned, inner), projection, &mut matrix_mut(&mut projected, columns));
        delta.chunks_exact_mut(inner).for_each(|row| row.copy_from_slice(parameters.step_bias));
        let sources = matrix(&projected, [tokens, rank], [columns, 1]);
        let step = matrix(parameters.step, [rank, inner], [1, rank]);
        add_product(sources, step, &mut matrix_mut(&mut delta, inner));
        for at in (0..delta.len()).step_by(LANES) {
            let step = softplus(load(&delta, at));
            store(&mut delta, at, step);
        }

        for (at, decay) in (0..inner).step_by(LANES).zip(decays) {
            let skip = load(parameters.skip, at);
            let mut hidden = vec![[0.0; LANES]; state];
            for t in 0..tokens {
                let step = load(&delta[t * inner..][..inner], at);
                let x = load(&scanned[t * inner..][..inner], at);
                let (b, c) = projected[t * columns + rank..][..2 * state].split_at(state);
                let driven = each(|j| step[j] * x[j]);
                let mut y = each(|j| skip[j] * x[j]);
                for (((hidden, decay), b), c) in hidden.iter_mut().zip(decay).zip(b).zip(c) {
                    let kept = exp(each(|j| step[j] * decay[j]));
                    *hidden = each(|j| kept[j].mul_add(hidden[j], driven[j] * b));
                    y = each(|j| hidden[j].mul_add(*c, y[j]));
                }
                store(&mut read[t * inner..][..inner], at, y);
                let z = load(&xz[(order[t] * 2 + 1) * inner..][..inner], at);
                let gate = sigmoid(z);
                store(&mut out[order[t] * inner..][..inner], at, each(|j| y[j] * z[j] * gate[j]));
            }
        }
        Kept { convolved, scanned, projected, delta, read }
    }
}

/// Returns the weights of tap `k` of sixteen channels from `at` on.
#[inline(always)]
fn tap(weights: &[f32], Sizes { inner, taps, .. }: Sizes, at: usize, k: usize) -> Lanes {
    each(|j| if at + j < inner { weights[(at + j) * taps + k] } else { 0.0 })
}

/// Returns a row-major matrix over all of a slice.
fn rows(values: &[f32], columns: usize) -> ArrayView2<'_, f32> {
    matrix(values, [values.len() / columns, columns], [columns, 1])
}

/// Gradients of the loss by the input of an image and, summed over its tokens, by the parameters.
struct Gradients {
    xz: Vec<f32>,
    parameters: [Vec<f32>; 7],
}

/// Backward pass of one image.
struct Reverse<'a> {
    sizes: Sizes,
    order: &'a [usize],
    parameters: Parameters<'a>,
    decays: &'a [Vec<Lanes>],
    xz: &'a [f32],
    kept: &'a Kept,
    gradient: &'a [f32],
}

impl WithSimd for Reverse<'_> {
    type Output = Gradients;

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) -> Gradients {
        let Self { sizes, order, parameters, decays, xz, kept, gradient } = self;
        let Sizes { tokens, inner, state, taps, rank } = sizes;
        let columns = sizes.projected();
        let mut by_xz = vec![0.0; xz.len()];
        let (mut by_scanned, mut by_delta) = (vec![0.0; tokens * inner], vec![0.0; tokens * inner]);
        let (mut by_a, mut by_skip) = (vec![0.0; inner * state], vec![0.0; inner]);
        // Per token and state: the hidden states from the start on, the share of each that is kept, and lane by lane the sums for B, C.
        let mut hidden = vec![[0.0; LANES]; (tokens + 1) * state];
        let mut fractions = vec![[0.0; LANES]; tokens * state];
        let (mut by_b, mut by_c) = (vec![[0.0; LANES]; tokens * state], vec![[0.0; LANES]; tokens * state]);
        for (at, decay) in (0..inner).step_by(LANES).zip(decays) {
            for t in 0..tokens {
                let step = load(&kept.delta[t * inner..][..inner], at);
                let x = load(&kept.scanned[t * inner..][..inner], at);
                let b = &kept.projected[t * columns + rank..][..state];
                let driven = each(|j| step[j] * x[j]);
                let (past, now) = hidden[t * state..].split_at_mut(state);
                let states = past.iter().zip(now).zip(&mut fractions[t * state..]).zip(decay).zip(b);
                for ((((past, now), fraction), decay), b) in states {
                    *fraction = exp(each(|j| step[j] * decay[j]));
                    *now = each(|j| fraction[j].mul_add(past[j], driven[j] * b));
                }
            }
            let skip = load(parameters.skip, at);
            let mut skip_sum = [0.0; LANES];
            let mut by_hidden = vec![[0.0; LANES]; state];
            let mut by_decay = vec![[0.0; LANES]; state];
            for t in (0..tokens).rev() {
                let step = load(&kept.delta[t * inner..][..inner], at);
                let x = load(&kept.scanned[t * inner..][..inner], at);
                let read = load(&kept.read[t * inner..][..inner], at);
                let z = load(&xz[(order[t] * 2 + 1) * inner..][..inner], at);
                let g = load(&gradient[order[t] * inner..][..inner], at);
                let gate = sigmoid(z);
                let by_z = each(|j| g[j] * read[j] * gate[j] * (1.0 + z[j] * (1.0 - gate[j])));
                store(&mut by_xz[(order[t] * 2 + 1) * inner..][..inner], at, by_z);
                let g = each(|j| g[j] * z[j] * gate[j]);
                skip_sum = each(|j| g[j].mul_add(x[j], skip_sum[j]));
                let driven = each(|j| step[j] * x[j]);
                let (b, c) = kept.projected[t * columns + rank..][..2 * state].split_at(state);
                let (mut by_driven, mut by_step) = ([0.0; LANES], [0.0; LANES]);
                for n in 0..state {
                    let (past, now) = (hidden[t * state + n], hidden[(t + 1) * state + n]);
                    let (fraction, decay) = (fractions[t * state + n], decay[n]);
                    let by_now = each(|j| g[j].mul_add(c[n], by_hidden[n][j]));
                    let (sum_c, sum_b) = (by_c[t * state + n], by_b[t * state + n]);
                    by_c[t * state + n] = each(|j| g[j].mul_add(now[j], sum_c[j]));
                    by_b[t * state + n] = each(|j| by_now[j].mul_add(driven[j], sum_b[j]));
                    by_driven = each(|j| by_now[j].mul_add(b[n], by_driven[j]));
                    let by_past = each(|j| by_now[j] * fraction[j]);
                    let by_exponent = each(|j| by_past[j] * past[j]);
                    by_step = each(|j| by_exponent[j].mul_add(decay[j], by_step[j]));
                    let sum = by_decay[n];
                    by_decay[n] = each(|j| by_exponent[j].mul_add(step[j], sum[j]));
                    by_hidden[n] = by_past;
                }
                store(&mut by_scanned[t * inner..][..inner], at, each(|j| by_driven[j] * step[j] + g[j] * skip[j]));
                // The slope of softplus is 1 - e^-softplus.
                let rest = exp(each(|j| -step[j]));
                let by_sum = each(|j| (by_driven[j] * x[j] + by_step[j]) * (1.0 - rest[j]));
                store(&mut by_delta[t * inner..][..inner], at, by_sum);
            }
            for j in 0..LANES.min(inner - at) {
                by_skip[at + j] = skip_sum[j];
                for n in 0..state {
                    // The slope of A = -exp(A_log) is A itself.
                    by_a[(at + j) * state + n] = by_decay[n][j] * decay[n][j];
                }
            }
        }

        let mut by_projected = vec![0.0; tokens * columns];
        for t in 0..tokens {
            let row = &mut by_projected[t * columns + rank..][..2 * state];
            for n in 0..state {
                row[n] = by_b[t * state + n].iter().sum();
                row[state + n] = by_c[t * state + n].iter().sum();
            }
        }
        let mut by_sources = vec![0.0; tokens * rank];
        let step = matrix(parameters.step, [inner, rank], [rank, 1]);
        add_product(rows(&by_delta, inner), step, &mut matrix_mut(&mut by_sources, rank));
        for (row, sources) in by_projected.chunks_exact_mut(columns).zip(by_sources.chunks_exact(rank)) {
            row[..rank].copy_from_slice(sources);
        }
        let mut by_step_bias = vec![0.0; inner];
        by_delta.chunks_exact(inner).for_each(|row| add_to(&mut by_step_bias, row));
        let mut by_step_weight = vec![0.0; inner * rank];
        let sources = matrix(&kept.projected, [tokens, rank], [columns, 1]);
        add_product(rows(&by_delta, inner).reversed_axes(), sources, &mut matrix_mut(&mut by_step_weight, rank));
        let mut by_projection = vec![0.0; columns * inner];
        let by_projected = rows(&by_projected, columns);
        let scanned = rows(&kept.scanned, inner);
        add_product(by_projected.reversed_axes(), scanned, &mut matrix_mut(&mut by_projection, inner));
        let projection = matrix(parameters.projection, [columns, inner], [inner, 1]);
        add_product(by_projected, projection, &mut matrix_mut(&mut by_scanned, inner));

        let (mut by_taps, mut by_bias) = (vec![0.0; inner * taps], vec![0.0; inner]);
        for at in (0..inner).step_by(LANES) {
            let mut bias_sum = [0.0; LANES];
            let mut tap_sums = vec![[0.0; LANES]; taps];
            let weights: Vec<Lanes> = (0..taps).map(|k| tap(parameters.taps, sizes, at, k)).collect();
            for t in 0..tokens {
                let sum = load(&kept.convolved[t * inner..][..inner], at);
                let g = load(&by_scanned[t * inner..][..inner], at);
                let gate = sigmoid(sum);
                let g = each(|j| g[j] * gate[j] * (1.0 + sum[j] * (1.0 - gate[j])));
                bias_sum = each(|j| bias_sum[j] + g[j]);
                for k in 0..taps {
                    if let Some(&token) = (t + k + 1).checked_sub(taps).and_then(|past| order.get(past)) {
                        let x = load(&xz[token * 2 * inner..][..inner], at);
                        let sum = tap_sums[k];
                        tap_sums[k] = each(|j| g[j].mul_add(x[j], sum[j]));
                        let row = &mut by_xz[token * 2 * inner..][..inner];
                        let by_x = load(row, at);
                        store(row, at, each(|j| g[j].mul_add(weights[k][j], by_x[j])));
                    }
                }
            }
            store(&mut by_bias, at, bias_sum);
            for (j, k) in (0..LANES.min(inner - at)).flat_map(|j| (0..taps).map(move |k| (j, k))) {
                by_taps[(at + j) * taps + k] = tap_sums[k][j];
            }
        }
        let parameters = [by_taps, by_bias, by_projection, by_step_weight, by_step_bias, by_a, by_skip];
        Gradients { xz: by_xz, parameters }
    }
}

impl Selective {
    fn prepare<'a>(&self, inputs: &[TensorView<'a>; 8]) -> (Sizes, Parameters<'a>, Vec<Vec<Lanes>>) {
        let sizes = Sizes::new(&self.order, inputs);
        let [_, taps, bias, projection, step, step_bias, a_log, skip] = inputs.map(|input| input.values);
        let decays = (0..sizes.inner).step_by(LANES).map(|at| decay(a_log, sizes, at)).collect();
        (sizes, Parameters { taps, bias, projection, step, step_bias, skip }, decays)
    }
}

impl Kernel<8> for Selective {
    type Kept = Vec<Kept>;

    fn forward(&self, inputs: Inputs<'_, 8>) -> (WeightTensor, Vec<Kept>) {
        let (sizes, parameters, decays) = self.prepare(&inputs);
        let xz = inputs[0];
        let size = sizes.tokens * sizes.inner;
        let mut values = vec![0.0; xz.values.len() / 2];
        let images = values.par_chunks_mut(size).zip(xz.values.par_chunks(2 * size));
        let kept = images.map(|(out, xz)| {
            let (order, decays) = (&*self.order, &*decays);
            pulp::Arch::new().dispatch(Forward { sizes, order, parameters, decays, xz, out })
        });
        let kept = kept.collect();
        (WeightTensor { shape: vec![xz.shape[0], sizes.tokens, sizes.inner], values }, kept)
    }

    fn backward(&self, inputs: Inputs<'_, 8>, kept: &Vec<Kept>, gradient: &[f32], _: [bool; 8]) -> Slopes<8> {
        let (sizes, parameters, decays) = self.prepare(&inputs);
        let size = sizes.tokens * sizes.inner;
        let images = inputs[0].values.par_chunks(2 * size).zip(kept).zip(gradient.par_chunks(size));
        let images = images.map(|((xz, kept), gradient)| {
            let (order, decays) = (&*self.order, &*decays);
            pulp::Arch::new().dispatch(Reverse { sizes, order, parameters, decays, xz, kept, gradient })
        });
        let images: Vec<Gradients> = images.collect();
        let mut parts: [Vec<Vec<f32>>; 7] = Default::default();
        let mut by_xz = Vec::with_capacity(inputs[0].values.len());
        for Gradients { xz, parameters } in images {
            by_xz.extend(xz);
            parts.iter_mut().zip(parameters).for_each(|(part, parameter)| part.push(parameter));
        }
        let mut sums = parts.into_iter();
        std::array::from_fn(|i| {
            let TensorView { shape, values, .. } = inputs[i];
            let sum = match i {
                0 => std::mem::take(&mut by_xz),
                _ => total(sums.next()?, values.len()),
            };
            Some(WeightTensor { shape: shape.to_vec(), values: sum })
        })
    }
}
