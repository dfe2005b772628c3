//! Foxglove's message types, complete as Foxglove publishes them, and messages of them.

use mvt_frames::camera::Intrinsics;
use mvt_frames::{Camera, Frame, Isometry, World};
use mvt_mesh::Mesh;
use mvt_robot::hand::Hand;

use crate::protobuf::Message;
use crate::schema::{Field, Kind, MessageType, many, one, optional};

const fn google(name: &'static str, fields: &'static [Field]) -> MessageType {
    MessageType { package: "google.protobuf", name, fields }
}

const fn foxglove(name: &'static str, fields: &'static [Field]) -> MessageType {
    MessageType { package: "foxglove", name, fields }
}

pub(crate) static TIMESTAMP: MessageType =
    google("Timestamp", &[one(1, "seconds", Kind::Int64), one(2, "nanos", Kind::Int32)]);

static VECTOR3: MessageType =
    foxglove("Vector3", &[one(1, "x", Kind::Double), one(2, "y", Kind::Double), one(3, "z", Kind::Double)]);

static QUATERNION: MessageType = foxglove(
    "Quaternion",
    &[one(1, "x", Kind::Double), one(2, "y", Kind::Double), one(3, "z", Kind::Double), one(4, "w", Kind::Double)],
);

static FRAME_TRANSFORM: MessageType = foxglove(
    "FrameTransform",
    &[
        one(1, "timestamp", Kind::Of(&TIMESTAMP)),
        one(2, "parent_frame_id", Kind::Text),
        one(3, "child_frame_id", Kind::Text),
        one(4, "translation", Kind::Of(&VECTOR3)),
        one(5, "rotation", Kind::Of(&QUATERNION)),
    ],
);

pub(crate) static FRAME_TRANSFORMS: MessageType =
    foxglove("FrameTransforms", &[many(1, "transforms", Kind::Of(&FRAME_TRANSFORM))]);

static JOINT_STATE: MessageType = foxglove(
    "JointState",
    &[
        one(1, "name", Kind::Text),
        optional(2, "position"),
        optional(3, "velocity"),
        optional(4, "acceleration"),
        optional(5, "effort"),
    ],
);

pub(crate) static JOINT_STATES: MessageType =
    foxglove("JointStates", &[one(1, "timestamp", Kind::Of(&TIMESTAMP)), many(2, "joints", Kind::Of(&JOINT_STATE))]);

pub(crate) static COMPRESSED_IMAGE: MessageType = foxglove(
    "CompressedImage",
    &[
        one(1, "timestamp", Kind::Of(&TIMESTAMP)),
        one(4, "frame_id", Kind::Text),
        one(2, "data", Kind::Bytes),
        one(3, "format", Kind::Text),
    ],
);

pub(crate) static RAW_IMAGE: MessageType = foxglove(
    "RawImage",
    &[
        one(1, "timestamp", Kind::Of(&TIMESTAMP)),
        one(7, "frame_id", Kind::Text),
        one(2, "width", Kind::Fixed32),
        one(3, "height", Kind::Fixed32),
        one(4, "encoding", Kind::Text),
        one(5, "step", Kind::Fixed32),
        one(6, "data", Kind::Bytes),
    ],
);

pub(crate) static CAMERA_CALIBRATION: MessageType = foxglove(
    "CameraCalibration",
    &[
        one(1, "timestamp", Kind::Of(&TIMESTAMP)),
        one(9, "frame_id", Kind::Text),
        one(2, "width", Kind::Fixed32),
        one(3, "height", Kind::Fixed32),
        one(4, "distortion_model", Kind::Text),
        many(5, "D", Kind::Double),
        many(6, "K", Kind::Double),
        many(7, "R", Kind::Double),
        many(8, "P", Kind::Double),
    ],
);

static DURATION: MessageType = google("Duration", &[one(1, "seconds", Kind::Int64), one(2, "nanos", Kind::Int32)]);

static POSE: MessageType =
    foxglove("Pose", &[one(1, "position", Kind::Of(&VECTOR3)), one(2, "orientation", Kind::Of(&QUATERNION))]);

