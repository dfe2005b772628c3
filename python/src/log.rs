//! FeelSight logs.

use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use indicatif::ProgressBar;
use mvt_feelsight::LogFormat;
use mvt_feelsight::{Log as FeelSight, PartialFrames, TouchPart};
use mvt_perceive::true_press;
use mvt_render::touch::TouchConfig;
use mvt_robot::hand::PerPad;
use mvt_run::object::load_object;
use mvt_simulated::recorder::{Noise, Recorder, Settings};
use numpy::{PyArray1, PyArrayDyn};
use pyo3::exceptions::PyIndexError;
use pyo3::prelude::*;

use crate::arrays::{line, shaped};
use crate::camera::{Camera, around, read_rig};
use crate::errors::{Kind, argument, check_camera_noise, check_duration, detached, file};
use crate::frame::Frame;

/// FeelSight log of an episode: of this program, or published. A sequence of frames; iterating reads it once from beginning to end, which is
/// faster than asking for each frame.
#[pyclass(frozen, module = "mambavitact")]
pub struct Log {
    folder: PathBuf,
    log: FeelSight,
}

/// Iterator over the frames of a log.
#[pyclass(frozen, module = "mambavitact")]
pub struct LogFrames(Mutex<Reader>);

struct Reader {
    frames: PartialFrames,
    next: usize,
}

/// Returns the data of a frame besides joints, depths and touch images.
fn complete(log: &FeelSight, index: usize, mut frame: Frame) -> Frame {
    frame.colours = (0..log.cameras().len()).map(|k| log.colour(k, index).unwrap_or_default()).collect();
    let gels = log.hand().gel_views();
    frame.presses = log.hand().per_pad(|pad| true_press(&log.touch_truth(pad, index).ok()?, gels.get(pad)?));
    frame.object_pose = log.object_poses().get(index).copied().flatten();
    frame.next_joints = log.times_s().get(index + 1).copied().zip(log.joints().get(index + 1).cloned());
    frame
}

#[pymethods]
impl Log {
    #[new]
    fn new(py: Python<'_>, folder: PathBuf) -> PyResult<Self> {
        let log = detached(py, || FeelSight::open_tolerant(&folder).map_err(file))?;
        Ok(Self { folder, log })
    }

    fn __len__(&self) -> usize {
        self.log.len()
    }

    fn __getitem__(&self, py: Python<'_>, index: isize) -> PyResult<Frame> {
        let count = self.log.len();
        let place = if index < 0 { index + count as isize } else { index };
        let Some(place) = usize::try_from(place).ok().filter(|&place| place < count) else {
            return Err(PyIndexError::new_err(format!("the log has {count} frames, got index {index}")));
        };
        detached(py, || {
            let frame = self.log.frame(place).map_err(file)?;
            let frame = frame
                .ok_or_else(|| Kind::File.error(format!("{}: frame {place} is missing", self.folder.display())))?;
            Ok(complete(&self.log, place, Frame::observed(self.log.hand(), frame.observation, None)))
        })
    }

    fn __iter__(&self, py: Python<'_>) -> PyResult<LogFrames> {
        detached(py, || {
            let log = FeelSight::open_tolerant(&self.folder).map_err(file)?;
            let cameras: Vec<usize> = (0..log.cameras().len()).collect();
            let frames = log.into_partial_frames(&cameras, TouchPart::Images);
            Ok(LogFrames(Mutex::new(Reader { frames, next: 0 })))
        })
    }

    /// Folder of the log.
    #[getter]
    fn folder(&self) -> &Path {
        &self.folder
    }

    /// Name of the object, or the path of its mesh.
    #[getter]
    fn object(&self) -> &str {
        self.log.scene().map_or(self.log.object_name(), |scene| &scene.object.mesh)
    }

    /// Seed of the episode; None in logs of other programs.
    #[getter]
    fn seed(&self) -> Option<u64> {
        Some(self.log.scene()?.seed)
    }

