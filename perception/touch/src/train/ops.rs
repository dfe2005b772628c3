//! Operations of the networks, and their computation on the tape.

use std::sync::Arc;

use super::attention::Attention;
use super::convolution::Convolution;
use super::linear::Linear;
use super::pointwise::{DepthToSpace, Norm, Relu};
use super::resample::Resample;
use super::scan::Selective;
use super::tape::{Var, apply};
use super::tokens::{AddTable, Append, Gelu, Pair, WithLast};
use crate::network::WeightTensor;
use mvt_products::Instructions;

/// Computes the operations of networks. Values are row-major; maps are `[images, rows, columns, channels]`, tokens
/// `[images, tokens, channels]`.
pub trait Ops {
    /// Value that remembers its origin; a copy is the same value.
    type Value: Clone;

    /// Returns a value without a gradient.
    fn constant(&self, tensor: WeightTensor) -> Self::Value;

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

    /// Computes the [`Convolution`] of a map, with weight and bias.
    fn convolution(&self, x: Self::Value, parameters: [Self::Value; 2], stride: usize, relu: bool) -> Self::Value;

    /// Computes the inside of a Mamba block, see [`Selective`].
    fn selective(&self, order: &Arc<[usize]>, inputs: [Self::Value; 8]) -> Self::Value;

    /// Computes the [`Attention`] of `heads` heads over queries, keys and values.
    fn attention(&self, qkv: Self::Value, heads: usize) -> Self::Value;

    /// Returns the greater of each number and zero.
    fn relu(&self, x: Self::Value) -> Self::Value;

    /// Multiplies each number by the normal distribution function of it.
    fn gelu(&self, x: Self::Value) -> Self::Value;

    /// Resizes a map.
    fn resample(&self, x: Self::Value, resample: Resample) -> Self::Value;

    /// Computes [`DepthToSpace`].
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

    fn selective(&self, order: &Arc<[usize]>, inputs: [Var; 8]) -> Var {
        apply(Selective { order: order.clone() }, inputs)
    }

    fn attention(&self, qkv: Var, heads: usize) -> Var {
        apply(Attention { heads }, [qkv])
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