static POINT3: MessageType =
    foxglove("Point3", &[one(1, "x", Kind::Double), one(2, "y", Kind::Double), one(3, "z", Kind::Double)]);

static COLOR: MessageType = foxglove(
    "Color",
    &[one(1, "r", Kind::Double), one(2, "g", Kind::Double), one(3, "b", Kind::Double), one(4, "a", Kind::Double)],
);

static KEY_VALUE_PAIR: MessageType =
    foxglove("KeyValuePair", &[one(1, "key", Kind::Text), one(2, "value", Kind::Text)]);

static PACKED_ELEMENT_FIELD: MessageType = foxglove(
    "PackedElementField",
    &[
        one(1, "name", Kind::Text),
        one(2, "offset", Kind::Fixed32),
        one(
            3,
            "type",
            Kind::Choice(
                "NumericType",
                &["UNKNOWN", "UINT8", "INT8", "UINT16", "INT16", "UINT32", "INT32", "FLOAT32", "FLOAT64"],
            ),
        ),
    ],
);

pub(crate) static POINT_CLOUD: MessageType = foxglove(
    "PointCloud",
    &[
        one(1, "timestamp", Kind::Of(&TIMESTAMP)),
        one(2, "frame_id", Kind::Text),
        one(3, "pose", Kind::Of(&POSE)),
        one(4, "point_stride", Kind::Fixed32),
        many(5, "fields", Kind::Of(&PACKED_ELEMENT_FIELD)),
        one(6, "data", Kind::Bytes),
    ],
);

static ARROW: MessageType = foxglove(
    "ArrowPrimitive",
    &[
        one(1, "pose", Kind::Of(&POSE)),
        one(2, "shaft_length", Kind::Double),
        one(3, "shaft_diameter", Kind::Double),
        one(4, "head_length", Kind::Double),
        one(5, "head_diameter", Kind::Double),
        one(6, "color", Kind::Of(&COLOR)),
    ],
);

static CUBE: MessageType = foxglove(
    "CubePrimitive",
    &[one(1, "pose", Kind::Of(&POSE)), one(2, "size", Kind::Of(&VECTOR3)), one(3, "color", Kind::Of(&COLOR))],
);

static SPHERE: MessageType = foxglove(
    "SpherePrimitive",
    &[one(1, "pose", Kind::Of(&POSE)), one(2, "size", Kind::Of(&VECTOR3)), one(3, "color", Kind::Of(&COLOR))],
);

static CYLINDER: MessageType = foxglove(
    "CylinderPrimitive",
    &[
        one(1, "pose", Kind::Of(&POSE)),
        one(2, "size", Kind::Of(&VECTOR3)),
        one(3, "bottom_scale", Kind::Double),
        one(4, "top_scale", Kind::Double),
        one(5, "color", Kind::Of(&COLOR)),
    ],
);

static LINE: MessageType = foxglove(
    "LinePrimitive",
    &[
        one(1, "type", Kind::Choice("Type", &["LINE_STRIP", "LINE_LOOP", "LINE_LIST"])),
        one(2, "pose", Kind::Of(&POSE)),
        one(3, "thickness", Kind::Double),
        one(4, "scale_invariant", Kind::Bool),
        many(5, "points", Kind::Of(&POINT3)),
        one(6, "color", Kind::Of(&COLOR)),
        many(7, "colors", Kind::Of(&COLOR)),
        many(8, "indices", Kind::Fixed32),
    ],
);

static TRIANGLES: MessageType = foxglove(
    "TriangleListPrimitive",
    &[
        one(1, "pose", Kind::Of(&POSE)),
        many(2, "points", Kind::Of(&POINT3)),
        one(3, "color", Kind::Of(&COLOR)),
        many(4, "colors", Kind::Of(&COLOR)),
        many(5, "indices", Kind::Fixed32),
    ],
);

static TEXT: MessageType = foxglove(
    "TextPrimitive",
    &[
        one(1, "pose", Kind::Of(&POSE)),
        one(2, "billboard", Kind::Bool),
        one(3, "font_size", Kind::Double),
        one(4, "scale_invariant", Kind::Bool),
        one(5, "color", Kind::Of(&COLOR)),
        one(6, "text", Kind::Text),
    ],
);

