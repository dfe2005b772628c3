//! Messages of ROS 2 that are decoded.

use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion};

use crate::cdr::CdrReader;
use crate::error::RosError;

/// Time and frame of a message.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct RosHeader {
    /// Nanoseconds; 0 if the message states no time.
    pub stamp_ns: i64,
    /// Name of the coordinate frame, without a slash before it.
    pub frame: String,
}

impl RosHeader {
    /// Reads the header at the beginning of a message; the message may be cut off behind it.
    ///
    /// # Errors
    /// [`RosError`] if the message does not start with one.
    pub fn decode(message: &[u8]) -> Result<Self, RosError> {
        Ok(Self::read(&mut CdrReader::new(message)?)?)
    }

    fn read(reader: &mut CdrReader<'_>) -> Result<Self, crate::cdr::CdrError> {
        let seconds = i64::from(reader.i32()?);
        let nanoseconds = i64::from(reader.u32()?);
        Ok(Self { stamp_ns: seconds * 1_000_000_000 + nanoseconds, frame: frame_name(reader.text()?) })
    }
}

/// Returns the name of a frame without the slash that old programs put before it.
pub(crate) fn frame_name(name: &str) -> String {
    name.trim_start_matches('/').to_owned()
}

/// Message `sensor_msgs/msg/Image`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RosImage<'a> {
    /// Time and frame.
    pub header: RosHeader,
    /// Width, pixels.
    pub width: usize,
    /// Height, pixels.
    pub height: usize,
    /// Encoding of the pixels, such as `rgb8`.
    pub encoding: &'a str,
    /// Whether numbers of several bytes start with the highest.
    pub is_big_endian: bool,
    /// Bytes of a row.
    pub step: usize,
    /// The rows.
    pub data: &'a [u8],
}

impl<'a> RosImage<'a> {
    /// Decodes a message.
    ///
    /// # Errors
    /// [`RosError`] if it is cut off or of another type. The pixels are judged when they are converted.
    pub fn decode(message: &'a [u8]) -> Result<Self, RosError> {
        let mut reader = CdrReader::new(message)?;
        let (header, [height, width], encoding) = Self::head(&mut reader)?;
        let is_big_endian = reader.u8()? != 0;
        let step = reader.u32()? as usize;
        Ok(Self { header, width, height, encoding, is_big_endian, step, data: reader.bytes()? })
    }

    fn head(reader: &mut CdrReader<'a>) -> Result<(RosHeader, [usize; 2], &'a str), RosError> {
        let header = RosHeader::read(reader)?;
        let size = [reader.u32()? as usize, reader.u32()? as usize];
        Ok((header, size, reader.text()?))
    }

    /// Reads the encoding of a message, which may be cut off behind it.
    pub(crate) fn encoding_of(message: &'a [u8]) -> Result<&'a str, RosError> {
        Ok(Self::head(&mut CdrReader::new(message)?)?.2)
    }
}

/// Message `sensor_msgs/msg/CompressedImage`, also of the transport `compressedDepth`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RosCompressedImage<'a> {
    /// Time and frame.
    pub header: RosHeader,
    /// What the publisher says, such as `jpeg`, `rgb8; jpeg compressed bgr8` or `16UC1; compressedDepth png`.
    pub format: &'a str,
    /// The file, behind a configuration for `compressedDepth`.
    pub data: &'a [u8],
}

impl<'a> RosCompressedImage<'a> {
    /// Decodes a message.
    ///
    /// # Errors
    /// [`RosError`] if it is cut off or of another type. The file is judged when it is converted.
    pub fn decode(message: &'a [u8]) -> Result<Self, RosError> {
        let mut reader = CdrReader::new(message)?;
        let header = RosHeader::read(&mut reader)?;
        Ok(Self { header, format: reader.text()?, data: reader.bytes()? })
    }

    /// Reads the format of a message, which may be cut off behind it.
    pub(crate) fn format_of(message: &'a [u8]) -> Result<&'a str, RosError> {
        let mut reader = CdrReader::new(message)?;
        RosHeader::read(&mut reader)?;
        Ok(reader.text()?)
    }
}

/// Message `sensor_msgs/msg/CameraInfo`. [`crate::RosLens`] makes a camera model of it.
#[derive(Debug, Clone, PartialEq)]
pub struct RosCameraInfo {
    /// Time and frame.
    pub header: RosHeader,
    /// Width of the whole sensor's image, pixels.
    pub width: usize,
    /// Height of the whole sensor's image, pixels.
    pub height: usize,
    /// Name of the lens model, such as `plumb_bob`.
    pub model: String,
    /// Its numbers.
    pub d: Vec<f64>,
    /// Camera matrix of the image with distortion, row by row.
    pub k: [f64; 9],
    /// Projection of the rectified image, row by row.
    pub p: [f64; 12],
    /// Pixels of the sensor in one of the image, along columns and rows; 0 means 1.
    pub binning: [usize; 2],
    /// Column, row, width and height of the part of the sensor that the image shows; 0 means all.
    pub part: [usize; 4],
}

impl RosCameraInfo {
    /// Decodes a message.
    ///
    /// # Errors
    /// [`RosError`] if it is cut off or of another type.
    pub fn decode(message: &[u8]) -> Result<Self, RosError> {
        let mut reader = CdrReader::new(message)?;
        let header = RosHeader::read(&mut reader)?;
        let (height, width) = (reader.u32()? as usize, reader.u32()? as usize);
        let model = reader.text()?.to_owned();
        let (d, k, _rectification, p) = (reader.f64s()?, reader.array()?, reader.array::<9>()?, reader.array()?);
        let mut number = || reader.u32().map(|number| number as usize);
        let binning = [number()?, number()?];
        let [column, row, part_height, part_width] = [number()?, number()?, number()?, number()?];
        Ok(Self { header, width, height, model, d, k, p, binning, part: [column, row, part_width, part_height] })
    }
}

/// Message `sensor_msgs/msg/JointState`.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct RosJointState {
    /// Time and frame.
    pub header: RosHeader,
    /// Names and positions, radians or metres. Joints without a position are left out.
    pub positions: Vec<(String, f64)>,
    /// Names and velocities, rad/s or m/s, of the joints that have one.
    pub velocities: Vec<(String, f64)>,
}

