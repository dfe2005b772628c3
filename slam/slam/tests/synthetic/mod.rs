//! Depth images of solids that are known by formula, ray by ray and without noise: what every sensor of a test sees.

#![allow(dead_code, reason = "every test uses another part")]

use super::Measurement;
use glam::Vec3;
use mvt_frames::camera::{Intrinsics, look_at};
use mvt_frames::depth::{CameraDepth, Label, TouchDepth};
use mvt_frames::image::{Rgb, RgbImage};
use mvt_frames::{Camera, Field, Frame, Isometry, Object, Obstacle, Point, Vector, World};
use mvt_mesh::SignedDistance;
use nalgebra as na;
use ndarray::Array2;

/// A solid around the origin of its frame.
#[derive(Debug, Clone, Copy)]
pub enum Solid {
    /// Of this radius, metres.
    Ball(f64),
    /// With these halves of its edges, metres.
    Block([f64; 3]),
}

/// Three different sides: only half turns take it to itself.
pub const BRICK: Solid = Solid::Block([0.035, 0.025, 0.018]);

impl Solid {
    /// Signed distance of a point in the solid's frame, metres.
    pub fn distance(self, p: na::Vector3<f64>) -> f64 {
        match self {
            Solid::Ball(radius) => p.norm() - radius,
            Solid::Block(half) => {
                let q = p.abs() - na::Vector3::from(half);
                q.sup(&na::Vector3::zeros()).norm() + q.max().min(0.0)
            }
        }
    }

    /// Lowest and highest corner, metres.
    pub fn bounds(self) -> [Vec3; 2] {
        let half = match self {
            Solid::Ball(radius) => [radius; 3],
            Solid::Block(half) => half,
        };
        let half = Vec3::from_array(half.map(|x| x as f32));
        [-half, half]
    }

    /// Where a ray from outside meets the solid, metres along its unit direction.
    fn enter(self, origin: na::Vector3<f64>, direction: na::Vector3<f64>) -> Option<f64> {
        match self {
            Solid::Ball(radius) => {
                let middle = -origin.dot(&direction);
                let square = radius * radius - (origin + direction * middle).norm_squared();
                (square > 0.0).then(|| middle - square.sqrt())
            }
            Solid::Block(half) => {
                let (mut enter, mut leave) = (f64::NEG_INFINITY, f64::INFINITY);
                for axis in 0..3 {
                    let a = (-half[axis] - origin[axis]) / direction[axis];
                    let b = (half[axis] - origin[axis]) / direction[axis];
                    (enter, leave) = (enter.max(a.min(b)), leave.min(a.max(b)));
                }
                (enter < leave).then_some(enter)
            }
        }
        .filter(|range| *range > 0.0)
    }

    /// Points on the surface, evenly spread over the directions around the middle; the solid's frame.
    pub fn surface(self, count: usize) -> Vec<na::Vector3<f64>> {
        (0..count)
            .map(|i| {
                let z = 1.0 - (2 * i + 1) as f64 / count as f64;
                let (sin, cos) = (2.399_963 * i as f64).sin_cos();
                let d = na::Vector3::new((1.0 - z * z).sqrt() * cos, (1.0 - z * z).sqrt() * sin, z);
                // From far outside back to the surface.
                d * (1.0 - self.enter(d, -d).unwrap_or(1.0))
            })
            .collect()
    }
}

impl SignedDistance for Solid {
    fn distance_m(&self, p: Point<Object>) -> f64 {
        self.distance(p.coords())
    }
}

/// Where solids are put: farther from the hand than anything that takes the hand into account reaches, metres.
pub const PLACE_M: [f64; 3] = [0.0, 0.0, 0.4];

/// The pose at [`PLACE_M`] moved by metres and turned by a rotation vector, degrees.
pub fn pose(shift: [f64; 3], turn_deg: [f64; 3]) -> Isometry<Field, World> {
    let rotation = na::UnitQuaternion::from_scaled_axis(na::Vector3::from(turn_deg.map(f64::to_radians)));
    let place = na::Vector3::from(PLACE_M) + na::Vector3::from(shift);
    Isometry::new(na::Isometry3::from_parts(place.into(), rotation))
}

/// A camera 35 cm away that looks down at [`PLACE_M`]: the middle of a named camera's image, with its focal length.
pub fn camera() -> (Intrinsics, Isometry<Camera, World>) {
    let intrinsics = Intrinsics { width: 320, height: 240, fx: 579.4, fy: 579.4, cx: 159.5, cy: 119.5 };
    let place = na::Vector3::from(PLACE_M);
    (intrinsics, look_at(place + na::Vector3::new(0.06, 0.24, 0.247), place, na::Vector3::z()))
}

fn cast<F: Frame>(
    solid: Solid,
    solid_from_camera: Isometry<Camera, F>,
    intrinsics: &Intrinsics,
    mut found: impl FnMut(usize, usize, f64),
) {
    let origin = solid_from_camera.origin().coords();
    for v in 0..intrinsics.height {
        for u in 0..intrinsics.width {
            let ray = intrinsics.unproject(u as f64, v as f64, 1.0).coords();
            let direction = (solid_from_camera * Vector::<Camera>::from(ray.normalize())).coords();
            if let Some(range) = solid.enter(origin, direction) {
                found(u, v, range / ray.norm());
            }
        }
    }
}

