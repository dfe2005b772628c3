//! Size, resolution and learning rates of a field.

use serde::{Deserialize, Serialize};

use super::FieldError;

/// Most levels of a grid.
const MAX_LEVELS: usize = 8;
/// Finest level, vertices per axis.
const MAX_RESOLUTION: u32 = 1024;

/// What a [`NeuralField`](super::NeuralField) is made of and how a [`FieldTrainer`](super::Trainer) teaches it.
///
/// The defaults are the winners of a comparison on noisy depth of four YCB objects: finer levels than 3 mm gained nothing at 1 mm
/// of noise, and hashed ones were slower with noisier normals.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Config {
    /// Half the side of the cube around the model's origin in which the field lives, metres.
    pub half_extent_m: f32,
    /// Distance at which the field saturates, metres: its unit of output.
    pub truncation_m: f32,
    /// Vertices per axis of each level of the grid, coarse to fine.
    pub levels: Vec<u32>,
    /// A level with more than 2^`table_log2` vertices is hashed into that many.
    pub table_log2: u32,
    /// Neurons of the hidden layer, a multiple of 16.
    pub hidden: usize,
    /// Learning rate of the grid's features.
    pub grid_rate: f32,
    /// Learning rate of the network.
    pub mlp_rate: f32,
    /// Output of an untrained field, in units of the truncation.
    pub initial_distance: f32,
    /// Weight of the demand that the gradient has length one near the surface, against a weight of one for the distances. 0: none.
    pub eikonal_weight: f32,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            half_extent_m: 0.075,
            truncation_m: 0.004,
            levels: vec![8, 20, 48],
            table_log2: 18,
            hidden: 32,
            grid_rate: 5e-3,
            mlp_rate: 2e-3,
            initial_distance: 0.5,
            eikonal_weight: 0.02,
        }
    }
}

impl Config {
    /// # Errors
    /// [`FieldError::Config`] names the first key that is out of range, and the range.
    pub fn validate(&self) -> Result<(), FieldError> {
        let within = |key: &'static str, value: f32, low: f32, high: f32| {
            // Written so that NaN fails.
            if (low..=high).contains(&value) {
                Ok(())
            } else {
                Err(FieldError::Config { key, message: format!("is {value}, must be {low} to {high}") })
            }
        };
        within("half_extent_m", self.half_extent_m, 0.005, 10.0)?;
        within("truncation_m", self.truncation_m, 1e-4, self.half_extent_m)?;
        within("levels", self.levels.len() as f32, 1.0, MAX_LEVELS as f32)?;
        for &resolution in &self.levels {
            within("levels", resolution as f32, 2.0, MAX_RESOLUTION as f32)?;
        }
        within("table_log2", self.table_log2 as f32, 8.0, 22.0)?;
        within("hidden", self.hidden as f32, 16.0, 256.0)?;
        if !self.hidden.is_multiple_of(16) {
            return Err(FieldError::Config {
                key: "hidden",
                message: format!("is {}, must be a multiple of 16", self.hidden),
            });
        }
        within("grid_rate", self.grid_rate, 0.0, 1.0)?;
        within("mlp_rate", self.mlp_rate, 0.0, 1.0)?;
        within("initial_distance", self.initial_distance, -1.0, 1.0)?;
        within("eikonal_weight", self.eikonal_weight, 0.0, 100.0)
    }
}
