//! Networks on burn's tensors, with whose gradients those of the tape and of the GPU's kernels are compared.

use std::sync::Arc;

use burn_tensor::activation::{log_sigmoid, relu, silu, softmax};
use burn_tensor::backend::{AutodiffBackend, Backend};
use burn_tensor::module::conv2d;
use burn_tensor::ops::{ConvOptions, FloatTensor};
use burn_tensor::{Int, Shape, Tensor as Array, TensorData, TensorMetadata as _, TensorPrimitive};

use mvt_training::backend::{Model, Ops, Resample, Tensors, WindowAttention, add_to};
use mvt_training::mvt_touch;
use mvt_training::{LossConfig, Penalty, TrainError, TrainingBatch};
use mvt_touch::network::{Architecture, LAYER_NORM_EPS, WeightTensor, relative_position};

/// Returns the loss of a batch and its gradients by all weights. A pass has about `pixels` pixels.
///
/// # Errors
/// [`TrainError::Gpu`] if the device fails.
pub fn gradients<B: AutodiffBackend>(
    device: &B::Device,
    architecture: &Architecture,
    weights: &Tensors,
    config: LossConfig,
    batch: &TrainingBatch,
    pixels: usize,
) -> Result<(f32, Tensors), TrainError> {
    let ops = Burn::<B> { device: device.clone() };
    let parameter =
        |tensor: &WeightTensor| BurnValue::<B>(B::float_set_require_grad(ops.constant(tensor.clone()).0, true));
    let variables = weights.iter().map(|(name, tensor)| (name.as_str(), parameter(tensor))).collect();
    let mut gradients: Tensors = weights.iter().map(|(name, tensor)| (name.clone(), tensor.zeros())).collect();
    let mut sum = 0.0;
    for (first, images) in batch.shares(pixels) {
        let output = Model { architecture, ops: &ops, variables: &variables }.forward(images);
        let loss = ops.loss(output, config, batch, first);
        let mut slopes = loss.backward();
        sum += read::<B::InnerBackend>(loss.inner().into_primitive().tensor())?.iter().sum::<f32>();
        for (variable, gradient) in variables.values().zip(gradients.values_mut()) {
            if let Some(slope) = B::grad_remove(&variable.0, &mut slopes) {
                add_to(&mut gradient.values, &read::<B::InnerBackend>(slope)?);
            }
        }
    }
    Ok((sum, gradients))
}

/// Returns the numbers of a tensor of any rank.
fn read<B: Backend>(tensor: FloatTensor<B>) -> Result<Vec<f32>, TrainError> {
    let count = tensor.shape().num_elements();
    let flat: Array<B, 1> = BurnValue(B::float_reshape(tensor, Shape::new([count]))).array();
    let data = flat.try_into_data().map_err(|error| TrainError::Gpu(error.to_string()))?;
    Ok(data.iter::<f32>().collect())
}

/// Tensor of any rank.
#[derive(Debug, Clone)]
pub struct BurnValue<B: Backend>(FloatTensor<B>);

impl<B: Backend> BurnValue<B> {
    /// Returns the tensor as an array of its D axes.
    fn array<const D: usize>(self) -> Array<B, D> {
        Array::from_primitive(TensorPrimitive::Float(self.0))
    }

    /// Returns the tensor as rows of its last axis.
    fn rows(self) -> Array<B, 2> {
        let shape = self.0.shape();
        let width = shape.iter().last().copied().unwrap_or(1);
        let rows = shape.num_elements() / width;
        Self(B::float_reshape(self.0, Shape::new([rows, width]))).array()
    }
}

impl<B: Backend, const D: usize> From<Array<B, D>> for BurnValue<B> {
    fn from(array: Array<B, D>) -> Self {
        Self(array.into_primitive().tensor())
    }
}

/// Operations of burn.
struct Burn<B: Backend> {
    device: B::Device,
}

impl<B: Backend> Burn<B> {
    fn array<const D: usize>(&self, values: Vec<f32>, shape: [usize; D]) -> Array<B, D> {
        Array::from_data(TensorData::new(values, shape), &self.device)
    }

    fn indices(&self, indices: impl Iterator<Item = usize>) -> Array<B, 1, Int> {
        let indices: Vec<i64> = indices.map(|i| i as i64).collect();
        let count = indices.len();
        Array::from_data(TensorData::new(indices, [count]), &self.device)
    }

