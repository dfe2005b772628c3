//! Touch images: rendering, and networks that read them.

use std::path::PathBuf;
use std::sync::Arc;

use mvt_products::Instructions;
use mvt_render::touch::{Background, TouchConfig, render_contact};
use mvt_robot::digit::profile::SensorProfile;
use mvt_run::source::{shipped_weights, weights_of};
use mvt_touch::contact::{ContactConfig, TouchSensor};
use mvt_touch::engine::Engine;
use mvt_touch::network::Weights;
use numpy::{IntoPyArray as _, PyArray1, PyArray2, PyArray3, PyArrayDyn};
use pyo3::prelude::*;

use crate::arrays::{image, line, numbers, shaped};
use crate::errors::{Kind, argument, detached, file, general, warn};
use crate::mesh;

/// Network that reads images of touch sensors. `weights` is a file of weights; without it those of the sensor's `profile` (a name such as digit, or
/// the path of a profile), or those that are shipped.
#[pyclass(frozen, module = "mambavitact")]
pub struct TouchNetwork {
    pub weights: Arc<Weights>,
    profile: SensorProfile,
    engine: Engine,
}

/// The contacts that a network finds in touch images.
#[pyclass(frozen, get_all, module = "mambavitact")]
pub struct TouchPrediction {
    /// How far the gel is pressed in, millimetres, 0 in implausible images: float32 (N, height, width).
    indentation_mm: Py<PyArrayDyn<f32>>,
    /// Where the object lies on the gel: bool (N, height, width).
    contact: Py<PyArrayDyn<bool>>,
    /// How far each image looks like one that a DIGIT makes, 0 to 1: float32 (N,).
    plausibility: Py<PyArray1<f32>>,
}

/// Images of one press.
#[pyclass(frozen, get_all, module = "mambavitact")]
pub struct TouchRendering {
    /// Without background: uint8 (320, 240, 3).
    raw: Py<PyArray3<u8>>,
    /// On the background: uint8 (320, 240, 3).
    calibrated: Py<PyArray3<u8>>,
    /// Depth along the camera's axis to the nearer of gel and object, metres: float32 (320, 240).
    depth_m: Py<PyArray2<f32>>,
}

impl TouchNetwork {
    fn of(weights: Weights, profile: SensorProfile) -> Self {
        let engine = Engine::new(&weights, Instructions::best());
        Self { weights: Arc::new(weights), profile, engine }
    }
}

#[pymethods]
impl TouchNetwork {
    #[new]
    #[pyo3(signature = (weights = None, profile = "tacto"))]
    fn new(py: Python<'_>, weights: Option<PathBuf>, profile: &str) -> PyResult<Self> {
        detached(py, || {
            let profile = SensorProfile::load(profile).map_err(argument)?;
            let weights = match weights.as_ref().or(profile.weights.as_ref()) {
                Some(path) => weights_of(path, &profile).map_err(file)?,
                None => shipped_weights(&profile).map_err(Kind::Argument.of())?,
            };
            Ok(Self::of(weights, profile))
        })
    }

    /// Returns the network that runs use: it sees images of half the width and height, and takes a quarter of the time.
    #[staticmethod]
    fn of_runs(py: Python<'_>) -> PyResult<Self> {
        detached(py, || {
            let weights = Weights::shipped_half().map_err(general)?;
            Ok(Self::of(weights, SensorProfile::tacto()))
        })
    }

    /// Predicts indentation, contact and plausibility of images, uint8 (N, height, width, 3), each by itself. `untouched`, uint8 (height, width, 3), is
    /// the image of the same sensor without contact; with it the prediction is better.
    #[pyo3(signature = (images, untouched = None))]
    fn predict(
        &self,
        py: Python<'_>,
        images: &Bound<'_, PyAny>,
        untouched: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<TouchPrediction> {
        /// Images between two looks for Ctrl-C: a fraction of a second.
        const AT_ONCE: usize = 32;
        let [height, width] = self.profile.shape();
        let size = [Some(height), Some(width)];
        let seen = crate::arrays::images(images, "images", None, size)?;
        let untouched = untouched.map(|untouched| image(untouched, "untouched", size)).transpose()?;
        let mut sensor = TouchSensor::new(&self.engine, &self.profile);
        if let Some(untouched) = &untouched {
            detached(py, || sensor.set_untouched(&self.engine, untouched).map_err(argument))?;
            let light = sensor.light();
            warn(py, if light.is_usual() { Vec::new() } else { vec![light.to_string()] })?;
        }
        let count = seen.len();
        let (mut indentation, mut contact) = (Vec::with_capacity(count * height * width), Vec::new());
        let mut plausibility = Vec::with_capacity(count);
        for part in seen.chunks(AT_ONCE) {
            let felt =
                detached(py, || sensor.feel_each(&self.engine, &ContactConfig::default(), part).map_err(argument))?;
            for felt in felt {
                plausibility.push(felt.plausibility);
                match felt.press {
                    Some(press) => {
                        indentation.extend(press.indentation_mm);
                        contact.extend(press.contact);
                    }
                    None => {
                        indentation.resize(indentation.len() + height * width, 0.0);
                        contact.resize(contact.len() + height * width, false);
                    }
                }
            }
        }
        let shape = [count, height, width];
        Ok(TouchPrediction {
            indentation_mm: shaped(py, indentation, &shape).unbind(),
            contact: shaped(py, contact, &shape).unbind(),
            plausibility: line(py, plausibility).unbind(),
        })
    }
}

/// Renders a DIGIT's image of a mesh that it touches, as TACTO does, without noise.
///
/// `mesh` is a path or a pair of arrays, vertices (N, 3) in metres and faces (M, 3). `pose` is 4 x 4 and takes the mesh to the sensor.
/// `sensor` is fork (YCB-Slide, FeelSight) or tacto (TACTO 0.0.3). `background` is an untouched image, uint8 (320, 240, 3).
#[pyfunction]
#[pyo3(signature = (mesh, pose, sensor = "fork", background = None))]
pub fn render_touch(
    py: Python<'_>,
    mesh: &Bound<'_, PyAny>,
    pose: &Bound<'_, PyAny>,
    sensor: &str,
    background: Option<&Bound<'_, PyAny>>,
) -> PyResult<TouchRendering> {
    let mesh = mesh::read(mesh, "mesh")?;
    let pose = numbers(pose, "pose", &[Some(4), Some(4)])?;
    let pose: [[f64; 4]; 4] = std::array::from_fn(|i| std::array::from_fn(|j| pose[[i, j]]));
    let config: TouchConfig = sensor.parse().map_err(argument)?;
    let background = match background {
        Some(value) => Background::Image(image(value, "background", SensorProfile::tacto().shape().map(Some))?),
        None => Background::Rendered,
    };
    let rendered = detached(py, || {
        // As the command does: repairs move no vertex.
        let (mesh, _) = mvt_mesh::repair(&mesh, "mesh").map_err(argument)?;
        render_contact(&mesh, &pose, config, background).map_err(argument)
    })?;
    Ok(TouchRendering {
        raw: rendered.raw.into_pyarray(py).unbind(),
        calibrated: rendered.calibrated.into_pyarray(py).unbind(),
        depth_m: rendered.depth_m.into_pyarray(py).unbind(),
    })
}
