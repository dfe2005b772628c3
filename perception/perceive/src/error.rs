//! Reasons why an observation cannot be used.

use mvt_robot::observation::{SensorError, SensorName};
use mvt_shear::ShearError;
use mvt_touch::network::ImageSizeError;

/// Reason that an observation cannot be used.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum PerceptionError {
    /// An image does not fit its sensor, or a number is not finite.
    #[error(transparent)]
    Sensor(#[from] SensorError),
    /// An image has a size with which the network cannot work.
    #[error("{sensor}: {reason}")]
    Image {
        /// The touch sensor.
        sensor: SensorName,
        /// Reason.
        reason: ImageSizeError,
    },
    /// The untouched image does not show the dots of the sensor.
    #[error("{sensor}: {reason}")]
    Dots {
        /// The touch sensor.
        sensor: SensorName,
        /// Reason.
        reason: ShearError,
    },
}
