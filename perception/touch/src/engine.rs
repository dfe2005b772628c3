//! Inference on the CPU: a network's forward pass for one image on one thread, with kernels chosen for the machine's instructions.
//!
//! [`Engine::new`] packs the weights for the kernels once. [`Engine::infer`] takes the memory that a pass works with from a store and
//! returns it, so that after the first images of a size nothing is allocated.

mod attention;
mod dpt;
mod image;

mod layers;
mod mamba;
mod map;

mod pyramid;
mod transformer;

use std::sync::{Mutex, PoisonError};

use ::image::RgbImage;
use ndarray::Array2;
use rayon::iter::{
    IndexedParallelIterator as _, IntoParallelRefIterator as _, IntoParallelRefMutIterator as _, ParallelIterator as _,
};

use crate::network::{Architecture, Weights};
use pyramid::Pyramid;
use transformer::Transformer;

pub use mvt_products::Instructions;
pub(crate) use mvt_products::multiply;

/// Longest side of an image, pixels.
const LARGEST: u32 = 2048;

/// What a network makes of an image. Arrays have the image's rows and columns.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Prediction {
    /// How far the gel is indented over the empty gel, millimetres, at least 0.
    pub indentation_mm: Array2<f32>,
    /// Logit of the probability that the object presses into the gel.
    pub contact_logit: Array2<f32>,
}

/// An image that no network takes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("the touch image is {width} x {height} pixels; its sides must be 1 to {LARGEST}, 240 x 320 is a DIGIT's size")]
pub struct ImageSizeError {
    /// Width, pixels.
    pub width: u32,
    /// Height, pixels.
    pub height: u32,
}

/// A network with packed weights. It serves any number of threads.
#[derive(Debug)]
pub struct Engine {
    architecture: Architecture,
    instructions: Instructions,
    network: Network,
}

#[derive(Debug)]
enum Network {
    Pyramid(Box<Runner<Pyramid>>),
    Transformer(Box<Runner<Transformer>>),
}

impl Engine {
    /// Packs weights for an instruction set; for the fastest one of the machine, [`Instructions::best`]. If the machine does not
    /// have it, the next one that it has takes its place.
    pub fn new(weights: &Weights, instructions: Instructions) -> Self {
        let wanted = Instructions::ALL.into_iter().skip_while(|&set| set != instructions);
        let instructions = wanted.into_iter().find(|set| set.is_available()).unwrap_or(Instructions::Scalar);
        let architecture = weights.architecture().clone();
        let network = match &architecture {
            Architecture::Default(pyramid) => {
                Network::Pyramid(Box::new(Runner::new(Pyramid::new(instructions, pyramid, weights))))
            }
            other => Network::Transformer(Box::new(Runner::new(Transformer::new(instructions, other, weights)))),
        };
        Self { architecture, instructions, network }
    }

    /// The network.
    pub fn architecture(&self) -> &Architecture {
        &self.architecture
    }

    /// The instruction set that it runs with.
    pub fn instructions(&self) -> Instructions {
        self.instructions
    }

    /// What the network makes of an image. An image whose sides are no multiples of the network's stride is resized to the next ones,
    /// and the result back.
    ///
    /// # Errors
    /// [`ImageSizeError`] if the image is empty or has a side of more than 2048 pixels.
    pub fn infer(&self, image: &RgbImage, prediction: &mut Prediction) -> Result<(), ImageSizeError> {
        let (width, height) = image.dimensions();
        if !(1..=LARGEST).contains(&width) || !(1..=LARGEST).contains(&height) {
            return Err(ImageSizeError { width, height });
        }
        let shape = (height as usize, width as usize);
        let Prediction { indentation_mm, contact_logit } = prediction;
        for plane in [indentation_mm, contact_logit] {
            if plane.dim() != shape {
                *plane = Array2::zeros(shape);
            }
        }
        let size = self.architecture.fit([shape.0, shape.1]);
        match &self.network {
            Network::Pyramid(runner) => runner.run(image, size, prediction),
            Network::Transformer(runner) => runner.run(image, size, prediction),
        }
        Ok(())
    }

    /// [`Engine::infer`] for each of several images, one image per thread of the current pool.
    ///
    /// # Errors
    /// As for [`Engine::infer`]; the other images may have been done or not.
    pub fn infer_each(&self, images: &[&RgbImage], predictions: &mut Vec<Prediction>) -> Result<(), ImageSizeError> {
        predictions.resize_with(images.len(), Prediction::default);
        images.par_iter().zip(predictions.par_iter_mut()).try_for_each(|(image, to)| self.infer(image, to))
    }
}

/// A network's forward pass.
trait Forward {
    /// What it works with.
    type Buffers;

    /// Room for inputs of a size, rows and columns.
    fn buffers(&self, size: [usize; 2]) -> Self::Buffers;

    /// From an image to a prediction of its size; `words` is room for matrix products.
    fn forward(&self, image: &RgbImage, buffers: &mut Self::Buffers, words: &mut Vec<u32>, to: &mut Prediction);
}

/// A network with the memory of passes that are not under way.
#[derive(Debug)]
struct Runner<N: Forward> {
    network: N,
    idle: Mutex<Vec<Workspace<N::Buffers>>>,
}

/// What a pass works with.
#[derive(Debug)]
struct Workspace<S> {
    size: [usize; 2],
    buffers: S,
    words: Vec<u32>,
}

impl<N: Forward> Runner<N> {
    fn new(network: N) -> Self {
        Self { network, idle: Mutex::new(Vec::new()) }
    }

    fn run(&self, image: &RgbImage, size: [usize; 2], prediction: &mut Prediction) {
        let idle = || self.idle.lock().unwrap_or_else(PoisonError::into_inner);
        // Passes for another size than the last one are not expected to return.
        let known = idle().pop().filter(|workspace| workspace.size == size);
        let mut workspace =
            known.unwrap_or_else(|| Workspace { size, buffers: self.network.buffers(size), words: Vec::new() });
        self.network.forward(image, &mut workspace.buffers, &mut workspace.words, prediction);
        idle().push(workspace);
    }
}

#[cfg(test)]
mod tests;
