//! Values that remember their origin, and the backward pass from the loss to the parameters.

use std::cell::Cell;
use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::rc::Rc;

use crate::gpu::Gpu;
use crate::machine::GpuError;
use crate::memory::{DeviceArray, Real};

/// Value of a network. After an error it is only a shape; see [`Gpu::take_error`].
#[derive(Debug, Clone)]
pub struct Var {
    shape: Vec<usize>,
    node: Option<Rc<Node>>,
}

/// Computes gradients by the inputs from that by the result.
pub type Back = Box<dyn FnOnce(DeviceArray<Real>, &mut Slopes) -> Result<(), GpuError>>;

/// Numbers of a value, with its backward pass.
pub type Computed = Result<(DeviceArray<Real>, Back), GpuError>;

/// Boxes a backward pass.
pub fn back(back: impl FnOnce(DeviceArray<Real>, &mut Slopes) -> Result<(), GpuError> + 'static) -> Back {
    Box::new(back)
}

/// Numbers of a value and their origin.
pub struct Node {
    /// Greater than the numbers of all values that led to this one.
    number: u64,
    values: DeviceArray<Real>,
    origin: Origin,
}

impl std::fmt::Debug for Node {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Node").field("number", &self.number).field("values", &self.values).finish_non_exhaustive()
    }
}

enum Origin {
    Constant,
    Parameter(Parameter),
    Computed(Cell<Option<Back>>),
}

/// Weights in 32-bit floats.
#[derive(Debug, Clone)]
pub struct Parameter {
    /// The weights.
    pub values: DeviceArray<f32>,
    /// Sum of the gradients by them, where they are trained.
    pub gradient: Option<DeviceArray<f32>>,
}

impl Node {
    /// Returns the numbers.
    pub fn values(&self) -> &DeviceArray<Real> {
        &self.values
    }

    /// Returns the weights.
    ///
    /// # Errors
    /// If the value is not a parameter: a mistake in a network.
    pub fn parameter(&self) -> Result<&Parameter, GpuError> {
        match &self.origin {
            Origin::Parameter(parameter) => Ok(parameter),
            _ => Err(GpuError::Unsuitable("a weight of a network is not a parameter".to_owned())),
        }
    }

    /// Returns whether a gradient by this value is wanted.
    pub fn is_tracked(&self) -> bool {
        match &self.origin {
            Origin::Constant => false,
            Origin::Parameter(parameter) => parameter.gradient.is_some(),
            Origin::Computed(_) => true,
        }
    }
}

/// Gradients that wait for the values they belong to.
pub struct Slopes {
    gpu: Rc<Gpu>,
    waiting: BTreeMap<u64, (Rc<Node>, DeviceArray<Real>)>,
}

impl Slopes {
    /// Adds a gradient by an input.
    ///
    /// # Errors
    /// If the GPU fails.
    pub fn give(&mut self, input: &Rc<Node>, slope: DeviceArray<Real>) -> Result<(), GpuError> {
        if !input.is_tracked() {
            return Ok(());
        }
        match self.waiting.entry(input.number) {
            Entry::Vacant(place) => {
                place.insert((input.clone(), slope));
            }
            Entry::Occupied(mut place) => {
                let (_, sum) = place.get_mut();
                // The same memory may be the gradient of two values.
                *sum = self.gpu.add(sum, &slope, sum.is_unshared().then(|| sum.clone()))?;
            }
        }
        Ok(())
    }
}

impl Var {
    fn new(gpu: &Gpu, shape: &[usize], values: DeviceArray<Real>, origin: Origin) -> Self {
        let node = Rc::new(Node { number: gpu.next_number(), values, origin });
        Self { shape: shape.to_vec(), node: Some(node) }
    }

    /// Returns weights; `values` are those of `parameter` as activations are stored.
    pub fn parameter(gpu: &Gpu, shape: &[usize], values: DeviceArray<Real>, parameter: Parameter) -> Self {
        Self::new(gpu, shape, values, Origin::Parameter(parameter))
    }

    /// Returns the sides.
    pub fn shape(&self) -> &[usize] {
        &self.shape
    }

    /// Returns the first N sides; a side that is missing counts as 1.
    pub fn sides<const N: usize>(&self) -> [usize; N] {
        std::array::from_fn(|axis| self.shape.get(axis).copied().unwrap_or(1))
    }

    /// Returns the numbers, or `None` after an error.
    pub fn node(&self) -> Option<&Rc<Node>> {
        self.node.as_ref()
    }

    /// Computes a value of a shape from others. `compute` also gets to know whether a gradient will be wanted; without that, its
    /// backward pass is dropped at once.
    pub fn compute<const N: usize>(
        gpu: &Rc<Gpu>,
        shape: &[usize],
        inputs: [&Self; N],
        compute: impl FnOnce(&Rc<Gpu>, [Rc<Node>; N], bool) -> Computed,
    ) -> Self {
        let mut nodes = Vec::with_capacity(N);
        nodes.extend(inputs.iter().filter_map(|input| input.node.clone()));
        let Ok(nodes) = <[Rc<Node>; N]>::try_from(nodes) else {
            return Self { shape: shape.to_vec(), node: None };
        };
        let is_tracked = nodes.iter().any(|node| node.is_tracked());
        match compute(gpu, nodes, is_tracked) {
            Ok((values, back)) => {
                let origin = if is_tracked { Origin::Computed(Cell::new(Some(back))) } else { Origin::Constant };
                Self::new(gpu, shape, values, origin)
            }
            Err(error) => {
                gpu.fail(error);
                Self { shape: shape.to_vec(), node: None }
            }
        }
    }

    /// Passes the gradient by this value back to all parameters.
    ///
    /// # Errors
    /// If the GPU fails, or failed before.
    pub fn backward(self, gpu: &Rc<Gpu>, gradient: DeviceArray<Real>) -> Result<(), GpuError> {
        gpu.take_error()?;
        let mut slopes = Slopes { gpu: gpu.clone(), waiting: BTreeMap::new() };
        if let Some(node) = self.node {
            slopes.give(&node, gradient)?;
        }
        // The gradient of a value is complete when no value with a greater number waits. Its memory and that of what only the value
        // needed is free after its turn.
        while let Some((_, (node, gradient))) = slopes.waiting.pop_last() {
            match &node.origin {
                Origin::Constant => {}
                Origin::Parameter(Parameter { gradient: sum, .. }) => {
                    if let Some(sum) = sum {
                        gpu.accumulate(sum, &gradient)?;
                    }
                }
                Origin::Computed(back) => {
                    if let Some(back) = back.take() {
                        back(gradient, &mut slopes)?;
                    }
                }
            }
        }
        Ok(())
    }
}