    /// Hand: left or right.
    #[getter]
    fn side(&self) -> &'static str {
        self.log.hand().side().name()
    }

    /// The cameras.
    #[getter]
    fn cameras(&self) -> Vec<Camera> {
        self.log.cameras().iter().cloned().map(Camera).collect()
    }

    /// Seconds of each frame: float64 (N,).
    #[getter]
    fn times_s<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        line(py, self.log.times_s().to_vec())
    }

    /// Joint angles of each frame, radians: float64 (N, J) for the J joints of the hand.
    #[getter]
    fn joints<'py>(&self, py: Python<'py>) -> Bound<'py, PyArrayDyn<f64>> {
        shaped(py, self.log.joints().concat(), &[self.log.len(), self.log.hand().joints().len()])
    }

    /// True pose of the object in each frame: float64 (N, 4, 4), NaN where it is unknown.
    #[getter]
    fn object_poses<'py>(&self, py: Python<'py>) -> Bound<'py, PyArrayDyn<f64>> {
        let poses = self.log.object_poses();
        let matrices =
            poses.iter().flat_map(|pose| pose.map_or([[f64::NAN; 4]; 4], mvt_frames::Isometry::to_matrix).concat());
        shaped(py, matrices.collect(), &[poses.len(), 4, 4])
    }
}

#[pymethods]
impl LogFrames {
    fn __iter__(this: PyRef<'_, Self>) -> PyRef<'_, Self> {
        this
    }

    fn __next__(&self, py: Python<'_>) -> PyResult<Option<Frame>> {
        detached(py, || {
            let mut reader = self.0.lock().unwrap_or_else(PoisonError::into_inner);
            let Some(partial) = reader.frames.next() else { return Ok(None) };
            let index = reader.next;
            reader.next += 1;
            if let Some((_, defect)) = partial.defects.into_iter().next() {
                return Err(file(defect));
            }
            let depth = |depth: Option<ndarray::Array2<f32>>| {
                depth.unwrap_or_default().mapv(|z| if z.is_finite() && z > 0.0 { z } else { 0.0 })
            };
            let frame = Frame {
                time_s: partial.time_s,
                joints: partial.joints,
                colours: Vec::new(),
                depths_m: partial.cameras.into_iter().map(depth).collect(),
                labels: Vec::new(),
                touch: Some(partial.touch_images.into_iter().map(Option::unwrap_or_default).collect()),
                presses: PerPad::default(),
                object_pose: None,
                next_joints: None,
            };
            Ok(Some(complete(reader.frames.log(), index, frame)))
        })
    }
}

/// Simulates an episode and writes it as a log, as `mambavitact generate` does. Arguments as of `Episode`. An existing log is replaced only
/// with `overwrite`.
#[pyfunction]
#[pyo3(signature = (folder, object, *, seed = 0, rig = "allegro_digit", side = None, gait = "auto", duration_s = 30.0, cameras = "front-left", touch_noise = true, camera_noise = 0.0, overwrite = false))]
pub fn record_log(
    py: Python<'_>,
    folder: PathBuf,
    object: &str,
    seed: u64,
    rig: &str,
    side: Option<&str>,
    gait: &str,
    duration_s: f64,
    cameras: &str,
    touch_noise: bool,
    camera_noise: f64,
    overwrite: bool,
) -> PyResult<Log> {
    let rig = read_rig(py, rig, side)?;
    let cameras = around(cameras, &rig)?;
    let hand = rig.hand;
    check_duration(duration_s)?;
    check_camera_noise(camera_noise)?;
    let settings = Settings {
        controller: gait.to_owned(),
        hand,
        duration_s,
        noise: Noise { touch: touch_noise, camera_depth: (camera_noise > 0.0).then_some(camera_noise) },
        touch_config: TouchConfig::Fork,
        background: None,
    };
    detached(py, || {
        let loaded = load_object(object).map_err(argument)?;
        let recorder = Recorder::new(&loaded, object, &settings).map_err(Kind::Argument.of())?;
        recorder
            .record(seed, &cameras, &folder, LogFormat::default(), overwrite, &ProgressBar::hidden())
            .map_err(Kind::File.of())?;
        Ok(())
    })?;
    Log::new(py, folder)
}
