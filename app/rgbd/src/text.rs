//! Numbers in text files.

use std::path::Path;

use mvt_files::input;
use mvt_frames::{Camera, Frame, Isometry};
use nalgebra as na;

use crate::error::RgbdError;

/// Largest text file that is read, bytes: an hour of poses.
const LARGEST_TEXT: u64 = 64 << 20;

/// Reads a text.
pub(crate) fn read(path: &Path) -> Result<String, RgbdError> {
    input::read_text(path, LARGEST_TEXT).map_err(RgbdError::io(path))
}

/// Reads all numbers of a text; spaces, commas, semicolons and brackets are between them.
pub(crate) fn numbers(path: &Path) -> Result<Vec<f64>, RgbdError> {
    let text = read(path)?;
    let words = text.split(|c: char| c.is_whitespace() || ",;[]".contains(c)).filter(|word| !word.is_empty());
    let number = |word: &str| {
        word.parse::<f64>()
            .ok()
            .filter(|number| number.is_finite())
            .ok_or_else(|| RgbdError::fault(path, format!("{word:?} is not a number")))
    };
    words.map(number).collect()
}

/// Reads fx, fy, cx and cy from the 9 numbers of a camera matrix.
pub(crate) fn camera_matrix(path: &Path) -> Result<[f64; 4], RgbdError> {
    of_matrix(&numbers(path)?).ok_or_else(|| RgbdError::fault(path, "it is not a camera matrix of 3 x 3 numbers"))
}

/// Returns fx, fy, cx and cy of a camera matrix, row by row.
pub(crate) fn of_matrix(matrix: &[f64]) -> Option<[f64; 4]> {
    let &[fx, _, cx, _, fy, cy, _, _, one] = matrix else { return None };
    (fx > 0.0 && fy > 0.0 && one == 1.0).then_some([fx, fy, cx, cy])
}

/// Reads the 16 numbers of a motion, row by row.
pub(crate) fn motion(path: &Path) -> Result<na::Isometry3<f64>, RgbdError> {
    let numbers = numbers(path)?;
    let rows: Option<[[f64; 4]; 4]> =
        (numbers.len() == 16).then(|| std::array::from_fn(|i| std::array::from_fn(|j| numbers[4 * i + j])));
    let rows = rows.ok_or_else(|| {
        RgbdError::fault(path, format!("a pose of 4 x 4 numbers is expected; it has {}", numbers.len()))
    })?;
    // The frames are those of the file.
    Isometry::<Camera, Camera>::from_matrix(&rows)
        .map(Isometry::untyped)
        .map_err(|reason| RgbdError::fault(path, format!("the pose is {reason}")))
}

/// Reads a pose of a camera's file, 4 x 4 numbers with OpenCV axes (x right, y down, z forward).
///
/// # Errors
/// [`RgbdError`] if the file cannot be read or holds no rigid motion.
pub fn read_pose_in_camera<From: Frame>(path: &Path) -> Result<Isometry<From, Camera>, RgbdError> {
    motion(path).map(to_opencv)
}

/// From a camera with OpenCV axes (x right, y down, z forward) to one with OpenGL axes, and back.
fn other_axes() -> na::Isometry3<f64> {
    na::Isometry3::rotation(na::Vector3::x() * std::f64::consts::PI)
}

/// Returns a motion from a camera with OpenCV axes as one from a [`Camera`].
pub(crate) fn from_opencv<To: Frame>(to_from_camera: na::Isometry3<f64>) -> Isometry<Camera, To> {
    Isometry::new(to_from_camera * other_axes())
}

/// Returns a motion to a camera with OpenCV axes as one to a [`Camera`].
pub(crate) fn to_opencv<From: Frame>(camera_from: na::Isometry3<f64>) -> Isometry<From, Camera> {
    Isometry::new(other_axes() * camera_from)
}
