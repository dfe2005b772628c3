//! Values that remember what they were computed from, and the way back from the loss to the parameters.
//!
//! A tape belongs to one thread and holds a share of a batch; shares run side by side. Each op is a [`Kernel`], plain loops over
//! slices in both directions.

use std::cell::Cell;
use std::collections::{BTreeMap, HashMap};
use std::fmt;
use std::rc::Rc;
use std::sync::{Arc, OnceLock};

use super::linear::add_to;
use crate::network::Tensor;
use mvt_products::multiply::Packed;

/// A value on the tape.
#[derive(Debug, Clone)]
pub struct Var(Rc<Node>);

#[derive(Debug)]
struct Node {
    /// Greater than those of all values from which it was computed.
    number: u64,
    value: Arc<Value>,
    origin: Origin,
}

/// A tensor, and what kernels have packed of it: weights are packed once for all shares of a batch.
#[derive(Debug)]
pub struct Value {
    tensor: Tensor,
    packed: [OnceLock<Packed>; 2],
}

impl From<Tensor> for Value {
    fn from(tensor: Tensor) -> Self {
        Self { tensor, packed: Default::default() }
    }
}

impl From<Tensor> for Arc<Value> {
    fn from(tensor: Tensor) -> Self {
        Self::new(tensor.into())
    }
}

impl Value {
    fn view(&self) -> View<'_> {
        let Tensor { shape, values } = &self.tensor;
        View { shape, values, packed: &self.packed }
    }
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
    packed: &'a [OnceLock<Packed>; 2],
}

impl<'a> View<'a> {
    /// Packed for the way forward; by `pack`, the first time.
    pub fn forwards(self, pack: impl FnOnce() -> Packed) -> &'a Packed {
        self.packed[0].get_or_init(pack)
    }

    /// Packed for the way back; by `pack`, the first time.
    pub fn backwards(self, pack: impl FnOnce() -> Packed) -> &'a Packed {
        self.packed[1].get_or_init(pack)
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
    fn new(value: Arc<Value>, origin: Origin) -> Self {
        thread_local!(static NEXT: Cell<u64> = const { Cell::new(0) });
        let number = NEXT.replace(NEXT.get() + 1);
        Self(Rc::new(Node { number, value, origin }))
    }

    /// A value that was computed from others, of which none may need a gradient.
    fn computed<const N: usize>(tensor: Tensor, inputs: &[Self; N], step: impl Step + 'static) -> Self {
        let is_tracked = inputs.iter().any(Self::is_tracked);
        Self::new(Arc::new(tensor.into()), if is_tracked { Origin::Computed(Box::new(step)) } else { Origin::Constant })
    }

    /// A value without a gradient.
    pub fn constant(value: impl Into<Arc<Value>>) -> Self {
        Self::new(value.into(), Origin::Constant)
    }

    /// A value whose gradient is wanted.
    pub fn parameter(value: impl Into<Arc<Value>>) -> Self {
        Self::new(value.into(), Origin::Parameter)
    }

    fn is_tracked(&self) -> bool {
        !matches!(self.0.origin, Origin::Constant)
    }

    fn view(&self) -> View<'_> {
        self.0.value.view()
    }

    /// Its numbers.
    pub fn tensor(&self) -> &Tensor {
        &self.0.value.tensor
    }

    /// Its sides.
    pub fn shape(&self) -> &[usize] {
        &self.tensor().shape
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
        let gradient = Value::from(gradient);
        let slopes = kernel.backward(inputs.each_ref().map(Var::view), kept, gradient.view(), wanted);
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
