//! Values that remember what they were computed from, and the way back from the loss to the parameters.
//!
//! A tape belongs to one thread and holds a share of a batch; shares run side by side. Each op is a [`Kernel`], plain loops over
//! slices in both directions.

use std::cell::Cell;
use std::collections::{BTreeMap, HashMap};
use std::fmt;
use std::rc::Rc;
use std::sync::Arc;

use super::linear::add_to;
use crate::network::Tensor;

/// A value on the tape.
#[derive(Debug, Clone)]
pub struct Var(Rc<Node>);

#[derive(Debug)]
struct Node {
    /// Greater than those of all values from which it was computed.
    number: u64,
    tensor: Arc<Tensor>,
    origin: Origin,
}

/// Where a value comes from.
enum Origin {
    Constant,
    Parameter,
    Computed(Box<dyn Step>),
}

impl fmt::Debug for Origin {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Constant => "constant",
            Self::Parameter => "parameter",
            Self::Computed(_) => "computed",
        })
    }
}

/// Numbers with a shape, row-major, of somebody else.
#[derive(Debug, Clone, Copy)]
pub struct View<'a> {
    /// Its sides.
    pub shape: &'a [usize],
    /// As many numbers as the product of the sides.
    pub values: &'a [f32],
}

impl<'a> From<&'a Tensor> for View<'a> {
    fn from(Tensor { shape, values }: &'a Tensor) -> Self {
        Self { shape, values }
    }
}

/// An op with N inputs and one output. Inputs and output are row-major.
pub trait Kernel<const N: usize>: 'static {
    /// What the forward pass keeps for the backward pass, beside the inputs.
    type Kept: 'static;

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

/// How a value was computed.
trait Step {
    /// Hands the loss' gradients by what the value was computed from to `give`.
    fn back(&self, gradient: Tensor, give: &mut dyn FnMut(&Var, Tensor));
}

/// The loss' gradients by all parameters.
pub struct Slopes(HashMap<u64, Tensor>);

impl Var {
    fn new(tensor: Arc<Tensor>, origin: Origin) -> Self {
        thread_local!(static NEXT: Cell<u64> = const { Cell::new(0) });
        let number = NEXT.replace(NEXT.get() + 1);
        Self(Rc::new(Node { number, tensor, origin }))
    }

    /// A value that was computed from others, of which none may need a gradient.
    fn computed<const N: usize>(tensor: Tensor, inputs: &[Self; N], step: impl Step + 'static) -> Self {
        let is_tracked = inputs.iter().any(Self::is_tracked);
        Self::new(Arc::new(tensor), if is_tracked { Origin::Computed(Box::new(step)) } else { Origin::Constant })
    }

    /// A value without a gradient.
    pub fn constant(tensor: impl Into<Arc<Tensor>>) -> Self {
        Self::new(tensor.into(), Origin::Constant)
    }

    /// A value whose gradient is wanted.
    pub fn parameter(tensor: impl Into<Arc<Tensor>>) -> Self {
        Self::new(tensor.into(), Origin::Parameter)
    }

    fn is_tracked(&self) -> bool {
        !matches!(self.0.origin, Origin::Constant)
    }

    fn view(&self) -> View<'_> {
        View::from(self.tensor())
    }

    /// Its numbers.
    pub fn tensor(&self) -> &Tensor {
        &self.0.tensor
    }

    /// Its sides.
    pub fn shape(&self) -> &[usize] {
        &self.0.tensor.shape
    }

    /// The sum of two values of one shape.
    pub fn add(self, other: Self) -> Self {
        let values = self.tensor().values.iter().zip(&other.tensor().values).map(|(a, b)| a + b).collect();
        let tensor = Tensor { shape: self.shape().to_vec(), values };
        let inputs = [self, other];
        Self::computed(tensor, &inputs.clone(), Sum(inputs))
    }

    /// The same numbers with other sides.
    pub fn reshape(self, shape: &[usize]) -> Self {
        let tensor = Tensor { shape: shape.to_vec(), values: self.tensor().values.clone() };
        let inputs = [self];
        Self::computed(tensor, &inputs.clone(), Reshaped(inputs))
    }

    /// Goes back from this value, the loss.
    pub fn backward(self) -> Slopes {
        let ones = Tensor { shape: self.shape().to_vec(), values: vec![1.0; self.tensor().values.len()] };
        let mut slopes = HashMap::new();
        // A value's gradient is whole when no value with a greater number waits.
        let mut waiting = BTreeMap::from([(self.0.number, (self, ones))]);
        while let Some((number, (Var(node), gradient))) = waiting.pop_last() {
            match &node.origin {
                Origin::Constant => {}
                Origin::Parameter => {
                    slopes.insert(number, gradient);
                }
                Origin::Computed(step) => step.back(gradient, &mut |input, slope| {
                    let (_, sum) = match waiting.entry(input.0.number) {
                        std::collections::btree_map::Entry::Vacant(place) => {
                            place.insert((input.clone(), slope));
                            return;
                        }
                        std::collections::btree_map::Entry::Occupied(place) => place.into_mut(),
                    };
                    add_to(&mut sum.values, &slope.values);
                }),
            }
        }
        Slopes(slopes)
    }
}

impl Slopes {
    /// Takes the gradient by a parameter; `None` if it had no part in the loss.
    pub fn take(&mut self, parameter: &Var) -> Option<Tensor> {
        self.0.remove(&parameter.0.number)
    }
}

/// A sum of two values.
struct Sum([Var; 2]);

impl Step for Sum {
    fn back(&self, gradient: Tensor, give: &mut dyn FnMut(&Var, Tensor)) {
        let Self([first, second]) = self;
        if first.is_tracked() {
            give(first, gradient.clone());
        }
        if second.is_tracked() {
            give(second, gradient);
        }
    }
}

/// A value with other sides.
struct Reshaped([Var; 1]);

impl Step for Reshaped {
    fn back(&self, gradient: Tensor, give: &mut dyn FnMut(&Var, Tensor)) {
        let Self([input]) = self;
        give(input, Tensor { shape: input.shape().to_vec(), values: gradient.values });
    }
}

/// The result of a kernel.
struct Applied<K: Kernel<N>, const N: usize> {
    kernel: K,
    inputs: [Var; N],
    kept: K::Kept,
}

impl<K: Kernel<N>, const N: usize> Step for Applied<K, N> {
    fn back(&self, gradient: Tensor, give: &mut dyn FnMut(&Var, Tensor)) {
        let Self { kernel, inputs, kept } = self;
        let wanted = inputs.each_ref().map(Var::is_tracked);
        let slopes = kernel.backward(inputs.each_ref().map(Var::view), kept, View::from(&gradient), wanted);
        for ((input, slope), is_wanted) in inputs.iter().zip(slopes).zip(wanted) {
            if let Some(slope) = slope.filter(|_| is_wanted) {
                give(input, slope);
            }
        }
    }
}

/// Applies an op.
pub fn apply<K: Kernel<N>, const N: usize>(kernel: K, inputs: [Var; N]) -> Var {
    let (tensor, kept) = kernel.forward(inputs.each_ref().map(Var::view));
    Var::computed(tensor, &inputs.clone(), Applied { kernel, inputs, kept })
}
