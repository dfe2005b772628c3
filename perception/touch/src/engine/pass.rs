//! Forward passes, and the memory that they share.

use std::sync::{Mutex, PoisonError};

use image::RgbImage;
use ndarray::Array2;

/// Prediction of a network for an image. The arrays have the image's rows and columns.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Prediction {
    /// Indentation of the gel, millimetres, at least 0.
    pub indentation_mm: Array2<f32>,
    /// Logit of the probability that the object presses into the gel.
    pub contact_logit: Array2<f32>,
}

/// Forward pass of a network.
pub(super) trait Forward {
    /// Memory of a pass.
    type Buffers;

    /// Returns memory for inputs of some rows and columns.
    fn buffers(&self, size: [usize; 2]) -> Self::Buffers;

    /// Predicts from an image; `words` is room for matrix products.
    fn forward(&self, image: &RgbImage, buffers: &mut Self::Buffers, words: &mut Vec<u32>, to: &mut Prediction);
}

/// Network with a store of memory for passes.
#[derive(Debug)]
pub(super) struct Runner<N: Forward> {
    network: N,
    idle: Mutex<Vec<Workspace<N::Buffers>>>,
}

/// Memory of a pass for inputs of some rows and columns.
#[derive(Debug)]
struct Workspace<S> {
    size: [usize; 2],
    buffers: S,
    words: Vec<u32>,
}

impl<N: Forward> Runner<N> {
    pub(super) fn new(network: N) -> Self {
        Self { network, idle: Mutex::new(Vec::new()) }
    }

    pub(super) fn run(&self, image: &RgbImage, size: [usize; 2], prediction: &mut Prediction) {
        let idle = || self.idle.lock().unwrap_or_else(PoisonError::into_inner);
        // Memory for another size is dropped: sizes rarely change.
        let known = idle().pop().filter(|workspace| workspace.size == size);
        let mut workspace =
            known.unwrap_or_else(|| Workspace { size, buffers: self.network.buffers(size), words: Vec::new() });
        self.network.forward(image, &mut workspace.buffers, &mut workspace.words, prediction);
        idle().push(workspace);
    }
}
