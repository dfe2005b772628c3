//! Sensor data of one instant.

use image::RgbImage;
use mvt_frames::depth::{GivenLabels, Label};
use mvt_frames::{Camera, Isometry, Object, World};
use mvt_perceive::true_press;
use mvt_robot::hand::{Hand, JointAngles, PerPad};
use mvt_robot::observation::{GroundTruth, Observation, Press, Rgbd};
use mvt_run::source::Modality;
use ndarray::{Array2, ArrayD, Axis, Ix2};
use numpy::{IntoPyArray as _, PyArray1, PyArray2, PyArrayDyn};
use pyo3::prelude::*;

use crate::arrays::{
    bytes, image, images, line, matrix, motion, numbers, pixels, plane, same_size, shaped, singles, stacked, truths,
};
use crate::errors::Kind;

/// Sensor data of one instant, and the truth where it is known.
///
/// `joints` are the angles of the hand's joints in radians (16 of an Allegro), `depth_m` one image per camera (metres along the optical axis, 0 where nothing was measured),
/// `touch_images` (P, height, width, 3), `indentation_mm` and `contact` (P, height, width) for the P pads of the hand (4 of an Allegro, with 320 x 240
/// pixels). Without touch images or indentation the pads deliver nothing. `masks`, one bool (height, width) per depth image, show where the object
/// is visible; or `labels`, uint8 (height, width), show 0 background, 127 hand, 255 object and 64 unsure. Without them the pixels are labelled
/// from the hand's geometry. `camera_pose` (4, 4) is the pose of the first camera, if it moves.
#[pyclass(frozen, module = "mambavitact")]
pub struct Frame {
    pub time_s: f64,
    pub joints: JointAngles,
    pub colours: Vec<RgbImage>,
    pub depths_m: Vec<Array2<f32>>,
    /// What is known of the pixels of each camera beforehand, in their order.
    pub labels: Vec<GivenLabels>,
    /// Images of the touch sensors; `None` without touch images.
    pub touch: Option<PerPad<RgbImage>>,
    /// True press on each touch sensor, where it is known.
    pub presses: PerPad<Option<Press>>,
    pub object_pose: Option<Isometry<Object, World>>,
    /// Pose of the first camera, if it differs from frame to frame.
    pub world_from_camera: Option<Isometry<Camera, World>>,
    /// Time and joint readings of the next frame, where a log knows them.
    pub next_joints: Option<(f64, JointAngles)>,
}

/// Standard deviation of an indentation from Python, millimetres: that of true touch depth in logs.
const SIGMA_MM: f32 = 0.05;

impl Frame {
    /// Takes an observation of a hand with its truth.
    pub fn observed(hand: &Hand, observation: Observation, truth: Option<GroundTruth>) -> Self {
        let Observation { time_s, joints, touch, cameras } = observation;
        let (colours, depths_m) = cameras.into_iter().map(|rgbd| (rgbd.color, rgbd.depth_m)).unzip();
        let touched = truth.iter().flat_map(|truth| truth.touch.iter().zip(hand.gel_views().iter()));
        let presses = touched.map(|(truth, gel)| true_press(truth, gel)).collect();
        let object_pose = truth.map(|truth| truth.object_pose);
        let labels = Vec::new();
        Self {
            time_s,
            joints,
            colours,
            depths_m,
            labels,
            touch: Some(touch),
            presses,
            object_pose,
            world_from_camera: None,
            next_joints: None,
        }
    }
}

