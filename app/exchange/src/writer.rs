//! Writer of MCAP files (<https://mcap.dev/spec>): chunks of messages, compressed with LZ4, and an index at the end.

// Why: notes/decisions/exchange.md, "Our own MCAP and protobuf".

use std::io::{self, Write};

use crc32fast::Hasher;
use lz4_flex::frame::FrameEncoder;

use crate::schema::MessageType;

const MAGIC: [u8; 8] = *b"\x89MCAP0\r\n";
/// Messages are collected up to this size, bytes, before they are compressed.
const CHUNK: usize = 4 << 20;
const COMPRESSION: &str = "lz4";

/// Number of a kind of record.
#[derive(Debug, Clone, Copy)]
enum Kind {
    Header = 1,
    Footer = 2,
    Schema = 3,
    Channel = 4,
    Message = 5,
    Chunk = 6,
    MessageIndex = 7,
    ChunkIndex = 8,
    Attachment = 9,
    AttachmentIndex = 10,
    Statistics = 11,
    SummaryOffset = 14,
    DataEnd = 15,
}

/// Contents of a record. Numbers are little-endian, texts and lists have their length before them.
#[derive(Debug, Clone, Default)]
struct Content(Vec<u8>);

impl Content {
    fn u16(mut self, value: u16) -> Self {
        self.0.extend(value.to_le_bytes());
        self
    }

    fn u32(mut self, value: u32) -> Self {
        self.0.extend(value.to_le_bytes());
        self
    }

    fn u64(mut self, value: u64) -> Self {
        self.0.extend(value.to_le_bytes());
        self
    }

    fn raw(mut self, bytes: &[u8]) -> Self {
        self.0.extend(bytes);
        self
    }

    /// A text, or a list by its bytes.
    fn counted(self, bytes: &[u8]) -> Self {
        // All are short: names, descriptors, and lists of some hundred entries.
        self.u32(bytes.len() as u32).raw(bytes)
    }

    fn text(self, text: &str) -> Self {
        self.counted(text.as_bytes())
    }

    fn record(self, kind: Kind) -> Vec<u8> {
        let mut record = vec![kind as u8];
        record.extend((self.0.len() as u64).to_le_bytes());
        record.extend(self.0);
        record
    }
}

/// File to which is written, its length and the checksum of its bytes.
struct Out<W> {
    file: W,
    length: u64,
    checksum: Hasher,
}

impl<W: Write> Out<W> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.file.write_all(bytes)?;
        self.length += bytes.len() as u64;
        self.checksum.update(bytes);
        Ok(())
    }
}

/// Handle of a channel.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Channel(pub(crate) u16);

/// Where messages go: a file, or programs that watch.
pub(crate) trait MessageSink {
    /// Adds a channel of protobuf messages.
    fn channel(&mut self, topic: &str, of: &'static MessageType) -> io::Result<Channel>;

    /// Adds a message.
    fn push(&mut self, channel: Channel, time_ns: u64, data: &[u8]) -> io::Result<()>;
}

/// A channel of the file.
struct Topic {
    record: Vec<u8>,
    messages: u64,
    /// Times and places of its messages in the chunk.
    places: Vec<(u64, u64)>,
}

/// Span of times of messages, nanoseconds.
#[derive(Clone, Copy, Default)]
struct Span(Option<(u64, u64)>);

impl Span {
    fn add(&mut self, time_ns: u64) {
        let (first, last) = self.0.unwrap_or((time_ns, time_ns));
        self.0 = Some((first.min(time_ns), last.max(time_ns)));
    }

    /// Returns first and last time, 0 without messages.
    fn ends(self) -> (u64, u64) {
        self.0.unwrap_or_default()
    }
}

/// Writer of an MCAP file.
pub(crate) struct Mcap<W> {
    out: Out<W>,
    schemas: Vec<(String, Vec<u8>)>,
    topics: Vec<Topic>,
    chunk: Vec<u8>,
    span: Span,
    chunk_span: Span,
    chunk_indices: Vec<u8>,
    chunks: u32,
    attachment_indices: Vec<u8>,
    attachments: u32,
}

impl<W: Write> MessageSink for Mcap<W> {
    /// A schema of a name is written once.
    fn channel(&mut self, topic: &str, of: &'static MessageType) -> io::Result<Channel> {
        let schema = of.full_name();
        let known = self.schemas.iter().position(|(name, _)| *name == schema);
        let schema_id = match known {
            Some(index) => index as u16 + 1,
            // 0 stands for no schema.
            None => {
                let id = self.schemas.len() as u16 + 1;
                let content = Content::default().u16(id).text(&schema).text("protobuf").counted(&of.descriptor_set());
                let record = content.record(Kind::Schema);
                self.out.write(&record)?;
                self.schemas.push((schema, record));
                id
            }
        };
        let id = self.topics.len() as u16;
        let content = Content::default().u16(id).u16(schema_id).text(topic).text("protobuf").counted(&[]);
        let record = content.record(Kind::Channel);
        self.out.write(&record)?;
        self.topics.push(Topic { record, messages: 0, places: Vec::new() });
        Ok(Channel(id))
    }

