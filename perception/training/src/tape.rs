//! Values that remember their origin, and the backward pass from the loss to the parameters.
//!
//! A tape belongs to one thread and holds a share of a batch; shares run side by side. Each op is a [`Kernel`], plain loops over
//! slices in both directions.

// Why: notes/decisions/touch.md, "A tape per share of a batch".

use std::cell::Cell;
use std::collections::{BTreeMap, HashMap};
use std::fmt;
use std::rc::Rc;
use std::sync::{Arc, OnceLock};

use crate::lanes::add_to;
use mvt_products::multiply::Packed;
use mvt_touch::network::WeightTensor;

/// Value on the tape.
#[derive(Debug, Clone)]
pub struct Var(Rc<Node>);

#[derive(Debug)]
struct Node {
    /// Greater than the numbers of all values that led to this one.
    number: u64,
    value: Arc<TapeValue>,
    origin: Origin,
}

/// Tensor with its packed forms: weights are packed once for all shares of a batch.
#[derive(Debug)]
pub struct TapeValue {
    tensor: WeightTensor,
    packed: [OnceLock<Packed>; 2],
}

impl From<WeightTensor> for TapeValue {
    fn from(tensor: WeightTensor) -> Self {
        Self { tensor, packed: Default::default() }
    }
}

/// Tensor that values on several tapes may share.
pub trait Shareable {
    /// Returns the tensor with room for its packed forms.
    fn shared(self) -> Arc<TapeValue>;
}

impl Shareable for WeightTensor {
    fn shared(self) -> Arc<TapeValue> {
        Arc::new(self.into())
    }
}

impl Shareable for Arc<TapeValue> {
    fn shared(self) -> Arc<TapeValue> {
        self
    }
}

impl TapeValue {
    fn view(&self) -> TensorView<'_> {
        let WeightTensor { shape, values } = &self.tensor;
        TensorView { shape, values, packed: &self.packed }
    }
}

/// Origin of a value.
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

/// Borrowed numbers with a shape, row-major.
#[derive(Debug, Clone, Copy)]
pub struct TensorView<'a> {
    /// Sides.
    pub shape: &'a [usize],
    /// As many numbers as the product of the sides.
    pub values: &'a [f32],
    packed: &'a [OnceLock<Packed>; 2],
}

impl<'a> TensorView<'a> {
    /// Returns the packed form for the forward pass; the first call packs.
    pub fn forwards(self, pack: impl FnOnce() -> Packed) -> &'a Packed {
        self.packed[0].get_or_init(pack)
    }

    /// Returns the packed form for the backward pass; the first call packs.
    pub fn backwards(self, pack: impl FnOnce() -> Packed) -> &'a Packed {
        self.packed[1].get_or_init(pack)
    }

    /// Returns a tensor of the same shape.
    pub fn like(self, values: Vec<f32>) -> WeightTensor {
        WeightTensor { shape: self.shape.to_vec(), values }
    }

    /// Returns the first N sides; a side that is missing counts as 1.
    pub fn sides<const N: usize>(self) -> [usize; N] {
        std::array::from_fn(|axis| self.shape.get(axis).copied().unwrap_or(1))
    }
}

/// Inputs of an op.
pub type Inputs<'a, const N: usize> = [TensorView<'a>; N];
/// Gradients of the loss by the inputs of an op.
pub type Slopes<const N: usize> = [Option<WeightTensor>; N];

