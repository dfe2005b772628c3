//! Inference on the CPU: the forward pass of a network for one image on one thread, with kernels for the machine's instructions. If the
//! program chose a GPU ([`Device::use_for_inference`]), that computes the network instead.
//!
//! [`Engine::new`] packs the weights for the kernels once. [`Engine::infer`] borrows the memory of a pass from a store and returns it, so
//! that no pass allocates memory after the first images of a size.

mod attention;
mod dpt;
mod hierarchy;
mod image;
mod layers;
mod mamba;
mod map;
mod pass;
mod pyramid;
mod reassemble;
mod transformer;

use std::sync::atomic::{AtomicBool, Ordering};

use ::image::RgbImage;
use mvt_robot::digit::profile::{Appearance, SensorProfile};
use ndarray::Array2;
use rayon::iter::{
    IndexedParallelIterator as _, IntoParallelRefIterator as _, IntoParallelRefMutIterator as _, ParallelIterator as _,
};

use crate::device::{Accelerator, Device};
pub use crate::network::ImageSizeError;
use crate::network::{Architecture, Weights};
use hierarchy::Hierarchy;
pub use mvt_products::Instructions;
pub use pass::Prediction;
use pass::Runner;
use pyramid::Pyramid;
use transformer::Transformer;

/// Network with packed weights. It serves any number of threads.
#[derive(Debug)]
pub struct Engine {
    architecture: Architecture,
    input_size: Option<[usize; 2]>,
    /// Look of the sensors that it was trained for.
    trained_for: Appearance,
    instructions: Instructions,
    network: Network,
    /// The network on a GPU, which computes it instead.
    accelerator: Option<Box<dyn Accelerator>>,
    /// Whether the GPU failed.
    has_failed: AtomicBool,
}

/// Most images of a pass on a GPU.
const BATCH: usize = 32;

#[derive(Debug)]
enum Network {
    Pyramid(Box<Runner<Pyramid>>),
    Transformer(Box<Runner<Transformer>>),
    Hierarchy(Box<Runner<Hierarchy>>),
}

impl Engine {
    /// Packs weights for an instruction set, such as [`Instructions::best`]. If the machine does not have it, the next one that the
    /// machine has replaces it.
    pub fn new(weights: &Weights, instructions: Instructions) -> Self {
        let wanted = Instructions::ALL.into_iter().skip_while(|&set| set != instructions);
        let instructions = wanted.into_iter().find(|set| set.is_available()).unwrap_or(Instructions::Scalar);
        let architecture = weights.architecture().clone();
        let network = match &architecture {
            Architecture::Default(pyramid) => {
                Network::Pyramid(Box::new(Runner::new(Pyramid::new(instructions, pyramid, weights))))
            }
            Architecture::Swin(swin) => {
                Network::Hierarchy(Box::new(Runner::new(Hierarchy::swin(instructions, swin, weights))))
            }
            Architecture::ConvNext(convnext) => {
                Network::Hierarchy(Box::new(Runner::new(Hierarchy::convnext(instructions, convnext, weights))))
            }
            other => Network::Transformer(Box::new(Runner::new(Transformer::new(instructions, other, weights)))),
        };
        let (accelerator, has_failed) = (Device::load(weights), AtomicBool::new(false));
        let trained_for = weights.trained_for().copied().unwrap_or_default();
        let input_size = weights.input_size();
        Self { architecture, input_size, trained_for, instructions, network, accelerator, has_failed }
    }

    /// Returns the architecture.
    pub fn architecture(&self) -> &Architecture {
        &self.architecture
    }

    /// Returns by how much the change of red, green and blue of a sensor is multiplied before the network sees it.
    pub fn gains(&self, sensor: &SensorProfile) -> [f32; 3] {
        sensor.gains(&self.trained_for)
    }

    /// Returns the instruction set that the engine uses.
    pub fn instructions(&self) -> Instructions {
        self.instructions
    }

    /// Predicts indentation and contact from an image. An image is resized to the input size of the weights, if they have one, and to the next
    /// multiples of the network's stride; the prediction is resized back.
    ///
    /// # Errors
    /// [`ImageSizeError`] if the image is empty or has a side of more than 2048 pixels.
    pub fn infer(&self, image: &RgbImage, prediction: &mut Prediction) -> Result<(), ImageSizeError> {
        let shape = (image.height() as usize, image.width() as usize);
        ImageSizeError::check(shape.1, shape.0)?;
        if self.accelerated(&[image], std::slice::from_mut(prediction)) {
            return Ok(());
        }
        let Prediction { indentation_mm, contact_logit } = prediction;
        for plane in [indentation_mm, contact_logit] {
            if plane.dim() != shape {
                *plane = Array2::zeros(shape);
            }
        }
        let size = self.architecture.fit(self.input_size.unwrap_or([shape.0, shape.1]));
        match &self.network {
            Network::Pyramid(runner) => runner.run(image, size, prediction),
            Network::Transformer(runner) => runner.run(image, size, prediction),
            Network::Hierarchy(runner) => runner.run(image, size, prediction),
        }
        Ok(())
    }

    /// Predicts from images of one size on the GPU. Returns false without one, or if it fails.
    fn accelerated(&self, images: &[&RgbImage], predictions: &mut [Prediction]) -> bool {
        let accelerator = self.accelerator.as_ref().filter(|_| !self.has_failed.load(Ordering::Relaxed));
        let (Some(accelerator), Some(first)) = (accelerator, images.first()) else { return false };
        let (rows, columns) = (first.height() as usize, first.width() as usize);
        let levels = images.iter().flat_map(|image| image.as_raw()).copied().collect();
        match accelerator.predict(levels, [images.len(), rows, columns]) {
            Ok(pixels) => {
                for (prediction, pixels) in predictions.iter_mut().zip(pixels.chunks(rows * columns)) {
                    let plane = |part: usize| {
                        Array2::from_shape_fn((rows, columns), |(row, column)| pixels[row * columns + column][part])
                    };
                    *prediction = Prediction { indentation_mm: plane(0), contact_logit: plane(1) };
                }
                true
            }
            Err(error) => {
                tracing::warn!("the GPU failed: {error}; network {} goes on on the CPU", self.architecture.name());
                self.has_failed.store(true, Ordering::Relaxed);
                false
            }
        }
    }

    /// Runs [`Engine::infer`] for several images, one image per thread of the current pool.
    ///
    /// # Errors
    /// As for [`Engine::infer`]; predictions of the other images may then be incomplete.
    pub fn infer_each(&self, images: &[&RgbImage], predictions: &mut Vec<Prediction>) -> Result<(), ImageSizeError> {
        predictions.resize_with(images.len(), Prediction::default);
        if self.accelerator.is_some() {
            images
                .iter()
                .try_for_each(|image| ImageSizeError::check(image.width() as usize, image.height() as usize))?;
            let mut rest = predictions.as_mut_slice();
            let are_done = images
                .chunk_by(|a, b| a.dimensions() == b.dimensions())
                .flat_map(|like| like.chunks(BATCH))
                .all(|some| {
                    let (now, later) = std::mem::take(&mut rest).split_at_mut(some.len());
                    rest = later;
                    self.accelerated(some, now)
                });
            if are_done {
                return Ok(());
            }
        }
        images.par_iter().zip(predictions.par_iter_mut()).try_for_each(|(image, to)| self.infer(image, to))
    }
}

#[cfg(test)]
mod tests;
