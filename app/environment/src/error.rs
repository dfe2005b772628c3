//! Reasons why a task cannot go on.

use mvt_gaits::gait::UnknownGait;
use mvt_perceive::PerceptionError;
use mvt_physics::simulation::SimulationError;
use mvt_render::touch::TouchError;
use mvt_robot::hand::HandError;
use mvt_slam::SettingError;

/// Why a task cannot be set up, reset or stepped.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum TaskError {
    /// A setting is invalid.
    #[error("{0}")]
    Setting(String),
    /// The actions have the wrong length.
    #[error("actions has {found} numbers; {expected} expected, 16 for each environment")]
    Count {
        /// Numbers expected.
        expected: usize,
        /// Numbers given.
        found: usize,
    },
    /// An action is NaN or infinite.
    #[error("actions holds a number that is not finite")]
    NotFinite,
    /// MuJoCo refuses the object.
    #[error(transparent)]
    Simulation(#[from] SimulationError),
    /// A touch sensor cannot be rendered.
    #[error(transparent)]
    Touch(#[from] TouchError),
    /// The hand cannot have the drives of the task.
    #[error(transparent)]
    Hand(#[from] HandError),
    /// The gait is unknown.
    #[error(transparent)]
    Gait(#[from] UnknownGait),
    /// A setting of the estimator is out of range.
    #[error(transparent)]
    Estimator(#[from] SettingError),
    /// The estimator cannot use an observation.
    #[error(transparent)]
    Perception(#[from] PerceptionError),
}