/// An op with N inputs and one output. Inputs and output are row-major.
pub trait Kernel<const N: usize>: 'static {
    /// Intermediate results that the forward pass keeps for the backward pass, beside the inputs.
    type Kept: 'static;

    /// Computes the output.
    fn forward(&self, inputs: Inputs<'_, N>) -> (WeightTensor, Self::Kept);

    /// Computes the gradients of the loss by the wanted inputs from its gradient by the output.
    fn backward(&self, inputs: Inputs<'_, N>, kept: &Self::Kept, gradient: &[f32], wanted: [bool; N]) -> Slopes<N>;
}

/// Computation of a value.
trait Step {
    /// Passes the gradients of the loss by the inputs to `give`.
    fn back(&self, gradient: WeightTensor, give: &mut dyn FnMut(&Var, WeightTensor));
}

/// Gradients of the loss by all parameters.
pub struct ParameterSlopes(HashMap<u64, WeightTensor>);

impl Var {
    fn new(value: Arc<TapeValue>, origin: Origin) -> Self {
        thread_local!(static NEXT: Cell<u64> = const { Cell::new(0) });
        let number = NEXT.replace(NEXT.get() + 1);
        Self(Rc::new(Node { number, value, origin }))
    }

    /// Returns a computed value; it is a constant if no input needs a gradient.
    fn computed<const N: usize>(tensor: WeightTensor, inputs: &[Self; N], step: impl Step + 'static) -> Self {
        let is_tracked = inputs.iter().any(Self::is_tracked);
        Self::new(tensor.shared(), if is_tracked { Origin::Computed(Box::new(step)) } else { Origin::Constant })
    }

    /// Returns a value without a gradient.
    pub fn constant(value: impl Shareable) -> Self {
        Self::new(value.shared(), Origin::Constant)
    }

    /// Returns a value with a gradient.
    pub fn parameter(value: impl Shareable) -> Self {
        Self::new(value.shared(), Origin::Parameter)
    }

    fn is_tracked(&self) -> bool {
        !matches!(self.0.origin, Origin::Constant)
    }

    fn view(&self) -> TensorView<'_> {
        self.0.value.view()
    }

    /// Returns the numbers.
    pub fn tensor(&self) -> &WeightTensor {
        &self.0.value.tensor
    }

    /// Returns the sides.
    pub fn shape(&self) -> &[usize] {
        &self.tensor().shape
    }

    /// Returns the sum of two values of one shape.
    pub fn add(self, other: Self) -> Self {
        let values = self.tensor().values.iter().zip(&other.tensor().values).map(|(a, b)| a + b).collect();
        let tensor = WeightTensor { shape: self.shape().to_vec(), values };
        let inputs = [self, other];
        Self::computed(tensor, &inputs.clone(), Sum(inputs))
    }

    /// Returns the same numbers with other sides.
    pub fn reshape(self, shape: &[usize]) -> Self {
        let tensor = WeightTensor { shape: shape.to_vec(), values: self.tensor().values.clone() };
        let inputs = [self];
        Self::computed(tensor, &inputs.clone(), Reshaped(inputs))
    }

    /// Computes the gradients of this value, the loss, by all parameters.
    pub fn backward(self) -> ParameterSlopes {
        let ones = WeightTensor { shape: self.shape().to_vec(), values: vec![1.0; self.tensor().values.len()] };
        let mut slopes = HashMap::new();
        // The gradient of a value is complete when no value with a greater number waits.
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
        ParameterSlopes(slopes)
    }
}

impl ParameterSlopes {
    /// Removes and returns the gradient by a parameter; `None` if the loss does not depend on it.
    pub fn take(&mut self, parameter: &Var) -> Option<WeightTensor> {
        self.0.remove(&parameter.0.number)
    }
}

/// Sum of two values.
struct Sum([Var; 2]);

impl Step for Sum {
    fn back(&self, gradient: WeightTensor, give: &mut dyn FnMut(&Var, WeightTensor)) {
        let Self([first, second]) = self;
        if first.is_tracked() {
            give(first, gradient.clone());
        }
        if second.is_tracked() {
            give(second, gradient);
        }
    }
}

/// Value with other sides.
struct Reshaped([Var; 1]);

impl Step for Reshaped {
    fn back(&self, gradient: WeightTensor, give: &mut dyn FnMut(&Var, WeightTensor)) {
        let Self([input]) = self;
        give(input, WeightTensor { shape: input.shape().to_vec(), values: gradient.values });
    }
}

/// Result of a kernel.
struct Applied<K: Kernel<N>, const N: usize> {
    kernel: K,
    inputs: [Var; N],
    kept: K::Kept,
}

impl<K: Kernel<N>, const N: usize> Step for Applied<K, N> {
    fn back(&self, gradient: WeightTensor, give: &mut dyn FnMut(&Var, WeightTensor)) {
        let Self { kernel, inputs, kept } = self;
        let wanted = inputs.each_ref().map(Var::is_tracked);
        let slopes = kernel.backward(inputs.each_ref().map(Var::view), kept, &gradient.values, wanted);
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
