//! Foxglove's protobuf messages, decoded. Fields that are absent are zero or empty, as protobuf defines them.

use mvt_frames::camera::Intrinsics;
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion};

use crate::protobuf::{Fields, Value};

/// Transforms or joints of a message that are read: far more than a robot has.
const MOST: usize = 4096;

/// Message of a known schema. Texts and data are those of the file.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Decoded<'a> {
    Image(Picture<'a>),
    Calibration(Calibration<'a>),
    Transforms(Vec<Transform<'a>>),
    /// Names and positions; `None` where a joint has no position.
    Joints(Vec<(&'a str, Option<f64>)>),
}

/// Image as it was sent.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct Picture<'a> {
    /// Size in pixels, 0 for a compressed image, which knows its own.
    pub width: u64,
    pub height: u64,
    /// Bytes of a row.
    pub step: u64,
    /// Encoding of the pixels, such as `rgb8`; `None` for an image file.
    pub encoding: Option<&'a str>,
    /// What the message says about an image file, such as `16UC1; compressedDepth png`.
    pub format: &'a str,
    pub data: &'a [u8],
}

/// Pinhole model of a camera and its distortion.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Calibration<'a> {
    pub frame: &'a str,
    pub intrinsics: Intrinsics,
    pub model: &'a str,
    pub distortion: Vec<f64>,
}

/// Pose of a frame in its parent, metres.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Transform<'a> {
    pub parent: &'a str,
    pub child: &'a str,
    /// A defect if it is no pose.
    pub pose: Result<Isometry3<f64>, String>,
    /// The time that it states, nanoseconds; 0 if it states none.
    pub stated_ns: u64,
}

/// Decodes a message of a schema with the time that it states, nanoseconds; 0 if it states none.
///
/// # Errors
/// A sentence if the schema is unknown or the message does not follow it.
pub(crate) fn decode<'a>(schema: &str, message: &'a [u8]) -> Result<(u64, Decoded<'a>), String> {
    let decoded = match schema {
        "foxglove.CompressedImage" => image(message, false).map(Decoded::Image),
        "foxglove.RawImage" => image(message, true).map(Decoded::Image),
        "foxglove.CameraCalibration" => calibration(message).map(Decoded::Calibration),
        "foxglove.FrameTransform" => transform(message).map(|one| Decoded::Transforms(vec![one])),
        "foxglove.FrameTransforms" => transforms(message).map(Decoded::Transforms),
        "foxglove.JointStates" => joints(message).map(Decoded::Joints),
        _ => return Err(format!("the schema {schema:?} is unknown; messages of foxglove.* in protobuf are read")),
    };
    let decoded = decoded.ok_or_else(|| format!("it does not follow the schema {schema}"))?;
    Ok((stamp(message).unwrap_or_default(), decoded))
}

/// Returns the fields of a message.
fn whole(message: &[u8]) -> Option<Fields<'_>> {
    let mut fields = Fields::of(message);
    fields.by_ref().for_each(drop);
    fields.is_whole().then(|| Fields::of(message))
}

/// Returns the time in the first field of a message.
fn stamp(message: &[u8]) -> Option<u64> {
    let [mut seconds, mut nanos] = [0, 0];
    for (number, value) in whole(bytes_of(message, 1)?)? {
        match (number, value) {
            (1, Value::Number(value)) => seconds = value,
            (2, Value::Number(value)) => nanos = value,
            _ => {}
        }
    }
    seconds.checked_mul(1_000_000_000)?.checked_add(nanos)
}

/// Returns the contents of the last field of a number, as protobuf defines it.
fn bytes_of(message: &[u8], field: u64) -> Option<&[u8]> {
    let bytes = |(number, value)| match value {
        Value::Bytes(bytes) if number == field => Some(bytes),
        _ => None,
    };
    whole(message)?.filter_map(bytes).last()
}

fn text(value: Value<'_>) -> Option<&str> {
    match value {
        Value::Bytes(bytes) => std::str::from_utf8(bytes).ok(),
        Value::Number(_) => None,
    }
}

fn data(value: Value<'_>) -> Option<&[u8]> {
    match value {
        Value::Bytes(bytes) => Some(bytes),
        Value::Number(_) => None,
    }
}

fn number(value: Value<'_>) -> Option<u64> {
    match value {
        Value::Number(number) => Some(number),
        Value::Bytes(_) => None,
    }
}

