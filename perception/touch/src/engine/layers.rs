//! Layers of [`crate::network`] with packed weights. Results have channels that fill whole vectors; channels beyond those of the layer
//! are zero.

use pulp::{Simd, WithSimd};

use super::map::FeatureMap;
use crate::network::{LAYER_NORM_EPS, Weights};
use mvt_products::Instructions;
use mvt_products::math::multiply_add;
use mvt_products::multiply::{LANES, Left, Packed, Target, Then, Windows, multiply};

/// Linear map of each pixel or token.
#[derive(Debug)]
pub(super) struct Linear(Packed);

impl Linear {
    /// Packs `name.weight [outputs, inputs]` and, if it exists, `name.bias`.
    pub(super) fn new(instructions: Instructions, weights: &Weights, name: &str) -> Self {
        let matrix = Matrix::of(weights, name);
        Self::spread(instructions, &matrix, matrix.outputs, Some, matrix.inputs, Some)
    }

    /// Packs a layer with rearranged columns: `output` returns the output of a column of `columns`, `input` the input of a channel of
    /// `channels`; `None` means zero.
    pub(super) fn spread(
        instructions: Instructions,
        matrix: &Matrix<'_>,
        columns: usize,
        output: impl Fn(usize) -> Option<usize>,
        channels: usize,
        input: impl Fn(usize) -> Option<usize>,
    ) -> Self {
        let bias: Vec<f32> =
            (0..columns).map(|n| output(n).and_then(|n| matrix.bias.get(n)).copied().unwrap_or(0.0)).collect();
        let weight = |k, n| match (input(k), output(n)) {
            (Some(k), Some(n)) => matrix.weight[n * matrix.inputs + k],
            _ => 0.0,
        };
        Self(Packed::new(instructions, 1, channels, &bias, weight))
    }

    /// Maps the pixels of a map to those of another of the same size.
    pub(super) fn apply(&self, from: &FeatureMap, then: Then, words: &mut Vec<u32>, to: &mut FeatureMap) {
        let (from_windows, to_windows) = (from.pixels(), to.pixels());
        // Tokens lie in one row, a framed map has its own rows.
        let is_alike = from_windows.columns == to_windows.columns;
        let (windows, target) = if is_alike { (from_windows, to_windows) } else { (from.rows(), to.rows()) };
        self.run(Left { data: &from.data, windows, rectified: false }, words, place(to, target, then));
    }

    /// Maps windows to a target.
    pub(super) fn run(&self, left: Left<'_>, words: &mut Vec<u32>, target: Target<'_>) {
        multiply(&self.0, left, words, target);
    }
}

/// Two linear maps with a GELU between them.
#[derive(Debug)]
pub(super) struct Mlp {
    fc1: Linear,
    fc2: Linear,
    pub(super) hidden: usize,
}

impl Mlp {
    /// Packs `name.fc1` and `name.fc2`, the outputs of the latter multiplied by `scale`; without numbers, by 1.
    pub(super) fn new(instructions: Instructions, weights: &Weights, name: &str, scale: &[f32]) -> Self {
        let matrix = Matrix::of(weights, &format!("{name}.fc2"));
        let factor = |output: usize| scale.get(output).copied().unwrap_or(1.0);
        let weight: Vec<f32> =
            matrix.weight.iter().enumerate().map(|(k, x)| x * factor(k / matrix.inputs.max(1))).collect();
        let bias: Vec<f32> = matrix.bias.iter().enumerate().map(|(k, x)| x * factor(k)).collect();
        let scaled = Matrix { weight: &weight, bias: &bias, ..matrix };
        Self {
            fc1: Linear::new(instructions, weights, &format!("{name}.fc1")),
            fc2: Linear::spread(instructions, &scaled, scaled.outputs, Some, scaled.inputs, Some),
            hidden: scaled.inputs,
        }
    }

    /// Adds the result to `to`.
    pub(super) fn apply(&self, from: &FeatureMap, hidden: &mut FeatureMap, words: &mut Vec<u32>, to: &mut FeatureMap) {
        self.fc1.apply(from, Then::Gelu, words, hidden);
        self.fc2.apply(hidden, Then::Add, words, to);
    }
}