impl RosJointState {
    /// Decodes a message.
    ///
    /// # Errors
    /// [`RosError`] if it is cut off or of another type, or has positions for some of its names only.
    pub fn decode(message: &[u8]) -> Result<Self, RosError> {
        let mut reader = CdrReader::new(message)?;
        let header = RosHeader::read(&mut reader)?;
        // A name has at least its length.
        let count = reader.count(4)?;
        let names: Vec<&str> = (0..count).map(|_| reader.text()).collect::<Result<_, _>>()?;
        let positions = reader.f64s()?;
        if !positions.is_empty() && positions.len() != names.len() {
            let fault = format!("{} names of joints, but {} positions", names.len(), positions.len());
            return Err(RosError::fault(fault));
        }
        // Velocities are of use, but nothing needs them.
        let velocities = reader.f64s().unwrap_or_default();
        let named = |numbers: Vec<f64>| {
            let numbers = if numbers.len() == names.len() { numbers } else { Vec::new() };
            let finite = names.iter().zip(numbers).filter(|(_, number)| number.is_finite());
            finite.map(|(name, number)| ((*name).to_owned(), number)).collect()
        };
        Ok(Self { header, positions: named(positions), velocities: named(velocities) })
    }
}

/// Transform of a `tf2_msgs/msg/TFMessage`.
#[derive(Debug, Clone, PartialEq)]
pub struct RosTransform {
    /// Time, and the parent frame.
    pub header: RosHeader,
    /// The child frame.
    pub child: String,
    /// Pose of the child in its parent, metres.
    pub parent_from_child: Isometry3<f64>,
}

impl RosTransform {
    /// Decodes the transforms of a message. Transforms without a valid rotation are left out.
    ///
    /// # Errors
    /// [`RosError`] if it is cut off or of another type.
    pub fn decode(message: &[u8]) -> Result<Vec<Self>, RosError> {
        let mut reader = CdrReader::new(message)?;
        // Stamp, two names and seven numbers.
        let count = reader.count(8 + 4 + 4 + 56)?;
        let mut transforms = Vec::new();
        for _ in 0..count {
            let header = RosHeader::read(&mut reader)?;
            let child = frame_name(reader.text()?);
            if let Some(parent_from_child) = pose(reader.array()?) {
                transforms.push(Self { header, child, parent_from_child });
            }
        }
        Ok(transforms)
    }
}

/// Message `geometry_msgs/msg/PoseStamped`.
#[derive(Debug, Clone, PartialEq)]
pub struct RosPose {
    /// Time, and the frame of the pose.
    pub header: RosHeader,
    /// Pose in the frame, metres.
    pub pose: Isometry3<f64>,
}

impl RosPose {
    /// Decodes a message.
    ///
    /// # Errors
    /// [`RosError`] if it is cut off or of another type, or its rotation is no rotation.
    pub fn decode(message: &[u8]) -> Result<Self, RosError> {
        let mut reader = CdrReader::new(message)?;
        let header = RosHeader::read(&mut reader)?;
        let pose =
            pose(reader.array()?).ok_or_else(|| RosError::fault("its rotation is not a quaternion of length 1"))?;
        Ok(Self { header, pose })
    }
}

/// Greatest difference of a rotation's length from 1: the bound of tf2.
const ROTATION_TOLERANCE: f64 = 0.01;

/// Returns a pose of x, y, z and a quaternion x, y, z, w; `None` if it is no pose.
fn pose([x, y, z, i, j, k, w]: [f64; 7]) -> Option<Isometry3<f64>> {
    let quaternion = Quaternion::new(w, i, j, k);
    let is_pose = [x, y, z].iter().all(|v| v.is_finite()) && (quaternion.norm() - 1.0).abs() <= ROTATION_TOLERANCE;
    is_pose.then(|| Isometry3::from_parts(Translation3::new(x, y, z), UnitQuaternion::from_quaternion(quaternion)))
}
