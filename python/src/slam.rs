//! The estimator.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use glam::{Mat3A, Vec3, Vec3A};
use mvt_field::shape::{Distance, Shape as _};
use mvt_frames::camera::PosedCamera;
use mvt_perceive::{Perception, PerceptionSetup};
use mvt_robot::hand::{Hand, PerPad};
use mvt_run::carrier::{LabelCarrier, leave_labels_open};
use mvt_run::config::RunConfig;
use mvt_run::estimator::Estimator;
use mvt_run::source::Modality;
use mvt_slam::TrackState;
use mvt_slam::map::Map;
use numpy::{PyArray1, PyArrayDyn};
use pyo3::prelude::*;

use crate::arrays::{images, line, matrix, shaped, singles};
use crate::camera::{Camera, read_rig};
use crate::errors::{Kind, argument, detached, warn};
use crate::frame::Frame;
use crate::mesh::{MeshArrays, arrays};
use crate::touch::TouchNetwork;

/// Estimate of a frame.
#[pyclass(frozen, module = "mambavitact")]
pub struct Estimate(mvt_slam::Estimate);

#[pymethods]
impl Estimate {
    /// Number of the frame.
    #[getter]
    fn frame(&self) -> usize {
        self.0.frame
    }

    /// Seconds since the start.
    #[getter]
    fn time_s(&self) -> f64 {
        self.0.time_s
    }

    /// Estimated pose: it takes the coordinates of `Slam.mesh` to the world. float64 (4, 4).
    #[getter]
    fn pose<'py>(&self, py: Python<'py>) -> Bound<'py, PyArrayDyn<f64>> {
        matrix(py, self.0.pose)
    }

    /// How far the tracker trusts the pose, 0 to 1.
    #[getter]
    fn confidence(&self) -> f64 {
        self.0.confidence
    }

    /// How far the pose may place the surface off, metres, one standard deviation; None while the object is lost.
    #[getter]
    fn deviation_m(&self) -> Option<f64> {
        self.0.deviation.map(|deviation| deviation.surface_m)
    }

    /// How far the rotation may be off, degrees, one standard deviation; 180 where nothing tells it.
    #[getter]
    fn deviation_deg(&self) -> Option<f64> {
        self.0.deviation.map(|deviation| deviation.angle_rad.to_degrees())
    }

    /// State: waiting (nothing seen yet), tracking, relocalised or lost.
    #[getter]
    fn state(&self) -> &'static str {
        state_name(self.0.state)
    }

    /// Whether the pose is trusted.
    #[getter]
    fn is_tracking(&self) -> bool {
        self.0.state.is_tracking()
    }

    /// Whether the map keeps the frame.
    #[getter]
    fn is_keyframe(&self) -> bool {
        self.0.keyframe
    }
}

/// Returns the name of a state.
pub fn state_name(state: TrackState) -> &'static str {
    match state {
        TrackState::Waiting => "waiting",
        TrackState::Tracking => "tracking",
        TrackState::Relocalised => "relocalised",
        TrackState::Lost => "lost",
    }
}

/// Signed distances and their gradients.
type DistanceArrays<'py> = (Bound<'py, PyArray1<f32>>, Bound<'py, PyArrayDyn<f32>>);

/// Estimates pose and shape of one object, frame by frame.
///
/// `cameras` are those of the frames, in their order. `modality` is vitac (cameras and touch), vi or tac. With a `network`, touch is read
/// from the touch images, and `untouched`, uint8 (P, height, width, 3), are the images without contact; without one the frame's indentation
/// is taken. With `rig="none"` there is no hand: joints are empty, and frames have masks or labels, at least the first one: into others the mask is
/// carried. `settings` are keys and values as of `mambavitact run --set`, such as {"slam.map.batch": 512}.
#[pyclass(frozen, module = "mambavitact")]
pub struct Slam {
    hand: Arc<Hand>,
    modality: Modality,
    running: Mutex<Running>,
}

/// The part that changes.
struct Running {
    perception: Perception,
    estimator: Estimator,
    /// Without a hand: carries masks into frames that have none.
    carrier: Option<LabelCarrier>,
}

