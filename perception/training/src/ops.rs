//! Operations of the networks, and their computation on the tape.

use std::sync::Arc;

use crate::attention::{Attention, WindowAttention};
use crate::batch::TrainingImages;
use crate::convolution::Convolution;
use crate::depthwise::Depthwise;
use crate::linear::Linear;
use crate::pointwise::{DepthToSpace, Norm, Relu, Scale};
use crate::resample::Resample;
use crate::scan::Selective;
use crate::tape::{Var, apply};
use crate::tokens::{AddTable, Append, Gather, Gelu, Pair, WithLast, space_to_depth, with_coordinates};
use mvt_products::Instructions;
use mvt_touch::network::WeightTensor;

/// Computes the operations of networks. Values are row-major; maps are `[images, rows, columns, channels]`, tokens
/// `[images, tokens, channels]`.
pub trait Ops {
    /// Value that remembers its origin; a copy is the same value.
    type Value: Clone;

    /// Returns a value without a gradient.
    fn constant(&self, tensor: WeightTensor) -> Self::Value;

    /// Returns numbers without a gradient that are the same whenever name and shape are.
    fn fixed(&self, _: &str, shape: &[usize], make: impl FnOnce() -> Vec<f32>) -> Self::Value {
        self.constant(WeightTensor { shape: shape.to_vec(), values: make() })
    }

    /// Returns the squares of `side` x `side` pixels of images, with levels from -1 to 1:
    /// `[images, rows / side, columns / side, side * side * 3]`.
    fn patches(&self, images: TrainingImages<'_>, side: usize) -> Self::Value {
        self.constant(space_to_depth(images, side))
    }

    /// Returns images with levels from -1 to 1 and the coordinates of the pixels as two more channels: `[images, rows, columns, 5]`.
    fn with_coordinates(&self, images: TrainingImages<'_>) -> Self::Value {
        self.constant(with_coordinates(images))
    }

    /// Returns the sides of a value.
    fn shape(&self, x: &Self::Value) -> Vec<usize>;

    /// Returns the sum of two values of one shape.
    fn add(&self, a: Self::Value, b: Self::Value) -> Self::Value;

    /// Returns the same numbers with other sides.
    fn reshape(&self, x: Self::Value, shape: &[usize]) -> Self::Value;

    /// Computes `W x` over the last axis, with W `[out, in]`.
    fn product(&self, x: Self::Value, weight: Self::Value) -> Self::Value;

    /// Computes `W x + b` over the last axis, with W `[out, in]` and b `[out]`.
    fn linear(&self, x: Self::Value, parameters: [Self::Value; 2]) -> Self::Value;

    /// Computes a layer norm over the last axis, with weight and bias.
    fn norm(&self, x: Self::Value, parameters: [Self::Value; 2]) -> Self::Value;

    /// Computes the `Convolution` of a map, with weight and bias.
    fn convolution(&self, x: Self::Value, parameters: [Self::Value; 2], stride: usize, relu: bool) -> Self::Value;

    /// Computes the `Depthwise` convolution of a map, with weight and bias.
    fn depthwise(&self, x: Self::Value, parameters: [Self::Value; 2]) -> Self::Value;

    /// Multiplies each channel by a number.
    fn scale(&self, x: Self::Value, scale: Self::Value) -> Self::Value;

    /// Computes the inside of a Mamba block, see `Selective`.
    fn selective(&self, order: &Arc<[usize]>, inputs: [Self::Value; 8]) -> Self::Value;

    /// Computes the `Attention` of `heads` heads over queries, keys and values.
    fn attention(&self, qkv: Self::Value, heads: usize) -> Self::Value;

    /// Computes [`WindowAttention`] over queries, keys and values, with the table of relative positions.
    fn window_attention(&self, qkv: Self::Value, table: Self::Value, attention: &WindowAttention) -> Self::Value;

    /// Returns the tokens of every image that `tokens` names, zeros for `None`.
    fn gather(&self, x: Self::Value, tokens: &Arc<[Option<usize>]>) -> Self::Value;

    /// Returns the greater of each number and zero.
    fn relu(&self, x: Self::Value) -> Self::Value;

