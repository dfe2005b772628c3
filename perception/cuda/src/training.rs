//! Training whose weights, gradients and moments stay on the GPU.

use std::collections::BTreeMap;
use std::rc::Rc;

use mvt_training::backend::{Model, OptimiserState, Tensors, Update};
use mvt_training::mvt_touch::network::{Architecture, WeightTensor};
use mvt_training::{LossConfig, Penalty, TrainingBatch};

use crate::gpu::{Gpu, each, launch};
use crate::machine::{Argument, GpuError, Launch};
use crate::memory::{DeviceArray, Real};
use crate::ops::GpuOps;
use crate::tape::{Parameter, Var};

/// Tensors start at multiples of this many numbers, so that products may read several at once.
const ALIGNMENT: usize = 64;
/// Threads of a block of the kernels that sum over a block, which their text assumes.
const SUM_THREADS: u32 = 256;
/// Most blocks of those kernels.
const SUM_BLOCKS: usize = 1024;
/// Most steps whose results wait on the GPU.
const MOST_UNREAD: usize = 1024;

/// Place of a tensor among all numbers of a network.
#[derive(Debug, Clone)]
struct Place {
    first: usize,
    shape: Vec<usize>,
}

/// Places of the tensors of a network, one behind the other.
#[derive(Debug)]
pub struct Layout {
    places: BTreeMap<String, Place>,
    len: usize,
}

impl Layout {
    /// Returns the layout of tensors.
    pub fn new(tensors: &Tensors) -> Self {
        let mut len = 0;
        let place = |(name, tensor): (&String, &WeightTensor)| {
            let first = len;
            len += tensor.values.len().next_multiple_of(ALIGNMENT);
            (name.clone(), Place { first, shape: tensor.shape.clone() })
        };
        let places = tensors.iter().map(place).collect();
        Self { places, len }
    }

    /// Returns the numbers of tensors. Kernels of convolutions, `[out, in, 3, 3]`, become `[out, 3, 3, in]`.
    fn packed(&self, tensors: &Tensors) -> Vec<f32> {
        let mut numbers = vec![0.0; self.len];
        for (place, tensor) in self.places.values().zip(tensors.values()) {
            let to = &mut numbers[place.first..][..tensor.values.len()];
            match tensor.shape[..] {
                [_, inputs, 3, 3] => {
                    for (k, value) in tensor.values.iter().enumerate() {
                        let (output, input, tap) = (k / 9 / inputs, k / 9 % inputs, k % 9);
                        to[(output * 9 + tap) * inputs + input] = *value;
                    }
                }
                _ => to.copy_from_slice(&tensor.values),
            }
        }
        numbers
    }

    /// The reverse of `packed`.
    fn unpacked(&self, numbers: &[f32]) -> Tensors {
        let tensor = |place: &Place| {
            let len = place.shape.iter().product();
            let from = &numbers[place.first..][..len];
            let values = match place.shape[..] {
                [_, inputs, 3, 3] => {
                    (0..len).map(|k| from[(k / 9 / inputs * 9 + k % 9) * inputs + k / 9 % inputs]).collect()
                }
                _ => from.to_vec(),
            };
            WeightTensor { shape: place.shape.clone(), values }
        };
        self.places.iter().map(|(name, place)| (name.clone(), tensor(place))).collect()
    }

    /// Returns 1 for each number of a matrix or kernel, which the optimiser lets decay.
    fn decayed(&self) -> Vec<u8> {
        let mut decayed = vec![0; self.len];
        for (name, Place { first, shape }) in &self.places {
            let is_decayed = OptimiserState::is_decayed(name, shape);
            decayed[*first..][..shape.iter().product()].fill(u8::from(is_decayed));
        }
        decayed
    }
}

/// Weights of a network on a GPU.
#[derive(Debug)]
pub struct GpuWeights {
    layout: Layout,
    /// The weights.
    pub values: DeviceArray<f32>,
    /// The weights as activations are stored; the same memory where these are 32-bit floats.
    copy: DeviceArray<Real>,
}

impl GpuWeights {
    /// Copies weights to a GPU.
    ///
    /// # Errors
    /// If there is no memory for them.
    pub fn new(gpu: &Gpu, tensors: &Tensors) -> Result<Self, GpuError> {
        let layout = Layout::new(tensors);
        let values: DeviceArray<f32> = gpu.array(layout.len)?;
        values.upload(&layout.packed(tensors))?;
        let copy = values.as_real().map_or_else(|| gpu.to_real(&values), Ok)?;
        Ok(Self { layout, values, copy })
    }

