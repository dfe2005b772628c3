//! Settings of a run.

use mvt_calibration::CalibrationConfig;
use mvt_perceive::PerceptionConfig;
use mvt_segmentation::SegmentationConfig;
use mvt_settings::settings;
use mvt_slam::SlamConfig;
use mvt_touch::contact::ContactConfig;

use crate::supervisor::SupervisorRules;

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
    /// The settings of perception.
    pub fn perception(&self) -> PerceptionConfig {
        PerceptionConfig { touch: self.touch, calibration: self.calibration, segmentation: self.segmentation }
    }
}
