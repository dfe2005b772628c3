//! The network: one hidden layer of rectified neurons and one output. Points lie side by side in the lanes, so that every
//! product is a vector times a number.

use pulp::Simd;

use super::FieldConfig;
use super::grid::{CHUNK, FEATURES, Row};

/// Where the parameters are in their common array.
#[derive(Debug, Clone, Copy)]
pub(super) struct Layout {
    pub(super) inputs: usize,
    pub(super) hidden: usize,
}

impl Layout {
    pub(super) fn new(config: &FieldConfig) -> Self {
        Self { inputs: config.levels.len() * FEATURES, hidden: config.hidden }
    }

    /// Weights of the hidden layer, by neuron and input, come first; then its biases.
    pub(super) fn biases(self) -> usize {
        self.hidden * self.inputs
    }

    /// Weights of the output, then its bias.
    pub(super) fn output(self) -> usize {
        self.biases() + self.hidden
    }

    pub(super) fn output_bias(self) -> usize {
        self.output() + self.hidden
    }

    /// Numbers in use.
    pub(super) fn parameters(self) -> usize {
        self.output_bias() + 1
    }

    /// Length of the array: whole vectors of any instruction set.
    pub(super) fn padded(self) -> usize {
        self.parameters().next_multiple_of(16)
    }
}

/// The parameters as the kernels want them: the weights of four neurons, and of four inputs, side by side.
#[derive(Debug, Clone)]
pub(super) struct Network<'a> {
    layout: Layout,
    parameters: &'a [f32],
    /// `[hidden / 4][inputs]` of four neurons.
    by_neuron: Vec<[f32; 4]>,
    /// `[inputs / 4][hidden]` of four inputs.
    by_input: Vec<[f32; 4]>,
}

/// Working memory of the network for a chunk.
#[derive(Debug, Clone)]
pub(super) struct Activations {
    /// Features of the points, one row each.
    pub(super) inputs: Vec<Row>,
    /// Outputs of the hidden neurons; after going backward, the gradient with respect to their inputs.
    hidden: Vec<Row>,
    /// The field, in units of the truncation.
    pub(super) output: Row,
    /// Gradient with respect to `inputs`.
    pub(super) input_gradient: Vec<Row>,
}

impl Activations {
    pub(super) fn new(layout: Layout) -> Self {
        Self {
            inputs: vec![[0.0; CHUNK]; layout.inputs],
            hidden: vec![[0.0; CHUNK]; layout.hidden],
            output: [0.0; CHUNK],
            input_gradient: vec![[0.0; CHUNK]; layout.inputs],
        }
    }
}

impl<'a> Network<'a> {
    pub(super) fn new(layout: Layout, parameters: &'a [f32]) -> Self {
        let Layout { inputs, hidden } = layout;
        let weight = |neuron: usize, input: usize| parameters[neuron * inputs + input];
        let by_neuron = (0..hidden / 4)
            .flat_map(|n| (0..inputs).map(move |k| [0, 1, 2, 3].map(|lane| weight(4 * n + lane, k))))
            .collect();
        let by_input = (0..inputs / 4)
            .flat_map(|k| (0..hidden).map(move |n| [0, 1, 2, 3].map(|lane| weight(n, 4 * k + lane))))
            .collect();
        Self { layout, parameters, by_neuron, by_input }
    }

    /// From `inputs` to `output`.
    #[inline(always)]
    pub(super) fn forward<S: Simd>(&self, simd: S, at: &mut Activations) {
        let biases = &self.parameters[self.layout.biases()..self.layout.output()];
        multiply::<S, true>(simd, &self.by_neuron, &at.inputs, biases, &mut at.hidden);
        let weights = &self.parameters[self.layout.output()..self.layout.output_bias()];
        let bias = simd.splat_f32s(self.parameters[self.layout.output_bias()]);
        let out = S::as_mut_simd_f32s(&mut at.output).0;
        for (k, out) in out.iter_mut().enumerate() {
            let mut sum = bias;
            for (&weight, row) in weights.iter().zip(&at.hidden) {
                sum = simd.mul_add_e_f32s(simd.splat_f32s(weight), S::as_simd_f32s(row).0[k], sum);
            }
            *out = sum;
        }
    }

    /// Gradient of the output with respect to the inputs, after [`forward`](Self::forward).
    #[inline(always)]
    pub(super) fn backward<S: Simd>(&self, simd: S, at: &mut Activations) {
        let zero = simd.splat_f32s(0.0);
        let weights = &self.parameters[self.layout.output()..self.layout.output_bias()];
        for (&weight, row) in weights.iter().zip(&mut at.hidden) {
            let weight = simd.splat_f32s(weight);
            for h in S::as_mut_simd_f32s(row).0 {
                *h = simd.select_f32s(simd.greater_than_f32s(*h, zero), weight, zero);
            }
        }
        multiply::<S, false>(simd, &self.by_input, &at.hidden, &[], &mut at.input_gradient);
    }

