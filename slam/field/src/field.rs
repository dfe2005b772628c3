//! The neural signed-distance field: a multi-resolution grid of features and a small network, in a cube around the model's origin.
//!
//! [`NeuralField`] holds the parameters and answers queries as a [`Shape`]; a clone of it is a snapshot of some 2 MB that can be meshed
//! elsewhere. [`FieldTrainer`] holds a field and what its optimiser remembers. Everything runs on the calling thread with the
//! fastest [`FieldInstructions`] of the machine, and gives the same bits for the same input on the same instructions.

use std::path::Path;

use glam::Vec3;
use mvt_settings::SettingError;
use pulp::{Simd, WithSimd};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::shape::{Distance, Shape};
use crate::tensors::{Contents, FileError};

mod config;
mod file;
mod grid;
mod instructions;
mod network;
mod train;

pub use config::FieldConfig;
pub use grid::FEATURES;
pub use instructions::FieldInstructions;
pub use train::{FieldTrainer, Sample};

use grid::{CHUNK, Cells, Level, Row, Slopes};
use network::{Activations, Layout, Network};

/// Features start within plus and minus this.
const INITIAL_FEATURE: f32 = 1e-2;

/// A file of a field that cannot be read or written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum FieldError {
    /// The file cannot be read or written, or holds no valid field.
    #[error(transparent)]
    File(#[from] FileError),
}

// Why: notes/decisions/settings.md, "Dense field, not TSDF and not hashed".
/// The signed distance to a surface, learnt: negative inside, in units of the truncation, interpolated and passed through a network.
///
/// As a [`Shape`]: points outside of the cube have the value of the nearest point in it, and no gradient along the axes on which
/// they are outside. On the face between two cells the gradient is that of the upper cell; a coordinate that is NaN
/// counts as the lower end of its axis.
#[derive(Debug, Clone)]
pub struct NeuralField {
    config: FieldConfig,
    instructions: FieldInstructions,
    levels: Vec<Level>,
    layout: Layout,
    parameters: Parameters,
}

/// One number for each number that can be learnt.
#[derive(Debug, Clone, PartialEq)]
struct Parameters {
    table: Vec<[f32; FEATURES]>,
    network: Vec<f32>,
}

impl Parameters {
    fn zeros(entries: usize, layout: Layout) -> Self {
        Self { table: vec![[0.0; FEATURES]; entries], network: vec![0.0; layout.padded()] }
    }
}

impl NeuralField {
    /// An untrained field, near [`FieldConfig::initial_distance`] everywhere.
    ///
    /// # Errors
    /// [`SettingError`] if a setting is out of range.
    pub fn new(config: &FieldConfig, seed: u64) -> Result<Self, SettingError> {
        let mut field = Self::zeros(config)?;
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let mut uniform = |amplitude: f32| random.random_range(-amplitude..=amplitude);
        field.parameters.table.as_flattened_mut().fill_with(|| uniform(INITIAL_FEATURE));
        let (layout, network) = (field.layout, &mut field.parameters.network);
        // Variance 2 / inputs before a rectifier, 1 / inputs after it (He et al. 2015); a uniform variable has a third of its square.
        network[..layout.biases()].fill_with(|| uniform((6.0 / layout.inputs as f32).sqrt()));
        network[layout.output()..layout.output_bias()].fill_with(|| uniform((3.0 / layout.hidden as f32).sqrt()));
        network[layout.output_bias()] = config.initial_distance;
        Ok(field)
    }

    /// A field of zeros.
    fn zeros(config: &FieldConfig) -> Result<Self, SettingError> {
        config.validate()?;
        let (levels, entries) = grid::levels(config);
        let layout = Layout::new(config);
        let parameters = Parameters::zeros(entries, layout);
        Ok(Self { config: config.clone(), instructions: FieldInstructions::best(), levels, layout, parameters })
    }

    /// Its settings.
    pub fn config(&self) -> &FieldConfig {
        &self.config
    }

    /// Memory of its parameters, bytes. A [`FieldTrainer`] takes four times as much.
    pub fn size_bytes(&self) -> usize {
        size_of_val(self.parameters.table.as_slice()) + size_of_val(self.parameters.network.as_slice())
    }

    /// The same field, computed with other instructions; with [`FieldInstructions::Scalar`] if the machine has them not. For tests and
    /// comparisons: the fastest are chosen in any case.
    #[must_use]
    pub fn with_instructions(mut self, instructions: FieldInstructions) -> Self {
        self.instructions = instructions;
        self
    }

    /// Writes the field as safetensors, with the configuration as JSON in the metadata, so that the file appears whole or not at all.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn save(&self, path: &Path) -> Result<(), FieldError> {
        Ok(file::save(path, self, &[("", &self.parameters)], None)?)
    }

    /// Reads a field that [`NeuralField::save`] or [`FieldTrainer::save`] wrote.
    ///
    /// # Errors
    /// If the file cannot be read or has another layout; the error names the tensor that is missing, misshapen or not finite.
    pub fn load(path: &Path) -> Result<Self, FieldError> {
        file::field(&Contents::read(path)?)
    }
}