    /// Multiplies each number by the normal distribution function of it.
    fn gelu(&self, x: Self::Value) -> Self::Value;

    /// Resizes a map.
    fn resample(&self, x: Self::Value, resample: Resample) -> Self::Value;

    /// Computes `DepthToSpace`.
    fn depth_to_space(&self, x: Self::Value, factor: usize) -> Self::Value;

    /// Adds a table `[tokens, width]` to the tokens of every image.
    fn add_table(&self, x: Self::Value, table: Self::Value) -> Self::Value;

    /// Appends a token `[1, width]` to the tokens of every image.
    fn append(&self, x: Self::Value, last: Self::Value) -> Self::Value;

    /// Pairs each token but the last one of its image with the last one.
    fn with_last(&self, x: Self::Value) -> Self::Value;

    /// Joins two maps of one channel to a map of two.
    fn pair(&self, a: Self::Value, b: Self::Value) -> Self::Value;
}

/// Operations on the tape: kernels on the CPU.
#[derive(Debug, Clone, Copy)]
pub struct Cpu {
    /// Instructions of the products.
    pub instructions: Instructions,
}

impl Ops for Cpu {
    type Value = Var;

    fn constant(&self, tensor: WeightTensor) -> Var {
        Var::constant(tensor)
    }

    fn shape(&self, x: &Var) -> Vec<usize> {
        x.shape().to_vec()
    }

    fn add(&self, a: Var, b: Var) -> Var {
        a.add(b)
    }

    fn reshape(&self, x: Var, shape: &[usize]) -> Var {
        x.reshape(shape)
    }

    fn product(&self, x: Var, weight: Var) -> Var {
        let outputs = weight.shape()[0];
        let bias = Var::constant(WeightTensor { shape: vec![outputs], values: vec![0.0; outputs] });
        self.linear(x, [weight, bias])
    }

    fn linear(&self, x: Var, [weight, bias]: [Var; 2]) -> Var {
        apply(Linear { instructions: self.instructions }, [x, weight, bias])
    }

    fn norm(&self, x: Var, [weight, bias]: [Var; 2]) -> Var {
        apply(Norm, [x, weight, bias])
    }

    fn convolution(&self, x: Var, [weight, bias]: [Var; 2], stride: usize, relu: bool) -> Var {
        apply(Convolution { stride, relu, instructions: self.instructions }, [x, weight, bias])
    }

    fn depthwise(&self, x: Var, [weight, bias]: [Var; 2]) -> Var {
        apply(Depthwise { instructions: self.instructions }, [x, weight, bias])
    }

    fn scale(&self, x: Var, scale: Var) -> Var {
        apply(Scale, [x, scale])
    }

    fn selective(&self, order: &Arc<[usize]>, inputs: [Var; 8]) -> Var {
        apply(Selective { order: order.clone() }, inputs)
    }

    fn attention(&self, qkv: Var, heads: usize) -> Var {
        apply(Attention { heads }, [qkv])
    }

    fn window_attention(&self, qkv: Var, table: Var, attention: &WindowAttention) -> Var {
        apply(attention.clone(), [qkv, table])
    }

    fn gather(&self, x: Var, tokens: &Arc<[Option<usize>]>) -> Var {
        apply(Gather { tokens: tokens.clone() }, [x])
    }

    fn relu(&self, x: Var) -> Var {
        apply(Relu, [x])
    }

    fn gelu(&self, x: Var) -> Var {
        apply(Gelu, [x])
    }

    fn resample(&self, x: Var, resample: Resample) -> Var {
        apply(resample, [x])
    }

    fn depth_to_space(&self, x: Var, factor: usize) -> Var {
        apply(DepthToSpace(factor), [x])
    }

    fn add_table(&self, x: Var, table: Var) -> Var {
        apply(AddTable, [x, table])
    }

    fn append(&self, x: Var, last: Var) -> Var {
        apply(Append, [x, last])
    }

    fn with_last(&self, x: Var) -> Var {
        apply(WithLast, [x])
    }

    fn pair(&self, a: Var, b: Var) -> Var {
        apply(Pair, [a, b])
    }
}