    /// Returns the part of a batch's loss, as [`LossConfig`] defines it, that belongs to the pixels from `first` on.
    fn loss(&self, output: BurnValue<B>, config: LossConfig, batch: &TrainingBatch, first: usize) -> Array<B, 1> {
        let LossConfig { penalty, huber_mm, contact_weight, segmentation } = config;
        let output = output.rows();
        let [count, _] = output.dims();
        let column = |values: &[f32]| self.array(values[first..first + count].to_vec(), [count, 1]);
        let (target, contact) = (column(&batch.targets.indentation_mm), column(&batch.targets.contact));
        let [indentation, logit] = [0, 1].map(|part| output.clone().narrow(1, part, 1));
        let error = (indentation - target).abs();
        let cost = match penalty {
            Penalty::Mse => error.clone() * error,
            Penalty::L1 => error,
            Penalty::Huber => {
                let near = error.clone().clamp_max(huber_mm);
                (error - near.clone() * 0.5) * near / huber_mm
            }
        };
        let entropy = softplus(logit.clone()) - logit * contact.clone();
        let weight = contact * (contact_weight - 1.0) + 1.0;
        (weight * cost + entropy * segmentation).sum() / batch.targets.contact.len() as f32
    }
}

fn softplus<B: Backend, const D: usize>(x: Array<B, D>) -> Array<B, D> {
    -log_sigmoid(-x)
}

impl<B: Backend> Ops for Burn<B> {
    type Value = BurnValue<B>;

    fn constant(&self, WeightTensor { shape, values }: WeightTensor) -> BurnValue<B> {
        BurnValue(B::float_from_data(TensorData::new(values, shape), &self.device))
    }

    fn shape(&self, x: &BurnValue<B>) -> Vec<usize> {
        x.0.shape().to_vec()
    }

    fn add(&self, a: BurnValue<B>, b: BurnValue<B>) -> BurnValue<B> {
        BurnValue(B::float_add(a.0, b.0))
    }

    fn reshape(&self, x: BurnValue<B>, shape: &[usize]) -> BurnValue<B> {
        BurnValue(B::float_reshape(x.0, Shape::from(shape)))
    }

    fn product(&self, x: BurnValue<B>, weight: BurnValue<B>) -> BurnValue<B> {
        let (mut shape, weight) = (self.shape(&x), weight.array::<2>());
        shape.pop();
        shape.push(weight.dims()[0]);
        self.reshape(x.rows().matmul(weight.transpose()).into(), &shape)
    }

    fn linear(&self, x: BurnValue<B>, [weight, bias]: [BurnValue<B>; 2]) -> BurnValue<B> {
        let y = self.product(x, weight);
        let shape = self.shape(&y);
        self.reshape((y.rows() + bias.array::<1>().unsqueeze()).into(), &shape)
    }

    fn norm(&self, x: BurnValue<B>, [weight, bias]: [BurnValue<B>; 2]) -> BurnValue<B> {
        let (shape, x) = (self.shape(&x), x.rows());
        let centred = x.clone() - x.mean_dim(1);
        let variance = (centred.clone() * centred.clone()).mean_dim(1);
        let unit = centred / (variance + LAYER_NORM_EPS).sqrt();
        self.reshape((unit * weight.array::<1>().unsqueeze() + bias.array::<1>().unsqueeze()).into(), &shape)
    }

    fn convolution(
        &self,
        x: BurnValue<B>,
        [weight, bias]: [BurnValue<B>; 2],
        stride: usize,
        is_rectified: bool,
    ) -> BurnValue<B> {
        let x = x.array::<4>().permute([0, 3, 1, 2]);
        let x = if is_rectified { relu(x) } else { x };
        let options = ConvOptions::new([stride; 2], [1; 2], [1; 2], 1);
        conv2d(x, weight.array(), Some(bias.array()), options).permute([0, 2, 3, 1]).into()
    }

    fn depthwise(&self, x: BurnValue<B>, [weight, bias]: [BurnValue<B>; 2]) -> BurnValue<B> {
        let weight = weight.array::<3>();
        let [channels, side, _] = weight.dims();
        let options = ConvOptions::new([1; 2], [side / 2; 2], [1; 2], channels);
        let x = x.array::<4>().permute([0, 3, 1, 2]);
        conv2d(x, weight.reshape([channels, 1, side, side]), Some(bias.array()), options).permute([0, 2, 3, 1]).into()
    }

    fn scale(&self, x: BurnValue<B>, scale: BurnValue<B>) -> BurnValue<B> {
        let shape = self.shape(&x);
        self.reshape((x.rows() * scale.array::<1>().unsqueeze()).into(), &shape)
    }

