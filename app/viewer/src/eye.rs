//! Camera from which the scene is shown.

use clap::ValueEnum;
use mvt_frames::camera::{Intrinsics, look_at};
use mvt_frames::{Camera, Isometry, World};
use mvt_recording::Recording;
use nalgebra::{Point3, UnitQuaternion, Vector3};

/// Camera that orbits around a point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Eye {
    /// Point that it looks at, metres in the world.
    pub target: Vector3<f64>,
    /// Direction of the eye from the target around the upward axis, radians.
    pub yaw_rad: f64,
    /// Angle above the horizon, radians.
    pub pitch_rad: f64,
    /// Distance from the target, metres.
    pub distance_m: f64,
    /// Axes of the angles in the world: z is up, and at yaw 0 the eye is on the side of x.
    axes: UnitQuaternion<f64>,
    /// Point of the object that a film keeps in the middle, in its coordinates.
    follows: Option<Point3<f64>>,
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
const DISTANCE_M: f64 = 0.4;
/// Share of the height of a picture that an object without a hand fills.
const FILLED: f64 = 0.6;
/// Size of an object of which no shape is known yet, metres.
const USUAL_SIZE_M: f64 = 0.1;
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
        let axes = UnitQuaternion::identity();
        Self { target: Vector3::from(MIDDLE_M), yaw_rad, pitch_rad, distance_m: DISTANCE_M, axes, follows: None }
    }

    /// Returns an eye for a recording, from this direction. Without a hand it looks at the object: upwards is then upwards in the images of the first
    /// camera, which is in front.
    pub fn of(recording: &Recording, preset: Preset) -> Self {
        let mut eye = Self::new(preset);
        let moments = recording.moments().len();
        let first = (0..moments).find_map(|moment| recording.pose(moment));
        let Some((camera, pose)) = recording.about().cameras.first().zip(first) else { return eye };
        if !recording.about().hand.is_none() {
            return eye;
        }
        let shape = recording.shape(moments - 1).ok().flatten();
        let mesh =
            shape.as_ref().map(|shape| &shape.mesh).or(recording.true_mesh()).filter(|mesh| !mesh.vertices.is_empty());
        let (middle, size_m) = mesh.map_or((Point3::origin(), USUAL_SIZE_M), |mesh| {
            let [low, high] = mesh.bounds_m().map(|corner| Vector3::from(corner.to_array().map(f64::from)));
            (Point3::from((low + high) / 2.0), (high - low).amax())
        });
        eye.follows = Some(middle);
        eye.target = (pose.untyped() * middle).coords;
        eye.distance_m = (size_m / (FILLED * 2.0 * (0.5 * FOV_Y_RAD).tan())).clamp(DISTANCES_M[0], DISTANCES_M[1]);
        let camera = camera.pose.untyped();
        let up = camera.rotation * Vector3::y();
        let towards_camera = camera.translation.vector - eye.target;
        let level = towards_camera - towards_camera.dot(&up) * up;
        // A camera right above the object has no side; then its back counts.
        let front = level.try_normalize(1e-6).unwrap_or_else(|| camera.rotation * Vector3::z());
        eye.axes = UnitQuaternion::from_basis_unchecked(&[front, up.cross(&front), up]);
        eye
    }

    /// Returns the eye of a moment of a film: without a hand it follows the object.
    pub fn at(&self, recording: &Recording, moment: usize) -> Self {
        match self.follows.zip(recording.pose(moment)) {
            Some((middle, pose)) => Self { target: (pose.untyped() * middle).coords, ..*self },
            None => *self,
        }
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
        let out = self.axes * Vector3::new(cos * cos_yaw, cos * sin_yaw, sin);
        look_at(self.target + self.distance_m * out, self.target, self.axes * Vector3::z())
    }

    /// Returns the pinhole model for an image of this width and height.
    pub fn intrinsics(&self, [width, height]: [usize; 2]) -> Intrinsics {
        Intrinsics::from_fov_y(width, height, FOV_Y_RAD)
    }
}
