//! Reader of MCAP files (<https://mcap.dev/spec>), from the first record to the last.
//!
//! A file may be a bomb: a few bytes that decompress to many. Chunks are therefore never held whole, and all that is kept of a file is limited by
//! its size.

use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::fs::File;
use std::io::{self, BufReader, Read};
use std::path::Path;

use crc32fast::Hasher;
use lz4_flex::frame::FrameDecoder as Lz4;
use ruzstd::decoding::errors::FrameDecoderError;
use ruzstd::decoding::{FrameDecoder, StreamingDecoder};

use crate::writer::MAGIC;

/// Greatest size of a message, bytes: larger than the image of any camera. In a small file a message may be [`SMALL`], but not larger than the
/// file otherwise.
const LARGEST: u64 = 64 << 20;
const SMALL: u64 = 4 << 20;
/// Greatest ratio of decompressed to compressed bytes: even depth images without any depth have less.
const RATIO: u64 = 2000;
/// A record grows by this many bytes, so that no more is allocated than the file delivers.
const STEP: usize = 1 << 20;
/// Greatest window of Zstandard, bytes: that of its levels 1 to 19. The decoder allocates it at once.
const WINDOW: u64 = 8 << 20;

/// Kinds of records that are read; all others are skipped.
const HEADER: u8 = 1;
const FOOTER: u8 = 2;
const SCHEMA: u8 = 3;
const CHANNEL: u8 = 4;
const MESSAGE: u8 = 5;
const CHUNK: u8 = 6;
const ATTACHMENT: u8 = 9;

/// Reason why a file is not read to its end.
#[derive(Debug, thiserror::Error)]
pub(crate) enum ReadError {
    /// Not a whole MCAP file, or damaged.
    #[error("{0}")]
    Damaged(String),
    /// The operating system refused, or compressed data are damaged.
    #[error("{0}")]
    Io(io::Error),
}

impl From<io::Error> for ReadError {
    fn from(error: io::Error) -> Self {
        match error.kind() {
            io::ErrorKind::UnexpectedEof => Self::Damaged(CUT_OFF.to_owned()),
            _ => Self::Io(error),
        }
    }
}

const CUT_OFF: &str = "it ends in the middle of a record: it was cut off";

fn damaged<T>(defect: impl Into<String>) -> Result<T, ReadError> {
    Err(ReadError::Damaged(defect.into()))
}

/// Channel of a file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct ChannelRecord {
    pub topic: String,
    /// Name of the schema, such as `foxglove.RawImage`; empty without one.
    pub schema: String,
    /// Encoding of the messages, such as `protobuf`.
    pub encoding: String,
}

/// Record that a visitor receives.
pub(crate) enum Record<'a> {
    /// A channel appears for the first time. Its messages are delivered only if the visitor returns true.
    Channel(u16, &'a ChannelRecord),
    /// A message of a channel: time of recording, nanoseconds, and contents.
    Message(u16, u64, &'a [u8]),
    /// A file in the file, by its name.
    Attachment(&'a str, &'a [u8]),
}

/// Numbers and texts at the beginning of a record.
struct Fields<'a>(&'a [u8]);

impl<'a> Fields<'a> {
    fn bytes(&mut self, count: usize) -> Result<&'a [u8], ReadError> {
        match self.0.split_at_checked(count) {
            Some((bytes, rest)) => {
                self.0 = rest;
                Ok(bytes)
            }
            None => damaged("a record is shorter than its contents"),
        }
    }

    fn number(&mut self, size: usize) -> Result<u64, ReadError> {
        Ok(self.bytes(size)?.iter().rev().fold(0, |number, &byte| number << 8 | u64::from(byte)))
    }

    fn counted(&mut self) -> Result<&'a [u8], ReadError> {
        let count = self.number(4)? as usize;
        self.bytes(count)
    }

    fn text(&mut self) -> Result<&'a str, ReadError> {
        std::str::from_utf8(self.counted()?).or_else(|_| damaged("a name is not UTF-8"))
    }
}

/// Contents of the file that is read, up to some place.
struct Counted<R> {
    inner: R,
    checksum: Hasher,
    count: u64,
    limit: u64,
}

impl<R: Read> Read for Counted<R> {
    fn read(&mut self, out: &mut [u8]) -> io::Result<usize> {
        let read = self.inner.read(out)?;
        self.checksum.update(out.get(..read).unwrap_or_default());
        self.count += read as u64;
        if self.count > self.limit {
            return Err(io::Error::other("it decompresses to more bytes than any recording has"));
        }
        Ok(read)
    }
}

