//! data.pkl: everything in a log besides images.

use std::path::Path;
use std::sync::Arc;

use mvt_frames::camera::Intrinsics;
use mvt_robot::digit;
use mvt_robot::digit::gel::APEX_M;
use mvt_robot::digit::profile::SensorProfile;
use mvt_robot::hand::{Hand, JointAngles, Side};

use crate::array::Array;
use crate::error::LogError;
use crate::hand;
use crate::io::read_at_most;
use crate::npz::NpzReader;
use crate::pickle::{self, PickleValue};

/// Greatest size of data.pkl, bytes: ten times that of a log of thirty minutes.
const LARGEST_FILE: u64 = 256 << 20;

/// Pose as a 4 x 4 row-major matrix.
pub(super) type Matrix = [[f64; 4]; 4];

/// Encoding of touch depth as grey levels, of a DIGIT.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DigitInfo {
    /// Intrinsics in the log. Published logs round the principal point to (120, 160).
    pub intrinsics: Intrinsics,
    /// Camera z of level 0, metres: the plane of the gel's apex, negative.
    pub cam_dist_m: f64,
    /// Levels per metre.
    pub depth_scale: f64,
}

impl DigitInfo {
    /// Returns the values of the published logs.
    pub fn published() -> Self {
        let intrinsics =
            Intrinsics { fx: 277.128_129_2, fy: 277.128_129_2, cx: 120.0, cy: 160.0, ..digit::intrinsics() };
        Self { intrinsics, cam_dist_m: -0.022, depth_scale: 33_333.333_34 }
    }

    /// Returns the encoding for a sensor: level 0 is the plane of the apex of its gel.
    pub(crate) fn of(&self, profile: &SensorProfile) -> Self {
        Self { cam_dist_m: self.cam_dist_m + (APEX_M - profile.apex_mm / 1e3), ..*self }
    }

    /// Returns the level of a depth along the camera's axis, metres; 0 beyond the apex plane.
    pub fn level(&self, depth_m: f32) -> u8 {
        // `as` saturates.
        ((-f64::from(depth_m) - self.cam_dist_m) * self.depth_scale).round() as u8
    }

    /// Returns the depth along the camera's axis of a level, metres.
    pub fn depth_m(&self, level: u8) -> f32 {
        -(f64::from(level) / self.depth_scale + self.cam_dist_m) as f32
    }
}

/// Camera in data.pkl.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct CameraRecord {
    pub name: String,
    /// Camera to world, OpenGL axes.
    pub pose: Matrix,
    pub intrinsics: Intrinsics,
    /// k1, k2, p1, p2, k3 of OpenCV's model; `None` if the log has no such keys.
    pub distortion: Option<[f64; 5]>,
}

/// Contents of data.pkl.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Record {
    pub times_s: Vec<f64>,
    pub object_name: String,
    pub object_mesh: String,
    /// Published mesh to world.
    pub object_poses: Vec<Matrix>,
    /// The hand, where scene.json does not say it. Other loaders ignore it; without both the hand is the left Allegro.
    pub hand: Option<Arc<Hand>>,
    /// Hand base to world.
    pub base_pose: Matrix,
    /// As many in each frame.
    pub joints: Vec<JointAngles>,
    /// Cameras of the touch sensors to world, as many in each frame, for checks by other programs.
    pub finger_poses: Option<Vec<Vec<Matrix>>>,
    pub digit: DigitInfo,
    pub cameras: Vec<CameraRecord>,
}

const DISTORTION: [&str; 5] = ["k1", "k2", "p1", "p2", "k3"];

impl Record {
    /// Returns the dictionary that loaders expect.
    pub fn to_value(&self) -> PickleValue {
        let matrix = |m: &Matrix| PickleValue::Array(Array::from_f64(vec![4, 4], m.iter().flatten().copied()));
        let (frames, joints) = (self.times_s.len(), self.joints.first().map_or(0, Vec::len));
        let mut allegro = vec![
            ("base_pose".into(), matrix(&self.base_pose)),
            ("joint_state".into(), Array::from_f64(vec![frames, joints], self.joints.iter().flatten().copied()).into()),
        ];
        allegro.extend(self.hand.as_ref().map(|hand| match hand::stored(hand) {
            // JSON has a text for every description: all of its numbers are finite.
            Some(description) => {
                ("hand".into(), serde_json::to_string(description).unwrap_or_default().as_str().into())
            }
            None => ("side".into(), hand.side().name().into()),
        }));
        // A list of arrays without elements has no shape.
        if let Some(poses) = self.finger_poses.as_ref().filter(|poses| poses.iter().all(|poses| !poses.is_empty())) {
            let of_frame = |poses: &Vec<Matrix>| {
                Array::from_f64(vec![poses.len(), 4, 4], poses.iter().flatten().flatten().copied()).into()
            };
            allegro.push(("finger_poses".into(), PickleValue::List(poses.iter().map(of_frame).collect())));
        }
        let camera = |camera: &CameraRecord| {
            let description = PickleValue::dict([
                ("pose", matrix(&camera.pose)),
                ("intrinsics", intrinsics_to_value(&camera.intrinsics, camera.distortion)),
                ("depth_scale", 1.0.into()),
            ]);
            (camera.name.as_str().into(), description)
        };
        PickleValue::dict([
            ("time", Array::from_f64(vec![frames], self.times_s.iter().copied()).into()),
            (
                "object",
                PickleValue::dict([
                    ("name", self.object_name.as_str().into()),
                    ("mesh", self.object_mesh.as_str().into()),
                    ("pose", PickleValue::List(self.object_poses.iter().map(matrix).collect())),
                ]),
            ),
            ("allegro", PickleValue::Dict(allegro)),
            (
                "digit_info",
                PickleValue::dict([
                    ("intrinsics", intrinsics_to_value(&self.digit.intrinsics, None)),
                    ("cam_dist", self.digit.cam_dist_m.into()),
                    ("depth_scale", self.digit.depth_scale.into()),
                ]),
            ),
            ("realsense", PickleValue::Dict(self.cameras.iter().map(camera).collect())),
        ])
    }

