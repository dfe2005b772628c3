//! Messages of ROS 2 that are published, as bytes.

use mvt_bag::nalgebra::Isometry3;

use crate::cdr_writer::CdrWriter;

/// Types of the messages, as ROS names them.
pub const POSE: &str = "geometry_msgs/msg/PoseWithCovarianceStamped";
/// See [`POSE`].
pub const TRANSFORMS: &str = "tf2_msgs/msg/TFMessage";
/// See [`POSE`].
pub const MARKER: &str = "visualization_msgs/msg/Marker";
/// See [`POSE`].
pub const POINTS: &str = "sensor_msgs/msg/PointCloud2";
/// See [`POSE`].
pub const DIAGNOSTICS: &str = "diagnostic_msgs/msg/DiagnosticArray";

/// Most triangles of a marker, so that it fits one datagram of 64 KB: receivers with small buffers lose longer messages.
pub const MOST_TRIANGLES: usize = 830;
/// `Marker.type` of a list of triangles.
const TRIANGLE_LIST: i32 = 11;
/// Actions of a marker.
const ADD: i32 = 0;
const DELETE: i32 = 2;

/// Time and frame of a message.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct OutgoingHeader<'a> {
    /// Stamp, nanoseconds.
    pub stamp_ns: i64,
    /// Name of the coordinate frame.
    pub frame: &'a str,
}

impl OutgoingHeader<'_> {
    pub(crate) fn write(&self, writer: &mut CdrWriter) {
        self.write_stamp(writer);
        writer.text(self.frame);
    }

    pub(crate) fn write_stamp(&self, writer: &mut CdrWriter) {
        const SECOND_NS: i64 = 1_000_000_000;
        // Seconds beyond 2038 are not stamps of ROS 2.
        writer.i32(i32::try_from(self.stamp_ns.div_euclid(SECOND_NS)).unwrap_or(i32::MAX));
        writer.u32(self.stamp_ns.rem_euclid(SECOND_NS) as u32);
    }
}

pub(crate) fn write_pose(writer: &mut CdrWriter, pose: &Isometry3<f64>) {
    let (at, turn) = (pose.translation, pose.rotation);
    writer.array(&[at.x, at.y, at.z, turn.i, turn.j, turn.k, turn.w]);
}

/// Returns a `PoseWithCovarianceStamped`. The variances, square metres and square radians, are the same along and about all axes: the
/// estimate states one deviation of the surface and one of the angle.
pub fn pose(header: OutgoingHeader<'_>, pose: &Isometry3<f64>, [along, about]: [f64; 2]) -> Vec<u8> {
    let mut writer = CdrWriter::new();
    header.write(&mut writer);
    write_pose(&mut writer, pose);
    let covariance: [f64; 36] = std::array::from_fn(|k| match (k / 6, k % 6) {
        (row, column) if row != column => 0.0,
        (row, _) if row < 3 => along,
        _ => about,
    });
    writer.array(&covariance);
    writer.into_message()
}

/// Returns a `TFMessage` with one transform.
pub fn transform(header: OutgoingHeader<'_>, child: &str, parent_from_child: &Isometry3<f64>) -> Vec<u8> {
    let mut writer = CdrWriter::new();
    writer.count(1);
    header.write(&mut writer);
    writer.text(child);
    write_pose(&mut writer, parent_from_child);
    writer.into_message()
}

/// Returns the `Marker`s of a mesh, in pieces of at most [`MOST_TRIANGLES`] with numbers from 0 on, and one that deletes each piece of an
/// earlier, larger mesh, which had `earlier` pieces. Corners are metres in the frame of the header.
pub fn markers(header: OutgoingHeader<'_>, triangles: &[[[f64; 3]; 3]], earlier: usize) -> Vec<Vec<u8>> {
    let pieces = triangles.chunks(MOST_TRIANGLES);
    let count = pieces.len();
    let mut markers: Vec<Vec<u8>> = pieces.enumerate().map(|(id, piece)| marker(header, id, ADD, piece)).collect();
    markers.extend((count..earlier).map(|id| marker(header, id, DELETE, &[])));
    markers
}

fn marker(header: OutgoingHeader<'_>, id: usize, action: i32, triangles: &[[[f64; 3]; 3]]) -> Vec<u8> {
    /// Red, green, blue and opacity: a light grey.
    const COLOUR: [f32; 4] = [0.75, 0.75, 0.78, 1.0];
    let mut writer = CdrWriter::new();
    header.write(&mut writer);
    writer.text("mesh").i32(i32::try_from(id).unwrap_or(i32::MAX)).i32(TRIANGLE_LIST).i32(action);
    write_pose(&mut writer, &Isometry3::identity());
    writer.array(&[1.0; 3]);
    for level in COLOUR {
        writer.f32(level);
    }
    // It stays until it is replaced, and moves with its frame.
    writer.i32(0).u32(0).u8(1);
    writer.count(3 * triangles.len());
    for corner in triangles.iter().flatten() {
        writer.array(corner);
    }
    // No colours of corners.
    writer.count(0);
    // No texture: its name, an empty compressed image, and no coordinates.
    writer.text("");
    OutgoingHeader { stamp_ns: 0, frame: "" }.write(&mut writer);
    writer.text("").count(0).count(0);
    // No text, no file of a mesh.
    writer.text("").text("").text("").count(0).u8(0);
    writer.into_message()
}

