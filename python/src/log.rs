//! FeelSight logs, and RGB-D sequences without a hand.

use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use indicatif::ProgressBar;
use mvt_feelsight::LogFormat;
use mvt_feelsight::{Log as FeelSight, PartialFrames, TouchPart};
use mvt_frames::Isometry;
use mvt_frames::camera::PosedCamera;
use mvt_frames::depth::GivenLabels;
use mvt_perceive::true_press;
use mvt_render::touch::TouchConfig;
use mvt_rgbd::RgbdFrame;
use mvt_robot::hand::{Hand, PerPad};
use mvt_run::object::load_object;
use mvt_run::source::RgbdSequence;
use mvt_simulated::recorder::{Noise, Recorder, Settings};
use numpy::{PyArray1, PyArrayDyn};
use pyo3::exceptions::PyIndexError;
use pyo3::prelude::*;

use crate::arrays::{line, shaped};
use crate::camera::{Camera, around, read_rig};
use crate::errors::{Failure, Kind, argument, check_camera_noise, check_duration, detached, file, warn};
use crate::frame::Frame;

/// FeelSight log of an episode, of this program or published; or an RGB-D sequence without a hand: a folder in a known layout, or a bag of ROS 2. A sequence of
/// frames; iterating reads it once from beginning to end, which is faster than asking for each frame. Frames of an RGB-D sequence have `masks` and no
/// joints.
#[pyclass(frozen, module = "mambavitact")]
pub struct Log {
    folder: PathBuf,
    kind: LogKind,
}

/// What a log is.
enum LogKind {
    Hand(Box<FeelSight>),
    /// A sequence with its camera, and a hand without joints and sensors.
    Sequence {
        sequence: Mutex<RgbdSequence>,
        camera: Box<PosedCamera>,
        hand: Arc<Hand>,
    },
}

/// Iterator over the frames of a log.
#[pyclass(frozen, module = "mambavitact")]
pub struct LogFrames(Mutex<Reader>);

enum Reader {
    Hand { frames: Box<PartialFrames>, next: usize },
    Sequence { sequence: Box<RgbdSequence>, next: usize },
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

/// Reads a frame of an RGB-D sequence.
fn frame_of(sequence: &mut RgbdSequence, index: usize) -> Result<Frame, Failure> {
    let RgbdFrame { time_s, color, depth_m, mask, world_from_camera, camera_from_object, .. } =
        sequence.frame(index).map_err(Kind::File.of())?;
    Ok(Frame {
        time_s,
        joints: Vec::new(),
        colours: vec![color],
        depths_m: vec![depth_m],
        labels: mask.map(GivenLabels::Mask).into_iter().collect(),
        touch: None,
        presses: PerPad::default(),
        // Of the object as the data set defines it.
        object_pose: camera_from_object.map(|pose| Isometry::new((world_from_camera * pose).untyped())),
        world_from_camera: Some(world_from_camera),
        next_joints: None,
    })
}

fn open_sequence(folder: &Path) -> Result<RgbdSequence, Failure> {
    RgbdSequence::open(folder).map_err(Kind::File.of())
}

fn locked(sequence: &Mutex<RgbdSequence>) -> MutexGuard<'_, RgbdSequence> {
    sequence.lock().unwrap_or_else(PoisonError::into_inner)
}

#[pymethods]
impl Log {
    #[new]
    fn new(py: Python<'_>, folder: PathBuf) -> PyResult<Self> {
        if !RgbdSequence::is_here(&folder) {
            let log = detached(py, || FeelSight::open_tolerant(&folder).map_err(file))?;
            return Ok(Self { folder, kind: LogKind::Hand(Box::new(log)) });
        }
        let sequence = detached(py, || open_sequence(&folder))?;
        warn(py, sequence.notes().iter().map(|note| format!("{}: {note}", folder.display())).collect())?;
        let first = sequence.intrinsics().zip(sequence.camera_poses().first().copied());
        let Some((intrinsics, pose)) = first else {
            return Err(Kind::File.error(format!("{}: there are no frames", folder.display())).into());
        };
        let camera = Box::new(PosedCamera { name: "camera".to_owned(), intrinsics, pose });
        Ok(Self { folder, kind: LogKind::Sequence { sequence: Mutex::new(sequence), camera, hand: Hand::none() } })
    }

    fn __len__(&self) -> usize {
        match &self.kind {
            LogKind::Hand(log) => log.len(),
            LogKind::Sequence { sequence, .. } => locked(sequence).len(),
        }
    }

    fn __getitem__(&self, py: Python<'_>, index: isize) -> PyResult<Frame> {
        let count = self.__len__();
        let place = if index < 0 { index + count as isize } else { index };
        let Some(place) = usize::try_from(place).ok().filter(|&place| place < count) else {
            return Err(PyIndexError::new_err(format!("the log has {count} frames, got index {index}")));
        };
        detached(py, || {
            let log = match &self.kind {
                LogKind::Hand(log) => log,
                LogKind::Sequence { sequence, .. } => return frame_of(&mut locked(sequence), place),
            };
            let frame = log.frame(place).map_err(file)?;
            let frame = frame
                .ok_or_else(|| Kind::File.error(format!("{}: frame {place} is missing", self.folder.display())))?;
            Ok(complete(log, place, Frame::observed(log.hand(), frame.observation, None)))
        })
    }

