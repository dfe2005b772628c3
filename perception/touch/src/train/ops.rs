//! The operations that networks consist of, and how the tape computes them.

use std::sync::Arc;

use super::attention::Attention;
use super::convolution::Convolution;
use super::linear::Linear;
use super::pointwise::{DepthToSpace, Norm, Relu};
use super::resample::Resample;
use super::scan::Selective;
use super::tape::{Var, apply};
use super::tokens::{AddTable, Append, Gelu, Pair, WithLast};
use crate::network::Tensor;
use mvt_products::Instructions;

/// Something that computes networks. Values are row-major; maps are `[images, rows, columns, channels]`, tokens
/// `[images, tokens, channels]`.
pub trait Ops {
    /// A value that remembers what it was computed from; a copy is the same value.
    type Value: Clone;

    /// A value without a gradient.
    fn constant(&self, tensor: Tensor) -> Self::Value;

    /// The sides of a value.
    fn shape(&self, x: &Self::Value) -> Vec<usize>;

    /// The sum of two values of one shape.
    fn add(&self, a: Self::Value, b: Self::Value) -> Self::Value;

    /// The same numbers with other sides.
    fn reshape(&self, x: Self::Value, shape: &[usize]) -> Self::Value;

    /// `W x` over the last axis, with W `[out, in]`.
    fn product(&self, x: Self::Value, weight: Self::Value) -> Self::Value;

    /// `W x + b` over the last axis, with W `[out, in]` and b `[out]`.
    fn linear(&self, x: Self::Value, parameters: [Self::Value; 2]) -> Self::Value;

    /// Layer norm over the last axis, with weight and bias.
    fn norm(&self, x: Self::Value, parameters: [Self::Value; 2]) -> Self::Value;

    /// 3 x 3 convolution of a map, as [`Convolution`] has it, with weight and bias.
    fn convolution(&self, x: Self::Value, parameters: [Self::Value; 2], stride: usize, relu: bool) -> Self::Value;

    /// The inside of a Mamba block, as [`Selective`] has it.
    fn selective(&self, order: &Arc<[usize]>, inputs: [Self::Value; 8]) -> Self::Value;

    /// Attention of `heads` heads over queries, keys and values, as [`Attention`] has it.
    fn attention(&self, qkv: Self::Value, heads: usize) -> Self::Value;

    /// The greater of each number and zero.
    fn relu(&self, x: Self::Value) -> Self::Value;

    /// Each number times the normal distribution function of it.
    fn gelu(&self, x: Self::Value) -> Self::Value;

    /// A map of another size.
    fn resample(&self, x: Self::Value, resample: Resample) -> Self::Value;

    /// Depth to space, as [`DepthToSpace`] has it.
    fn depth_to_space(&self, x: Self::Value, factor: usize) -> Self::Value;

    /// Adds a table `[tokens, width]` to the tokens of every image.
    fn add_table(&self, x: Self::Value, table: Self::Value) -> Self::Value;

    /// Puts one more token `[1, width]` behind those of every image.
    fn append(&self, x: Self::Value, last: Self::Value) -> Self::Value;

    /// Each token with the last one of its image beside it; the last one itself goes.
    fn with_last(&self, x: Self::Value) -> Self::Value;

    /// Two maps of one channel as a map of two.
    fn pair(&self, a: Self::Value, b: Self::Value) -> Self::Value;
}

/// The tape: kernels on the CPU.
#[derive(Debug, Clone, Copy)]
pub struct Cpu {
    /// With which products are formed.
    pub instructions: Instructions,
}

impl Ops for Cpu {
    type Value = Var;

    fn constant(&self, tensor: Tensor) -> Var {
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
        let bias = Var::constant(Tensor { shape: vec![outputs], values: vec![0.0; outputs] });
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
