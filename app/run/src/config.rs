//! Settings of a run.

use std::path::Path;

use mvt_calibration::CalibrationConfig;
use mvt_perceive::PerceptionConfig;
use mvt_segmentation::{LabelSource, SegmentationConfig};
use mvt_settings::settings;
use mvt_slam::SlamConfig;
use mvt_touch::contact::ContactConfig;

use crate::source::RgbdSequence;
use crate::supervisor::SupervisorRules;

/// Depths within a mask that differ by more than this form an edge, metres: at a metre, slanted faces differ by more than those in a hand.
const MASK_JUMP_M: f32 = 0.03;

settings! {
    /// All settings of a run.
    #[non_exhaustive]
    pub struct RunConfig {
        /// Noise of camera depth as a multiple of Redwood's model; NeuralFeels uses 5. It is also added to the true depth of logs. 0 adds no
        /// noise.
        pub camera_noise: f64 = 5.0, 0.0..=100.0;
        /// Edge of the cells of the mesh, millimetres.
        pub mesh_cell_mm: f64 = 1.5, 0.2..=20.0;
        /// The shape is meshed and scored at every Nth frame.
        pub score_every: u64 = 30, 1..=1_000_000;
        /// Contact from a touch network's predictions.
        pub touch: ContactConfig, Nested;
        /// Refinement of camera poses and joint angles.
        pub calibration: CalibrationConfig, Nested;
        /// Labels of camera pixels.
        pub segmentation: SegmentationConfig, Nested;
        /// The estimator.
        pub slam: SlamConfig, Nested;
        /// The supervisor.
        pub supervisor: SupervisorRules, Nested;
    }
}

impl RunConfig {
    /// Returns the settings with which a recording starts, or a simulated episode without one: those without a hand for an RGB-D sequence.
    pub fn suited(recording: Option<&Path>) -> Self {
        if recording.is_some_and(RgbdSequence::is_here) { Self::without_hand() } else { Self::default() }
    }

    /// Returns the settings for an object that no hand of ours holds, in RGB-D images with masks.
    pub fn without_hand() -> Self {
        let segmentation =
            SegmentationConfig { labels: LabelSource::Given, jump_m: MASK_JUMP_M, edge_px: 0, ..Default::default() };
        Self { segmentation, slam: SlamConfig::without_hand(), ..Default::default() }
    }

    /// The settings of perception.
    pub fn perception(&self) -> PerceptionConfig {
        PerceptionConfig { touch: self.touch, calibration: self.calibration, segmentation: self.segmentation }
    }
}