#[pymethods]
impl Frame {
    #[new]
    #[pyo3(signature = (time_s, joints, *, depth_m = Vec::new(), color = Vec::new(), masks = Vec::new(), labels = Vec::new(), touch_images = None, indentation_mm = None, contact = None, object_pose = None, camera_pose = None))]
    fn new(
        time_s: f64,
        joints: &Bound<'_, PyAny>,
        depth_m: Vec<Bound<'_, PyAny>>,
        color: Vec<Bound<'_, PyAny>>,
        masks: Vec<Bound<'_, PyAny>>,
        labels: Vec<Bound<'_, PyAny>>,
        touch_images: Option<&Bound<'_, PyAny>>,
        indentation_mm: Option<&Bound<'_, PyAny>>,
        contact: Option<&Bound<'_, PyAny>>,
        object_pose: Option<&Bound<'_, PyAny>>,
        camera_pose: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        if !time_s.is_finite() {
            return Err(Kind::Argument.error(format!("time_s: expected a finite number, got {time_s}")).into());
        }
        let depths_m = depth_m.iter().enumerate().map(|(k, depth)| plane(depth, &format!("depth_m[{k}]"), [None; 2]));
        let colours = color.iter().enumerate().map(|(k, color)| image(color, &format!("color[{k}]"), [None; 2]));
        let labels = read_labels(&masks, &labels, depth_m.len())?;
        let touch = match touch_images {
            Some(value) => Some(PerPad(images(value, "touch_images", None, [None; 2])?)),
            None => None,
        };
        let size = [None; 3];
        let presses = match (indentation_mm, contact) {
            (Some(indentation), Some(contact)) => {
                let indentation = singles(indentation, "indentation_mm", &size)?;
                let contact = truths(contact, "contact", &size)?;
                if indentation.shape() != contact.shape() {
                    return Err(Kind::Argument
                        .error("indentation_mm and contact have different numbers of pads or pixels")
                        .into());
                }
                PerPad::from_fn(contact.shape()[0], |pad| {
                    Some(Press {
                        indentation_mm: slice(&indentation, pad)?,
                        contact: slice(&contact, pad)?,
                        sigma_mm: SIGMA_MM,
                    })
                })
            }
            (None, None) => PerPad::default(),
            _ => return Err(Kind::Argument.error("give both indentation_mm and contact, or none of them").into()),
        };
        Ok(Self {
            time_s,
            joints: read_joints(joints, "joints")?,
            colours: colours.collect::<PyResult<_>>()?,
            depths_m: depths_m.collect::<PyResult<_>>()?,
            labels,
            touch,
            presses,
            object_pose: object_pose.map(|pose| motion(pose, "object_pose")).transpose()?,
            world_from_camera: camera_pose.map(|pose| motion(pose, "camera_pose")).transpose()?,
            next_joints: None,
        })
    }

    /// Seconds since the start.
    #[getter]
    fn time_s(&self) -> f64 {
        self.time_s
    }

    /// Joint angles, radians: float64, one per joint.
    #[getter]
    fn joints<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        line(py, self.joints.to_vec())
    }

    /// Colours of each camera: uint8 (height, width, 3).
    #[getter]
    fn color<'py>(&self, py: Python<'py>) -> Vec<Bound<'py, PyArrayDyn<u8>>> {
        self.colours.iter().map(|image| pixels(py, image.clone())).collect()
    }

    /// Depth of each camera along its optical axis, metres, 0 where nothing was measured: float32 (height, width).
    #[getter]
    fn depth_m<'py>(&self, py: Python<'py>) -> Vec<Bound<'py, PyArray2<f32>>> {
        self.depths_m.iter().map(|depth| depth.clone().into_pyarray(py)).collect()
    }

    /// Where the object is visible in each depth image: bool (height, width). Empty in a frame without masks.
    #[getter]
    fn masks<'py>(&self, py: Python<'py>) -> Vec<Bound<'py, PyArray2<bool>>> {
        let mask = |labels: &GivenLabels| match labels {
            GivenLabels::Mask(mask) => Some(mask.clone().into_pyarray(py)),
            GivenLabels::Labels(_) => None,
        };
        self.labels.iter().filter_map(mask).collect()
    }

    /// Pose of the first camera in the world, where a frame states it: float64 (4, 4), or None.
    #[getter]
    fn camera_pose<'py>(&self, py: Python<'py>) -> Option<Bound<'py, PyArrayDyn<f64>>> {
        Some(matrix(py, self.world_from_camera?))
    }

    /// Images of the touch sensors: uint8 (P, height, width, 3), or None.
    #[getter]
    fn touch_images<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyArrayDyn<u8>>>> {
        let is_whole = |touch: &&PerPad<RgbImage>| !touch.is_empty() && touch.iter().all(|image| !image.is_empty());
        self.touch.as_ref().filter(is_whole).map(|images| stacked(py, images)).transpose()
    }

    /// True indentation of the gels, millimetres: float32 (P, height, width), or None.
    #[getter]
    fn indentation_mm<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyArrayDyn<f32>>>> {
        let presses = self.of_presses(|press| press.indentation_mm.iter().copied())?;
        Ok(presses.map(|(values, shape)| shaped(py, values, &shape)))
    }

    /// Where the object truly lies on the gels: bool (P, height, width), or None.
    #[getter]
    fn contact<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyArrayDyn<bool>>>> {
        let presses = self.of_presses(|press| press.contact.iter().copied())?;
        Ok(presses.map(|(values, shape)| shaped(py, values, &shape)))
    }

    /// True pose of the object in the world: float64 (4, 4), or None.
    #[getter]
    fn object_pose<'py>(&self, py: Python<'py>) -> Option<Bound<'py, PyArrayDyn<f64>>> {
        Some(matrix(py, self.object_pose?))
    }
}

