//! An MCAP file that is open: its chunks, in the order of recording.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BinaryHeap, HashMap, VecDeque};
use std::fs::File;
use std::io::{self, Read as _, Seek as _, SeekFrom};
use std::path::Path;
use std::sync::Arc;

use lz4_flex::frame::FrameDecoder as Lz4;

use super::record::{self, CHANNEL, ChunkHead, Fields, HEAD, MESSAGE, MESSAGE_HEAD, McapChannel, SCHEMA, Span};
use crate::packed;

/// Most bytes of decompressed chunks that are kept. Two are kept in any case.
const KEPT_BYTES: usize = 64 << 20;
/// Most decompressed chunks that are kept: recorders write a few at the same time.
const KEPT: usize = 16;

/// Schemas and channels by number.
#[derive(Debug, Default)]
pub(super) struct Names {
    schemas: HashMap<u16, String>,
    pub(super) channels: BTreeMap<u16, McapChannel>,
}

impl Names {
    /// Keeps a schema or channel. The first one of a number counts.
    pub(super) fn add(&mut self, kind: u8, mut fields: Fields<'_>) -> Option<()> {
        let id = fields.id()?;
        if kind == SCHEMA {
            let name = fields.text()?;
            self.schemas.entry(id).or_insert_with(|| name.to_owned());
        } else if kind == CHANNEL && !self.channels.contains_key(&id) {
            let schema = self.schemas.get(&fields.id()?).cloned().unwrap_or_default();
            let channel = McapChannel { topic: fields.text()?.to_owned(), schema, encoding: fields.text()?.to_owned() };
            self.channels.insert(id, channel);
        }
        Some(())
    }
}

/// File of MCAP that is open for reading.
#[derive(Debug)]
pub(crate) struct McapReader {
    pub(super) file: File,
    pub(super) size: u64,
    pub(super) names: Names,
    /// Number of messages of each channel.
    pub(super) counts: HashMap<u16, u64>,
    pub(super) spans: Vec<Span>,
    /// Plain records of the spans that were read last, the newest in front.
    kept: VecDeque<(usize, Arc<Vec<u8>>)>,
    /// What was left out.
    pub(super) notes: Vec<String>,
}

/// Message of a file: time of recording, place and channel.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct McapEntry {
    pub log_ns: i64,
    pub span: u32,
    /// Where its data start in the plain records.
    pub offset: u64,
    pub length: u64,
    pub channel: u16,
}

/// Order in which the messages of a file are read.
#[derive(Debug)]
pub(crate) struct McapCursor {
    /// Spans by the time of their first message, the next one last.
    spans: Vec<(i64, usize)>,
    entries: BinaryHeap<Reverse<McapEntry>>,
}

impl McapReader {
    /// Opens a file and surveys its contents.
    pub fn open(path: &Path) -> io::Result<Self> {
        let mut file = mvt_files::input::open(path)?;
        let size = file.seek(SeekFrom::End(0))?;
        let mut opened = Self {
            file,
            size,
            names: Names::default(),
            counts: HashMap::new(),
            spans: Vec::new(),
            kept: VecDeque::new(),
            notes: Vec::new(),
        };
        if let Err(reason) = opened.survey_by_summary()? {
            opened.names = Names::default();
            opened.counts.clear();
            opened.spans.clear();
            opened
                .notes
                .push(format!("{reason}: it was read from front to back; `mcap recover` makes a whole file of it"));
            opened.survey_by_walk()?;
        }
        Ok(opened)
    }

    /// Returns the channels with their numbers of messages.
    pub fn channels(&self) -> impl Iterator<Item = (u16, &McapChannel, u64)> {
        self.names.channels.iter().map(|(id, channel)| (*id, channel, self.counts.get(id).copied().unwrap_or(0)))
    }

    /// Returns the omissions since the last call.
    pub fn take_notes(&mut self) -> Vec<String> {
        std::mem::take(&mut self.notes)
    }

    /// Starts to read the messages from the first.
    pub fn cursor(&self) -> McapCursor {
        let mut spans: Vec<(i64, usize)> =
            self.spans.iter().enumerate().map(|(number, span)| (span.start_ns, number)).collect();
        spans.sort_unstable_by(|a, b| b.cmp(a));
        McapCursor { spans, entries: BinaryHeap::new() }
    }

    /// Returns the next message of the channels that are wanted, in the order of recording. Damaged chunks are left out with a note.
    pub fn next(&mut self, cursor: &mut McapCursor, is_wanted: impl Fn(u16) -> bool) -> Option<McapEntry> {
        loop {
            let next_ns = cursor.spans.last().map(|(start_ns, _)| *start_ns);
            let first = cursor.entries.peek().map(|Reverse(entry)| *entry);
            if let Some(entry) = first.filter(|entry| next_ns.is_none_or(|next_ns| entry.log_ns < next_ns)) {
                cursor.entries.pop();
                return Some(entry);
            }
            let (_, number) = cursor.spans.pop()?;
            match self.plain(number) {
                Ok(plain) => {
                    let entries = entries(&plain, number as u32).filter(|entry| is_wanted(entry.channel));
                    cursor.entries.extend(entries.map(Reverse));
                }
                Err(reason) => {
                    let at = self.spans.get(number).map_or(0, |span| span.offset);
                    self.notes.push(format!("the chunk at byte {at} is left out ({reason}); copy the file again"));
                }
            }
        }
    }