/// Linear map of the patches of an image.
#[derive(Debug)]
pub(super) struct Embedding {
    side: usize,
    /// A window is a patch, a segment a row of it.
    packed: Packed,
}

impl Embedding {
    /// Packs `patch` for patches of `side` pixels a side of a map of [`FeatureMap::image`] with `channels` numbers per pixel.
    pub(super) fn new(instructions: Instructions, weights: &Weights, side: usize, channels: usize) -> Self {
        let Matrix { weight, bias, inputs, .. } = Matrix::of(weights, "patch");
        let entry = |k: usize, n: usize| {
            let (row, column, channel) = (k / (side * channels), k / channels % side, k % channels);
            if channel < 3 { weight[n * inputs + 3 * (row * side + column) + channel] } else { 0.0 }
        };
        Self { side, packed: Packed::new(instructions, side, side * channels, bias, entry) }
    }

    /// Maps the patches of an image to tokens.
    pub(super) fn apply(&self, image: &FeatureMap, then: Then, words: &mut Vec<u32>, tokens: &mut FeatureMap) {
        let left = Left { data: &image.data, windows: image.patches(self.side), rectified: false };
        let target = tokens.rows();
        multiply(&self.packed, left, words, place(tokens, target, then));
    }
}

/// Weight and bias of the file.
pub(super) struct Matrix<'a> {
    pub(super) weight: &'a [f32],
    /// Empty without a bias.
    pub(super) bias: &'a [f32],
    pub(super) outputs: usize,
    pub(super) inputs: usize,
}

impl<'a> Matrix<'a> {
    /// Returns `name.weight`, its last axes joined, and `name.bias`.
    pub(super) fn of(weights: &'a Weights, name: &str) -> Self {
        let weight = weights.tensors().get(&format!("{name}.weight"));
        let (shape, values) = weight.map_or((&[][..], &[][..]), |tensor| (&tensor.shape, &tensor.values));
        let outputs = shape.first().copied().unwrap_or(0);
        let bias = weights.values(&format!("{name}.bias"));
        Self { weight: values, bias, outputs, inputs: values.len() / outputs.max(1) }
    }
}

/// Returns the target of products that replace windows of a map.
fn place(to: &mut FeatureMap, windows: Windows, then: Then) -> Target<'_> {
    Target { data: &mut to.data, first: windows.first, step: windows.step, pitch: windows.pitch, then }
}

/// 3 x 3 convolution.
#[derive(Debug)]
pub(super) struct Convolution {
    packed: Packed,
    stride: usize,
}

impl Convolution {
    /// Packs `name.weight [outputs, inputs, 3, 3]` and `name.bias` for maps with `channels` numbers per pixel.
    pub(super) fn new(
        instructions: Instructions,
        weights: &Weights,
        name: &str,
        channels: usize,
        stride: usize,
    ) -> Self {
        let Matrix { weight, bias, inputs, .. } = Matrix::of(weights, name);
        let inputs = inputs / 9;
        let entry = |k: usize, n: usize| {
            let (row, column, channel) = (k / (3 * channels), k / channels % 3, k % channels);
            if channel < inputs { weight[((n * inputs + channel) * 3 + row) * 3 + column] } else { 0.0 }
        };
        Self { packed: Packed::new(instructions, 3, 3 * channels, bias, entry), stride }
    }

    /// Maps a framed map to another, whose sides are divided by the stride and rounded up.
    pub(super) fn apply(
        &self,
        from: &FeatureMap,
        rectified: bool,
        then: Then,
        words: &mut Vec<u32>,
        to: &mut FeatureMap,
    ) {
        let left = Left { data: &from.data, windows: from.neighbourhoods(self.stride), rectified };
        let target = to.rows();
        multiply(&self.packed, left, words, place(to, target, then));
    }
}

/// `x + conv2(relu(conv1(relu(x))))`.
#[derive(Debug)]
pub(super) struct Unit {
    conv1: Convolution,
    conv2: Convolution,
}

impl Unit {
    pub(super) fn new(instructions: Instructions, weights: &Weights, name: &str, channels: usize) -> Self {
        let convolution = |part| Convolution::new(instructions, weights, &format!("{name}.{part}"), channels, 1);
        Self { conv1: convolution("conv1"), conv2: convolution("conv2") }
    }