    /// Gradient of a loss with respect to the inputs, given that with respect to the output, after
    /// [`forward`](Self::forward). That with respect to the parameters is added to `sums`, which holds one vector of partial
    /// sums per parameter.
    #[inline(always)]
    pub(super) fn learn<S: Simd>(&self, simd: S, at: &mut Activations, output_gradient: &Row, sums: &mut [f32]) {
        let zero = simd.splat_f32s(0.0);
        let Layout { inputs, .. } = self.layout;
        let sums = S::as_mut_simd_f32s(sums).0;
        let gradient = S::as_simd_f32s(output_gradient).0;
        let weights = &self.parameters[self.layout.output()..self.layout.output_bias()];
        for (n, (&weight, row)) in weights.iter().zip(&mut at.hidden).enumerate() {
            let weight = simd.splat_f32s(weight);
            let mut to_weight = sums[self.layout.output() + n];
            let mut to_bias = sums[self.layout.biases() + n];
            for (h, &g) in S::as_mut_simd_f32s(row).0.iter_mut().zip(gradient) {
                to_weight = simd.mul_add_e_f32s(*h, g, to_weight);
                *h = simd.select_f32s(simd.greater_than_f32s(*h, zero), simd.mul_f32s(weight, g), zero);
                to_bias = simd.add_f32s(to_bias, *h);
            }
            sums[self.layout.output() + n] = to_weight;
            sums[self.layout.biases() + n] = to_bias;
        }
        for &g in gradient {
            let bias = &mut sums[self.layout.output_bias()];
            *bias = simd.add_f32s(*bias, g);
        }
        multiply::<S, false>(simd, &self.by_input, &at.hidden, &[], &mut at.input_gradient);
        for (n, four) in at.hidden.as_chunks::<4>().0.iter().enumerate() {
            for (k, two) in at.inputs.as_chunks::<2>().0.iter().enumerate() {
                correlate(simd, four, two, &mut sums[4 * n * inputs + 2 * k..], inputs);
            }
        }
    }
}

/// `out[r] = start[r] + sum over p of weights[r / 4][p][r % 4] * rows[p]`, for as many rows as `out` has, a multiple of four. An
/// empty `start` is zero. `RECTIFY`: negative results become zero.
#[inline(always)]
fn multiply<S: Simd, const RECTIFY: bool>(simd: S, weights: &[[f32; 4]], rows: &[Row], start: &[f32], out: &mut [Row]) {
    let zero = simd.splat_f32s(0.0);
    for (r, (weights, out)) in weights.chunks_exact(rows.len()).zip(out.as_chunks_mut::<4>().0).enumerate() {
        let mut begin = [zero; 4];
        if let Some(start) = start.get(4 * r..4 * r + 4) {
            for lane in 0..4 {
                begin[lane] = simd.splat_f32s(start[lane]);
            }
        }
        // Two vectors by four rows: eight sums hide the latency of the multiply-add and fit in the registers of AVX2.
        for column in (0..CHUNK / S::F32_LANES).step_by(2) {
            let mut sums = [[begin[0]; 2], [begin[1]; 2], [begin[2]; 2], [begin[3]; 2]];
            for (weights, row) in weights.iter().zip(rows) {
                let row = S::as_simd_f32s(row).0;
                let (left, right) = (row[column], row[column + 1]);
                for lane in 0..4 {
                    let weight = simd.splat_f32s(weights[lane]);
                    sums[lane][0] = simd.mul_add_e_f32s(weight, left, sums[lane][0]);
                    sums[lane][1] = simd.mul_add_e_f32s(weight, right, sums[lane][1]);
                }
            }
            for lane in 0..4 {
                let out = S::as_mut_simd_f32s(&mut out[lane]).0;
                for half in 0..2 {
                    let sum = sums[lane][half];
                    out[column + half] = if RECTIFY { simd.max_f32s(sum, zero) } else { sum };
                }
            }
        }
    }
}

/// Adds the products of four rows with two rows, lane by lane, to `sums[stride * i + j]`.
#[inline(always)]
fn correlate<S: Simd>(simd: S, four: &[Row; 4], two: &[Row; 2], sums: &mut [S::f32s], stride: usize) {
    let mut sum = [[simd.splat_f32s(0.0); 2]; 4];
    for column in 0..CHUNK / S::F32_LANES {
        let left = S::as_simd_f32s(&two[0]).0[column];
        let right = S::as_simd_f32s(&two[1]).0[column];
        for i in 0..4 {
            let row = S::as_simd_f32s(&four[i]).0[column];
            sum[i][0] = simd.mul_add_e_f32s(row, left, sum[i][0]);
            sum[i][1] = simd.mul_add_e_f32s(row, right, sum[i][1]);
        }
    }
    for i in 0..4 {
        let sums = &mut sums[stride * i..stride * i + 2];
        sums[0] = simd.add_f32s(sums[0], sum[i][0]);
        sums[1] = simd.add_f32s(sums[1], sum[i][1]);
    }
}
