//! Cameras around the hand.

use mvt_frames::camera::{Intrinsics, PosedCamera};
use mvt_hands::LoadedHand;
use mvt_robot::hand::Side;
use numpy::PyArrayDyn;
use pyo3::prelude::*;

use crate::arrays::{matrix, motion, numbers, shaped};
use crate::errors::{Kind, argument, detached, warn};

/// Pinhole camera. `intrinsics` is 3 x 3, in pixels; `pose` is 4 x 4 and takes the camera's coordinates (OpenGL axes, metres) to the
/// world.
#[pyclass(frozen, module = "mambavitact")]
pub struct Camera(pub PosedCamera);

#[pymethods]
impl Camera {
    #[new]
    #[pyo3(signature = (name, width, height, intrinsics, pose))]
    fn new(
        name: String,
        width: usize,
        height: usize,
        intrinsics: &Bound<'_, PyAny>,
        pose: &Bound<'_, PyAny>,
    ) -> PyResult<Self> {
        /// Longest side of an image, pixels.
        const LONGEST: usize = 16_384;
        if !(1..=LONGEST).contains(&width) || !(1..=LONGEST).contains(&height) {
            let text = format!("width and height are {width} and {height}; expected 1 to {LONGEST} pixels");
            return Err(Kind::Argument.error(text).into());
        }
        let k = numbers(intrinsics, "intrinsics", &[Some(3), Some(3)])?;
        let intrinsics = Intrinsics { width, height, fx: k[[0, 0]], fy: k[[1, 1]], cx: k[[0, 2]], cy: k[[1, 2]] };
        if intrinsics.fx <= 0.0 || intrinsics.fy <= 0.0 {
            return Err(Kind::Argument
                .error("intrinsics: the focal lengths [0, 0] and [1, 1] must be positive")
                .into());
        }
        Ok(Self(PosedCamera { name, intrinsics, pose: motion(pose, "pose")? }))
    }

    /// Returns the cameras of a comma-separated list of places: front-left, back-right, top-down, side, or azimuth/elevation in degrees,
    /// such as 330/35.
    #[staticmethod]
    #[pyo3(signature = (places, side = None, rig = "allegro_digit"))]
    fn placed(py: Python<'_>, places: &str, side: Option<&str>, rig: &str) -> PyResult<Vec<Self>> {
        Ok(around(places, &read_rig(py, rig, side)?)?.into_iter().map(Self).collect())
    }

    /// Name, also of the folder in a log.
    #[getter]
    fn name(&self) -> &str {
        &self.0.name
    }

    /// Width of the images, pixels.
    #[getter]
    fn width(&self) -> usize {
        self.0.intrinsics.width
    }

    /// Height of the images, pixels.
    #[getter]
    fn height(&self) -> usize {
        self.0.intrinsics.height
    }

    /// Pinhole model in pixels: float64 (3, 3).
    #[getter]
    fn intrinsics<'py>(&self, py: Python<'py>) -> Bound<'py, PyArrayDyn<f64>> {
        let k = &self.0.intrinsics;
        shaped(py, vec![k.fx, 0.0, k.cx, 0.0, k.fy, k.cy, 0.0, 0.0, 1.0], &[3, 3])
    }

    /// From the camera to the world: float64 (4, 4).
    #[getter]
    fn pose<'py>(&self, py: Python<'py>) -> Bound<'py, PyArrayDyn<f64>> {
        matrix(py, self.0.pose)
    }
}

/// Returns the cameras of a list of places or names of the rig; none for an empty list.
pub fn around(places: &str, rig: &LoadedHand) -> PyResult<Vec<PosedCamera>> {
    if places.is_empty() {
        return Ok(Vec::new());
    }
    Ok(rig.placed(places).map_err(argument)?)
}

/// Loads a rig by its name or file. `side`, left or right, chooses the side of the built-in hand.
pub fn read_rig(py: Python<'_>, rig: &str, side: Option<&str>) -> PyResult<LoadedHand> {
    let side = match side {
        None => None,
        Some("left") => Some(Side::Left),
        Some("right") => Some(Side::Right),
        Some(other) => {
            return Err(Kind::Argument.error(format!("side: expected left or right, got {other:?}")).into());
        }
    };
    let mut loaded = detached(py, || LoadedHand::rig(rig, side).map_err(argument))?;
    warn(py, std::mem::take(&mut loaded.warnings))?;
    Ok(loaded)
}