static MODEL: MessageType = foxglove(
    "ModelPrimitive",
    &[
        one(1, "pose", Kind::Of(&POSE)),
        one(2, "scale", Kind::Of(&VECTOR3)),
        one(3, "color", Kind::Of(&COLOR)),
        one(4, "override_color", Kind::Bool),
        one(5, "url", Kind::Text),
        one(6, "media_type", Kind::Text),
        one(7, "data", Kind::Bytes),
    ],
);

static SCENE_ENTITY_DELETION: MessageType = foxglove(
    "SceneEntityDeletion",
    &[
        one(1, "timestamp", Kind::Of(&TIMESTAMP)),
        one(2, "type", Kind::Choice("Type", &["MATCHING_ID", "ALL"])),
        one(3, "id", Kind::Text),
    ],
);

static SCENE_ENTITY: MessageType = foxglove(
    "SceneEntity",
    &[
        one(1, "timestamp", Kind::Of(&TIMESTAMP)),
        one(2, "frame_id", Kind::Text),
        one(3, "id", Kind::Text),
        one(4, "lifetime", Kind::Of(&DURATION)),
        one(5, "frame_locked", Kind::Bool),
        many(6, "metadata", Kind::Of(&KEY_VALUE_PAIR)),
        many(7, "arrows", Kind::Of(&ARROW)),
        many(8, "cubes", Kind::Of(&CUBE)),
        many(9, "spheres", Kind::Of(&SPHERE)),
        many(10, "cylinders", Kind::Of(&CYLINDER)),
        many(11, "lines", Kind::Of(&LINE)),
        many(12, "triangles", Kind::Of(&TRIANGLES)),
        many(13, "texts", Kind::Of(&TEXT)),
        many(14, "models", Kind::Of(&MODEL)),
    ],
);

pub(crate) static SCENE_UPDATE: MessageType = foxglove(
    "SceneUpdate",
    &[many(1, "deletions", Kind::Of(&SCENE_ENTITY_DELETION)), many(2, "entities", Kind::Of(&SCENE_ENTITY))],
);

pub(crate) static LOG: MessageType = foxglove(
    "Log",
    &[
        one(1, "timestamp", Kind::Of(&TIMESTAMP)),
        one(2, "level", Kind::Choice("Level", &["UNKNOWN", "DEBUG", "INFO", "WARNING", "ERROR", "FATAL"])),
        one(3, "message", Kind::Text),
        one(4, "name", Kind::Text),
        one(5, "file", Kind::Text),
        one(6, "line", Kind::Fixed32),
    ],
);

/// Returns nanoseconds; times before zero become zero.
pub(crate) fn time_ns(time_s: f64) -> u64 {
    (time_s * 1e9).round() as u64
}

pub(crate) fn timestamp(time_ns: u64) -> Message {
    const SECOND: u64 = 1_000_000_000;
    Message::default().varint(1, time_ns / SECOND).varint(2, time_ns % SECOND)
}

/// Returns the rotation from the camera that Foxglove expects, with z along the optical axis and y down, to one with OpenGL axes.
pub(crate) fn optical() -> Isometry<Camera, Camera> {
    Isometry::from_parts([0.0; 3], [0.0, 1.0, 0.0, 0.0])
}

pub(crate) fn transform<F: Frame>(stamp: &Message, child: &str, pose: Isometry<F, World>) -> Message {
    let origin = pose.origin().coords();
    let [w, x, y, z] = pose.quaternion_wxyz();
    Message::default()
        .message(1, stamp)
        .text(2, "world")
        .text(3, child)
        .message(4, &numbers(&[origin.x, origin.y, origin.z]))
        .message(5, &numbers(&[x, y, z, w]))
}

pub(crate) fn transforms(poses: &[Message]) -> Message {
    poses.iter().fold(Message::default(), |list, pose| list.message(1, pose))
}

/// Returns the angles, radians, or displacements, metres, with the names of the joints.
pub(crate) fn joint_states(stamp: &Message, hand: &Hand, joints: &[f64]) -> Message {
    hand.joints().iter().zip(joints).fold(Message::default().message(1, stamp), |list, (joint, &angle)| {
        list.message(2, &Message::default().text(1, &joint.name).double(2, angle))
    })
}