    /// Changes `x` in place; `between` is a map of the same size.
    pub(super) fn apply(&self, words: &mut Vec<u32>, between: &mut FeatureMap, x: &mut FeatureMap) {
        self.conv1.apply(x, true, Then::Relu, words, between);
        self.conv2.apply(between, false, Then::Add, words, x);
    }
}

/// Linear map to `factor * factor` times as many channels, and depth to space: one product per pixel of a square.
#[derive(Debug)]
pub(super) struct Up {
    parts: Vec<Linear>,
    factor: usize,
}

impl Up {
    pub(super) fn new(instructions: Instructions, weights: &Weights, name: &str, factor: usize) -> Self {
        let matrix = Matrix::of(weights, name);
        let channels = matrix.outputs / (factor * factor);
        let part =
            |k: usize| Linear::spread(instructions, &matrix, channels, |n| Some(k * channels + n), matrix.inputs, Some);
        Self { parts: (0..factor * factor).map(part).collect(), factor }
    }

    /// Maps a map to one with `factor` times its rows and columns.
    pub(super) fn apply(&self, from: &FeatureMap, then: Then, words: &mut Vec<u32>, to: &mut FeatureMap) {
        let (step, pitch) = (self.factor * to.channels, self.factor * to.pitch());
        for (k, part) in self.parts.iter().enumerate() {
            let first = to.at(k / self.factor, k % self.factor);
            let left = Left { data: &from.data, windows: from.rows(), rectified: false };
            part.run(left, words, Target { data: &mut to.data, first, step, pitch, then });
        }
    }
}

/// Layer norm over the channels of each token.
#[derive(Debug)]
pub(super) struct Norm {
    instructions: Instructions,
    width: usize,
    weight: Vec<f32>,
    bias: Vec<f32>,
}

impl Norm {
    pub(super) fn new(instructions: Instructions, weights: &Weights, name: &str) -> Self {
        let [weight, bias] = ["weight", "bias"].map(|part| {
            let mut values = weights.values(&format!("{name}.{part}")).to_vec();
            values.resize(values.len().next_multiple_of(LANES), 0.0);
            values
        });
        Self { instructions, width: weights.values(&format!("{name}.bias")).len(), weight, bias }
    }

    /// Normalises tokens into `to`.
    pub(super) fn apply(&self, from: &FeatureMap, to: &mut FeatureMap) {
        to.data.copy_from_slice(&from.data);
        self.apply_in_place(to);
    }

    /// Normalises tokens in place.
    pub(super) fn apply_in_place(&self, tokens: &mut FeatureMap) {
        self.instructions.run(Normalise { norm: self, tokens: &mut tokens.data });
    }
}

struct Normalise<'a> {
    norm: &'a Norm,
    tokens: &'a mut [f32],
}

impl WithSimd for Normalise<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Norm { width, weight, bias, .. } = self.norm;
        let stored = weight.len();
        let [weight, bias] = [weight, bias].map(|values| S::as_simd_f32s(values).0);
        let padding = (stored - width) as f32;
        for token in self.tokens.chunks_exact_mut(stored) {
            let token = S::as_mut_simd_f32s(token).0;
            let sum = token.iter().fold(simd.splat_f32s(0.0), |sum, &x| simd.add_f32s(sum, x));
            let mean = simd.reduce_sum_f32s(sum) / *width as f32;
            let centre = simd.splat_f32s(mean);
            let squares = token.iter().fold(simd.splat_f32s(0.0), |sum, &x| {
                let d = simd.sub_f32s(x, centre);
                multiply_add(simd, d, d, sum)
            });
            // Channels beyond the width are zero; their distance from the mean is subtracted again.
            let variance = (simd.reduce_sum_f32s(squares) - padding * mean * mean).max(0.0) / *width as f32;
            let scale = simd.splat_f32s(1.0 / (variance + LAYER_NORM_EPS).sqrt());
            for ((x, &weight), &bias) in token.iter_mut().zip(weight).zip(bias) {
                *x = multiply_add(simd, simd.mul_f32s(simd.sub_f32s(*x, centre), scale), weight, bias);
            }
        }
    }
}