    fn selective(
        &self,
        order: &Arc<[usize]>,
        [xz, taps, bias, projection, step, step_bias, a_log, skip]: [BurnValue<B>; 8],
    ) -> BurnValue<B> {
        let mut inverse: Vec<usize> = (0..order.len()).collect();
        inverse.sort_by_key(|&k| order[k]);
        let (taps, a_log) = (taps.array::<2>(), a_log.array::<2>());
        let ([inner, count], [_, state]) = (taps.dims(), a_log.dims());
        let rank = self.shape(&step)[1];

        let xz = xz.array::<3>().select(1, self.indices(order.iter().copied()));
        let [images, tokens, _] = xz.dims();
        let (x, z) = (xz.clone().narrow(2, 0, inner), xz.narrow(2, inner, inner));
        let past =
            if count > 1 { Array::cat(vec![Array::zeros([images, count - 1, inner], &self.device), x], 1) } else { x };
        let convolved = (0..count).fold(bias.array::<1>().unsqueeze(), |sum: Array<B, 3>, k| {
            sum + past.clone().narrow(1, k, tokens) * taps.clone().narrow(1, k, 1).reshape([1, 1, inner])
        });
        let x = silu(convolved);
        let projected = self.product(x.clone().into(), projection).array::<3>();
        let source = projected.clone().narrow(2, 0, rank);
        let delta = softplus(self.linear(source.into(), [step, step_bias]).array::<3>());
        let [b, c] = [rank, rank + state].map(|at| projected.clone().narrow(2, at, state));
        let y = scan(&delta, &x, &b, &c, &-a_log.exp()) + x * skip.array::<1>().unsqueeze();
        (y * silu(z)).select(1, self.indices(inverse.into_iter())).into()
    }

    fn attention(&self, qkv: BurnValue<B>, heads: usize) -> BurnValue<B> {
        let qkv = qkv.array::<3>();
        let [images, tokens, triple] = qkv.dims();
        let (width, head) = (triple / 3, triple / 3 / heads);
        let qkv = qkv.reshape([images, tokens, 3, heads, head]).permute([2, 0, 3, 1, 4]);
        let [queries, keys, values] =
            [0, 1, 2].map(|part| qkv.clone().narrow(0, part, 1).reshape([images, heads, tokens, head]));
        let scores = queries.matmul(keys.swap_dims(2, 3)) / (head as f32).sqrt();
        softmax(scores, 3).matmul(values).permute([0, 2, 1, 3]).reshape([images, tokens, width]).into()
    }

    fn window_attention(
        &self,
        qkv: BurnValue<B>,
        table: BurnValue<B>,
        &WindowAttention { heads, side, ref regions }: &WindowAttention,
    ) -> BurnValue<B> {
        let qkv = qkv.array::<3>();
        let [windows, tokens, triple] = qkv.dims();
        let (width, head) = (triple / 3, triple / 3 / heads);
        let qkv = qkv.reshape([windows, tokens, 3, heads, head]).permute([2, 0, 3, 1, 4]);
        let [queries, keys, values] =
            [0, 1, 2].map(|part| qkv.clone().narrow(0, part, 1).reshape([windows, heads, tokens, head]));
        let pairs = (0..tokens * tokens).map(|at| (at / tokens, at % tokens));
        let positions = self.indices(pairs.map(|(query, key)| relative_position(side, query, key)));
        let bias = table.array::<2>().select(0, positions).transpose().reshape([1, heads, tokens, tokens]);
        let apart = |at: usize| {
            let regions = &regions[at / (tokens * tokens) * tokens % regions.len()..];
            if regions[at / tokens % tokens] == regions[at % tokens] { 0.0 } else { -1e9 }
        };
        let far = (0..windows * tokens * tokens).map(apart).collect();
        let far = self.array(far, [windows, 1, tokens, tokens]);
        let scores = queries.matmul(keys.swap_dims(2, 3)) / (head as f32).sqrt() + bias + far;
        softmax(scores, 3).matmul(values).permute([0, 2, 1, 3]).reshape([windows, tokens, width]).into()
    }

    fn gather(&self, x: BurnValue<B>, tokens: &Arc<[Option<usize>]>) -> BurnValue<B> {
        let x = x.array::<3>();
        let [images, count, width] = x.dims();
        let with_zeros = Array::cat(vec![x, Array::zeros([images, 1, width], &self.device)], 1);
        with_zeros.select(1, self.indices(tokens.iter().map(|token| token.unwrap_or(count)))).into()
    }

    fn relu(&self, x: BurnValue<B>) -> BurnValue<B> {
        BurnValue(B::relu(x.0))
    }

    fn gelu(&self, x: BurnValue<B>) -> BurnValue<B> {
        // The backward pass of burn's own GELU is an approximation.
        let (shape, x) = (self.shape(&x), x.rows());
        let below = ((x.clone() * std::f32::consts::FRAC_1_SQRT_2).erf() + 1.0) * 0.5;
        self.reshape((x * below).into(), &shape)
    }

    fn resample(&self, x: BurnValue<B>, resample: Resample) -> BurnValue<B> {
        // Two products, since burn's own resampling has no backward pass on a GPU.
        let x = x.array::<4>();
        let [images, rows, columns, channels] = x.dims();
        let [down, across] = [(rows, resample.size[0]), (columns, resample.size[1])]
            .map(|(from, to)| self.array(resample.matrix(from, to), [1, to, from]));
        let x = down.matmul(x.reshape([images, rows, columns * channels]));
        let x = across.matmul(x.reshape([images * resample.size[0], columns, channels]));
        x.reshape([images, resample.size[0], resample.size[1], channels]).into()
    }

