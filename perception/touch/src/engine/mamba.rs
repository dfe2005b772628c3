//! Mamba layer. Its causal convolution and its scan visit tokens in any order and read each token in place, so that all orders cost the
//! same.

// Why: notes/decisions/touch.md, "Tokens are not moved".

use pulp::{Simd, WithSimd};

use super::layers::{Linear, Matrix};
use super::map::FeatureMap;
use crate::network::Weights;
use mvt_products::Instructions;
use mvt_products::math::{exp2, multiply_add, silu};
use mvt_products::multiply::{LANES, Left, Target, Then};

/// States that a scan carries together: with their rates and inputs they fit in the registers of AVX2.
const STATES: usize = 8;

/// Mamba layer with packed weights.
#[derive(Debug)]
pub(super) struct Mamba {
    instructions: Instructions,
    in_proj: Linear,
    x_proj: Linear,
    dt_proj: Linear,
    out_proj: Linear,
    /// Channels of the scan, with those that fill the last vector.
    inner: usize,
    /// States, with those that fill the last group.
    state: usize,
    /// Index of B and C among the results of `x_proj`.
    inputs: usize,
    /// `[taps][inner]`, first the taps of the oldest token.
    taps: Vec<f32>,
    tap_bias: Vec<f32>,
    /// log2(e) A, `[inner / LANES][state][LANES]`.
    decay: Vec<f32>,
    skip: Vec<f32>,
}

/// Memory of a layer.
#[derive(Debug, Clone, Default)]
pub(super) struct MambaBuffers {
    /// Results of `in_proj`: x and z.
    xz: FeatureMap,
    /// x after the convolution.
    x: FeatureMap,
    /// Results of `x_proj`: sources of the step sizes, B and C.
    dbc: FeatureMap,
    delta: FeatureMap,
    /// Input of `out_proj`.
    y: FeatureMap,
}

impl Mamba {
    pub(super) fn new(instructions: Instructions, weights: &Weights, name: &str) -> Self {
        let values = |part: &str| weights.values(&format!("{name}.{part}"));
        let matrix = |part: &str| Matrix::of(weights, &format!("{name}.{part}"));
        let channels = values("D").len();
        let inner = channels.next_multiple_of(LANES);
        let states = values("A_log").len() / channels.max(1);
        let state = states.next_multiple_of(STATES);
        let taps = values("conv1d.weight").len() / channels.max(1);
        let (in_proj, x_proj, dt_proj, out_proj) =
            (matrix("in_proj"), matrix("x_proj"), matrix("dt_proj"), matrix("out_proj"));
        let rank = dt_proj.inputs;
        let inputs = rank.next_multiple_of(2);

        let half = |n: usize| (n % inner < channels).then_some(n / inner * channels + n % inner);
        let dbc = |n: usize| match n.checked_sub(inputs) {
            None => (n < rank).then_some(n),
            Some(n) => (n % state < states).then_some(rank + n / state * states + n % state),
        };
        let within = |n: usize| (n < channels).then_some(n);
        let padded = |values: &[f32]| (0..inner).map(|n| values.get(n).copied().unwrap_or(0.0)).collect::<Vec<_>>();
        let per_channel = |values: &[f32], count: usize, n: usize, k: usize| {
            if n < channels && k < count { values[n * count + k] } else { 0.0 }
        };
        let decay = |at: usize| {
            let (block, k, lane) = (at / (LANES * state), at / LANES % state, at % LANES);
            -per_channel(values("A_log"), states, block * LANES + lane, k).exp() * std::f32::consts::LOG2_E
        };
        Self {
            instructions,
            in_proj: Linear::spread(instructions, &in_proj, 2 * inner, half, in_proj.inputs, Some),
            x_proj: Linear::spread(instructions, &x_proj, inputs + 2 * state, dbc, inner, within),
            dt_proj: Linear::spread(instructions, &dt_proj, inner, within, rank, Some),
            out_proj: Linear::spread(instructions, &out_proj, out_proj.outputs, Some, inner, within),
            inner,
            state,
            inputs,
            taps: (0..taps * inner)
                .map(|at| per_channel(values("conv1d.weight"), taps, at % inner, at / inner))
                .collect(),
            tap_bias: padded(values("conv1d.bias")),
            decay: (0..inner * state).map(decay).collect(),
            skip: padded(values("D")),
        }
    }

    /// Returns memory for as many tokens as `like` has.
    pub(super) fn buffers(&self, like: &FeatureMap) -> MambaBuffers {
        let tokens = |channels| FeatureMap::tokens([1, like.count()], 0, channels);
        MambaBuffers {
            xz: tokens(2 * self.inner),
            x: tokens(self.inner),
            dbc: tokens(self.inputs + 2 * self.state),
            delta: tokens(self.inner),
            y: tokens(self.inner),
        }
    }

    /// Stores the layer's result in `to` or adds it. `order` lists the tokens in the order of the scan.
    pub(super) fn apply(
        &self,
        from: &FeatureMap,
        order: &[u32],
        then: Then,
        buffers: &mut MambaBuffers,
        words: &mut Vec<u32>,
        to: &mut FeatureMap,
    ) {
        self.scan(from, order, buffers, words);
        self.project(then, buffers, words, to);
    }

    /// Replaces the tokens by the layer's result.
    pub(super) fn apply_in_place(
        &self,
        x: &mut FeatureMap,
        order: &[u32],
        buffers: &mut MambaBuffers,
        words: &mut Vec<u32>,
    ) {
        self.scan(x, order, buffers, words);
        self.project(Then::Store, buffers, words, x);
    }

