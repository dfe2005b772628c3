//! Reader of MCAP files from the first record to the last.
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

use super::record::{CHANNEL, CHUNK, FOOTER, Fields, MAGIC, MESSAGE, MESSAGE_HEAD, McapChannel, SCHEMA};
use crate::packed::{self, SMALL, zstd};

/// Greatest size of a message, bytes: larger than the image of any camera. In a small file a message may be [`SMALL`], but not larger than the
/// file otherwise.
const LARGEST: u64 = 64 << 20;
/// A record grows by this many bytes, so that no more is allocated than the file delivers.
const STEP: usize = 1 << 20;
/// Kinds of records that are read beside those of [`super::record`].
const HEADER: u8 = 1;
const ATTACHMENT: u8 = 9;

/// Reason why an MCAP file is not read to its end.
#[derive(Debug, thiserror::Error)]
pub enum McapError {
    /// Not a whole MCAP file, or damaged.
    #[error("{0}")]
    Damaged(String),
    /// The operating system refused, or compressed data are damaged.
    #[error("{0}")]
    Io(io::Error),
}

impl From<io::Error> for McapError {
    fn from(error: io::Error) -> Self {
        match error.kind() {
            io::ErrorKind::UnexpectedEof => Self::Damaged(CUT_OFF.to_owned()),
            _ => Self::Io(error),
        }
    }
}

const CUT_OFF: &str = "it ends in the middle of a record: it was cut off";

fn damaged<T>(defect: impl Into<String>) -> Result<T, McapError> {
    Err(McapError::Damaged(defect.into()))
}

/// Record of an MCAP file that a visitor receives.
#[derive(Debug)]
pub enum McapRecord<'a> {
    /// A channel appears for the first time. Its messages are delivered only if the visitor returns true.
    Channel(u16, &'a McapChannel),
    /// A message of a channel: time of recording, nanoseconds, and contents.
    Message(u16, u64, &'a [u8]),
    /// A file in the file, by its name.
    Attachment(&'a str, &'a [u8]),
}

/// Returns a value of a record, which it may lack.
fn had<T>(value: Option<T>) -> Result<T, McapError> {
    value.ok_or_else(|| McapError::Damaged("a record is shorter than its contents, or a name is not UTF-8".to_owned()))
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
    channels: HashMap<u16, (McapChannel, bool)>,
    /// Bytes of names that may still be kept.
    names_left: u64,
    /// Decompressed bytes that may still come.
    bytes_left: u64,
    largest: u64,
    record: Vec<u8>,
}

/// Reads a file and passes its records to `visit`, whose answer matters for channels alone. An error of `visit` ends the reading.
///
/// # Errors
/// Those of `visit`, and [`McapError`] if the file is no MCAP file, cut off or damaged.
pub fn scan<E: From<McapError>>(
    path: &Path,
    visit: &mut impl FnMut(McapRecord<'_>) -> Result<bool, E>,
) -> Result<(), E> {
    let file = mvt_files::input::open(path).map_err(McapError::from)?;
    let size = file.metadata().map_err(McapError::from)?.len();
    let limit = packed::most(size);
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
    V: FnMut(McapRecord<'_>) -> Result<bool, E>,
    E: From<McapError>,
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
        had(fields.bytes(16))?;
        let size = had(fields.number(8))?;
        let checksum = had(fields.number(4))? as u32;
        let name_length = had(fields.number(4))?;
        if name_length > 16 {
            return Ok(damaged("the compression of a chunk is unknown")?);
        }
        let mut rest = vec![0; name_length as usize + 8];
        read_exact(file, &mut rest)?;
        let mut fields = Fields(&rest);
        let compression = String::from_utf8_lossy(had(fields.bytes(name_length as usize))?).into_owned();
        let packed = had(fields.number(8))?;
        if Some(packed) != length.checked_sub((FIXED + rest.len()) as u64) {
            return Ok(damaged("the size of a chunk contradicts that of its records")?);
        }
        let mut packed = file.take(packed);
        let (found_size, found_checksum) = match compression.as_str() {
            "" => self.records(&mut packed)?,
            "lz4" => self.records(Lz4::new(&mut packed))?,
            "zstd" => {
                let plain = zstd(&mut packed);
                self.records(plain.map_err(|e| McapError::Damaged(format!("a chunk is not Zstandard: {e}")))?)?
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
        let mut fixed = [0; MESSAGE_HEAD];
        let Some(length) = length.checked_sub(MESSAGE_HEAD as u64) else {
            return Ok(damaged("a message is shorter than its head")?);
        };
        read_exact(from, &mut fixed)?;
        let mut fields = Fields(&fixed);
        let id = had(fields.number(2))? as u16;
        had(fields.bytes(4))?;
        let time_ns = had(fields.number(8))?;
        match self.channels.get(&id) {
            None => Ok(damaged("a message has no channel")?),
            Some((_, false)) => Ok(self.skip(from, length)?),
            Some((_, true)) => {
                self.load(from, length)?;
                (self.visit)(McapRecord::Message(id, time_ns, &self.record)).map(|_| ())
            }
        }
    }

    /// Keeps a schema or channel, or passes an attachment on.
    fn described(&mut self, kind: u8) -> Result<(), E> {
        let Self { visit, schemas, channels, names_left, record, .. } = self;
        let mut fields = Fields(record);
        if kind == ATTACHMENT {
            had(fields.bytes(16))?;
            let name = had(fields.text())?;
            had(fields.text())?;
            let size = had(fields.number(8))?;
            let data = had(fields.bytes(usize::try_from(size).unwrap_or(usize::MAX)))?;
            let checksum = had(fields.number(4))?;
            let covered = record.get(..record.len().saturating_sub(4)).unwrap_or_default();
            if checksum != 0 && checksum != u64::from(crc32fast::hash(covered)) {
                return Ok(damaged(format!("the attachment {name:?} is damaged: its checksum is wrong"))?);
            }
            return visit(McapRecord::Attachment(name, data)).map(|_| ());
        }
        let id = had(fields.number(2))? as u16;
        let mut keep = |text: &str| match names_left.checked_sub(text.len() as u64 + 8) {
            Some(left) => {
                *names_left = left;
                Ok(text.to_owned())
            }
            None => damaged("the names of its channels are longer than the file"),
        };
        if kind == SCHEMA {
            if let Entry::Vacant(place) = schemas.entry(id) {
                place.insert(keep(had(fields.text())?)?);
            }
            return Ok(());
        }
        if channels.contains_key(&id) {
            return Ok(());
        }
        let schema = schemas.get(&(had(fields.number(2))? as u16)).cloned().unwrap_or_default();
        let channel = McapChannel {
            topic: keep(had(fields.text())?)?,
            schema: keep(&schema)?,
            encoding: keep(had(fields.text())?)?,
        };
        let is_wanted = visit(McapRecord::Channel(id, &channel))?;
        channels.insert(id, (channel, is_wanted));
        Ok(())
    }

    /// Reads the contents of a record into `self.record`.
    fn load(&mut self, from: &mut impl Read, length: u64) -> Result<(), McapError> {
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

    fn skip(&mut self, from: &mut impl Read, length: u64) -> Result<(), McapError> {
        if io::copy(&mut from.take(length), &mut io::sink())? < length {
            return damaged(CUT_OFF);
        }
        Ok(())
    }
}

/// Reads kind and length of a record; `None` at the end.
fn head(from: &mut impl Read) -> Result<Option<(u8, u64)>, McapError> {
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

fn read_exact(from: &mut impl Read, out: &mut [u8]) -> Result<(), McapError> {
    Ok(from.read_exact(out)?)
}
