//! Teaching a field: squared errors of distances and of the gradient's length, and lazy Adam.

use std::path::Path;

use glam::Vec3;
use pulp::{Simd, WithSimd};

use super::grid::{CHUNK, FEATURES, LINE, Row, scatter};
use super::network::Network;
use super::{Chunk, FieldError, NeuralField, Parameters, file};
use crate::tensors::Contents;

/// How much of the running mean of gradients and of their squares a step keeps.
const KEEP: [f32; 2] = [0.9, 0.99];
/// Keeps the step finite where all gradients were zero.
const TINY: f32 = 1e-12;
/// One sample of so many near the surface also asks for a gradient of length one.
const EIKONAL_STRIDE: usize = 16;
/// Step of the differences that stand for the gradient there, in units of the truncation.
const EIKONAL_STEP: f32 = 0.375;
/// A gradient takes its own point and one along each axis.
const EIKONAL_POINTS: usize = CHUNK / 4;

/// The target of the field at a point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sample {
    /// In the model's frame, metres.
    pub position: Vec3,
    /// Distance in units of the truncation; -1 to 1, 1 in free space. Values beyond are clamped.
    pub target: f32,
    /// Weight of its squared error.
    pub weight: f32,
    /// The field may be larger: `target` is only a lower bound.
    pub at_least: bool,
}

/// A field and what its optimiser remembers.
///
/// The loss is the mean of `weight * (field - target)^2` over the samples, plus
/// [`eikonal_weight`](super::FieldConfig::eikonal_weight) times the mean of `(|gradient| - 1)^2` over a sixteenth of the samples near
/// the surface, with the gradient from differences over 3/8 of the truncation.
///
/// Adam (Kingma and Ba 2015) with 0.9 and 0.99 is lazy: a parameter whose gradient is zero is left alone, and only lines of
/// the table that a sample touched are visited, in the order of their addresses. The grid goes without the correction for
/// the first steps, as its entries first see a gradient at different times; the network has it.
#[derive(Debug, Clone)]
pub struct FieldTrainer {
    pub(super) field: NeuralField,
    /// Running means of the gradients and of their squares.
    moments: [Parameters; 2],
    steps: u64,
    gradient: Parameters,
    /// A bit per line of the table that has a gradient.
    touched: Vec<u64>,
    /// Gradient of the network, one vector of partial sums per parameter.
    sums: Vec<f32>,
    chunk: Chunk,
    near: Vec<Vec3>,
}

impl FieldTrainer {
    /// Goes on teaching `field` with an optimiser that remembers nothing.
    pub fn new(field: NeuralField) -> Self {
        let zeros = Parameters::zeros(field.parameters.table.len(), field.layout);
        Self {
            moments: [zeros.clone(), zeros.clone()],
            steps: 0,
            touched: vec![0; zeros.table.len().div_ceil(LINE * 64)],
            sums: vec![0.0; 16 * zeros.network.len()],
            gradient: zeros,
            chunk: Chunk::new(&field),
            near: Vec::new(),
            field,
        }
    }

    /// The field.
    pub fn field(&self) -> &NeuralField {
        &self.field
    }

    #[cfg(test)]
    pub(super) fn gradient(&self) -> &Parameters {
        &self.gradient
    }

    /// Steps taken, also before the optimiser was saved and loaded.
    pub fn steps(&self) -> u64 {
        self.steps
    }

    /// One step down the gradient of the loss over `samples`; returns the loss before the step. Nothing happens for an empty
    /// slice. A sample with a number that is not finite has no error.
    pub fn step(&mut self, samples: &[Sample]) -> f32 {
        if samples.is_empty() {
            return 0.0;
        }
        let instructions = self.field.instructions;
        let loss = instructions.run(Differentiate { trainer: self, samples });
        self.steps += 1;
        instructions.run(Update { trainer: self });
        loss
    }

    /// Writes the field and the state of the optimiser, so that training goes on from the file as if it had not been interrupted.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn save(&self, path: &Path) -> Result<(), FieldError> {
        let [mean, square] = &self.moments;
        let parameters = [("", &self.field.parameters), ("mean.", mean), ("square.", square)];
        Ok(file::save(path, &self.field, &parameters, Some(self.steps))?)
    }

    /// Reads what [`FieldTrainer::save`] wrote.
    ///
    /// # Errors
    /// If the file cannot be read or has another layout; the error names the tensor that is missing, misshapen or not finite.
    pub fn load(path: &Path) -> Result<Self, FieldError> {
        let contents = Contents::read(path)?;
        let field = file::field(&contents)?;
        let moments = [file::parameters(&contents, "mean.", &field)?, file::parameters(&contents, "square.", &field)?];
        Ok(Self { moments, steps: file::steps(&contents)?, ..Self::new(field) })
    }
}

/// Computes the loss and its gradient.
pub(super) struct Differentiate<'a> {
    pub(super) trainer: &'a mut FieldTrainer,
    pub(super) samples: &'a [Sample],
}

