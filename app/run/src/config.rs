//! Settings of a run.

use std::path::Path;

use mvt_calibration::CalibrationConfig;
use mvt_perceive::PerceptionConfig;
use mvt_segmentation::{LabelSource, SegmentationConfig};
use mvt_slam::SlamConfig;
use mvt_touch::contact::ContactConfig;

use crate::settings::{self, LoadSettingsError};
use crate::source::RgbdSequence;
use crate::supervisor::SupervisorRules;

/// Depths within a mask that differ by more than this form an edge, metres: at a metre, slanted faces differ by more than those in a hand.
const MASK_JUMP_M: f32 = 0.03;

mvt_settings::settings! {
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

    /// Returns these settings, changed by a TOML file if one is given, then by texts of the form `key=value` in their order. A value is TOML
    /// (`0.5`, `true`, `[1, 2]`, `"text"`); texts need no quotation marks, and a whole number is accepted as any number.
    ///
    /// # Errors
    /// [`LoadSettingsError`]: for an unknown key it names the nearest key, for an invalid value the key with its kind and range.
    // Not generic, so that the code that reads all settings is compiled once.
    pub fn changed(self, file: Option<&Path>, set: &[String]) -> Result<Self, LoadSettingsError> {
        settings::load(self, file, set)
    }

    /// Returns the settings as TOML that [`RunConfig::changed`] reads, with documentation, range and default of each as comments.
    ///
    /// # Errors
    /// [`LoadSettingsError::Unfit`] if they do not fit TOML, which is a bug.
    pub fn to_toml(&self) -> Result<String, LoadSettingsError> {
        settings::to_toml(self)
    }

    /// The settings of perception.
    pub fn perception(&self) -> PerceptionConfig {
        PerceptionConfig { touch: self.touch, calibration: self.calibration, segmentation: self.segmentation }
    }
}