impl Slam {
    fn running(&self) -> MutexGuard<'_, Running> {
        self.running.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The rig of cameras alone.
const NO_HAND: &str = "none";

/// Groups of settings that have an effect.
const USED: [&str; 4] = ["slam.", "touch.", "calibration.", "segmentation."];

#[pymethods]
impl Slam {
    #[new]
    #[pyo3(signature = (cameras, *, rig = "allegro_digit", side = None, seed = 0, modality = "vitac", network = None, untouched = None, settings = BTreeMap::new()))]
    fn new(
        py: Python<'_>,
        cameras: Vec<PyRef<'_, Camera>>,
        rig: &str,
        side: Option<&str>,
        seed: u64,
        modality: &str,
        network: Option<PyRef<'_, TouchNetwork>>,
        untouched: Option<&Bound<'_, PyAny>>,
        settings: BTreeMap<String, Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        let hand = if rig == NO_HAND { Hand::none() } else { read_rig(py, rig, side)?.hand };
        let modality = [Modality::Vitac, Modality::Vi, Modality::Tac]
            .into_iter()
            .find(|known| known.name() == modality)
            .ok_or_else(|| Kind::Argument.error(format!("modality: expected vitac, vi or tac, got {modality:?}")))?;
        let set: Vec<String> = settings
            .iter()
            .map(|(key, value)| {
                let text = value.str()?.to_string();
                // As TOML has it.
                let text = if value.is_instance_of::<pyo3::types::PyBool>() { text.to_lowercase() } else { text };
                Ok(format!("{key}={text}"))
            })
            .collect::<PyResult<_>>()?;
        let base = if rig == NO_HAND { RunConfig::without_hand() } else { RunConfig::default() };
        let config = base.changed(None, &set).map_err(argument)?;
        if let Some(key) = settings.keys().find(|key| !USED.iter().any(|group| key.starts_with(group))) {
            let words = format!(
                "settings: {key} has no effect here; Slam uses settings of slam, touch, calibration and segmentation"
            );
            return Err(Kind::Argument.error(words).into());
        }
        let cameras: Vec<PosedCamera> = cameras.iter().map(|camera| camera.0.clone()).collect();
        let untouched = match untouched {
            Some(value) => images(value, "untouched", Some(hand.pads().len()), [None; 2])?,
            None => Vec::new(),
        };
        if network.is_none() && !untouched.is_empty() {
            return Err(Kind::Argument.error("untouched is for a network: give network, too").into());
        }
        let weights = network.map(|network| hand.per_pad(|_| Arc::clone(&network.weights)));
        detached(py, || {
            let setup = PerceptionSetup { weights: weights.as_ref(), config: config.perception() };
            let mut perception = Perception::new(Arc::clone(&hand), cameras, &setup);
            for (pad, image) in untouched.iter().enumerate() {
                perception.set_untouched(pad, image).map_err(argument)?;
            }
            let estimator = Estimator::new(&config.slam, &hand, seed).map_err(argument)?;
            let carrier = hand.is_none().then(|| LabelCarrier::new(config.segmentation));
            Ok(Self { hand, modality, running: Mutex::new(Running { perception, estimator, carrier }) })
        })
    }

    /// Estimates the pose of the next frame and learns the shape from it.
    fn observe(&self, py: Python<'_>, frame: &Frame) -> PyResult<Estimate> {
        let mut warnings = Vec::new();
        let estimate = detached(py, || {
            let mut running = self.running();
            let Running { perception, estimator, carrier } = &mut *running;
            let reads_images = perception.reads_touch_images() && self.modality.has_touch();
            if reads_images && frame.touch.is_none() {
                return Err(Kind::Argument.error("frame: it has no touch images for the network"));
            }
            let presses = match self.modality.has_touch() {
                false => Some(PerPad::default()),
                true => (!reads_images).then(|| frame.presses.clone()),
            };
            if let Some((time_s, joints)) = &frame.next_joints {
                perception.set_next_joints(*time_s, joints.clone());
            }
            let mut observation = frame.observation(self.modality);
            let is_carried = carrier.is_some() && estimator.frames() > 0 && leave_labels_open(&mut observation);
            let mut seen = perception.see(estimator.frames() as u64, observation, presses).map_err(argument)?;
            warnings.extend(seen.warnings);
            if let Some(carrier) = carrier.as_mut().filter(|_| is_carried) {
                carrier.carry(&mut seen.percept, Some(estimator));
            }
            let estimate = estimator.observe(&self.hand, &seen.percept, self.modality);
            if let Some(carrier) = carrier {
                carrier.learn(&seen.percept, &estimate, !is_carried);
            }
            Ok(Estimate(estimate))
        })?;
        warn(py, warnings)?;
        Ok(estimate)
    }