    fn push(&mut self, Channel(id): Channel, time_ns: u64, data: &[u8]) -> io::Result<()> {
        if let Some(topic) = self.topics.get_mut(usize::from(id)) {
            topic.places.push((time_ns, self.chunk.len() as u64));
            let content = Content::default().u16(id).u32(topic.messages as u32).u64(time_ns).u64(time_ns).raw(data);
            topic.messages += 1;
            self.chunk.extend(content.record(Kind::Message));
            self.span.add(time_ns);
            self.chunk_span.add(time_ns);
        }
        if self.chunk.len() >= CHUNK { self.write_chunk() } else { Ok(()) }
    }
}

impl<W: Write> Mcap<W> {
    /// Begins a file.
    pub fn new(file: W, library: &str) -> io::Result<Self> {
        let mut out = Out { file, length: 0, checksum: Hasher::new() };
        out.write(&MAGIC)?;
        out.write(&Content::default().text("").text(library).record(Kind::Header))?;
        Ok(Self {
            out,
            schemas: Vec::new(),
            topics: Vec::new(),
            chunk: Vec::with_capacity(CHUNK + (CHUNK >> 1)),
            span: Span::default(),
            chunk_span: Span::default(),
            chunk_indices: Vec::new(),
            chunks: 0,
            attachment_indices: Vec::new(),
            attachments: 0,
        })
    }

    /// Returns the number of channels.
    pub fn channel_count(&self) -> usize {
        self.topics.len()
    }

    fn write_chunk(&mut self) -> io::Result<()> {
        if self.chunk.is_empty() {
            return Ok(());
        }
        let mut encoder = FrameEncoder::new(Vec::with_capacity(self.chunk.len() / 2));
        encoder.write_all(&self.chunk)?;
        let packed = encoder.finish()?;
        let (first, last) = std::mem::take(&mut self.chunk_span).ends();
        let size = self.chunk.len() as u64;
        let content = Content::default().u64(first).u64(last).u64(size).u32(crc32fast::hash(&self.chunk));
        let record = content.text(COMPRESSION).u64(packed.len() as u64).raw(&packed).record(Kind::Chunk);
        let start = self.out.length;
        self.out.write(&record)?;
        let (mut places, indices_start) = (Content::default(), self.out.length);
        for (id, topic) in (0_u16..).zip(&mut self.topics) {
            if topic.places.is_empty() {
                continue;
            }
            places = places.u16(id).u64(self.out.length);
            let list = topic.places.drain(..).fold(Content::default(), |list, (time, place)| list.u64(time).u64(place));
            self.out.write(&Content::default().u16(id).counted(&list.0).record(Kind::MessageIndex))?;
        }
        let index = Content::default().u64(first).u64(last).u64(start).u64(record.len() as u64);
        let index = index.counted(&places.0).u64(self.out.length - indices_start);
        let index = index.text(COMPRESSION).u64(packed.len() as u64).u64(size);
        self.chunk_indices.extend(index.record(Kind::ChunkIndex));
        self.chunks += 1;
        self.chunk.clear();
        Ok(())
    }

    /// Adds a file.
    pub fn attach(&mut self, name: &str, media_type: &str, data: &[u8]) -> io::Result<()> {
        self.write_chunk()?;
        let start = self.out.length;
        let content = Content::default().u64(0).u64(0).text(name).text(media_type).u64(data.len() as u64).raw(data);
        let checksum = crc32fast::hash(&content.0);
        let record = content.u32(checksum).record(Kind::Attachment);
        self.out.write(&record)?;
        let index = Content::default().u64(start).u64(record.len() as u64).u64(0).u64(0).u64(data.len() as u64);
        self.attachment_indices.extend(index.text(name).text(media_type).record(Kind::AttachmentIndex));
        self.attachments += 1;
        Ok(())
    }

    /// Completes the file and returns its length in bytes.
    pub fn finish(mut self) -> io::Result<u64> {
        self.write_chunk()?;
        let checksum = self.out.checksum.clone().finalize();
        self.out.write(&Content::default().u32(checksum).record(Kind::DataEnd))?;
        let summary = self.out.length;
        self.out.checksum = Hasher::new();
        let (first, last) = self.span.ends();
        let statistics = Content::default()
            .u64(self.topics.iter().map(|topic| topic.messages).sum())
            .u16(self.schemas.len() as u16)
            .u32(self.topics.len() as u32)
            .u32(self.attachments)
            .u32(0)
            .u32(self.chunks)
            .u64(first)
            .u64(last);
        let counts = (0_u16..).zip(&self.topics);
        let counts = counts.fold(Content::default(), |list, (id, topic)| list.u16(id).u64(topic.messages));
        let groups = [
            (Kind::Schema, self.schemas.iter().flat_map(|(_, record)| record.clone()).collect()),
            (Kind::Channel, self.topics.iter().flat_map(|topic| topic.record.clone()).collect()),
            (Kind::Statistics, statistics.counted(&counts.0).record(Kind::Statistics)),
            (Kind::ChunkIndex, self.chunk_indices),
            (Kind::AttachmentIndex, self.attachment_indices),
        ];
        let mut offsets = Vec::new();
        for (kind, records) in groups.into_iter().filter(|(_, records)| !records.is_empty()) {
            let place = Content(vec![kind as u8]).u64(self.out.length).u64(records.len() as u64);
            offsets.extend(place.record(Kind::SummaryOffset));
            self.out.write(&records)?;
        }
        let offsets_start = self.out.length;
        self.out.write(&offsets)?;
        // The checksum covers the footer up to itself: kind, length of the content, and two places.
        let content = Content::default().u64(summary).u64(offsets_start);
        let head = [&[Kind::Footer as u8][..], &20_u64.to_le_bytes(), &content.0].concat();
        self.out.write(&head)?;
        let checksum = self.out.checksum.clone().finalize();
        self.out.write(&checksum.to_le_bytes())?;
        self.out.write(&MAGIC)?;
        self.out.file.flush()?;
        Ok(self.out.length)
    }
}
