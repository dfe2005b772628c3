//! Size, resolution and learning rates of a field.

use mvt_settings::{SettingError, settings};

settings! {
    /// Size of a [`NeuralField`](super::NeuralField) and learning rates of its [`FieldTrainer`](super::FieldTrainer).
    ///
    /// The defaults did best in a comparison on noisy depth of four YCB objects: levels finer than 3 mm did not help at 1 mm of noise, and
    /// hashed levels were slower and had noisier normals.
    pub struct FieldConfig {
        /// Half the side of the cube around the model's origin that the field covers, metres.
        pub half_extent_m: f32 = 0.075, 0.005..=10.0;
        /// Distance at which the field saturates, metres. The field's output is in units of it.
        pub truncation_m: f32 = 0.004, 1e-4..=10.0;
        // Why: notes/decisions/estimation.md, "A small dense grid, not a large hashed one".
        /// Vertices per axis of each level of the grid, coarse to fine.
        pub levels: Vec<u32> = vec![8, 20, 48], List { length: 1..=8, each: 2..=1024 };
        /// A level with more than 2^table_log2 vertices is hashed into a table of that size.
        pub table_log2: u32 = 18, 8..=22;
        /// Neurons of the hidden layer.
        pub hidden: usize = 32, Multiple { of: 16, within: 16..=256 };
        /// Learning rate of the grid's features.
        pub grid_rate: f32 = 5e-3, 1e-6..=1.0;
        /// Learning rate of the network.
        pub mlp_rate: f32 = 2e-3, 0.0..=1.0;
        /// Output of an untrained field, in units of the truncation. Below 0 all unseen space would be the inside.
        pub initial_distance: f32 = 0.5, 0.0..=1.0;
        /// Weight of the loss that keeps gradients near the surface at length 1; the loss of distances has weight 1. 0 switches it off.
        pub eikonal_weight: f32 = 0.02, 0.0..=100.0;
    }
    rule = truncation_fits;
}

fn truncation_fits(config: &FieldConfig) -> Result<(), SettingError> {
    if config.truncation_m <= config.half_extent_m {
        return Ok(());
    }
    let range = format!("at most half_extent_m, {}", config.half_extent_m);
    Err(SettingError::new("truncation_m", config.truncation_m.to_string(), range))
}