pub(crate) fn calibration(stamp: &Message, frame: &str, intrinsics: &Intrinsics) -> Message {
    let &Intrinsics { width, height, fx, fy, cx, cy } = intrinsics;
    Message::default()
        .message(1, stamp)
        .text(9, frame)
        .fixed32(2, width as u32)
        .fixed32(3, height as u32)
        .text(4, "plumb_bob")
        .doubles(5, &[0.0; 5])
        .doubles(6, &[fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0])
        .doubles(7, &[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0])
        .doubles(8, &[fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0])
}

pub(crate) fn compressed(stamp: &Message, frame: &str, file: &[u8]) -> Message {
    // The name of a file in a log does not tell its format.
    let format = if file.starts_with(b"\x89PNG") { "png" } else { "jpeg" };
    Message::default().message(1, stamp).text(4, frame).bytes(2, file).text(3, format)
}

/// Returns depth or indentation row by row.
pub(crate) fn raw_image(stamp: &Message, frame: &str, width: usize, values: &[f32]) -> Message {
    let bytes: Vec<u8> = values.iter().flat_map(|z| z.to_le_bytes()).collect();
    Message::default()
        .message(1, stamp)
        .text(7, frame)
        .fixed32(2, width as u32)
        .fixed32(3, (values.len() / width.max(1)) as u32)
        .text(4, "32FC1")
        .fixed32(5, 4 * width as u32)
        .bytes(6, &bytes)
}

/// Returns points, metres, with their colours.
pub(crate) fn point_cloud(stamp: &Message, frame: &str, points: impl Iterator<Item = ([f32; 3], [u8; 3])>) -> Message {
    const FLOAT32: u64 = 7;
    const UINT8: u64 = 1;
    let bytes: Vec<u8> = points
        .flat_map(|(point, [r, g, b])| point.into_iter().flat_map(f32::to_le_bytes).chain([r, g, b, u8::MAX]))
        .collect();
    let field =
        |name: &str, offset: u32, kind: u64| Message::default().text(1, name).fixed32(2, offset).varint(3, kind);
    let mut cloud = Message::default().message(1, stamp).text(2, frame).message(3, &unmoved()).fixed32(4, 16);
    for (name, offset) in [("x", 0), ("y", 4), ("z", 8)] {
        cloud = cloud.message(5, &field(name, offset, FLOAT32));
    }
    for (name, offset) in [("red", 12), ("green", 13), ("blue", 14), ("alpha", 15)] {
        cloud = cloud.message(5, &field(name, offset, UINT8));
    }
    cloud.bytes(6, &bytes)
}

/// Returns a scene in which a mesh replaces the last one of this name. It moves with the frame.
pub(crate) fn mesh(stamp: &Message, frame: &str, name: &str, mesh: &Mesh, color: [f64; 4]) -> Message {
    let mut triangles = Message::default().message(1, &unmoved());
    for vertex in &mesh.vertices {
        triangles = triangles.message(2, &numbers(&vertex.to_array().map(f64::from)));
    }
    let indices: Vec<u8> = mesh.faces.iter().flatten().flat_map(|index| index.to_le_bytes()).collect();
    let triangles = triangles.message(3, &numbers(&color)).bytes(5, &indices);
    let entity = Message::default().message(1, stamp).text(2, frame).text(3, name).varint(5, 1).message(12, &triangles);
    Message::default().message(2, &entity)
}

/// Importance of a line.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Level {
    Info = 2,
    Warning = 3,
}

pub(crate) fn log_line(stamp: &Message, level: Level, text: &str) -> Message {
    Message::default().message(1, stamp).varint(2, level as u64).text(3, text).text(4, "mambavitact")
}

/// The pose that changes nothing.
fn unmoved() -> Message {
    Message::default().message(1, &Message::default()).message(2, &Message::default().double(4, 1.0))
}

/// Numbers in the fields from 1 on.
fn numbers(values: &[f64]) -> Message {
    (1..).zip(values).fold(Message::default(), |list, (field, &value)| list.double(field, value))
}
