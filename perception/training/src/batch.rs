//! Batches of images, and the errors of training.

use std::path::PathBuf;
use std::sync::Arc;

use crate::loss::Targets;
use mvt_touch::network::{Architecture, UnknownNetwork, WeightsError};

/// Images that enter a network together.
#[derive(Debug, Clone, Copy)]
pub struct TrainingImages<'a> {
    /// RGB of each pixel, image by image and row by row.
    pub levels: &'a [u8],
    /// Images, rows and columns.
    pub shape: [usize; 3],
}

/// Images with their targets.
#[derive(Debug, Clone, Default)]
pub struct TrainingBatch {
    /// Images, rows and columns.
    pub shape: [usize; 3],
    /// RGB of each pixel, image by image and row by row.
    pub levels: Vec<u8>,
    /// Correct answers for each pixel.
    pub targets: Arc<Targets>,
}

impl TrainingBatch {
    /// Returns the images in shares of about `pixels` pixels, each with the index of its first pixel.
    pub fn shares(&self, pixels: usize) -> Vec<(usize, TrainingImages<'_>)> {
        let [_, rows, columns] = self.shape;
        let count = (pixels / (rows * columns)).max(1);
        let shares = self.levels.chunks(3 * count * rows * columns).enumerate();
        let shares = shares.map(|(k, levels)| {
            let shape = [levels.len() / (3 * rows * columns), rows, columns];
            (k * count * rows * columns, TrainingImages { levels, shape })
        });
        shares.collect()
    }
}

/// Reason that training cannot go on.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum TrainError {
    /// The architecture is invalid.
    #[error(transparent)]
    Network(#[from] UnknownNetwork),
    /// A file of weights or a checkpoint cannot be used.
    #[error(transparent)]
    Weights(#[from] WeightsError),
    /// A setting is out of range.
    #[error("training configuration: {0}")]
    Setting(#[from] mvt_settings::SettingError),
    /// The loss or its gradient is not finite. The weights are those before the step.
    #[error(
        "the loss of step {step} is {loss} and its gradient's length {gradient}: training diverged; resume from the last \
         checkpoint with a smaller optimiser.learning_rate, a longer warm_up or a smaller clip"
    )]
    NotFinite {
        /// The step.
        step: u64,
        /// Loss of the step.
        loss: f32,
        /// Length of the gradient.
        gradient: f32,
    },
    /// The number of levels does not fit the shape, or the sides are not multiples of the network's stride.
    #[error(
        "{levels} levels do not make {} RGB images of {} x {} pixels, or the sides are not multiples of the network's stride",
        shape[0], shape[2], shape[1]
    )]
    Batch {
        /// Images, rows and columns.
        shape: [usize; 3],
        /// Number of levels.
        levels: usize,
    },
    /// The GPU failed. The weights are those before the step.
    #[error("the GPU failed: {0}; resume from the last checkpoint, on the CPU if it fails again")]
    Gpu(String),
    /// The weights to start from belong to another network.
    #[error(
        "the weights to start from belong to a network with other hyper-parameters; choose the network of those weights"
    )]
    OtherStart,
    /// A checkpoint belongs to another training.
    #[error("{}: its {what} differs from the configuration's; resume with the configuration it was begun with", path.display())]
    OtherTraining {
        /// The checkpoint.
        path: PathBuf,
        /// The part that differs.
        what: &'static str,
    },
}

/// Checks that images of this shape can enter a network.
pub(crate) fn check_shape(architecture: &Architecture, levels: usize, shape: [usize; 3]) -> Result<(), TrainError> {
    let size = [shape[1], shape[2]];
    if levels == 3 * shape.iter().product::<usize>() && levels > 0 && architecture.fit(size) == size {
        Ok(())
    } else {
        Err(TrainError::Batch { shape, levels })
    }
}
