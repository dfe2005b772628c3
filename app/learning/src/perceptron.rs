//! Small networks of linear layers with ELU between them, their gradients, and Adam.

use ndarray::{Array1, Array2, ArrayView2, Axis, Zip};
use rand::{Rng, RngExt as _};

/// Linear layer: outputs x inputs, and an addend for each output.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Dense {
    pub(crate) weight: Array2<f32>,
    pub(crate) bias: Array1<f32>,
}

/// A network, or its gradient.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Perceptron {
    pub(crate) layers: Vec<Dense>,
    /// Logarithms of the standard deviations of the actions; empty for other networks.
    pub(crate) spread: Array1<f32>,
}

impl Perceptron {
    /// Draws a network whose sizes are `widths`, the inputs first. The weights of the last layer are scaled by `gain`.
    pub(crate) fn draw(widths: &[usize], gain: f32, spread: Array1<f32>, random: &mut impl Rng) -> Self {
        let last = widths.len().saturating_sub(2);
        let mut layers = Vec::new();
        for (k, (&inputs, &outputs)) in widths.iter().zip(widths.iter().skip(1)).enumerate() {
            // The variance of He et al. (2015), halved for ELU, whose negative half does not vanish.
            let bound = (3.0 / inputs.max(1) as f32).sqrt() * if k == last { gain } else { 1.0 };
            let weight = Array2::from_shape_simple_fn((outputs, inputs), || bound * random.random_range(-1.0..1.0_f32));
            layers.push(Dense { weight, bias: Array1::zeros(outputs) });
        }
        Self { layers, spread }
    }

    /// Returns zeros of the same sizes.
    pub(crate) fn zeros(&self) -> Self {
        let zeros = |layer: &Dense| Dense { weight: 0.0 * &layer.weight, bias: 0.0 * &layer.bias };
        Self { layers: self.layers.iter().map(zeros).collect(), spread: 0.0 * &self.spread }
    }

    pub(crate) fn values(&self) -> impl Iterator<Item = &f32> {
        self.layers.iter().flat_map(|layer| layer.weight.iter().chain(&layer.bias)).chain(&self.spread)
    }

    pub(crate) fn values_mut(&mut self) -> impl Iterator<Item = &mut f32> {
        self.layers.iter_mut().flat_map(|layer| layer.weight.iter_mut().chain(&mut layer.bias)).chain(&mut self.spread)
    }

    /// Adds another gradient.
    pub(crate) fn add(mut self, other: &Self) -> Self {
        self.values_mut().zip(other.values()).for_each(|(sum, value)| *sum += value);
        self
    }

    /// Returns the outputs of all layers for inputs row by row; those of the network last.
    pub(crate) fn run(&self, inputs: &ArrayView2<'_, f32>) -> Vec<Array2<f32>> {
        let mut outputs: Vec<Array2<f32>> = Vec::with_capacity(self.layers.len());
        for (k, layer) in self.layers.iter().enumerate() {
            let input = outputs.last().map_or(inputs.view(), |before| before.view());
            let mut output = input.dot(&layer.weight.t()) + &layer.bias;
            if k + 1 < self.layers.len() {
                output.mapv_inplace(|x| if x > 0.0 { x } else { x.exp_m1() });
            }
            outputs.push(output);
        }
        outputs
    }

    /// Returns the gradient for that of the outputs; that of the spread is 0.
    pub(crate) fn gradient(
        &self,
        inputs: &ArrayView2<'_, f32>,
        outputs: &[Array2<f32>],
        of_outputs: Array2<f32>,
    ) -> Self {
        let mut gradient = Self { layers: Vec::with_capacity(self.layers.len()), spread: 0.0 * &self.spread };
        let mut of_output = of_outputs;
        for (k, layer) in self.layers.iter().enumerate().rev() {
            let before = k.checked_sub(1).and_then(|before| outputs.get(before));
            let input = before.map_or(inputs.view(), |before| before.view());
            gradient.layers.push(Dense { weight: of_output.t().dot(&input), bias: of_output.sum_axis(Axis(0)) });
            let Some(before) = before else { break };
            of_output = of_output.dot(&layer.weight);
            // The slope of ELU: 1 above zero, else the output plus 1.
            Zip::from(&mut of_output).and(before).for_each(|slope, &y| *slope *= if y > 0.0 { 1.0 } else { y + 1.0 });
        }
        gradient.layers.reverse();
        gradient
    }
}

/// Adam of Kingma and Ba (2015) with clipped gradients.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Adam {
    pub(crate) mean: Perceptron,
    pub(crate) square: Perceptron,
    pub(crate) steps: u64,
}

impl Adam {
    /// Greatest length of a gradient; longer ones are shortened.
    const LONGEST: f32 = 1.0;
    const BETAS: [f32; 2] = [0.9, 0.999];

    pub(crate) fn new(network: &Perceptron) -> Self {
        Self { mean: network.zeros(), square: network.zeros(), steps: 0 }
    }

    /// Makes a step against a gradient. A gradient that is not finite changes nothing.
    pub(crate) fn advance(&mut self, network: &mut Perceptron, gradient: &Perceptron, rate: f32) {
        const EPSILON: f32 = 1e-5;
        let length = gradient.values().map(|g| f64::from(*g).powi(2)).sum::<f64>().sqrt() as f32;
        if !length.is_finite() {
            return;
        }
        self.steps += 1;
        let scale = if length > Self::LONGEST { Self::LONGEST / length } else { 1.0 };
        let [keep, keep_square] = Self::BETAS;
        let unbiased = Self::BETAS.map(|beta| 1.0 - beta.powf(self.steps as f32));
        let moments = self.mean.values_mut().zip(self.square.values_mut());
        for ((weight, g), (mean, square)) in network.values_mut().zip(gradient.values()).zip(moments) {
            let g = scale * g;
            *mean = keep * *mean + (1.0 - keep) * g;
            *square = keep_square * *square + (1.0 - keep_square) * g * g;
            *weight -= rate * (*mean / unbiased[0]) / ((*square / unbiased[1]).sqrt() + EPSILON);
        }
    }
}
