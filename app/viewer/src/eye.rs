//! Camera from which the scene is shown.

use clap::ValueEnum;
use mvt_frames::camera::{Intrinsics, look_at};
use mvt_frames::{Camera, Isometry, World};
use nalgebra::Vector3;

/// Camera that orbits around a point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Eye {
    /// Point that it looks at, metres in the world.
    pub target: Vector3<f64>,
    /// Direction of the eye from the target around z, radians.
    pub yaw_rad: f64,
    /// Angle above the horizon, radians.
    pub pitch_rad: f64,
    /// Distance from the target, metres.
    pub distance_m: f64,
}

/// Preset directions of view.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
#[non_exhaustive]
pub enum Preset {
    /// From over the fingertips' side, obliquely.
    Oblique,
    /// From the fingertips.
    Front,
    /// From the wrist.
    Back,
    /// From +y.
    Left,
    /// From -y.
    Right,
    /// From above.
    Top,
}

/// Point between palm, fingertips and object, metres in the world.
const MIDDLE_M: [f64; 3] = [-0.01, 0.0, 0.025];
/// Distance that shows the whole hand, metres.
pub const DISTANCE_M: f64 = 0.4;
/// Vertical field of view, radians.
const FOV_Y_RAD: f64 = 0.6;
/// Nearest and farthest distance, metres. From the nearest, an object of 6 cm fills the height of the picture.
const DISTANCES_M: [f64; 2] = [0.1, 2.0];
/// Steepest pitch, radians. At a right angle the image would spin.
const STEEPEST_RAD: f64 = 1.55;

impl Default for Eye {
    fn default() -> Self {
        Self::new(Preset::Oblique)
    }
}

impl Preset {
    /// All presets.
    pub const ALL: [Self; 6] = [Self::Oblique, Self::Front, Self::Back, Self::Left, Self::Right, Self::Top];

    /// Returns its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Oblique => "oblique",
            Self::Front => "front",
            Self::Back => "back",
            Self::Left => "left",
            Self::Right => "right",
            Self::Top => "top",
        }
    }

    /// Yaw and pitch, radians.
    fn angles_rad(self) -> [f64; 2] {
        let [yaw, pitch]: [f64; 2] = match self {
            Self::Oblique => [55.0, 35.0],
            Self::Front => [0.0, 10.0],
            Self::Back => [180.0, 10.0],
            Self::Left => [90.0, 10.0],
            Self::Right => [-90.0, 10.0],
            Self::Top => [0.0, 90.0],
        };
        [yaw.to_radians(), pitch.to_radians().min(STEEPEST_RAD)]
    }
}

impl Eye {
    /// Returns an eye that looks at the middle of the hand from this direction.
    pub fn new(preset: Preset) -> Self {
        let [yaw_rad, pitch_rad] = preset.angles_rad();
        Self { target: Vector3::from(MIDDLE_M), yaw_rad, pitch_rad, distance_m: DISTANCE_M }
    }

    /// Turns to a direction and keeps target and distance.
    pub fn look_from(&mut self, preset: Preset) {
        [self.yaw_rad, self.pitch_rad] = preset.angles_rad();
    }

    /// Orbits around the target by angles, radians.
    pub fn orbit(&mut self, yaw_rad: f64, pitch_rad: f64) {
        self.yaw_rad = (self.yaw_rad + yaw_rad).rem_euclid(std::f64::consts::TAU);
        self.pitch_rad = (self.pitch_rad + pitch_rad).clamp(-STEEPEST_RAD, STEEPEST_RAD);
    }

    /// Moves sideways so that the target moves by this many pixels in an image of that height.
    pub fn pan(&mut self, [right, down]: [f64; 2], height: usize) {
        let rotation = self.pose().untyped().rotation;
        self.target += rotation * Vector3::new(-right, down, 0.0) * self.metres_per_pixel(height);
    }

    /// Returns the size of a pixel at the target in an image of that height, metres.
    pub fn metres_per_pixel(&self, height: usize) -> f64 {
        2.0 * self.distance_m * (0.5 * FOV_Y_RAD).tan() / height.max(1) as f64
    }

    /// Multiplies the distance by a factor, within limits.
    pub fn zoom(&mut self, factor: f64) {
        if factor.is_finite() {
            self.distance_m = (self.distance_m * factor).clamp(DISTANCES_M[0], DISTANCES_M[1]);
        }
    }

    /// Looks at another point from the same direction and distance.
    pub fn follow(&mut self, target: Vector3<f64>) {
        self.target = target;
    }

    /// Returns the pose of the camera.
    pub fn pose(&self) -> Isometry<Camera, World> {
        let (sin_yaw, cos_yaw) = self.yaw_rad.sin_cos();
        let (sin, cos) = self.pitch_rad.sin_cos();
        let out = Vector3::new(cos * cos_yaw, cos * sin_yaw, sin);
        look_at(self.target + self.distance_m * out, self.target, Vector3::z())
    }

    /// Returns the pinhole model for an image of this width and height.
    pub fn intrinsics(&self, [width, height]: [usize; 2]) -> Intrinsics {
        Intrinsics::from_fov_y(width, height, FOV_Y_RAD)
    }
}
