//! Networks that predict on a GPU.

use std::collections::HashMap;
use std::rc::Rc;

use mvt_training::backend::{Model, TrainingImages};
use mvt_training::mvt_touch::network::{Architecture, Weights};

use crate::gpu::Gpu;
use crate::machine::GpuError;
use crate::memory::DeviceArray;
use crate::ops::GpuOps;
use crate::training::GpuWeights;

/// A network with its weights on a GPU.
#[derive(Debug)]
pub struct GpuNetwork {
    gpu: Rc<Gpu>,
    architecture: Architecture,
    input_size: Option<[usize; 2]>,
    weights: GpuWeights,
    /// How images `[images, rows, columns]` are computed.
    plans: HashMap<[usize; 3], Plan>,
}

/// Computation for images of one number and size. Its memory is its own: a recording uses the same places each time.
#[derive(Debug)]
struct Plan {
    gpu: Rc<Gpu>,
    levels: DeviceArray<u8>,
    result: DeviceArray<f32>,
    recording: Option<usize>,
}

impl GpuNetwork {
    /// Copies weights to a GPU.
    ///
    /// # Errors
    /// If there is no memory for them.
    pub fn new(gpu: Rc<Gpu>, weights: &Weights) -> Result<Self, GpuError> {
        let (architecture, input_size) = (weights.architecture().clone(), weights.input_size());
        let (weights, plans) = (GpuWeights::new(&gpu, weights.tensors())?, HashMap::new());
        Ok(Self { gpu, architecture, input_size, weights, plans })
    }

    /// Returns the most bytes of memory that were in use at once.
    pub fn most_memory(&self) -> usize {
        self.gpu.pool().most() + self.plans.values().map(|plan| plan.gpu.pool().most()).sum::<usize>()
    }

    /// Computes images on the GPU of a plan.
    fn forward(
        &self,
        gpu: &Rc<Gpu>,
        levels: &DeviceArray<u8>,
        [images, rows, columns]: [usize; 3],
    ) -> Result<DeviceArray<f32>, GpuError> {
        let size = self.architecture.fit(self.input_size.unwrap_or([rows, columns]));
        let ops = GpuOps::of_images(gpu.clone(), levels.clone(), [rows, columns]);
        let variables = self.weights.variables(gpu, None)?;
        let model = Model { architecture: &self.architecture, ops: &ops, variables: &variables };
        let output = model.forward(TrainingImages { levels: &[], shape: [images, size[0], size[1]] });
        gpu.take_error()?;
        let output = output.node().ok_or_else(|| GpuError::Unsuitable("a network has no output".to_owned()))?.values();
        let output = gpu.resized(output, [images, size[0], size[1], 2], [rows, columns])?;
        gpu.to_floats(&output)
    }

    /// Prepares the computation of images of one number and size.
    fn plan(&self, levels: &[u8], shape: [usize; 3]) -> Result<Plan, GpuError> {
        let gpu = self.gpu.beside();
        let uploaded: DeviceArray<u8> = gpu.array(levels.len())?;
        uploaded.upload(levels)?;
        // The first pass sets up tables and takes all its memory; the recording then finds both.
        let mut result = self.forward(&gpu, &uploaded, shape)?;
        let first = result.clone();
        let recording = gpu.pool().machine().record(&mut || {
            result = self.forward(&gpu, &uploaded, shape)?;
            Ok(())
        })?;
        drop(first);
        Ok(Plan { gpu, levels: uploaded, result, recording })
    }

    /// Queues the computation of RGB images `[images, rows, columns]`, which are resized to the size that the network sees. The result,
    /// valid until the next call, holds indentation in millimetres, which may be negative, and the logit of contact of each pixel.
    ///
    /// # Errors
    /// If the GPU fails.
    pub fn queue(&mut self, levels: &[u8], shape: [usize; 3]) -> Result<DeviceArray<f32>, GpuError> {
        if levels.is_empty() || levels.len() != 3 * shape.iter().product::<usize>() {
            return Err(GpuError::Unsuitable(format!("{} levels for images {shape:?}", levels.len())));
        }
        if !self.plans.contains_key(&shape) {
            let plan = self.plan(levels, shape)?;
            self.plans.insert(shape, plan);
        }
        let Some(plan) = self.plans.get_mut(&shape) else { unreachable!("it was just made") };
        plan.levels.upload(levels)?;
        let (gpu, levels) = (plan.gpu.clone(), plan.levels.clone());
        match plan.recording {
            // SAFETY: the plan keeps its memory.
            Some(recording) => unsafe { gpu.pool().machine().replay(recording)? },
            None => {
                let result = self.forward(&gpu, &levels, shape)?;
                self.plans.entry(shape).and_modify(|plan| plan.result = result);
            }
        }
        self.plans.get(&shape).map(|plan| plan.result.clone()).ok_or(GpuError::Memory(0))
    }

    /// Predicts indentation in millimetres, at least 0, and the logit of contact for each pixel of images; see [`queue`](Self::queue).
    ///
    /// # Errors
    /// If the GPU fails.
    pub fn predict(&mut self, levels: &[u8], shape: [usize; 3]) -> Result<Vec<[f32; 2]>, GpuError> {
        let output = self.queue(levels, shape)?.download()?;
        Ok(output.as_chunks::<2>().0.iter().map(|&[indentation, logit]| [indentation.max(0.0), logit]).collect())
    }
}
