//! Recordings of runs.

use std::path::PathBuf;
use std::sync::{Mutex, MutexGuard, PoisonError};

use mvt_recording::{Recording as Recorded, Status};
use mvt_run::report::FrameRow;
use numpy::{IntoPyArray as _, PyArray1, PyArray2, PyArrayDyn};
use pyo3::prelude::*;

use crate::arrays::{line, pixels, shaped};
use crate::camera::Camera;
use crate::errors::{Failure, Kind, detached, file};
use crate::mesh::{MeshArrays, arrays};
use crate::slam::state_name;

/// Images of a recorded frame.
#[pyclass(frozen, get_all, module = "mambavitact")]
pub struct RecordingFrame {
    /// Number of the recorded frame.
    frame: usize,
    /// Colours of each camera: uint8 (height, width, 3).
    color: Vec<Py<PyArrayDyn<u8>>>,
    /// Depth of each camera, metres: float32 (height, width).
    depth_m: Vec<Py<PyArray2<f32>>>,
    /// Image of each DIGIT, or None: uint8.
    touch_images: Vec<Option<Py<PyArrayDyn<u8>>>>,
    /// Indentation that the tracker received from each DIGIT, millimetres, or None: float32.
    touch_indentation_mm: Vec<Option<Py<PyArray2<f32>>>>,
}

/// Recording in the folder of a run, also while the run goes on.
#[pyclass(frozen, module = "mambavitact")]
pub struct Recording(Mutex<Recorded>);

impl Recording {
    fn recorded(&self) -> MutexGuard<'_, Recorded> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn of_rows<'py, T: numpy::Element>(
        &self,
        py: Python<'py>,
        value: impl Fn(&FrameRow) -> T,
    ) -> Bound<'py, PyArray1<T>> {
        line(py, self.recorded().moments().iter().map(|moment| value(&moment.row)).collect())
    }

    fn matrices<'py>(
        &self,
        py: Python<'py>,
        pose: fn(&mvt_recording::RecordedMoment) -> Option<[[f64; 4]; 4]>,
    ) -> Bound<'py, PyArrayDyn<f64>> {
        let recorded = self.recorded();
        let moments = recorded.moments();
        let matrices = moments.iter().flat_map(|moment| pose(moment).unwrap_or([[f64::NAN; 4]; 4]).concat());
        shaped(py, matrices.collect(), &[moments.len(), 4, 4])
    }
}

#[pymethods]
impl Recording {
    #[new]
    fn new(py: Python<'_>, folder: PathBuf) -> PyResult<Self> {
        Ok(Self(Mutex::new(detached(py, || Recorded::open(&folder).map_err(file))?)))
    }

    fn __len__(&self) -> usize {
        self.recorded().moments().len()
    }

    /// Reads the new part of the recording. Returns whether anything is new.
    fn refresh(&self, py: Python<'_>) -> PyResult<bool> {
        detached(py, || self.recorded().refresh().map_err(file))
    }

    /// Name of the object, or the path of its mesh.
    #[getter]
    fn object(&self) -> String {
        self.recorded().about().object.clone()
    }

    /// Seed of the run.
    #[getter]
    fn seed(&self) -> u64 {
        self.recorded().about().seed
    }