    fn depth_to_space(&self, x: BurnValue<B>, factor: usize) -> BurnValue<B> {
        let x = x.array::<4>();
        let [images, rows, columns, deep] = x.dims();
        let channels = deep / (factor * factor);
        let x = x.reshape([images, rows, columns, factor, factor, channels]).permute([0, 1, 3, 2, 4, 5]);
        x.reshape([images, rows * factor, columns * factor, channels]).into()
    }

    fn add_table(&self, x: BurnValue<B>, table: BurnValue<B>) -> BurnValue<B> {
        (x.array::<3>() + table.array::<2>().unsqueeze()).into()
    }

    fn append(&self, x: BurnValue<B>, last: BurnValue<B>) -> BurnValue<B> {
        let x = x.array::<3>();
        let [images, _, width] = x.dims();
        let last = last.array::<2>().unsqueeze::<3>().expand([images, 1, width]);
        Array::cat(vec![x, last], 1).into()
    }

    fn with_last(&self, x: BurnValue<B>) -> BurnValue<B> {
        let x = x.array::<3>();
        let [images, tokens, width] = x.dims();
        let last = x.clone().narrow(1, tokens - 1, 1).expand([images, tokens - 1, width]);
        Array::cat(vec![x.narrow(1, 0, tokens - 1), last], 2).into()
    }

    fn pair(&self, a: BurnValue<B>, b: BurnValue<B>) -> BurnValue<B> {
        Array::cat(vec![a.array::<4>(), b.array::<4>()], 3).into()
    }
}

/// Computes the recurrence `h = exp(delta A) h + delta x B`, read as `h C` after each token: delta and x are `[images, tokens, E]`, B
/// and C `[images, tokens, N]`, A is `[E, N]`.
///
/// Chunks of tokens start from zero side by side. Then each chunk passes its final state and its decay to the next one, and the states
/// of earlier chunks are added to each token. With as many chunks as a chunk has tokens, both loops take the root of the number of
/// tokens, which suits a GPU. No factor exceeds one. Four numbers per token, channel and state are kept for the backward pass.
fn scan<B: Backend>(
    delta: &Array<B, 3>,
    x: &Array<B, 3>,
    b: &Array<B, 3>,
    c: &Array<B, 3>,
    a: &Array<B, 2>,
) -> Array<B, 3> {
    let ([images, tokens, inner], [_, state]) = (delta.dims(), a.dims());
    let length = tokens.isqrt().max(1);
    let chunks = tokens.div_ceil(length);
    let device = delta.device();
    // The last chunk is filled up with tokens whose step is zero.
    let cut = |values: &Array<B, 3>| -> Array<B, 4> {
        let [_, _, width] = values.dims();
        let parts = match chunks * length - tokens {
            0 => vec![values.clone()],
            missing => vec![values.clone(), Array::zeros([images, missing, width], &device)],
        };
        Array::cat(parts, 1).reshape([images, chunks, length, width])
    };
    let [delta, x, b, c] = [delta, x, b, c].map(cut);
    let a = a.clone().reshape([1, 1, inner, state]);
    let row = |values: &Array<B, 4>, t: usize| values.clone().narrow(2, t, 1);
    let column = |values: &Array<B, 4>, t: usize| row(values, t).swap_dims(2, 3);

    let mut hidden = Array::zeros([images, chunks, inner, state], &device);
    let mut elapsed = Array::zeros([images, chunks, inner, 1], &device);
    let mut through = Array::ones([images, chunks, inner, state], &device);
    let mut inside = Vec::with_capacity(length);
    for t in 0..length {
        let step = column(&delta, t);
        elapsed = elapsed + step.clone();
        through = (elapsed.clone() * a.clone()).exp();
        hidden = hidden * (step.clone() * a.clone()).exp() + step * column(&x, t) * row(&b, t);
        inside.push((hidden.clone(), through.clone()));
    }
    let mut handed = Array::zeros([images, 1, inner, state], &device);
    let mut before = Vec::with_capacity(chunks);
    for k in 0..chunks {
        before.push(handed.clone());
        handed = handed * through.clone().narrow(1, k, 1) + hidden.clone().narrow(1, k, 1);
    }
    let before = Array::cat(before, 1);
    let read = inside
        .into_iter()
        .enumerate()
        .map(|(t, (hidden, through))| ((hidden + through * before.clone()) * row(&c, t)).sum_dim(3));
    let y = Array::cat(read.collect(), 3).swap_dims(2, 3);
    y.reshape([images, chunks * length, inner]).narrow(1, 0, tokens)
}