    /// Returns the weights as values of a network; with `gradient`, they are trained.
    ///
    /// # Errors
    /// If the layout does not fit the arrays: a mistake.
    pub fn variables(&self, gpu: &Gpu, gradient: Option<&DeviceArray<f32>>) -> Result<BTreeMap<&str, Var>, GpuError> {
        let short = || GpuError::Unsuitable("a tensor lies beyond its array".to_owned());
        let variable = |Place { first, shape }: &Place| {
            let len = shape.iter().product();
            let parameter = Parameter {
                values: self.values.part(*first, len).ok_or_else(short)?,
                gradient: gradient.map(|gradient| gradient.part(*first, len).ok_or_else(short)).transpose()?,
            };
            let values = self.copy.part(*first, len).ok_or_else(short)?;
            Ok(Var::parameter(gpu, shape, values, parameter))
        };
        self.layout.places.iter().map(|(name, place)| Ok((name.as_str(), variable(place)?))).collect()
    }
}

/// A training on a GPU.
#[derive(Debug)]
pub struct GpuTraining {
    gpu: Rc<Gpu>,
    architecture: Architecture,
    loss: LossConfig,
    weights: GpuWeights,
    average: DeviceArray<f32>,
    mean: DeviceArray<f32>,
    square: DeviceArray<f32>,
    gradient: DeviceArray<f32>,
    decayed: DeviceArray<u8>,
    /// Loss and length of the gradient of each step since the results were last read.
    results: DeviceArray<f32>,
    unread: usize,
    /// Results that were read because there was no more room for them.
    read: Vec<[f32; 2]>,
    /// Most images of a pass: fewer than those of a batch once the memory did not suffice.
    pass: usize,
}

impl GpuTraining {
    /// Copies the state of a training to a GPU.
    ///
    /// # Errors
    /// If there is no memory for it.
    pub fn new(
        gpu: Rc<Gpu>,
        architecture: &Architecture,
        loss: LossConfig,
        state: &OptimiserState,
    ) -> Result<Self, GpuError> {
        let weights = GpuWeights::new(&gpu, &state.weights)?;
        let len = weights.layout.len;
        let uploaded = |tensors: &Tensors| {
            let array: DeviceArray<f32> = gpu.array(len)?;
            array.upload(&weights.layout.packed(tensors))?;
            Ok::<_, GpuError>(array)
        };
        let (average, mean, square) = (uploaded(&state.average)?, uploaded(&state.mean)?, uploaded(&state.square)?);
        let decayed: DeviceArray<u8> = gpu.array(len)?;
        decayed.upload(&weights.layout.decayed())?;
        let (gradient, results) = (gpu.zeros(len)?, gpu.zeros(2 * MOST_UNREAD)?);
        let (architecture, pass) = (architecture.clone(), usize::MAX);
        Ok(Self {
            gpu,
            architecture,
            loss,
            weights,
            average,
            mean,
            square,
            gradient,
            decayed,
            results,
            unread: 0,
            read: vec![],
            pass,
        })
    }

    /// Computes loss and gradients of a batch; the loss in parts.
    fn gradients(&self, batch: &TrainingBatch) -> Result<Vec<DeviceArray<f32>>, GpuError> {
        let [_, rows, columns] = batch.shape;
        self.gradient.clear()?;
        let ops = GpuOps::new(self.gpu.clone());
        let pixels = self.pass.min(batch.shape[0]) * rows * columns;
        let mut losses = Vec::new();
        for (first, images) in batch.shares(pixels) {
            let variables = self.weights.variables(&self.gpu, Some(&self.gradient))?;
            let model = Model { architecture: &self.architecture, ops: &ops, variables: &variables };
            let output = model.forward(images);
            drop(variables);
            self.gpu.take_error()?;
            let (parts, slopes) = self.loss(&output, batch, first)?;
            losses.push(parts);
            output.backward(&self.gpu, slopes)?;
        }
        Ok(losses)
    }

    /// Computes the loss of the pixels from `first` on, in parts, and its slopes by the output.
    fn loss(
        &self,
        output: &Var,
        batch: &TrainingBatch,
        first: usize,
    ) -> Result<(DeviceArray<f32>, DeviceArray<Real>), GpuError> {
        let gpu = &self.gpu;
        let output = output.node().ok_or_else(|| GpuError::Unsuitable("a network has no output".to_owned()))?.values();
        let count = output.len() / 2;
        let uploaded = |targets: &[f32]| {
            let array: DeviceArray<f32> = gpu.array(count)?;
            array.upload(&targets[first..first + count])?;
            Ok::<_, GpuError>(array)
        };
        let (indentation_mm, contact) = (uploaded(&batch.targets.indentation_mm)?, uploaded(&batch.targets.contact)?);
        let LossConfig { penalty, huber_mm, contact_weight, segmentation } = self.loss;
        let penalty = match penalty {
            Penalty::Mse => 0,
            Penalty::L1 => 1,
            Penalty::Huber => 2,
        };
        let grid = summing(count);
        let parts: DeviceArray<f32> = gpu.array(grid.blocks[0] as usize)?;
        let slopes: DeviceArray<Real> = gpu.array(2 * count)?;
        let pixels = batch.targets.contact.len() as f32;
        launch!(
            gpu,
            "touch_loss",
            grid,
            &parts,
            &slopes,
            output,
            &indentation_mm,
            &contact,
            count,
            pixels,
            Argument::Integer(penalty),
            huber_mm,
            contact_weight,
            segmentation
        )?;
        Ok((parts, slopes))
    }