/// Returns a `PointCloud2` of places, x, y and z in the frame of the header, and of the indentation there, all in metres.
pub fn points(header: OutgoingHeader<'_>, points: &[[f32; 4]]) -> Vec<u8> {
    /// `PointField.datatype` of a number of 32 bits with fractions.
    const FLOAT32: u8 = 7;
    const FIELDS: [&str; 4] = ["x", "y", "z", "indentation"];
    let size = |values: usize| u32::try_from(size_of::<f32>() * values).unwrap_or(u32::MAX);
    let mut writer = CdrWriter::new();
    header.write(&mut writer);
    // One row.
    writer.u32(1).count(points.len()).count(FIELDS.len());
    for (k, name) in FIELDS.into_iter().enumerate() {
        writer.text(name).u32(size(k)).u8(FLOAT32).u32(1);
    }
    // Little endian; the bytes of a point and of the row.
    writer.u8(0).u32(size(FIELDS.len())).u32(size(FIELDS.len() * points.len()));
    let bytes: Vec<u8> = points.iter().flatten().flat_map(|value| value.to_le_bytes()).collect();
    // No point is missing.
    writer.bytes(&bytes).u8(1);
    writer.into_message()
}

/// How well something works, as diagnostics name it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DiagnosticLevel {
    /// As it should be.
    Ok = 0,
    /// It works, but somebody should look.
    Warn = 1,
    /// It does not work.
    Error = 2,
}

/// Returns a `DiagnosticArray` with one status: its name, what it is about, a sentence, and values by their keys.
pub fn diagnostics(
    header: OutgoingHeader<'_>,
    level: DiagnosticLevel,
    [name, message, hardware]: [&str; 3],
    values: &[(String, String)],
) -> Vec<u8> {
    let mut writer = CdrWriter::new();
    header.write(&mut writer);
    writer.count(1).u8(level as u8).text(name).text(message).text(hardware).count(values.len());
    for (key, value) in values {
        writer.text(key).text(value);
    }
    writer.into_message()
}

#[cfg(test)]
mod tests {
    use mvt_bag::nalgebra::{Translation3, UnitQuaternion, Vector3};
    use mvt_bag::{CdrReader, RosTransform};

    use super::*;

    const HEADER: OutgoingHeader<'_> = OutgoingHeader { stamp_ns: 12_000_000_345, frame: "cam" };

    fn some_pose() -> Isometry3<f64> {
        let turn = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), 0.7);
        Isometry3::from_parts(Translation3::new(1.0, 2.0, 3.0), turn)
    }

    #[test]
    fn a_transform_is_read_back() {
        let read = RosTransform::decode(&transform(HEADER, "mug", &some_pose())).unwrap();
        let [only] = read.as_slice() else { panic!("{read:?}") };
        assert_eq!(
            (only.header.stamp_ns, only.header.frame.as_str(), only.child.as_str()),
            (12_000_000_345, "cam", "mug")
        );
        assert!((only.parent_from_child.inv_mul(&some_pose())).translation.vector.norm() < 1e-12);
    }

    #[test]
    fn a_large_mesh_comes_in_pieces_that_fit_a_datagram() {
        let triangles = vec![[[0.1, 0.2, 0.3]; 3]; 2 * MOST_TRIANGLES + 1];
        let markers = markers(HEADER, &triangles, 5);
        assert_eq!(markers.len(), 5);
        assert!(markers.iter().all(|marker| marker.len() < 61_000), "{}", markers[0].len());
        for (number, marker) in markers.iter().enumerate() {
            let mut reader = CdrReader::new(marker).unwrap();
            let head = (reader.i32().unwrap(), reader.u32().unwrap(), reader.text().unwrap(), reader.text().unwrap());
            assert_eq!(head, (12, 345, "cam", "mesh"));
            let action = if number < 3 { ADD } else { DELETE };
            assert_eq!([reader.i32(), reader.i32(), reader.i32()], [Ok(number as i32), Ok(TRIANGLE_LIST), Ok(action)]);
        }
    }

    #[test]
    fn the_covariance_is_diagonal() {
        let message = pose(HEADER, &some_pose(), [4.0, 9.0]);
        let mut reader = CdrReader::new(&message).unwrap();
        let _ = (reader.i32(), reader.u32(), reader.text());
        let numbers: [f64; 43] = reader.array().unwrap();
        assert_eq!(numbers[..3], [1.0, 2.0, 3.0]);
        let sum: f64 = numbers[7..].iter().sum();
        assert_eq!((numbers[7], numbers[42], sum), (4.0, 9.0, 39.0));
    }
}
