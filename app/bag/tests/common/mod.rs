//! Writers of small bags for tests.

#![allow(dead_code, reason = "each test uses some of them")]

use std::path::{Path, PathBuf};

/// Returns a file or folder of `tests/data`.
pub fn data(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data").join(name)
}

/// Message in CDR, little-endian.
pub struct Cdr(Vec<u8>);

impl Cdr {
    pub fn new() -> Self {
        Self(vec![0, 1, 0, 0])
    }

    /// Starts with a stamp and a frame.
    pub fn header(stamp_ns: i64, frame: &str) -> Self {
        Self::new().u32((stamp_ns / 1_000_000_000) as u32).u32((stamp_ns % 1_000_000_000) as u32).text(frame)
    }

    fn align(&mut self, size: usize) {
        // Padding is not zero: programs leave there what was in memory.
        while !(self.0.len() - 4).is_multiple_of(size) {
            self.0.push(0xcd);
        }
    }

    pub fn u8(mut self, value: u8) -> Self {
        self.0.push(value);
        self
    }

    pub fn u32(mut self, value: u32) -> Self {
        self.align(4);
        self.0.extend(value.to_le_bytes());
        self
    }

    pub fn f64s(mut self, values: &[f64]) -> Self {
        for value in values {
            self.align(8);
            self.0.extend(value.to_le_bytes());
        }
        self
    }

    pub fn bytes(self, bytes: &[u8]) -> Self {
        let mut out = self.u32(bytes.len() as u32);
        out.0.extend(bytes);
        out
    }

    pub fn text(self, text: &str) -> Self {
        self.bytes(&[text.as_bytes(), &[0]].concat())
    }

    /// Ends with bytes that belong to nothing.
    pub fn done(mut self) -> Vec<u8> {
        self.0.extend([0xcd; 3]);
        self.0
    }
}

pub fn image(stamp_ns: i64, encoding: &str, [width, height]: [u32; 2], step: u32, pixels: &[u8]) -> Vec<u8> {
    let head = Cdr::header(stamp_ns, "optical").u32(height).u32(width).text(encoding);
    head.u8(0).u32(step).bytes(pixels).done()
}

/// A colour image of 4 x 3 pixels.
pub fn color(stamp_ns: i64) -> Vec<u8> {
    image(stamp_ns, "rgb8", [4, 3], 12, &[90; 36])
}

/// A depth image of 4 x 3 pixels at 1 m.
pub fn depth(stamp_ns: i64) -> Vec<u8> {
    image(stamp_ns, "16UC1", [4, 3], 8, &1000u16.to_le_bytes().repeat(12))
}

pub fn info(stamp_ns: i64, [width, height]: [u32; 2]) -> Vec<u8> {
    let k = [5.0, 0.0, f64::from(width) / 2.0, 0.0, 5.0, f64::from(height) / 2.0, 0.0, 0.0, 1.0];
    let head = Cdr::header(stamp_ns, "optical").u32(height).u32(width).text("plumb_bob").u32(0);
    let head = head.f64s(&k).f64s(&[0.0; 9]).f64s(&[0.0; 12]);
    head.u32(0).u32(0).u32(0).u32(0).u32(0).u32(0).u8(0).done()
}

pub const IMAGE: &str = "sensor_msgs/msg/Image";
pub const INFO: &str = "sensor_msgs/msg/CameraInfo";

/// Message of a bag: time of recording, topic, type and contents.
pub struct Written<'a>(pub i64, pub &'a str, pub &'a str, pub Vec<u8>);

/// The images and camera model of a frame with this stamp.
pub fn frame<'a>(log_ns: i64, stamp_ns: i64) -> Vec<Written<'a>> {
    vec![
        Written(log_ns, "/rgb/image", IMAGE, color(stamp_ns)),
        Written(log_ns, "/depth/image", IMAGE, depth(stamp_ns)),
        Written(log_ns, "/depth/camera_info", INFO, info(stamp_ns, [4, 3])),
    ]
}

fn record(kind: u8, contents: &[&[u8]]) -> Vec<u8> {
    let contents = contents.concat();
    [&[kind][..], &(contents.len() as u64).to_le_bytes(), &contents].concat()
}

fn text(text: &str) -> Vec<u8> {
    [&(text.len() as u32).to_le_bytes()[..], text.as_bytes()].concat()
}

/// Returns an MCAP file without chunks and without a summary.
pub fn mcap(messages: &[Written<'_>], encoding: &str) -> Vec<u8> {
    let mut out = b"\x89MCAP0\r\n".to_vec();
    out.extend(record(1, &[&text("ros2"), &text("")]));
    let mut topics: Vec<&str> = Vec::new();
    for Written(log_ns, topic, type_name, data) in messages {
        let id = topics.iter().position(|known| known == topic).unwrap_or_else(|| {
            topics.push(topic);
            let id = topics.len() as u16;
            out.extend(record(3, &[&id.to_le_bytes(), &text(type_name), &text("ros2msg"), &text("")]));
            out.extend(record(
                4,
                &[&(id - 1).to_le_bytes(), &id.to_le_bytes(), &text(topic), &text(encoding), &[0; 4]],
            ));
            topics.len() - 1
        });
        let time = log_ns.to_le_bytes();
        out.extend(record(5, &[&(id as u16).to_le_bytes(), &[0; 4], &time, &time, data]));
    }
    out.extend(record(15, &[&[0; 4]]));
    out.extend(record(2, &[&[0; 20]]));
    out.extend(b"\x89MCAP0\r\n");
    out
}