    /// Does a step with the gradients.
    fn update(&self, losses: &[DeviceArray<f32>], update: &Update) -> Result<(), GpuError> {
        let (gpu, len) = (&self.gpu, self.gradient.len());
        let result = self.results.part(2 * self.unread, 2).ok_or(GpuError::Memory(2))?;
        let all: DeviceArray<f32> = gpu.zeros(losses.iter().map(DeviceArray::len).sum())?;
        let mut first = 0;
        for parts in losses {
            // A copy: parts are added to zeros.
            let to = all.part(first, parts.len()).ok_or(GpuError::Memory(parts.len()))?;
            gpu.add_parts(&to, parts, 1)?;
            first += parts.len();
        }
        let grid = summing(len);
        let squares: DeviceArray<f32> = gpu.array(grid.blocks[0] as usize)?;
        launch!(gpu, "square_parts", grid, &squares, &self.gradient, len)?;
        let one = Launch { blocks: [1, 1, 1], threads: 1 };
        launch!(gpu, "progress", one, &result, &all, all.len(), &squares, squares.len())?;
        let Update { rate, decay, clip, betas: [beta1, beta2], unbiased: [first, second], keep } = *update;
        let GpuWeights { values, copy, .. } = &self.weights;
        let (average, mean, square) = (&self.average, &self.mean, &self.square);
        launch!(
            gpu,
            "adamw",
            each(len),
            values,
            average,
            mean,
            square,
            copy,
            &self.gradient,
            &self.decayed,
            &result,
            len,
            rate,
            decay,
            clip,
            beta1,
            beta2,
            first,
            second,
            keep
        )?;
        gpu.pool().machine().pace()
    }

    /// Waits for the steps and takes their results.
    fn take_results(&mut self) -> Result<(), GpuError> {
        if self.unread > 0 {
            let results = self.results.download()?;
            self.read.extend(&results.as_chunks::<2>().0[..self.unread]);
            self.unread = 0;
        }
        Ok(())
    }

    /// Queues a step. If its loss or gradient are not finite, it changes nothing.
    ///
    /// # Errors
    /// If the GPU fails.
    pub fn advance(&mut self, batch: &TrainingBatch, update: &Update) -> Result<(), GpuError> {
        if self.unread == MOST_UNREAD {
            self.take_results()?;
        }
        let losses = self.in_passes(batch)?;
        self.update(&losses, update)?;
        self.unread += 1;
        Ok(())
    }

    /// Waits for the queued steps. Returns the loss before each step since the last call, and the length of its gradient.
    ///
    /// # Errors
    /// If the GPU fails.
    pub fn results(&mut self) -> Result<Vec<[f32; 2]>, GpuError> {
        self.take_results()?;
        Ok(std::mem::take(&mut self.read))
    }

    /// Returns the weights, their average, and the means of the gradients and of their squares.
    ///
    /// # Errors
    /// If the GPU fails.
    pub fn read(&self) -> Result<[Tensors; 4], GpuError> {
        let read = |array: &DeviceArray<f32>| Ok(self.weights.layout.unpacked(&array.download()?));
        Ok([read(&self.weights.values)?, read(&self.average)?, read(&self.mean)?, read(&self.square)?])
    }

    /// Returns loss and gradients of a batch.
    ///
    /// # Errors
    /// If the GPU fails.
    pub fn loss_and_gradients(&mut self, batch: &TrainingBatch) -> Result<(f32, Tensors), GpuError> {
        let losses = self.in_passes(batch)?;
        let mut loss = 0.0;
        for parts in losses {
            loss += parts.download()?.iter().sum::<f32>();
        }
        Ok((loss, self.weights.layout.unpacked(&self.gradient.download()?)))
    }

    /// Computes gradients in passes that the memory suffices for.
    fn in_passes(&mut self, batch: &TrainingBatch) -> Result<Vec<DeviceArray<f32>>, GpuError> {
        let images = batch.shape[0];
        loop {
            match self.gradients(batch) {
                Err(GpuError::Memory(bytes)) if self.pass.min(images) > 1 => {
                    self.pass = self.pass.min(images).div_ceil(2);
                    self.gpu.pool().release();
                    tracing::warn!(
                        "the GPU has no {bytes} bytes left for a pass over more images; a batch of {images} takes passes of {} from now on",
                        self.pass
                    );
                }
                result => return result,
            }
        }
    }
}

/// Returns the grid of a kernel that sums numbers over blocks.
fn summing(count: usize) -> Launch {
    let blocks = count.div_ceil(SUM_THREADS as usize).clamp(1, SUM_BLOCKS);
    Launch { blocks: [blocks as u32, 1, 1], threads: SUM_THREADS }
}