    /// Computes everything up to the last linear map.
    fn scan(&self, from: &FeatureMap, order: &[u32], buffers: &mut MambaBuffers, words: &mut Vec<u32>) {
        let MambaBuffers { xz, x, dbc, delta, y } = buffers;
        assert_eq!((order.len(), xz.count()), (from.count(), from.count()), "an order for other tokens");
        assert!(order.iter().all(|&token| (token as usize) < from.count()), "an order of other tokens");
        self.in_proj.apply(from, Then::Store, words, xz);
        self.instructions.run(Convolve { layer: self, order, xz: &xz.data, x: &mut x.data });
        self.x_proj.apply(x, Then::Store, words, dbc);
        self.dt_proj.apply(dbc, Then::Softplus, words, delta);
        let (xz, x, delta, y_data) = (&xz.data, &x.data, &delta.data, &mut y.data);
        self.instructions.run(SelectiveScan { layer: self, order, xz, x, dbc, delta, y: y_data });
    }

    /// Computes the last linear map.
    fn project(&self, then: Then, buffers: &MambaBuffers, words: &mut Vec<u32>, to: &mut FeatureMap) {
        let target = to.pixels();
        let target = Target { data: &mut to.data, first: target.first, step: target.step, pitch: 0, then };
        self.out_proj.run(Left { data: &buffers.y.data, windows: buffers.y.pixels(), rectified: false }, words, target);
    }
}

/// Causal convolution of each channel, and SiLU.
struct Convolve<'a> {
    layer: &'a Mamba,
    order: &'a [u32],
    xz: &'a [f32],
    x: &'a mut [f32],
}

impl WithSimd for Convolve<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { layer: Mamba { inner, taps, tap_bias, .. }, order, xz, x } = self;
        let [taps, bias, xz] = [taps, tap_bias, xz].map(|values| S::as_simd_f32s(values).0);
        let x = S::as_mut_simd_f32s(x).0;
        let vectors = inner / S::F32_LANES;
        for (k, &token) in order.iter().enumerate() {
            let to = &mut x[token as usize * vectors..][..vectors];
            to.copy_from_slice(&bias[..vectors]);
            for (taps, &token) in taps.chunks_exact(vectors).rev().zip(order[..=k].iter().rev()) {
                let from = &xz[token as usize * 2 * vectors..][..vectors];
                for ((to, &tap), &from) in to.iter_mut().zip(taps).zip(from) {
                    *to = multiply_add(simd, tap, from, *to);
                }
            }
            for to in to {
                *to = silu(simd, *to);
            }
        }
    }
}

/// Selective scan with its skip and gate.
struct SelectiveScan<'a> {
    layer: &'a Mamba,
    order: &'a [u32],
    xz: &'a [f32],
    x: &'a [f32],
    dbc: &'a FeatureMap,
    delta: &'a [f32],
    y: &'a mut [f32],
}

impl WithSimd for SelectiveScan<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { layer, order, xz, x, dbc, delta, y } = self;
        let &Mamba { inner, state, inputs, .. } = layer;
        let [decay, skip, xz, x, delta] =
            [&layer.decay, &layer.skip, xz, x, delta].map(|values| S::as_simd_f32s(values).0);
        let y = S::as_mut_simd_f32s(y).0;
        let (vectors, per_block) = (inner / S::F32_LANES, LANES / S::F32_LANES);
        for vector in 0..vectors {
            let decay = &decay[vector / per_block * state * per_block + vector % per_block..];
            for group in (0..state).step_by(STATES) {
                let rates: [S::f32s; STATES] = std::array::from_fn(|k| decay[(group + k) * per_block]);
                let mut states = [simd.splat_f32s(0.0); STATES];
                let is_first = group == 0;
                let is_last = group + STATES == state;
                for &token in order {
                    let token = token as usize;
                    let at = token * vectors + vector;
                    let dbc = &dbc.data[token * dbc.channels + inputs + group..][..state + STATES];
                    let (b, c) = (&dbc[..STATES], &dbc[state..]);
                    let (delta, x) = (delta[at], x[at]);
                    let input = simd.mul_f32s(delta, x);
                    let mut sums =
                        [simd.splat_f32s(0.0), if is_first { simd.mul_f32s(skip[vector], x) } else { y[at] }];
                    for k in 0..STATES {
                        let kept = simd.mul_f32s(exp2(simd, simd.mul_f32s(delta, rates[k])), states[k]);
                        states[k] = multiply_add(simd, input, simd.splat_f32s(b[k]), kept);
                        sums[k % 2] = multiply_add(simd, states[k], simd.splat_f32s(c[k]), sums[k % 2]);
                    }
                    let sum = simd.add_f32s(sums[0], sums[1]);
                    y[at] = if is_last {
                        simd.mul_f32s(sum, silu(simd, xz[(2 * token + 1) * vectors + vector]))
                    } else {
                        sum
                    };
                }
            }
        }
    }
}

/// Returns the order of a scan over the tokens of a map; tokens without a patch come last.
pub(super) fn order(scan: crate::network::ScanOrder, tokens: &FeatureMap) -> Vec<u32> {
    let patches = scan.order(tokens.height, tokens.width);
    patches.into_iter().chain(tokens.height * tokens.width..tokens.count()).map(|token| token as u32).collect()
}