    fn __iter__(&self, py: Python<'_>) -> PyResult<LogFrames> {
        detached(py, || {
            if matches!(self.kind, LogKind::Sequence { .. }) {
                let sequence = Box::new(open_sequence(&self.folder)?);
                return Ok(LogFrames(Mutex::new(Reader::Sequence { sequence, next: 0 })));
            }
            let log = FeelSight::open_tolerant(&self.folder).map_err(file)?;
            let cameras: Vec<usize> = (0..log.cameras().len()).collect();
            let frames = Box::new(log.into_partial_frames(&cameras, TouchPart::Images));
            Ok(LogFrames(Mutex::new(Reader::Hand { frames, next: 0 })))
        })
    }

    /// Folder of the log, or file of the bag.
    #[getter]
    fn folder(&self) -> &Path {
        &self.folder
    }

    /// Names of the frames: those of an RGB-D data set, stamps of a bag in nanoseconds, or numbers.
    #[getter]
    fn names(&self) -> Vec<String> {
        match &self.kind {
            LogKind::Hand(log) => (0..log.len()).map(|k| k.to_string()).collect(),
            LogKind::Sequence { sequence, .. } => locked(sequence).names(),
        }
    }

    /// Name of the object, or the path of its mesh; `unknown` if an RGB-D sequence names none.
    #[getter]
    fn object(&self) -> String {
        match &self.kind {
            LogKind::Hand(log) => {
                log.scene().map_or_else(|| log.object_name().to_owned(), |scene| scene.object.mesh.clone())
            }
            LogKind::Sequence { sequence, .. } => locked(sequence).object_name().unwrap_or("unknown").to_owned(),
        }
    }

    /// Seed of the episode; None in logs of other programs.
    #[getter]
    fn seed(&self) -> Option<u64> {
        match &self.kind {
            LogKind::Hand(log) => Some(log.scene()?.seed),
            LogKind::Sequence { .. } => None,
        }
    }

    /// Hand: left or right.
    #[getter]
    fn side(&self) -> &'static str {
        self.hand().side().name()
    }

    /// The cameras.
    #[getter]
    fn cameras(&self) -> Vec<Camera> {
        match &self.kind {
            LogKind::Hand(log) => log.cameras().iter().cloned().map(Camera).collect(),
            LogKind::Sequence { camera, .. } => vec![Camera(camera.as_ref().clone())],
        }
    }

    /// Seconds of each frame: float64 (N,).
    #[getter]
    fn times_s<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        match &self.kind {
            LogKind::Hand(log) => line(py, log.times_s().to_vec()),
            LogKind::Sequence { sequence, .. } => line(py, locked(sequence).times_s()),
        }
    }

    /// Joint angles of each frame, radians: float64 (N, J) for the J joints of the hand.
    #[getter]
    fn joints<'py>(&self, py: Python<'py>) -> Bound<'py, PyArrayDyn<f64>> {
        let angles = match &self.kind {
            LogKind::Hand(log) => log.joints().concat(),
            LogKind::Sequence { .. } => Vec::new(),
        };
        shaped(py, angles, &[self.__len__(), self.hand().joints().len()])
    }

    /// True pose of the object in each frame: float64 (N, 4, 4), NaN where it is unknown.
    #[getter]
    fn object_poses<'py>(&self, py: Python<'py>) -> Bound<'py, PyArrayDyn<f64>> {
        let poses: Vec<Option<[[f64; 4]; 4]>> = match &self.kind {
            LogKind::Hand(log) => log.object_poses().iter().map(|pose| pose.map(Isometry::to_matrix)).collect(),
            LogKind::Sequence { sequence, .. } => {
                let sequence = locked(sequence);
                let pairs = sequence.camera_poses().into_iter().zip(sequence.object_poses());
                pairs.map(|(camera, object)| Some((camera * object?).to_matrix())).collect()
            }
        };
        let matrices = poses.iter().flat_map(|pose| pose.unwrap_or([[f64::NAN; 4]; 4]).concat());
        shaped(py, matrices.collect(), &[poses.len(), 4, 4])
    }
}

impl Log {
    fn hand(&self) -> &Hand {
        match &self.kind {
            LogKind::Hand(log) => log.hand(),
            LogKind::Sequence { hand, .. } => hand,
        }
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
            let (frames, next) = match &mut *reader {
                Reader::Hand { frames, next } => (frames, next),
                Reader::Sequence { sequence, next } => {
                    let index = *next;
                    *next += 1;
                    return if index < sequence.len() { frame_of(sequence, index).map(Some) } else { Ok(None) };
                }
            };
            let Some(partial) = frames.next() else { return Ok(None) };
            let index = *next;
            *next += 1;
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
                world_from_camera: None,
                next_joints: None,
            };
            Ok(Some(complete(frames.log(), index, frame)))
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