    /// Returns the data of a message.
    pub fn data(&mut self, entry: McapEntry, head: Option<usize>) -> io::Result<Vec<u8>> {
        let plain = self.plain(entry.span as usize)?;
        let gone = || io::Error::new(io::ErrorKind::InvalidData, "the file changed while it was read");
        let start = usize::try_from(entry.offset).map_err(|_| gone())?;
        let end = usize::try_from(entry.length).ok().and_then(|length| start.checked_add(length)).ok_or_else(gone)?;
        packed::message(plain.get(start..end).ok_or_else(gone)?, head)
    }

    /// Returns the plain records of a span.
    pub(super) fn plain(&mut self, number: usize) -> io::Result<Arc<Vec<u8>>> {
        if let Some(at) = self.kept.iter().position(|(of, _)| *of == number) {
            if let Some(found) = self.kept.remove(at) {
                self.kept.push_front(found);
            }
        } else {
            let plain = Arc::new(self.load(number)?);
            self.kept.push_front((number, plain));
            let mut bytes: usize = self.kept.iter().map(|(_, plain)| plain.len()).sum();
            while self.kept.len() > KEPT || (bytes > KEPT_BYTES && self.kept.len() > 2) {
                bytes -= self.kept.pop_back().map_or(0, |(_, plain)| plain.len());
            }
        }
        Ok(self.kept.front().map(|(_, plain)| Arc::clone(plain)).unwrap_or_default())
    }

    fn load(&mut self, number: usize) -> io::Result<Vec<u8>> {
        let wrong = |defect: &str| io::Error::new(io::ErrorKind::InvalidData, defect);
        let Some(span) = self.spans.get(number).copied() else { return Err(wrong("there is no such chunk")) };
        self.file.seek(SeekFrom::Start(span.offset))?;
        if !span.is_chunk {
            return exactly(&mut self.file, span.length);
        }
        let mut head = [0; HEAD];
        self.file.read_exact(&mut head)?;
        let mut fields = Fields(&head);
        let kind = fields.number(1).unwrap_or(0) as u8;
        let length = fields.number(8).unwrap_or(0);
        if kind != record::CHUNK || length.checked_add(HEAD as u64) != Some(span.length) {
            return Err(wrong("the index names a chunk where there is none"));
        }
        let head = ChunkHead::read(&mut self.file, length)?;
        let packed_bytes = exactly(&mut self.file, head.packed_size)?;
        let limit = packed::most(head.packed_size);
        // Not more than what usual data decompress to: the stated size may be wrong.
        let expected = head.plain_size.min(16 * head.packed_size) as usize;
        let plain = match head.compression.as_str() {
            "" => packed_bytes,
            "lz4" => packed::read(Lz4::new(packed_bytes.as_slice()), expected, limit, true)?,
            "zstd" => packed::read(packed::zstd(packed_bytes.as_slice())?, expected, limit, true)?,
            other => return Err(wrong(&format!("the compression {other:?} is unknown; lz4 and zstd are known"))),
        };
        if plain.len() as u64 != head.plain_size || (head.checksum != 0 && crc32fast::hash(&plain) != head.checksum) {
            return Err(wrong("its size or checksum is wrong"));
        }
        Ok(plain)
    }
}

/// Reads so many bytes. Allocates no more than there are.
pub(super) fn exactly(file: &mut File, length: u64) -> io::Result<Vec<u8>> {
    let left = file.metadata()?.len().saturating_sub(file.stream_position()?);
    if length > left {
        return Err(io::ErrorKind::UnexpectedEof.into());
    }
    packed::read(file, length as usize, length, false)
}

/// Returns the messages in plain records, up to one that is cut off.
pub(super) fn entries(plain: &[u8], span: u32) -> impl Iterator<Item = McapEntry> {
    let mut fields = Fields(plain);
    std::iter::from_fn(move || {
        loop {
            let (kind, mut record) = fields.record()?;
            if kind != MESSAGE || record.0.len() < MESSAGE_HEAD {
                continue;
            }
            let channel = record.id()?;
            record.bytes(4)?;
            let log_ns = record.time_ns()?;
            record.bytes(8)?;
            let (left, length) = (fields.0.len(), record.0.len());
            let offset = (plain.len() - left - length) as u64;
            return Some(McapEntry { log_ns, span, offset, length: length as u64, channel });
        }
    })
}
