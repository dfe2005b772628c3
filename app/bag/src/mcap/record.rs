//! Records of MCAP files.

use std::io::{self, Read};

/// First and last bytes of a file.
pub(crate) const MAGIC: [u8; 8] = *b"\x89MCAP0\r\n";

/// Kinds of records that are read; all others are skipped.
pub(crate) const FOOTER: u8 = 2;
pub(crate) const SCHEMA: u8 = 3;
pub(crate) const CHANNEL: u8 = 4;
pub(crate) const MESSAGE: u8 = 5;
pub(crate) const CHUNK: u8 = 6;
pub(crate) const MESSAGE_INDEX: u8 = 7;
pub(crate) const CHUNK_INDEX: u8 = 8;
pub(crate) const STATISTICS: u8 = 11;
pub(crate) const DATA_END: u8 = 15;

/// Bytes of the kind and length of a record.
pub(crate) const HEAD: usize = 9;
/// Bytes of a message before its data: channel, number, and the times of recording and publishing.
pub(crate) const MESSAGE_HEAD: usize = 2 + 4 + 8 + 8;

/// Numbers and texts of a record. `None` where it ends before.
#[derive(Debug, Clone)]
pub(crate) struct Fields<'a>(pub &'a [u8]);

impl<'a> Fields<'a> {
    pub fn bytes(&mut self, count: usize) -> Option<&'a [u8]> {
        let (bytes, rest) = self.0.split_at_checked(count)?;
        self.0 = rest;
        Some(bytes)
    }

    pub fn number(&mut self, size: usize) -> Option<u64> {
        Some(self.bytes(size)?.iter().rev().fold(0, |number, &byte| number << 8 | u64::from(byte)))
    }

    pub fn id(&mut self) -> Option<u16> {
        Some(self.number(2)? as u16)
    }

    /// Reads a time; those after the year 2262 become that year.
    pub fn time_ns(&mut self) -> Option<i64> {
        Some(i64::try_from(self.number(8)?).unwrap_or(i64::MAX))
    }

    pub fn text(&mut self) -> Option<&'a str> {
        let count = self.number(4)? as usize;
        std::str::from_utf8(self.bytes(count)?).ok()
    }

    /// Returns kind and contents of the next record; `None` at the end and where the rest is shorter than the record.
    pub fn record(&mut self) -> Option<(u8, Fields<'a>)> {
        let kind = self.number(1)? as u8;
        let length = usize::try_from(self.number(8)?).ok()?;
        Some((kind, Fields(self.bytes(length)?)))
    }
}

/// Channel of an MCAP file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct McapChannel {
    /// Name of the topic.
    pub topic: String,
    /// Name of the schema, such as `sensor_msgs/msg/Image` or `foxglove.RawImage`; empty without one.
    pub schema: String,
    /// Encoding of the messages, such as `cdr` or `protobuf`.
    pub encoding: String,
}

/// Place of a chunk, or of messages that stand in none.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Span {
    pub offset: u64,
    pub length: u64,
    /// Times of its first and last messages, nanoseconds.
    pub start_ns: i64,
    pub end_ns: i64,
    /// Whether it is a chunk; else the records themselves stand there.
    pub is_chunk: bool,
}

/// Head of a chunk.
#[derive(Debug)]
pub(crate) struct ChunkHead {
    pub start_ns: i64,
    pub end_ns: i64,
    pub plain_size: u64,
    /// Checksum of the plain records; 0 without one.
    pub checksum: u32,
    pub compression: String,
    pub packed_size: u64,
}

impl ChunkHead {
    /// Reads the head of a chunk of so many bytes.
    pub fn read(from: &mut impl Read, length: u64) -> io::Result<Self> {
        const FIXED: usize = 8 + 8 + 8 + 4 + 4;
        let wrong = || io::Error::new(io::ErrorKind::InvalidData, "the head of a chunk is damaged");
        let mut fixed = [0; FIXED];
        from.read_exact(&mut fixed)?;
        let mut fields = Fields(&fixed);
        let (start_ns, end_ns) = fields.time_ns().zip(fields.time_ns()).ok_or_else(wrong)?;
        let (plain_size, checksum) = fields.number(8).zip(fields.number(4)).ok_or_else(wrong)?;
        let name_length = fields.number(4).filter(|length| *length <= 16).ok_or_else(wrong)? as usize;
        let mut rest = [0; 16 + 8];
        let rest = rest.get_mut(..name_length + 8).ok_or_else(wrong)?;
        from.read_exact(rest)?;
        let mut fields = Fields(rest);
        let compression = String::from_utf8_lossy(fields.bytes(name_length).unwrap_or_default()).into_owned();
        let packed_size = fields.number(8).ok_or_else(wrong)?;
        let size = (FIXED + name_length + 8) as u64;
        if size.checked_add(packed_size) != Some(length) {
            return Err(wrong());
        }
        Ok(Self { start_ns, end_ns, plain_size, checksum: checksum as u32, compression, packed_size })
    }
}
