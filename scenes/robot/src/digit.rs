//! Touch sensors of the DIGIT's kind: their camera, gel and body. The constants are those of the DIGIT.

pub mod body;
pub mod gel;
pub mod markers;
pub mod profile;

use mvt_frames::camera::Intrinsics;
use mvt_frames::{Camera, Gel, Isometry};

/// Width of a DIGIT image, pixels.
pub const WIDTH: usize = 240;
/// Height of a DIGIT image, pixels.
pub const HEIGHT: usize = 320;
/// Vertical field of view of the DIGIT's camera in TACTO, degrees.
pub const FOV_Y_DEG: f64 = 60.0;

/// Returns the pinhole model of the DIGIT's camera in TACTO.
pub fn intrinsics() -> Intrinsics {
    Intrinsics::from_fov_y(WIDTH, HEIGHT, FOV_Y_DEG.to_radians())
}

/// Returns the pose of the DIGIT's camera: at the origin of the gel frame, looking along x, with z up.
pub fn gel_from_camera() -> Isometry<Camera, Gel> {
    // Columns: image right = -y, image up = +z, backwards = -x.
    Isometry::from_parts([0.0; 3], [0.5, 0.5, -0.5, -0.5])
}

#[cfg(test)]
mod tests {
    use super::*;
    use mvt_frames::Vector;

    #[test]
    fn camera_looks_out_of_the_gel_with_z_up() {
        let t = gel_from_camera();
        let axis = |x, y, z| (t * Vector::<Camera>::new(x, y, z)).coords();
        assert!((axis(1.0, 0.0, 0.0) - nalgebra::Vector3::new(0.0, -1.0, 0.0)).norm() < 1e-12);
        assert!((axis(0.0, 1.0, 0.0) - nalgebra::Vector3::new(0.0, 0.0, 1.0)).norm() < 1e-12);
        assert!((axis(0.0, 0.0, -1.0) - nalgebra::Vector3::new(1.0, 0.0, 0.0)).norm() < 1e-12);
    }
}