    /// Returns the estimated surface in the frame from which poses lead: vertices, metres, float32 (N, 3), and faces, uint32 (M, 3). None before
    /// the object was seen. `cell_mm` is the edge of a cell.
    #[pyo3(signature = (cell_mm = 1.5))]
    fn mesh<'py>(&self, py: Python<'py>, cell_mm: f32) -> PyResult<Option<MeshArrays<'py>>> {
        if !(0.2..=20.0).contains(&cell_mm) {
            return Err(Kind::Argument.error(format!("cell_mm: expected 0.2 to 20, got {cell_mm}")).into());
        }
        let mesh = detached(py, || {
            let running = self.running();
            Ok(seen(&running).map(|map| map.mesh(1e-3 * cell_mm)))
        })?;
        Ok(mesh.map(|mesh| arrays(py, mesh)))
    }

    /// Returns signed distances of the field at points (N, 3) in the frame of `mesh`, metres, negative inside: float32 (N,). They are truncated,
    /// and meaningless outside of the mapped box. None before the object was seen.
    fn distances<'py>(
        &self,
        py: Python<'py>,
        points: &Bound<'_, PyAny>,
    ) -> PyResult<Option<Bound<'py, PyArray1<f32>>>> {
        let points = read_points(points)?;
        let distances = detached(py, || {
            let running = self.running();
            let Some(map) = seen(&running) else { return Ok(None) };
            let (points, _) = in_field(map, points);
            let mut distances = vec![0.0; points.len()];
            map.field().distances(&points, &mut distances);
            Ok(Some(distances))
        })?;
        Ok(distances.map(|distances| line(py, distances)))
    }

    /// Returns signed distances as `distances` does, and their gradients in the frame of `mesh`: float32 (N,) and (N, 3).
    fn distances_and_gradients<'py>(
        &self,
        py: Python<'py>,
        points: &Bound<'_, PyAny>,
    ) -> PyResult<Option<DistanceArrays<'py>>> {
        let points = read_points(points)?;
        let result = detached(py, || {
            let running = self.running();
            let Some(map) = seen(&running) else { return Ok(None) };
            let (points, rotation) = in_field(map, points);
            let mut distances = vec![Distance::default(); points.len()];
            map.field().distances_and_gradients(&points, &mut distances);
            let back = rotation.transpose();
            let gradients = distances.iter().flat_map(|d| (back * Vec3A::from(d.gradient)).to_array()).collect();
            Ok(Some((distances.iter().map(|d| d.value_m).collect(), gradients)))
        })?;
        Ok(result.map(|(values, gradients): (Vec<f32>, Vec<f32>)| {
            let count = values.len();
            (line(py, values), shaped(py, gradients, &[count, 3]))
        }))
    }
}

/// Returns the map; `None` before the object was seen.
fn seen(running: &Running) -> Option<&Map> {
    running.estimator.map().filter(|map| !map.keyframes().is_empty())
}

fn read_points(value: &Bound<'_, PyAny>) -> PyResult<Vec<Vec3>> {
    let points = singles(value, "points", &[None, Some(3)])?;
    Ok(points.rows().into_iter().map(|p| Vec3::new(p[0], p[1], p[2])).collect())
}

/// Returns points of the model in the frame of the field, and the rotation from the one to the other.
fn in_field(map: &Map, points: Vec<Vec3>) -> (Vec<Vec3>, Mat3A) {
    let (rotation, translation) = map.field_from_model().to_f32();
    let moved = points.into_iter().map(|p| Vec3::from(rotation * Vec3A::from(p) + translation)).collect();
    (moved, rotation)
}
