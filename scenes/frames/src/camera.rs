//! Pinhole cameras.

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use crate::frame::{Camera, Isometry, Point, World};

/// Pinhole intrinsics without lens distortion.
///
/// The centre of pixel (column u, row v) is at (u, v), as in NeuralFeels' loaders. With OpenGL axes, depth z > 0 along
/// the optical axis gives the point ((u - cx) z / fx, -(v - cy) z / fy, -z).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Intrinsics {
    /// Image width, pixels.
    pub width: usize,
    /// Image height, pixels.
    pub height: usize,
    /// Focal length along the columns, pixels.
    pub fx: f64,
    /// Focal length along the rows, pixels.
    pub fy: f64,
    /// Column of the principal point, pixels.
    pub cx: f64,
    /// Row of the principal point, pixels.
    pub cy: f64,
}

impl Intrinsics {
    /// Returns intrinsics with square pixels, the principal point in the middle of the image, and a vertical field of
    /// view.
    pub fn from_fov_y(width: usize, height: usize, fov_y_rad: f64) -> Self {
        let f = 0.5 * height as f64 / (0.5 * fov_y_rad).tan();
        Self { width, height, fx: f, fy: f, cx: 0.5 * (width as f64 - 1.0), cy: 0.5 * (height as f64 - 1.0) }
    }

    /// Returns the point at pixel (u, v) and `depth_m` along the optical axis.
    pub fn unproject(&self, u: f64, v: f64, depth_m: f64) -> Point<Camera> {
        Point::new((u - self.cx) / self.fx * depth_m, -(v - self.cy) / self.fy * depth_m, -depth_m)
    }

    /// Returns the pixel (u, v) of a point; `None` behind the camera.
    pub fn project(&self, point: Point<Camera>) -> Option<(f64, f64)> {
        let p = point.coords();
        (p.z < 0.0).then(|| (self.cx - p.x / p.z * self.fx, self.cy + p.y / p.z * self.fy))
    }
}

/// Camera with a name and a pose.
#[derive(Debug, Clone, PartialEq)]
pub struct PosedCamera {
    /// Name, also of the folder in a log.
    pub name: String,
    /// Pinhole model.
    pub intrinsics: Intrinsics,
    /// Pose of the camera.
    pub pose: Isometry<Camera, World>,
}

/// Returns the pose of a camera at `eye` that looks at `target`; `up` points upwards in the image. Metres in the world.
pub fn look_at(eye: Vector3<f64>, target: Vector3<f64>, up: Vector3<f64>) -> Isometry<Camera, World> {
    let back = (eye - target).normalize();
    // A camera that looks along `up` has no defined roll; the world's x axis then points up in the image.
    let side = up.cross(&back);
    let right = if side.norm() > 1e-9 { side.normalize() } else { Vector3::x().cross(&back).normalize() };
    let rotation = nalgebra::Rotation3::from_basis_unchecked(&[right, back.cross(&right), back]);
    Isometry::new(nalgebra::Isometry3::from_parts(
        eye.into(),
        nalgebra::UnitQuaternion::from_rotation_matrix(&rotation),
    ))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn projection_round_trip(u in -50.0..700.0, v in -50.0..500.0, depth in 0.01..3.0, fov in 0.2..2.5) {
            let k = Intrinsics::from_fov_y(640, 480, fov);
            let point = k.unproject(u, v, depth);
            prop_assert!((point.coords().z + depth).abs() < 1e-12);
            let (u_again, v_again) = k.project(point).unwrap();
            prop_assert!((u - u_again).abs() < 1e-8 && (v - v_again).abs() < 1e-8);
        }
    }
}