fn image(message: &[u8], is_raw: bool) -> Option<Picture<'_>> {
    let mut picture = Picture::default();
    for (field, value) in whole(message)? {
        match (field, is_raw) {
            (2, false) | (6, true) => picture.data = data(value)?,
            (3, false) => picture.format = text(value)?,
            (2, true) => picture.width = number(value)?,
            (3, true) => picture.height = number(value)?,
            (4, true) => picture.encoding = Some(text(value)?),
            (5, true) => picture.step = number(value)?,
            _ => {}
        }
    }
    (!is_raw || picture.encoding.is_some()).then_some(picture)
}

/// Returns doubles, which are packed into one field or stand in several.
fn doubles(value: Value<'_>, into: &mut Vec<f64>) -> Option<()> {
    match value {
        Value::Number(bits) => into.push(f64::from_bits(bits)),
        Value::Bytes(bytes) => {
            let (eights, rest) = bytes.as_chunks::<8>();
            into.extend(eights.iter().map(|eight| f64::from_le_bytes(*eight)));
            if !rest.is_empty() {
                return None;
            }
        }
    }
    Some(())
}

fn calibration(message: &[u8]) -> Option<Calibration<'_>> {
    let (mut frame, mut model) = ("", "");
    let (mut width, mut height) = (0, 0);
    let (mut distortion, mut k) = (Vec::new(), Vec::new());
    for (field, value) in whole(message)? {
        match field {
            9 => frame = frame_name(text(value)?),
            2 => width = number(value)?,
            3 => height = number(value)?,
            4 => model = text(value)?,
            5 => doubles(value, &mut distortion)?,
            6 => doubles(value, &mut k)?,
            _ => {}
        }
    }
    // Without a matrix all of it is 0.
    k.resize(9, 0.0);
    let [fx, _, cx, _, fy, cy, ..] = k[..] else { return None };
    let (width, height) = (usize::try_from(width).ok()?, usize::try_from(height).ok()?);
    Some(Calibration { frame, intrinsics: Intrinsics { width, height, fx, fy, cx, cy }, model, distortion })
}

/// Returns the numbers of a message whose fields 1 to N are doubles.
fn vector<const N: usize>(message: &[u8]) -> Option<[f64; N]> {
    let mut vector = [0.0; N];
    for (field, value) in whole(message)? {
        let place = usize::try_from(field).ok().and_then(|field| vector.get_mut(field.checked_sub(1)?));
        if let Some(place) = place {
            *place = f64::from_bits(number(value)?);
        }
    }
    Some(vector)
}

/// Returns a pose of translation and rotation, or its defect.
fn pose(translation: [f64; 3], rotation: [f64; 4]) -> Result<Isometry3<f64>, String> {
    let [i, j, k, w] = rotation;
    if !translation.iter().chain(&rotation).all(|value| value.is_finite()) {
        return Err("numbers that are not finite".to_owned());
    }
    let quaternion = Quaternion::new(w, i, j, k);
    // The bound of tf2.
    if (quaternion.norm() - 1.0).abs() > 0.01 {
        return Err(format!("a rotation of length {:.3}", quaternion.norm()));
    }
    let [x, y, z] = translation;
    Ok(Isometry3::from_parts(Translation3::new(x, y, z), UnitQuaternion::from_quaternion(quaternion)))
}

fn transform(message: &[u8]) -> Option<Transform<'_>> {
    let (mut parent, mut child, mut translation, mut rotation) = ("", "", &[][..], &[][..]);
    for (field, value) in whole(message)? {
        match field {
            2 => parent = frame_name(text(value)?),
            3 => child = frame_name(text(value)?),
            4 => translation = data(value)?,
            5 => rotation = data(value)?,
            _ => {}
        }
    }
    let pose = pose(vector(translation)?, vector(rotation)?)
        .map_err(|defect| format!("the transform {parent} -> {child} has {defect}"));
    Some(Transform { parent, child, pose, stated_ns: stamp(message).unwrap_or_default() })
}

/// Returns a name of a frame or topic without the slash that old programs of ROS put before it.
pub(crate) fn frame_name(name: &str) -> &str {
    name.trim_start_matches('/')
}

fn transforms(message: &[u8]) -> Option<Vec<Transform<'_>>> {
    let of_list = whole(message)?.filter(|(field, _)| *field == 1).take(MOST);
    of_list.map(|(_, value)| transform(data(value)?)).collect()
}

fn joints(message: &[u8]) -> Option<Vec<(&str, Option<f64>)>> {
    let mut joints = Vec::new();
    for (_, value) in whole(message)?.filter(|(field, _)| *field == 2).take(MOST) {
        let (mut name, mut position) = ("", None);
        for (field, value) in whole(data(value)?)? {
            match field {
                1 => name = text(value)?,
                2 => position = Some(f64::from_bits(number(value)?)),
                _ => {}
            }
        }
        joints.push((name, position));
    }
    Some(joints)
}