impl WithSimd for Differentiate<'_> {
    type Output = f32;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> f32 {
        let FieldTrainer { field, gradient, touched, sums, chunk, near, .. } = self.trainer;
        let network = Network::new(field.layout, &field.parameters.network);
        let mut loss = 0.0f64;
        near.clear();
        let mut candidates = 0;

        let share = 1.0 / self.samples.len() as f32;
        for samples in self.samples.chunks(CHUNK) {
            for (i, sample) in samples.iter().enumerate() {
                chunk.place(i, sample.position);
            }
            chunk.forward(simd, field, &network);
            let mut output_gradient = [0.0; CHUNK];
            for (i, sample) in samples.iter().enumerate() {
                let error = chunk.activations.output[i] - sample.target.clamp(-1.0, 1.0);
                let weighted = sample.weight * error;
                if !(weighted.is_finite() && sample.position.is_finite()) {
                    continue;
                }
                if !(sample.at_least && error > 0.0) {
                    loss += f64::from(share * weighted * error);
                    output_gradient[i] = 2.0 * share * weighted;
                }
                if sample.target.abs() < 1.0 - EIKONAL_STEP && !sample.at_least {
                    candidates += 1;
                    if candidates % EIKONAL_STRIDE == 0 {
                        near.push(sample.position);
                    }
                }
            }
            backward(simd, &network, chunk, &output_gradient, gradient, touched, sums);
        }

        if field.config.eikonal_weight > 0.0 {
            let share = field.config.eikonal_weight / near.len() as f32;
            let step = EIKONAL_STEP * field.config.truncation_m;
            for centres in near.chunks(EIKONAL_POINTS) {
                for (i, &centre) in centres.iter().enumerate() {
                    for (k, offset) in [Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::Z].into_iter().enumerate() {
                        chunk.place(k * EIKONAL_POINTS + i, centre + step * offset);
                    }
                }
                chunk.forward(simd, field, &network);
                let mut output_gradient = [0.0; CHUNK];
                for i in 0..centres.len() {
                    let at = |k: usize| chunk.activations.output[k * EIKONAL_POINTS + i];
                    let slope = (Vec3::new(at(1), at(2), at(3)) - at(0)) / EIKONAL_STEP;
                    let length = slope.length();
                    loss += f64::from(share * (length - 1.0) * (length - 1.0));
                    let by_value = 2.0 * share * (length - 1.0) / length.max(TINY) / EIKONAL_STEP * slope;
                    output_gradient[i] = -by_value.element_sum();
                    for k in 0..3 {
                        output_gradient[(k + 1) * EIKONAL_POINTS + i] = by_value[k];
                    }
                }
                backward(simd, &network, chunk, &output_gradient, gradient, touched, sums);
            }
        }

        for (parameter, &sum) in gradient.network.iter_mut().zip(S::as_simd_f32s(sums).0) {
            *parameter = simd.reduce_sum_f32s(sum);
        }
        sums.fill(0.0);
        loss as f32
    }
}

/// Adds the gradient of a chunk's loss, given that with respect to its outputs.
#[inline(always)]
fn backward<S: Simd>(
    simd: S,
    network: &Network<'_>,
    chunk: &mut Chunk,
    output_gradient: &Row,
    gradient: &mut Parameters,
    touched: &mut [u64],
    sums: &mut [f32],
) {
    network.learn(simd, &mut chunk.activations, output_gradient, sums);
    for (cells, rows) in chunk.cells.iter().zip(chunk.activations.input_gradient.as_chunks::<FEATURES>().0) {
        scatter(cells, rows, &mut gradient.table, touched);
    }
}

/// Takes a step of Adam and clears the gradient.
struct Update<'a> {
    trainer: &'a mut FieldTrainer,
}

impl WithSimd for Update<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let FieldTrainer { field, moments: [mean, square], steps, gradient, touched, .. } = self.trainer;
        let width = LINE * FEATURES;
        let rate = field.config.grid_rate;
        for (k, word) in touched.iter_mut().enumerate() {
            while *word != 0 {
                let line = 64 * k + word.trailing_zeros() as usize;
                *word &= *word - 1;
                let numbers = line * width..(line + 1) * width;
                adam(
                    simd,
                    rate,
                    &mut field.parameters.table.as_flattened_mut()[numbers.clone()],
                    &mut mean.table.as_flattened_mut()[numbers.clone()],
                    &mut square.table.as_flattened_mut()[numbers.clone()],
                    &mut gradient.table.as_flattened_mut()[numbers],
                );
            }
        }
        // The means start at zero; this makes up for it (Kingma and Ba, end of section 2).
        let count = i32::try_from(*steps).unwrap_or(i32::MAX);
        let correction = (1.0 - KEEP[1].powi(count)).sqrt() / (1.0 - KEEP[0].powi(count));
        let rate = field.config.mlp_rate * correction;
        adam(simd, rate, &mut field.parameters.network, &mut mean.network, &mut square.network, &mut gradient.network);
    }
}

/// Updates the parameters with a gradient, which is cleared. Lengths are multiples of 16.
#[inline(always)]
fn adam<S: Simd>(
    simd: S,
    rate: f32,
    parameters: &mut [f32],
    mean: &mut [f32],
    square: &mut [f32],
    gradient: &mut [f32],
) {
    let [zero, rate, tiny] = [0.0, rate, TINY].map(|number| simd.splat_f32s(number));
    let [mean_share, square_share] = KEEP.map(|keep| simd.splat_f32s(1.0 - keep));
    let parameters = S::as_mut_simd_f32s(parameters).0;
    let means = S::as_mut_simd_f32s(mean).0;
    let squares = S::as_mut_simd_f32s(square).0;
    let gradients = S::as_mut_simd_f32s(gradient).0;
    for (((parameter, mean), square), gradient) in parameters.iter_mut().zip(means).zip(squares).zip(gradients) {
        let g = *gradient;
        let m = simd.mul_add_e_f32s(mean_share, simd.sub_f32s(g, *mean), *mean);
        let s = simd.mul_add_e_f32s(square_share, simd.sub_f32s(simd.mul_f32s(g, g), *square), *square);
        let step = simd.div_f32s(simd.mul_f32s(rate, m), simd.add_f32s(simd.sqrt_f32s(s), tiny));
        let idle = simd.equal_f32s(g, zero);
        *parameter = simd.select_f32s(idle, *parameter, simd.sub_f32s(*parameter, step));
        *mean = simd.select_f32s(idle, *mean, m);
        *square = simd.select_f32s(idle, *square, s);
        *gradient = zero;
    }
}