impl Shape for NeuralField {
    fn distances(&self, points: &[Vec3], out: &mut [f32]) {
        self.instructions.run(Query { field: self, points, out: Answers::Values(out) });
    }

    fn distances_and_gradients(&self, points: &[Vec3], out: &mut [Distance]) {
        self.instructions.run(Query { field: self, points, out: Answers::Gradients(out) });
    }
}

/// Working memory for points that are evaluated together.
#[derive(Debug, Clone)]
struct Chunk {
    points: [Row; 3],
    cells: Vec<Cells>,
    activations: Activations,
}

impl Chunk {
    fn new(field: &NeuralField) -> Self {
        Self {
            points: [[0.0; CHUNK]; 3],
            cells: vec![Cells::default(); field.levels.len()],
            activations: Activations::new(field.layout),
        }
    }

    /// Places point `i`. Points that are not placed stay from before, and are computed for nothing.
    #[inline(always)]
    fn place(&mut self, i: usize, point: Vec3) {
        self.points[0][i] = point.x;
        self.points[1][i] = point.y;
        self.points[2][i] = point.z;
    }

    /// The field at the points.
    #[inline(always)]
    fn forward<S: Simd>(&mut self, simd: S, field: &NeuralField, network: &Network<'_>) {
        for (k, (level, cells)) in field.levels.iter().zip(&mut self.cells).enumerate() {
            level.locate(&self.points, cells);
            grid::encode(
                &field.parameters.table,
                cells,
                &mut self.activations.inputs[k * FEATURES..(k + 1) * FEATURES],
            );
        }
        network.forward(simd, &mut self.activations);
    }

    /// As [`forward`](Self::forward), with the derivatives of the features of each level.
    #[inline(always)]
    fn forward_with_slopes<S: Simd>(
        &mut self,
        simd: S,
        field: &NeuralField,
        network: &Network<'_>,
        slopes: &mut [[Slopes; CHUNK]],
    ) {
        for (k, ((level, cells), slopes)) in field.levels.iter().zip(&mut self.cells).zip(slopes).enumerate() {
            level.locate(&self.points, cells);
            let features = &mut self.activations.inputs[k * FEATURES..(k + 1) * FEATURES];
            grid::encode_with_slopes(&field.parameters.table, cells, features, slopes);
        }
        network.forward(simd, &mut self.activations);
    }
}

/// Where the answers to a query go.
enum Answers<'a> {
    Values(&'a mut [f32]),
    Gradients(&'a mut [Distance]),
}

/// Evaluates the field at points.
struct Query<'a> {
    field: &'a NeuralField,
    points: &'a [Vec3],
    out: Answers<'a>,
}

impl WithSimd for Query<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { field, points, out } = self;
        let network = Network::new(field.layout, &field.parameters.network);
        let mut chunk = Chunk::new(field);
        let unit = field.config.truncation_m;
        match out {
            Answers::Values(out) => {
                for (points, out) in points.chunks(CHUNK).zip(out.chunks_mut(CHUNK)) {
                    for (i, &point) in points.iter().enumerate() {
                        chunk.place(i, point);
                    }
                    chunk.forward(simd, field, &network);
                    for (out, value) in out.iter_mut().zip(&chunk.activations.output) {
                        *out = value * unit;
                    }
                }
            }
            Answers::Gradients(out) => {
                let mut slopes = vec![[Slopes::default(); CHUNK]; field.levels.len()];
                for (points, out) in points.chunks(CHUNK).zip(out.chunks_mut(CHUNK)) {
                    for (i, &point) in points.iter().enumerate() {
                        chunk.place(i, point);
                    }
                    chunk.forward_with_slopes(simd, field, &network, &mut slopes);
                    network.backward(simd, &mut chunk.activations);
                    let gradients = spatial(field, &chunk, &slopes);
                    let half = Vec3::splat(field.config.half_extent_m);
                    for (i, (out, &point)) in out.iter_mut().zip(points).enumerate() {
                        let inside = point.abs().cmple(half);
                        out.value_m = chunk.activations.output[i] * unit;
                        out.gradient = Vec3::select(inside, gradients[i] * unit, Vec3::ZERO);
                    }
                }
            }
        }
    }
}

/// The chain rule from the features to the position: gradients of the output, per metre.
#[inline(always)]
fn spatial(field: &NeuralField, chunk: &Chunk, slopes: &[[Slopes; CHUNK]]) -> [Vec3; CHUNK] {
    let mut gradients = [Vec3::ZERO; CHUNK];
    for (k, (level, slopes)) in field.levels.iter().zip(slopes).enumerate() {
        let rows = &chunk.activations.input_gradient[k * FEATURES..(k + 1) * FEATURES];
        for first in (0..CHUNK).step_by(4) {
            let four = grid::points_of(rows, first) * level.density;
            for (j, by_feature) in [four.x_axis, four.y_axis, four.z_axis, four.w_axis].into_iter().enumerate() {
                let [x, y, z] = slopes[first + j];
                gradients[first + j] += Vec3::new(by_feature.dot(x), by_feature.dot(y), by_feature.dot(z));
            }
        }
    }
    gradients
}

#[cfg(test)]
mod tests;
