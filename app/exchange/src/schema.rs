//! Message types of Foxglove that a log needs, with their descriptors.

use crate::protobuf::Message;

/// Type of a field, with its number in descriptors.
#[derive(Debug, Clone, Copy)]
enum Kind {
    Double,
    Int64,
    Int32,
    Fixed32,
    Text,
    Bytes,
    Of(&'static MessageType),
}

/// How often a field occurs.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Times {
    One,
    /// Its absence differs from zero.
    Optional,
    Many,
}

#[derive(Debug, Clone, Copy)]
struct Field {
    number: u32,
    name: &'static str,
    kind: Kind,
    times: Times,
}

const fn one(number: u32, name: &'static str, kind: Kind) -> Field {
    Field { number, name, kind, times: Times::One }
}

const fn many(number: u32, name: &'static str, kind: Kind) -> Field {
    Field { number, name, kind, times: Times::Many }
}

const fn optional(number: u32, name: &'static str) -> Field {
    Field { number, name, kind: Kind::Double, times: Times::Optional }
}

/// Message type, one per file as in Foxglove's repository.
#[derive(Debug)]
pub(crate) struct MessageType {
    package: &'static str,
    name: &'static str,
    file: &'static str,
    fields: &'static [Field],
}

static TIMESTAMP: MessageType = MessageType {
    package: "google.protobuf",
    name: "Timestamp",
    file: "google/protobuf/timestamp.proto",
    fields: &[one(1, "seconds", Kind::Int64), one(2, "nanos", Kind::Int32)],
};

static VECTOR3: MessageType = MessageType {
    package: "foxglove",
    name: "Vector3",
    file: "foxglove/Vector3.proto",
    fields: &[one(1, "x", Kind::Double), one(2, "y", Kind::Double), one(3, "z", Kind::Double)],
};

static QUATERNION: MessageType = MessageType {
    package: "foxglove",
    name: "Quaternion",
    file: "foxglove/Quaternion.proto",
    fields: &[
        one(1, "x", Kind::Double),
        one(2, "y", Kind::Double),
        one(3, "z", Kind::Double),
        one(4, "w", Kind::Double),
    ],
};

static FRAME_TRANSFORM: MessageType = MessageType {
    package: "foxglove",
    name: "FrameTransform",
    file: "foxglove/FrameTransform.proto",
    fields: &[
        one(1, "timestamp", Kind::Of(&TIMESTAMP)),
        one(2, "parent_frame_id", Kind::Text),
        one(3, "child_frame_id", Kind::Text),
        one(4, "translation", Kind::Of(&VECTOR3)),
        one(5, "rotation", Kind::Of(&QUATERNION)),
    ],
};

pub(crate) static FRAME_TRANSFORMS: MessageType = MessageType {
    package: "foxglove",
    name: "FrameTransforms",
    file: "foxglove/FrameTransforms.proto",
    fields: &[many(1, "transforms", Kind::Of(&FRAME_TRANSFORM))],
};

static JOINT_STATE: MessageType = MessageType {
    package: "foxglove",
    name: "JointState",
    file: "foxglove/JointState.proto",
    fields: &[
        one(1, "name", Kind::Text),
        optional(2, "position"),
        optional(3, "velocity"),
        optional(4, "acceleration"),
        optional(5, "effort"),
    ],
};

pub(crate) static JOINT_STATES: MessageType = MessageType {
    package: "foxglove",
    name: "JointStates",
    file: "foxglove/JointStates.proto",
    fields: &[one(1, "timestamp", Kind::Of(&TIMESTAMP)), many(2, "joints", Kind::Of(&JOINT_STATE))],
};

pub(crate) static COMPRESSED_IMAGE: MessageType = MessageType {
    package: "foxglove",
    name: "CompressedImage",
    file: "foxglove/CompressedImage.proto",
    fields: &[
        one(1, "timestamp", Kind::Of(&TIMESTAMP)),
        one(4, "frame_id", Kind::Text),
        one(2, "data", Kind::Bytes),
        one(3, "format", Kind::Text),
    ],
};

pub(crate) static RAW_IMAGE: MessageType = MessageType {
    package: "foxglove",
    name: "RawImage",
    file: "foxglove/RawImage.proto",
    fields: &[
        one(1, "timestamp", Kind::Of(&TIMESTAMP)),
        one(7, "frame_id", Kind::Text),
        one(2, "width", Kind::Fixed32),
        one(3, "height", Kind::Fixed32),
        one(4, "encoding", Kind::Text),
        one(5, "step", Kind::Fixed32),
        one(6, "data", Kind::Bytes),
    ],
};

pub(crate) static CAMERA_CALIBRATION: MessageType = MessageType {
    package: "foxglove",
    name: "CameraCalibration",
    file: "foxglove/CameraCalibration.proto",
    fields: &[
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
};

impl MessageType {
    /// Returns the name with its package.
    pub fn full_name(&self) -> String {
        format!("{}.{}", self.package, self.name)
    }

    /// Returns a FileDescriptorSet of this type and all types in it.
    pub fn descriptor_set(&'static self) -> Vec<u8> {
        let mut set = Message::default();
        for of in self.with_parts() {
            set = set.message(1, &of.file_descriptor());
        }
        set.into_bytes()
    }

    /// Returns the types of which this one consists, each after its own parts, and last itself.
    fn with_parts(&'static self) -> Vec<&'static Self> {
        let mut types: Vec<&Self> = Vec::new();
        for of in self.parts().flat_map(Self::with_parts).chain([self]) {
            if !types.iter().any(|known| known.file == of.file) {
                types.push(of);
            }
        }
        types
    }

    fn parts(&self) -> impl Iterator<Item = &'static Self> {
        self.fields.iter().filter_map(|field| match field.kind {
            Kind::Of(of) => Some(of),
            _ => None,
        })
    }

    fn file_descriptor(&self) -> Message {
        let mut file = Message::default().text(1, self.file).text(2, self.package);
        let mut imports: Vec<&str> = self.parts().map(|of| of.file).collect();
        imports.dedup();
        for import in imports {
            file = file.text(3, import);
        }
        let mut of = Message::default().text(1, self.name);
        let mut choices = 0;
        for field in self.fields {
            of = of.message(2, &field.descriptor(choices));
            choices += u64::from(field.times == Times::Optional);
        }
        // The presence of an optional field is declared as a choice of one.
        for field in self.fields.iter().filter(|field| field.times == Times::Optional) {
            of = of.message(8, &Message::default().text(1, &format!("_{}", field.name)));
        }
        file.message(4, &of).text(12, "proto3")
    }
}

impl Field {
    fn descriptor(&self, choice: u64) -> Message {
        let label = if self.times == Times::Many { 3 } else { 1 };
        let number = match self.kind {
            Kind::Double => 1,
            Kind::Int64 => 3,
            Kind::Int32 => 5,
            Kind::Fixed32 => 7,
            Kind::Text => 9,
            Kind::Of(_) => 11,
            Kind::Bytes => 12,
        };
        let mut field = Message::default().text(1, self.name).varint(3, u64::from(self.number));
        field = field.varint(4, label).varint(5, number);
        if let Kind::Of(of) = self.kind {
            field = field.text(6, &format!(".{}", of.full_name()));
        }
        if self.times == Times::Optional { field.varint(9, choice).varint(17, 1) } else { field }
    }
}