/// The image of a solid without a background.
pub fn see<F: Frame>(
    solid: Solid,
    pose: Isometry<F, World>,
    (intrinsics, world_from_camera): (Intrinsics, Isometry<Camera, World>),
) -> CameraDepth {
    let (width, height) = (intrinsics.width, intrinsics.height);
    let mut depth_m = Array2::zeros((height, width));
    let mut labels = Array2::from_elem((height, width), Label::Background);
    cast(solid, pose.inverse() * world_from_camera, &intrinsics, |u, v, depth| {
        depth_m[(v, u)] = depth as f32;
        labels[(v, u)] = Label::Object;
    });
    CameraDepth { intrinsics, world_from_camera, depth_m, labels, colour: None }
}

/// Direction from which the light comes that stays where it is while solids turn.
const LIGHT: [f64; 3] = [0.5, 0.35, 0.8];

/// Adds the colours of the solid in a camera: `paint` is the brightness of a place of its surface, 0 to 1, in the solid's frame. A
/// lamp that stands still and the solid's normals shade it.
pub fn painted<F: Frame>(
    mut image: CameraDepth,
    solid: Solid,
    pose: Isometry<F, World>,
    paint: impl Fn(na::Vector3<f64>) -> f64,
) -> CameraDepth {
    const STEP_M: f64 = 1e-6;
    let solid_from_camera = pose.inverse() * image.world_from_camera;
    let light = pose.untyped().rotation.inverse() * na::Vector3::from(LIGHT).normalize();
    let (width, height) = (image.intrinsics.width as u32, image.intrinsics.height as u32);
    image.colour = Some(RgbImage::from_fn(width, height, |u, v| {
        let depth = image.depth_m[(v as usize, u as usize)];
        if depth <= 0.0 {
            return Rgb([170; 3]);
        }
        let p = solid_from_camera * image.intrinsics.unproject(f64::from(u), f64::from(v), f64::from(depth));
        let p = p.coords();
        let normal = na::Vector3::from_fn(|i, _| {
            let step = na::Vector3::ith(i, STEP_M);
            (solid.distance(p + step) - solid.distance(p - step)) / (2.0 * STEP_M)
        });
        let shade = 0.35 + 0.65 * normal.dot(&light).max(0.0);
        Rgb([(255.0 * (paint(p) * shade).clamp(0.0, 1.0)).round() as u8; 3])
    }));
    image
}

/// Blotches of some millimetres.
pub fn blotches(p: na::Vector3<f64>) -> f64 {
    let wave = |x: f64, y: f64, z: f64| (310.0 * x + 1.0).sin() * (260.0 * y + 2.0).sin() + (290.0 * z + 0.5).sin();
    0.5 + 0.2 * wave(p.x, p.y, p.z) + 0.1 * wave(1.7 * p.y, 1.9 * p.z, 1.8 * p.x)
}

/// The `k`-th frame at 30 Hz of a painted solid before [`camera`].
pub fn seen_painted<F: Frame>(
    k: usize,
    solid: Solid,
    pose: Isometry<F, World>,
    paint: impl Fn(na::Vector3<f64>) -> f64,
) -> Sensed {
    frame(k as f64 / 30.0, vec![Some(painted(see(solid, pose, camera()), solid, pose, paint))])
}

/// Depth of the flat gel of a synthetic DIGIT, metres.
pub const GEL_M: f32 = 0.02;

/// Pinhole model in the synthetic touch sensor: a DIGIT's.
pub fn touch_intrinsics() -> Intrinsics {
    Intrinsics::from_fov_y(240, 320, 60f64.to_radians())
}

/// The measurement of a touch sensor with a flat gel on a solid.
pub fn feel<F: Frame>(
    solid: Solid,
    pose: Isometry<F, World>,
    world_from_camera: Isometry<Camera, World>,
) -> TouchDepth {
    let intrinsics = touch_intrinsics();
    let mut depth_m = Array2::from_elem((intrinsics.height, intrinsics.width), GEL_M);
    let mut contact = Array2::from_elem((intrinsics.height, intrinsics.width), false);
    cast(solid, pose.inverse() * world_from_camera, &intrinsics, |u, v, depth| {
        if (depth as f32) < GEL_M {
            depth_m[(v, u)] = depth as f32;
            contact[(v, u)] = true;
        }
    });
    // The pad moves with the camera in it.
    let world_from_pad = Isometry::new(world_from_camera.untyped());
    TouchDepth { intrinsics, world_from_camera, world_from_pad, depth_m, contact, sigma_m: 0.0003 }
}

/// The measurements of one instant.
#[derive(Debug, Clone, PartialEq)]
pub struct Sensed {
    pub time_s: f64,
    pub cameras: Vec<Option<CameraDepth>>,
    pub touch: Vec<Option<TouchDepth>>,
    pub obstacles: Vec<Isometry<Obstacle, World>>,
}

impl Sensed {
    pub fn measured(&self) -> Measurement<'_> {
        Measurement { time_s: self.time_s, cameras: &self.cameras, touch: &self.touch, obstacles: &self.obstacles }
    }
}

/// An instant at which nothing is touched.
pub fn frame(time_s: f64, cameras: Vec<Option<CameraDepth>>) -> Sensed {
    Sensed { time_s, cameras, touch: Vec::new(), obstacles: Vec::new() }
}

/// The `k`-th frame at 30 Hz of a solid before [`camera`].
pub fn seen<F: Frame>(k: usize, solid: Solid, pose: Isometry<F, World>) -> Sensed {
    frame(k as f64 / 30.0, vec![Some(see(solid, pose, camera()))])
}