/// The state of a file while it is read.
struct Scan<'v, V> {
    visit: &'v mut V,
    schemas: HashMap<u16, String>,
    /// Channels, and whether they are wanted.
    channels: HashMap<u16, (ChannelRecord, bool)>,
    /// Bytes of names that may still be kept.
    names_left: u64,
    /// Decompressed bytes that may still come.
    bytes_left: u64,
    largest: u64,
    record: Vec<u8>,
}

/// Reads a file and passes its records to `visit`, whose answer matters for channels alone. An error of `visit` ends the reading.
pub(crate) fn scan<E: From<ReadError>>(
    path: &Path,
    visit: &mut impl FnMut(Record<'_>) -> Result<bool, E>,
) -> Result<(), E> {
    let file = mvt_files::input::open(path).map_err(ReadError::from)?;
    let size = file.metadata().map_err(ReadError::from)?.len();
    let limit = size.saturating_mul(RATIO).saturating_add(SMALL);
    let mut scan = Scan {
        visit,
        schemas: HashMap::new(),
        channels: HashMap::new(),
        names_left: size.max(1 << 16),
        bytes_left: limit,
        largest: size.clamp(SMALL, LARGEST),
        record: Vec::new(),
    };
    scan.file(BufReader::with_capacity(1 << 18, file))
}

impl<V, E> Scan<'_, V>
where
    V: FnMut(Record<'_>) -> Result<bool, E>,
    E: From<ReadError>,
{
    fn file(&mut self, mut file: BufReader<File>) -> Result<(), E> {
        let mut magic = [0; MAGIC.len()];
        if file.read_exact(&mut magic).is_err() || magic != MAGIC {
            return Ok(damaged("it is not an MCAP file: its first bytes are others")?);
        }
        let mut is_first = true;
        while let Some((kind, length)) = head(&mut file)? {
            if is_first != (kind == HEADER) {
                return Ok(damaged("it does not begin with one header")?);
            }
            is_first = false;
            match kind {
                CHUNK => self.chunk(&mut file, length)?,
                FOOTER => {
                    self.skip(&mut file, length)?;
                    if file.read_exact(&mut magic).is_err() || magic != MAGIC {
                        return Ok(damaged("its last bytes are not those of an MCAP file")?);
                    }
                    return Ok(());
                }
                _ => self.record(&mut file, kind, length)?,
            }
        }
        Ok(damaged("it ends before its footer: it was cut off; `mcap recover` keeps what is there")?)
    }

    /// Reads the records of a chunk.
    fn chunk(&mut self, file: &mut impl Read, length: u64) -> Result<(), E> {
        // Times of the first and last message, size, checksum, name of the compression, size of the records.
        const FIXED: usize = 8 + 8 + 8 + 4 + 4;
        let mut fixed = [0; FIXED];
        read_exact(file, &mut fixed)?;
        let mut fields = Fields(&fixed);
        fields.bytes(16)?;
        let size = fields.number(8)?;
        let checksum = fields.number(4)? as u32;
        let name_length = fields.number(4)?;
        if name_length > 16 {
            return Ok(damaged("the compression of a chunk is unknown")?);
        }
        let mut rest = vec![0; name_length as usize + 8];
        read_exact(file, &mut rest)?;
        let mut fields = Fields(&rest);
        let compression = String::from_utf8_lossy(fields.bytes(name_length as usize)?).into_owned();
        let packed = fields.number(8)?;
        if Some(packed) != length.checked_sub((FIXED + rest.len()) as u64) {
            return Ok(damaged("the size of a chunk contradicts that of its records")?);
        }
        let mut packed = file.take(packed);
        let (found_size, found_checksum) = match compression.as_str() {
            "" => self.records(&mut packed)?,
            "lz4" => self.records(Lz4::new(&mut packed))?,
            "zstd" => {
                let plain = zstd(&mut packed);
                self.records(plain.map_err(|e| ReadError::Damaged(format!("a chunk is not Zstandard: {e}")))?)?
            }
            other => return Ok(damaged(format!("its chunks have the compression {other:?}; lz4 and zstd are known"))?),
        };
        if found_size != size || (checksum != 0 && found_checksum != checksum) {
            return Ok(damaged("a chunk is damaged: its size or checksum is wrong")?);
        }
        let left = packed.limit();
        Ok(self.skip(&mut packed, left)?)
    }

    /// Reads records to their end. Returns their size and checksum.
    fn records(&mut self, from: impl Read) -> Result<(u64, u32), E> {
        let mut from = Counted { inner: from, checksum: Hasher::new(), count: 0, limit: self.bytes_left };
        while let Some((kind, length)) = head(&mut from)? {
            self.record(&mut from, kind, length)?;
        }
        self.bytes_left -= from.count.min(self.bytes_left);
        Ok((from.count, from.checksum.finalize()))
    }

    /// Reads a record and passes it on.
    fn record(&mut self, from: &mut impl Read, kind: u8, length: u64) -> Result<(), E> {
        if kind != MESSAGE {
            if !matches!(kind, SCHEMA | CHANNEL | ATTACHMENT) {
                return Ok(self.skip(from, length)?);
            }
            self.load(from, length)?;
            return self.described(kind);
        }
        const FIXED: usize = 2 + 4 + 8 + 8;
        let mut fixed = [0; FIXED];
        let Some(length) = length.checked_sub(FIXED as u64) else {
            return Ok(damaged("a message is shorter than its head")?);
        };
        read_exact(from, &mut fixed)?;
        let mut fields = Fields(&fixed);
        let id = fields.number(2)? as u16;
        fields.bytes(4)?;
        let time_ns = fields.number(8)?;
        match self.channels.get(&id) {
            None => Ok(damaged("a message has no channel")?),
            Some((_, false)) => Ok(self.skip(from, length)?),
            Some((_, true)) => {
                self.load(from, length)?;
                (self.visit)(Record::Message(id, time_ns, &self.record)).map(|_| ())
            }
        }
    }

    /// Keeps a schema or channel, or passes an attachment on.
    fn described(&mut self, kind: u8) -> Result<(), E> {
        let Self { visit, schemas, channels, names_left, record, .. } = self;
        let mut fields = Fields(record);
        if kind == ATTACHMENT {
            fields.bytes(16)?;
            let name = fields.text()?;
            fields.text()?;
            let size = fields.number(8)?;
            let data = fields.bytes(usize::try_from(size).unwrap_or(usize::MAX))?;
            let checksum = fields.number(4)?;
            let covered = record.get(..record.len().saturating_sub(4)).unwrap_or_default();
            if checksum != 0 && checksum != u64::from(crc32fast::hash(covered)) {
                return Ok(damaged(format!("the attachment {name:?} is damaged: its checksum is wrong"))?);
            }
            return visit(Record::Attachment(name, data)).map(|_| ());
        }
        let id = fields.number(2)? as u16;
        let mut keep = |text: &str| match names_left.checked_sub(text.len() as u64 + 8) {
            Some(left) => {
                *names_left = left;
                Ok(text.to_owned())
            }
            None => damaged("the names of its channels are longer than the file"),
        };
        if kind == SCHEMA {
            if let Entry::Vacant(place) = schemas.entry(id) {
                place.insert(keep(fields.text()?)?);
            }
            return Ok(());
        }
        if channels.contains_key(&id) {
            return Ok(());
        }
        let schema = schemas.get(&(fields.number(2)? as u16)).cloned().unwrap_or_default();
        let channel =
            ChannelRecord { topic: keep(fields.text()?)?, schema: keep(&schema)?, encoding: keep(fields.text()?)? };
        let is_wanted = visit(Record::Channel(id, &channel))?;
        channels.insert(id, (channel, is_wanted));
        Ok(())
    }

    /// Reads the contents of a record into `self.record`.
    fn load(&mut self, from: &mut impl Read, length: u64) -> Result<(), ReadError> {
        if length > self.largest {
            return damaged(format!("a record of {length} bytes is larger than a file of this size can hold"));
        }
        self.record.clear();
        while (self.record.len() as u64) < length {
            let step = STEP.min(length as usize - self.record.len());
            self.record.reserve_exact(step);
            if from.take(step as u64).read_to_end(&mut self.record)? < step {
                return damaged(CUT_OFF);
            }
        }
        Ok(())
    }

    fn skip(&mut self, from: &mut impl Read, length: u64) -> Result<(), ReadError> {
        if io::copy(&mut from.take(length), &mut io::sink())? < length {
            return damaged(CUT_OFF);
        }
        Ok(())
    }
}

/// Returns the plain contents of data compressed with Zstandard.
pub(crate) fn zstd<R: Read>(packed: R) -> Result<impl Read, FrameDecoderError> {
    let mut decoder = FrameDecoder::new();
    decoder.set_max_window_size(WINDOW);
    StreamingDecoder::new_with_decoder(packed, decoder)
}

/// Reads kind and length of a record; `None` at the end.
fn head(from: &mut impl Read) -> Result<Option<(u8, u64)>, ReadError> {
    let mut kind = [0];
    loop {
        match from.read(&mut kind) {
            Ok(0) => return Ok(None),
            Ok(_) => break,
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(error) => return Err(error.into()),
        }
    }
    let mut length = [0; 8];
    read_exact(from, &mut length)?;
    Ok(Some((kind[0], u64::from_le_bytes(length))))
}

fn read_exact(from: &mut impl Read, out: &mut [u8]) -> Result<(), ReadError> {
    Ok(from.read_exact(out)?)
}
