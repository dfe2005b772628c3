//! The three LEDs that light the gel, at the places of TACTO's configurations, and their random perturbation for
//! training.

use std::f64::consts::FRAC_PI_3;

use nalgebra::Vector3;
use rand::{Rng, RngExt};

use super::TouchConfig;

/// pyrender reads TACTO's integer light colours as 8-bit values, so every light is dimmer than configured by this
/// factor.
const INTEGER_COLOUR: f64 = 255.0;
/// Depth of the plane of the LEDs, metres (TACTO's `lights.origin`).
const PLANE_X_M: f64 = 0.005;
/// Distance of each LED from the camera's axis, metres (TACTO's `lights.xrtheta.rs`).
const RING_RADIUS_M: f64 = 0.020;
/// Angle of each LED in the y-z plane, degrees from +y (TACTO's `lights.xrtheta.thetas`).
const RING_ANGLES_DEG: [f64; 3] = [30.0, 150.0, 270.0];

/// Beam of a spot light with inner cone angle 0 (TACTO's fork; TACTO itself uses point lights).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Spot {
    /// Unit direction of the beam in the gel frame.
    pub direction: Vector3<f64>,
    /// Angle from the beam's axis at which the light reaches 0, radians.
    pub outer_rad: f64,
}

/// One LED in the gel frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Light {
    /// Position, metres.
    pub position_m: Vector3<f64>,
    /// Red, green and blue, 0 to 1.
    pub color: [f64; 3],
    /// Intensity in TACTO's configuration, before the division by 255 (see [`Light::radiant`]).
    pub intensity: f64,
    /// The beam; `None` shines in every direction.
    pub spot: Option<Spot>,
}

impl Light {
    /// Returns the colour times the intensity that the shader uses.
    pub fn radiant(&self) -> [f64; 3] {
        self.color.map(|c| c * self.intensity / INTEGER_COLOUR)
    }
}

/// The three LEDs of a DIGIT.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Lights(pub [Light; 3]);

impl Lights {
    /// Returns the LEDs of a TACTO configuration.
    pub fn of(config: TouchConfig) -> Self {
        Self::on_ring(config, Vector3::zeros(), [0.0; 3], [0.0; 3], [0.0; 3])
    }

    /// Draws from MidasTouch's distribution of lights: the common origin moves by N(0, 1 mm) per axis, each LED's
    /// radius by N(0, 1 mm), its angle by N(0, 5 degrees) and its intensity by N(0, 0.5), `strength` times as much.
    pub fn perturbed(config: TouchConfig, strength: f64, rng: &mut impl Rng) -> Self {
        let mut normal = |sigma: f64| strength * sigma * standard_normal(rng);
        let origin = Vector3::from_fn(|_, _| normal(1e-3));
        let radius = std::array::from_fn(|_| normal(1e-3));
        let angle = std::array::from_fn(|_| normal(5.0));
        Self::on_ring(config, origin, radius, angle, std::array::from_fn(|_| normal(0.5)))
    }

    fn on_ring(
        config: TouchConfig,
        shift: Vector3<f64>,
        radius: [f64; 3],
        angle: [f64; 3],
        brighter: [f64; 3],
    ) -> Self {
        let (colors, intensity) = match config {
            TouchConfig::Fork => ([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]], 2.0),
            TouchConfig::Tacto => ([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], 1.0),
        };
        Self(std::array::from_fn(|i| {
            let (sin, cos) = (RING_ANGLES_DEG[i] + angle[i]).to_radians().sin_cos();
            let r = RING_RADIUS_M + radius[i];
            Light {
                position_m: Vector3::new(PLANE_X_M, r * cos, r * sin) + shift,
                color: colors[i],
                intensity: (intensity + brighter[i]).max(0.0),
                // The Euler angles in TACTO's fork turn the beam towards the axis; its tilt out of the plane drops out.
                spot: (config == TouchConfig::Fork)
                    .then(|| Spot { direction: Vector3::new(0.0, -cos, -sin), outer_rad: FRAC_PI_3 }),
            }
        }))
    }
}

/// Draws a standard normal number (Box and Muller).
fn standard_normal(rng: &mut impl Rng) -> f64 {
    // 1 - u is never 0, the logarithm therefore finite.
    let radius = (-2.0 * (1.0 - rng.random::<f64>()).ln()).sqrt();
    radius * (std::f64::consts::TAU * rng.random::<f64>()).cos()
}
