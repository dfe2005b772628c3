//! Reasons why a training cannot go on.

use mvt_environment::TaskError;
use mvt_policy::PolicyError;

/// Why a policy cannot be trained.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum LearningError {
    /// The environments cannot be made or stepped.
    #[error(transparent)]
    Task(#[from] TaskError),
    /// The policy cannot be written.
    #[error(transparent)]
    Policy(#[from] PolicyError),
    /// A setting is out of range.
    #[error(transparent)]
    Setting(#[from] mvt_settings::SettingError),
    /// The state of an interrupted training cannot be used.
    #[error("the state of the interrupted training cannot be used: {0}; remove it to begin anew")]
    State(String),
    /// The object is kept for results.
    #[error("{0} is kept for results, which nothing is trained for; choose a random object with a seed below 1000")]
    KeptObject(String),
}
