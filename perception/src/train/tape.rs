//! Ops of ours on burn's tape: plain loops over slices, forward and backward.

use std::fmt::Debug;

use burn_autodiff::Autodiff;
use burn_autodiff::checkpoint::base::Checkpointer;
use burn_autodiff::checkpoint::strategy::NoCheckpointing;
use burn_autodiff::grads::Gradients;
use burn_autodiff::ops::{Backward, Ops, OpsKind};
use burn_backend::backend::AutodiffBackend;
use burn_backend::ops::FloatTensorOps;
use burn_backend::tensor::FloatTensor;
use burn_backend::{TensorData, TensorMetadata};
use burn_flex::{Flex, FlexTensor};

use crate::network::Tensor;

/// The backend with the tape.
type Tape = Autodiff<Flex>;

/// A value on the tape.
#[derive(Debug, Clone)]
pub struct Var(FloatTensor<Tape>);

/// Numbers with a shape, row-major, of somebody else.
#[derive(Debug, Clone, Copy)]
pub struct View<'a> {
    /// Its sides.
    pub shape: &'a [usize],
    /// As many numbers as the product of the sides.
    pub values: &'a [f32],
}

/// An op with N inputs and one output. Inputs and output are row-major.
pub trait Kernel<const N: usize>: Debug + Clone + Send + 'static {
    /// What the forward pass keeps for the backward pass, beside the inputs.
    type Kept: Debug + Clone + Send + 'static;

    /// The output.
    fn forward(&self, inputs: [View<'_>; N]) -> (Tensor, Self::Kept);

    /// The loss' gradients by the inputs, of those that are wanted, from its gradient by the output.
    fn backward(
        &self,
        inputs: [View<'_>; N],
        kept: &Self::Kept,
        gradient: View<'_>,
        wanted: [bool; N],
    ) -> [Option<Tensor>; N];
}

/// The loss' gradients by all values that ask for them.
pub struct Slopes(Gradients);

impl Var {
    /// A value without a gradient.
    pub fn constant(tensor: Tensor) -> Self {
        Self(Tape::from_inner(to_flex(tensor)))
    }

    /// A value whose gradient is wanted.
    pub fn parameter(tensor: Tensor) -> Self {
        Self(Self::constant(tensor).0.require_grad())
    }

    /// Its sides.
    pub fn shape(&self) -> Vec<usize> {
        self.0.shape().iter().copied().collect()
    }

    /// Its numbers.
    pub fn to_tensor(&self) -> Tensor {
        from_flex(&self.0.primitive)
    }

    /// The sum of two values of one shape.
    pub fn add(self, other: Self) -> Self {
        Self(Tape::float_add(self.0, other.0))
    }

    /// The same numbers with other sides.
    pub fn reshape(self, shape: &[usize]) -> Self {
        Self(Tape::float_reshape(self.0, shape.to_vec().into()))
    }

    /// Goes back from this value, the loss.
    pub fn backward(self) -> Slopes {
        Slopes(Tape::backward(self.0))
    }
}

impl Slopes {
    /// Takes the gradient by a parameter; `None` if it had no part in the loss.
    pub fn take(&mut self, parameter: &Var) -> Option<Tensor> {
        Tape::grad_remove(&parameter.0, &mut self.0).map(|tensor| from_flex(&tensor))
    }
}

/// Applies an op.
pub fn apply<K: Kernel<N>, const N: usize>(kernel: K, inputs: [Var; N]) -> Var {
    let nodes = std::array::from_fn(|i| inputs[i].0.node.clone());
    let primitives = inputs.map(|input| input.0.primitive.to_contiguous());
    let (output, kept) = with_views(&primitives, |views| kernel.forward(views));
    let output = to_flex(output);
    let op = Step::<K, N>(std::marker::PhantomData);
    Var(match op.prepare::<NoCheckpointing>(nodes).compute_bound().stateful() {
        OpsKind::Tracked(prepared) => prepared.finish((kernel, primitives, kept), output),
        OpsKind::UnTracked(prepared) => prepared.finish(output),
    })
}

/// The op as burn's tape sees it.
#[derive(Debug)]
struct Step<K, const N: usize>(std::marker::PhantomData<K>);

impl<K: Kernel<N>, const N: usize> Backward<Flex, N> for Step<K, N> {
    type State = (K, [FlexTensor; N], K::Kept);

    fn backward(self, ops: Ops<Self::State, N>, grads: &mut Gradients, _: &mut Checkpointer) {
        let gradient = [grads.consume::<Flex>(&ops.node).to_contiguous()];
        let (kernel, inputs, kept) = ops.state;
        let wanted = std::array::from_fn(|i| ops.parents[i].is_some());
        let slopes = with_views(&inputs, |inputs| {
            with_views(&gradient, |[gradient]| kernel.backward(inputs, &kept, gradient, wanted))
        });
        for (parent, slope) in ops.parents.into_iter().zip(slopes) {
            if let (Some(parent), Some(slope)) = (parent, slope) {
                grads.register::<Flex>(parent.id, to_flex(slope));
            }
        }
    }
}

fn with_views<R, const N: usize>(tensors: &[FlexTensor; N], run: impl FnOnce([View<'_>; N]) -> R) -> R {
    let shapes: [Vec<usize>; N] = std::array::from_fn(|i| tensors[i].layout().shape().iter().copied().collect());
    // They are contiguous and hold 32-bit floats: nothing else is ever made here.
    run(std::array::from_fn(|i| View { shape: &shapes[i], values: tensors[i].as_slice().unwrap_or_default() }))
}

fn to_flex(Tensor { shape, values }: Tensor) -> FlexTensor {
    FlexTensor::from_data(TensorData::new(values, shape))
}

fn from_flex(tensor: &FlexTensor) -> Tensor {
    let shape = tensor.layout().shape().iter().copied().collect();
    let values = tensor.to_contiguous().as_slice().unwrap_or_default().to_vec();
    Tensor { shape, values }
}