    /// Reads the file data.pkl of a log.
    ///
    /// # Errors
    /// [`LogError`] that names the file and its defect.
    pub fn read(path: &Path) -> Result<Self, LogError> {
        let bytes = read_at_most(path, LARGEST_FILE)?;
        let value = pickle::from_bytes(&bytes).map_err(|reason| LogError::Pickle { path: path.into(), reason })?;
        Self::from_value(&value).map_err(|defect| LogError::defect(path, defect))
    }

    /// Reads the dictionary of a log.
    ///
    /// # Errors
    /// A sentence that names the key and its defect.
    pub fn from_value(value: &PickleValue) -> Result<Self, String> {
        let object = get(value, "object")?;
        let allegro = get(value, "allegro")?;
        let text_of = |key| allegro.get(key).and_then(PickleValue::as_str);
        let text = |key| object.get(key).and_then(PickleValue::as_str).unwrap_or_default().to_owned();
        let finger_poses = match allegro.get("finger_poses") {
            None | Some(PickleValue::None) => None,
            Some(poses) => {
                let pads = second_axis(poses);
                Some(by_frame(&matrices(poses, &[pads], "allegro.finger_poses")?, pads))
            }
        };
        let times_s = elements(get(value, "time")?, &[], "time")?;
        let states = get(allegro, "joint_state")?;
        let joints = match second_axis(states) {
            0 => vec![Vec::new(); times_s.len()],
            count => by_frame(&elements(states, &[count], "allegro.joint_state")?, count),
        };
        let Some(PickleValue::Dict(cameras)) = value.get("realsense") else {
            return Err("realsense is missing".into());
        };
        Ok(Self {
            times_s,
            object_name: text("name"),
            object_mesh: text("mesh"),
            object_poses: matrices(get(object, "pose")?, &[], "object.pose")?,
            hand: match (text_of("hand"), text_of("side")) {
                (Some(text), _) => Some(hand::from_text(text).map_err(|e| format!("allegro.hand: {e}"))?),
                (None, None) => None,
                (None, Some("left")) => Some(Hand::allegro(Side::Left)),
                (None, Some("right")) => Some(Hand::allegro(Side::Right)),
                (None, Some(other)) => return Err(format!("allegro.side is {other:?} and not left or right")),
            },
            base_pose: matrix(get(allegro, "base_pose")?, "allegro.base_pose")?,
            joints,
            finger_poses,
            digit: value.get("digit_info").map_or(Ok(DigitInfo::published()), digit_from_value)?,
            cameras: cameras.iter().map(|(name, camera)| camera_from_value(name, camera)).collect::<Result<_, _>>()?,
        })
    }
}

fn intrinsics_to_value(intrinsics: &Intrinsics, distortion: Option<[f64; 5]>) -> PickleValue {
    let &Intrinsics { width, height, fx, fy, cx, cy } = intrinsics;
    let size = [("w", width), ("h", height)].map(|(key, n)| (key.into(), PickleValue::Int(n as i64)));
    let focal = [("fx", fx), ("fy", fy), ("cx", cx), ("cy", cy)].map(|(key, x)| (key.into(), x.into()));
    let bent = distortion.iter().flat_map(|d| DISTORTION.into_iter().zip(d).map(|(key, x)| (key.into(), (*x).into())));
    PickleValue::Dict(size.into_iter().chain(focal).chain(bent).collect())
}

fn get<'a>(value: &'a PickleValue, key: &str) -> Result<&'a PickleValue, String> {
    value.get(key).ok_or_else(|| format!("{key} is missing"))
}

fn number(value: &PickleValue, key: &str) -> Result<f64, String> {
    let number = get(value, key)?.to_number().filter(|x| x.is_finite());
    number.ok_or_else(|| format!("{key} is not a finite number"))
}

