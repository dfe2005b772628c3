//! How the noise of a camera's depth depends on distance.

use mvt_settings::Unlimited;
use serde::{Deserialize, Serialize};

/// Standard deviation of depth by time of flight at up to 2 m, metres: a millimetre is usual (Toelgyessy et al. 2021, Azure Kinect), and half as
/// much again, because pixels beside each other share noise.
const TIME_OF_FLIGHT_M: f32 = 0.0015;

/// The principle by which a camera measures depth.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum DepthSensor {
    /// A pattern or a second camera: the disparity has the noise, and that of depth grows with the square of the distance.
    #[default]
    #[serde(alias = "stereo")]
    StructuredLight,
    /// The time of light's way: the noise hardly depends on the distance.
    TimeOfFlight,
}

impl Unlimited for DepthSensor {}

impl DepthSensor {
    /// The standard deviation at a depth, metres; `per_m2` is that at one metre of a sensor that measures disparity.
    pub(super) fn sigma_m(self, depth_m: f32, per_m2: f32) -> f32 {
        match self {
            Self::StructuredLight => per_m2 * depth_m * depth_m,
            Self::TimeOfFlight => TIME_OF_FLIGHT_M,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noise_of_disparity_grows_with_the_square_of_the_distance_and_that_of_time_does_not() {
        let ratio = |sensor: DepthSensor| sensor.sigma_m(1.2, 0.004) / sensor.sigma_m(0.4, 0.004);
        assert!((ratio(DepthSensor::StructuredLight) - 9.0).abs() < 1e-4);
        assert!((ratio(DepthSensor::TimeOfFlight) - 1.0).abs() < 1e-4);
    }
}