    /// Hand: left or right.
    #[getter]
    fn side(&self) -> &'static str {
        self.recorded().about().hand.side().name()
    }

    /// The cameras, with the sizes of the recorded images.
    #[getter]
    fn cameras(&self) -> Vec<Camera> {
        self.recorded().about().cameras.iter().cloned().map(Camera).collect()
    }

    /// Status: running, finished, interrupted or crashed.
    #[getter]
    fn status(&self) -> &'static str {
        match self.recorded().status() {
            Status::Running => "running",
            Status::Finished => "finished",
            Status::Interrupted => "interrupted",
            Status::Crashed => "crashed",
        }
    }

    /// Warnings of the run and about damaged files.
    #[getter]
    fn warnings(&self) -> Vec<String> {
        self.recorded().warnings().to_vec()
    }

    /// Events: seconds and a sentence.
    #[getter]
    fn events(&self) -> Vec<(f64, String)> {
        self.recorded().events().iter().map(|event| (event.time_s, event.text.clone())).collect()
    }

    /// Seconds of each frame: float64 (N,).
    #[getter]
    fn times_s<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        self.of_rows(py, |row| row.time_s)
    }

    /// Confidence of each frame, 0 to 1: float64 (N,).
    #[getter]
    fn confidence<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        self.of_rows(py, |row| row.confidence)
    }

    /// State of each frame: tracking, relocalised or lost.
    #[getter]
    fn states(&self) -> Vec<&'static str> {
        self.recorded().moments().iter().map(|moment| state_name(moment.row.state)).collect()
    }

    /// Symmetric ADD-S of each frame, millimetres, NaN where the truth is unknown: float64 (N,).
    #[getter]
    fn add_s_mm<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        self.of_rows(py, |row| row.add_s.map_or(f64::NAN, |error| 1e3 * error.symmetric_m))
    }

    /// ADD of each frame, millimetres, NaN where it is unknown: float64 (N,).
    #[getter]
    fn add_mm<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        self.of_rows(py, |row| row.add_m.map_or(f64::NAN, |add_m| 1e3 * add_m))
    }

    /// Angle between the estimated and the true rotation of each frame, degrees, NaN where it is unknown: float64 (N,).
    #[getter]
    fn rotation_deg<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        self.of_rows(py, |row| row.rotation_error_rad().map_or(f64::NAN, f64::to_degrees))
    }

    /// Estimated pose of each frame: float64 (N, 4, 4).
    #[getter]
    fn poses<'py>(&self, py: Python<'py>) -> Bound<'py, PyArrayDyn<f64>> {
        self.matrices(py, |moment| Some(moment.estimate()?.to_matrix()))
    }

    /// True pose of each frame: float64 (N, 4, 4), NaN where it is unknown.
    #[getter]
    fn true_poses<'py>(&self, py: Python<'py>) -> Bound<'py, PyArrayDyn<f64>> {
        self.matrices(py, |moment| Some(moment.row.truth?.to_matrix()))
    }

    /// Returns the newest images at or before a frame; None before the first.
    fn images(&self, py: Python<'_>, index: usize) -> PyResult<Option<RecordingFrame>> {
        let images = detached(py, || {
            let recorded = self.recorded();
            check(index, recorded.moments().len())?;
            recorded.images(index).map_err(file)
        })?;
        Ok(images.map(|images| {
            let cameras = || images.cameras.iter().flatten();
            RecordingFrame {
                frame: images.frame,
                color: cameras().map(|camera| pixels(py, camera.colour.clone()).unbind()).collect(),
                depth_m: cameras().map(|camera| camera.depth_m.clone().into_pyarray(py).unbind()).collect(),
                touch_images: (images.touch.0.iter())
                    .map(|finger| Some(pixels(py, finger.as_ref()?.image.clone()).unbind()))
                    .collect(),
                touch_indentation_mm: (images.touch.0.iter())
                    .map(|finger| Some(finger.as_ref()?.indentation_mm.clone().into_pyarray(py).unbind()))
                    .collect(),
            }
        }))
    }

    /// Returns the newest shape at or before a frame: vertices, metres, float32 (N, 3), and faces, uint32 (M, 3); None before the first.
    fn mesh<'py>(&self, py: Python<'py>, index: usize) -> PyResult<Option<MeshArrays<'py>>> {
        let shape = detached(py, || {
            let recorded = self.recorded();
            check(index, recorded.moments().len())?;
            recorded.shape(index).map_err(file)
        })?;
        Ok(shape.map(|shape| arrays(py, shape.mesh.clone())))
    }
}

fn check(index: usize, count: usize) -> Result<(), Failure> {
    if index < count {
        return Ok(());
    }
    Err(Kind::Argument.error(format!("index: expected less than {count}, the number of frames, got {index}")))
}