/// Returns the numbers of an array of shape [N, axes...].
fn elements(value: &PickleValue, axes: &[usize], key: &str) -> Result<Vec<f64>, String> {
    let (shape, numbers) = value.to_tensor().ok_or_else(|| format!("{key} is not an array of numbers"))?;
    if shape.len() != axes.len() + 1 || &shape[1..] != axes {
        return Err(format!("{key} has the shape {shape:?} and not [N, {axes:?}]"));
    }
    if let Some(place) = numbers.iter().position(|x| !x.is_finite()) {
        let frame = place / axes.iter().product::<usize>().max(1);
        return Err(format!(
            "{key} of frame {frame} holds a number that is not finite; leave out that frame or repair it"
        ));
    }
    Ok(numbers)
}

/// Returns the length of the second axis of an array; 0 if it has none.
fn second_axis(value: &PickleValue) -> usize {
    value.to_tensor().and_then(|(shape, _)| shape.get(1).copied()).unwrap_or(0)
}

/// Returns values in groups of `count`, one for each frame.
fn by_frame<T: Clone>(values: &[T], count: usize) -> Vec<Vec<T>> {
    values.chunks_exact(count.max(1)).map(<[T]>::to_vec).collect()
}

/// Returns the matrices of an array of shape [N, axes..., 4, 4].
fn matrices(value: &PickleValue, axes: &[usize], key: &str) -> Result<Vec<Matrix>, String> {
    let numbers = elements(value, &[axes, &[4, 4]].concat(), key)?;
    let (rows, _) = numbers.as_chunks::<4>();
    Ok(rows.as_chunks::<4>().0.to_vec())
}

/// Returns a matrix, or the first of several: simulated logs repeat the pose of a camera at rest.
fn matrix(value: &PickleValue, key: &str) -> Result<Matrix, String> {
    let one = match value.to_tensor() {
        Some((shape, _)) if shape.len() == 2 => matrices(&PickleValue::List(vec![value.clone()]), &[], key)?,
        _ => matrices(value, &[], key)?,
    };
    one.first().copied().ok_or_else(|| format!("{key} holds no pose"))
}

fn intrinsics_from_value(value: &PickleValue, key: &str) -> Result<Intrinsics, String> {
    let value = get(value, "intrinsics").map_err(|e| format!("{key}.{e}"))?;
    let number = |name| number(value, name).map_err(|e| format!("{key}.intrinsics: {e}"));
    let side = |name| {
        let n = number(name)?;
        let fits = n.fract() == 0.0 && (1.0..=NpzReader::MAX_SIDE as f64).contains(&n);
        if fits { Ok(n as usize) } else { Err(format!("{key}.intrinsics: {name} is {n}")) }
    };
    let intrinsics = Intrinsics {
        width: side("w")?,
        height: side("h")?,
        fx: number("fx")?,
        fy: number("fy")?,
        cx: number("cx")?,
        cy: number("cy")?,
    };
    if intrinsics.fx <= 0.0 || intrinsics.fy <= 0.0 {
        return Err(format!("{key}.intrinsics: a focal length is not positive"));
    }
    Ok(intrinsics)
}

fn digit_from_value(value: &PickleValue) -> Result<DigitInfo, String> {
    let intrinsics = intrinsics_from_value(value, "digit_info")?;
    let number = |name| number(value, name).map_err(|e| format!("digit_info: {e}"));
    let digit = DigitInfo { intrinsics, cam_dist_m: number("cam_dist")?, depth_scale: number("depth_scale")? };
    if digit.cam_dist_m >= 0.0 || digit.depth_scale <= 0.0 {
        return Err("digit_info: cam_dist must be negative and depth_scale positive".into());
    }
    if (intrinsics.width, intrinsics.height) != (digit::WIDTH, digit::HEIGHT) {
        return Err(format!("digit_info: images are {} x {}", intrinsics.width, intrinsics.height));
    }
    Ok(digit)
}

fn camera_from_value(name: &PickleValue, camera: &PickleValue) -> Result<CameraRecord, String> {
    let name = name
        .as_str()
        .filter(|name| is_plain_name(name))
        .ok_or("realsense: the name of a camera is not a valid file name")?;
    let key = format!("realsense.{name}");
    let bends = get(camera, "intrinsics").map_err(|e| format!("{key}.{e}"))?;
    // Loaders read the coefficients in this order; a missing one is zero.
    let distortion = DISTORTION.map(|k| bends.get(k).and_then(PickleValue::to_number).filter(|x| x.is_finite()));
    Ok(CameraRecord {
        name: name.to_owned(),
        pose: matrix(get(camera, "pose").map_err(|e| format!("{key}.{e}"))?, &format!("{key}.pose"))?,
        intrinsics: intrinsics_from_value(camera, &key)?,
        distortion: distortion.iter().any(Option::is_some).then(|| distortion.map(Option::unwrap_or_default)),
    })
}

/// Returns whether a name is a valid folder or file name on every system, and not a path.
pub(super) fn is_plain_name(name: &str) -> bool {
    let plain = |c: char| c.is_ascii_alphanumeric() || matches!(c, '-' | '_' | '.');
    !name.is_empty() && name.len() <= 100 && !name.starts_with('.') && name.chars().all(plain)
}