impl Frame {
    /// Returns the data as an observation, without cameras if they are not used.
    pub fn observation(&self, modality: Modality) -> Observation {
        let depths_m = self.depths_m.iter().filter(|_| modality.has_vision());
        let camera = |(k, depth_m): (usize, &Array2<f32>)| Rgbd {
            color: self.colours.get(k).cloned().unwrap_or_default(),
            depth_m: depth_m.clone(),
            labels: self.labels.get(k).cloned(),
            world_from_camera: self.world_from_camera.filter(|_| k == 0),
        };
        Observation {
            time_s: self.time_s,
            joints: self.joints.clone(),
            touch: self.touch.clone().unwrap_or_default(),
            cameras: depths_m.enumerate().map(camera).collect(),
        }
    }

    /// Returns values of all presses with their shape; `None` if there are none or one is unknown.
    fn of_presses<'a, T, I: Iterator<Item = T>>(
        &'a self,
        values: fn(&'a Press) -> I,
    ) -> PyResult<Option<(Vec<T>, [usize; 3])>> {
        let presses: Option<Vec<&Press>> = self.presses.iter().map(Option::as_ref).collect();
        let Some(presses) = presses.filter(|presses| !presses.is_empty()) else { return Ok(None) };
        let (rows, columns) = same_size(presses.iter().map(|press| press.contact.dim()))?;
        let shape = [presses.len(), rows, columns];
        Ok(Some((presses.into_iter().flat_map(values).collect(), shape)))
    }
}

/// Reads the masks or the labels of `cameras` images; both are empty where nothing is known.
fn read_labels(masks: &[Bound<'_, PyAny>], labels: &[Bound<'_, PyAny>], cameras: usize) -> PyResult<Vec<GivenLabels>> {
    if !masks.is_empty() && !labels.is_empty() {
        return Err(Kind::Argument.error("give masks or labels, not both").into());
    }
    for (name, given) in [("masks", masks.len()), ("labels", labels.len())] {
        if given != 0 && given != cameras {
            return Err(Kind::Argument
                .error(format!("{name}: expected one per depth image ({cameras}), got {given}"))
                .into());
        }
    }
    let mask = |(k, mask): (usize, &Bound<'_, PyAny>)| {
        let mask = truths(mask, &format!("masks[{k}]"), &[None; 2])?;
        Ok(GivenLabels::Mask(mask.into_dimensionality::<Ix2>().unwrap_or_default()))
    };
    let label = |(k, levels): (usize, &Bound<'_, PyAny>)| {
        let name = format!("labels[{k}]");
        let levels = bytes(levels, &name, &[None; 2])?;
        let known = |grey: &u8| {
            let words =
                || format!("{name}: expected 0 (background), 127 (hand), 255 (object) and 64 (unsure), got {grey}");
            Label::from_grey(*grey).ok_or_else(|| Kind::Argument.error(words()))
        };
        let labels = levels.iter().map(known).collect::<Result<Vec<_>, _>>()?;
        let size = levels.into_dimensionality::<Ix2>().map(|levels| levels.dim()).unwrap_or_default();
        Ok(GivenLabels::Labels(Array2::from_shape_vec(size, labels).unwrap_or_default()))
    };
    match masks.is_empty() {
        true => labels.iter().enumerate().map(label).collect(),
        false => masks.iter().enumerate().map(mask).collect(),
    }
}

fn slice<T: Clone>(array: &ArrayD<T>, pad: usize) -> Option<Array2<T>> {
    array.index_axis(Axis(0), pad).to_owned().into_dimensionality::<Ix2>().ok()
}

/// Reads joint angles, any number of them.
pub fn read_joints(value: &Bound<'_, PyAny>, name: &str) -> PyResult<JointAngles> {
    Ok(numbers(value, name, &[None])?.iter().copied().collect())
}
