//! What an MCAP file holds: by its summary, or by a walk over all its records.

use std::collections::HashMap;
use std::io::{self, BufReader, Read as _, Seek as _, SeekFrom};

use super::file::{McapReader, Names, entries, exactly};
use super::record::{
    CHANNEL, CHUNK, CHUNK_INDEX, ChunkHead, DATA_END, FOOTER, Fields, HEAD, MAGIC, MESSAGE, MESSAGE_HEAD,
    MESSAGE_INDEX, SCHEMA, STATISTICS, Span,
};

/// Bytes of the footer's contents: places of the summary and of its offsets, and a checksum.
const FOOTER_SIZE: usize = 8 + 8 + 4;
/// Messages outside of chunks are read in pieces of this size, bytes.
const PIECE: u64 = 1 << 20;

impl McapReader {
    /// Reads the summary. Returns why it cannot be used.
    pub(super) fn survey_by_summary(&mut self) -> io::Result<Result<(), &'static str>> {
        const TAIL: usize = HEAD + FOOTER_SIZE + MAGIC.len();
        const UNCLOSED: &str = "the recording was cut off";
        let mut tail = [0; TAIL];
        if self.size < TAIL as u64 {
            return Ok(Err(UNCLOSED));
        }
        let tail_at = self.file.seek(SeekFrom::Start(self.size - TAIL as u64))?;
        self.file.read_exact(&mut tail)?;
        let Some((FOOTER, mut footer)) = Fields(&tail).record().filter(|_| tail.ends_with(&MAGIC)) else {
            return Ok(Err(UNCLOSED));
        };
        let (start, _, checksum) = (footer.number(8).unwrap_or(0), footer.number(8), footer.number(4).unwrap_or(0));
        if start == 0 || start > tail_at {
            return Ok(Err("it has no summary"));
        }
        self.file.seek(SeekFrom::Start(start))?;
        let summary = exactly(&mut self.file, tail_at - start)?;
        if checksum != 0 {
            let mut hasher = crc32fast::Hasher::new();
            hasher.update(&summary);
            hasher.update(tail.get(..HEAD + FOOTER_SIZE - 4).unwrap_or_default());
            if u64::from(hasher.finalize()) != checksum {
                return Ok(Err("its summary is damaged"));
            }
        }
        Ok(self.summary(&summary).ok_or("its summary has no index"))
    }

    fn summary(&mut self, summary: &[u8]) -> Option<()> {
        let mut fields = Fields(summary);
        let (mut chunks, mut messages) = (None, 0);
        while let Some((kind, mut record)) = fields.record() {
            match kind {
                SCHEMA | CHANNEL => self.names.add(kind, record)?,
                CHUNK_INDEX => {
                    let (start_ns, end_ns) = (record.time_ns()?, record.time_ns()?);
                    let (offset, length) = (record.number(8)?, record.number(8)?);
                    self.spans.push(Span { offset, length, start_ns, end_ns, is_chunk: true });
                }
                STATISTICS => {
                    messages = record.number(8)?;
                    // Numbers of schemas, channels, attachments, metadata and chunks, and two times.
                    record.bytes(2 + 4 + 4 + 4)?;
                    chunks = Some(record.number(4)?);
                    record.bytes(8 + 8)?;
                    let bytes = record.number(4)? as usize;
                    let mut counts = Fields(record.bytes(bytes)?);
                    while let Some(id) = counts.id() {
                        self.counts.insert(id, counts.number(8)?);
                    }
                }
                _ => {}
            }
        }
        // Chunks that overlap would be read again and again.
        self.spans.sort_by_key(|span| span.offset);
        let ends = self.spans.iter().map(|span| span.offset.saturating_add(span.length));
        if ends.zip(self.spans.iter().skip(1)).any(|(end, next)| end > next.offset) {
            return None;
        }
        let is_indexed = chunks == Some(self.spans.len() as u64) && (messages == 0 || !self.spans.is_empty());
        let are_named = self.counts.keys().all(|id| self.names.channels.contains_key(id));
        let counted: u64 = self.counts.values().fold(0, |sum, count| sum.saturating_add(*count));
        (is_indexed && are_named && counted == messages).then_some(())
    }

    /// Walks over all records, up to one that is cut off.
    pub(super) fn survey_by_walk(&mut self) -> io::Result<()> {
        let size = self.size;
        self.file.seek(SeekFrom::Start(MAGIC.len() as u64))?;
        let mut from = BufReader::with_capacity(1 << 16, self.file.try_clone()?);
        let mut at = MAGIC.len() as u64;
        // Messages of the last chunk by channel, from the indices behind it.
        let mut indexed: HashMap<u16, u64> = HashMap::new();
        let mut open_chunk = None;
        let mut cut = None;
        while size.saturating_sub(at) >= HEAD as u64 {
            let mut head = [0; HEAD];
            from.read_exact(&mut head)?;
            let mut fields = Fields(&head);
            let kind = fields.number(1).unwrap_or(0) as u8;
            let length = fields.number(8).unwrap_or(0);
            let Some(end) = (at + HEAD as u64).checked_add(length).filter(|end| *end <= size) else {
                cut = Some(at);
                break;
            };
            if kind != MESSAGE_INDEX
                && let Some(number) = open_chunk.take()
            {
                self.count_chunk(number, Some(std::mem::take(&mut indexed)));
                from.seek(SeekFrom::Start(at + HEAD as u64))?;
            }
            match kind {
                DATA_END | FOOTER => break,
                SCHEMA | CHANNEL => {
                    let record = crate::packed::read((&mut from).take(length), length as usize, length, false)?;
                    let _ = self.names.add(kind, Fields(&record));
                }
                CHUNK => {
                    if let Ok(head) = ChunkHead::read(&mut from, length) {
                        let (start_ns, end_ns) = (head.start_ns, head.end_ns);
                        open_chunk = Some(self.spans.len());
                        self.spans.push(Span {
                            offset: at,
                            length: HEAD as u64 + length,
                            start_ns,
                            end_ns,
                            is_chunk: true,
                        });
                    } else {
                        self.notes.push(format!("the chunk at byte {at} is left out: its head is damaged"));
                    }
                }
                MESSAGE_INDEX if length >= 6 => {
                    let mut index = [0; 6];
                    from.read_exact(&mut index)?;
                    let mut index = Fields(&index);
                    let (id, bytes) = (index.id().unwrap_or(0), index.number(4).unwrap_or(0));
                    *indexed.entry(id).or_default() += bytes / 16;
                }
                MESSAGE if length >= MESSAGE_HEAD as u64 => {
                    let mut message = [0; MESSAGE_HEAD];
                    from.read_exact(&mut message)?;
                    let mut message = Fields(&message);
                    let (id, _, log_ns) = (message.id().unwrap_or(0), message.bytes(4), message.time_ns().unwrap_or(0));
                    *self.counts.entry(id).or_default() += 1;
                    self.add_unchunked(at, end, log_ns);
                }
                _ => {}
            }
            at = end;
            let here = from.stream_position()?;
            from.seek_relative((end - here) as i64)?;
        }
        if let Some(number) = open_chunk {
            self.count_chunk(number, None);
        }
        if let Some(at) = cut {
            self.notes.push(format!("its last record, at byte {at}, is cut off and left out"));
        }
        Ok(())
    }

    /// Adds a message that stands in no chunk.
    fn add_unchunked(&mut self, offset: u64, end: u64, log_ns: i64) {
        match self.spans.last_mut() {
            Some(span) if !span.is_chunk && span.offset + span.length == offset && span.length < PIECE => {
                span.length = end - span.offset;
                span.start_ns = span.start_ns.min(log_ns);
                span.end_ns = span.end_ns.max(log_ns);
            }
            _ => self.spans.push(Span {
                offset,
                length: end - offset,
                start_ns: log_ns,
                end_ns: log_ns,
                is_chunk: false,
            }),
        }
    }

    /// Counts the messages of a chunk: by its indices if they name known channels only, else by its contents.
    fn count_chunk(&mut self, number: usize, indexed: Option<HashMap<u16, u64>>) {
        if let Some(indexed) = indexed
            && !indexed.is_empty()
            && indexed.keys().all(|id| self.names.channels.contains_key(id))
        {
            for (id, count) in indexed {
                *self.counts.entry(id).or_default() += count;
            }
            return;
        }
        // A chunk that cannot be read is noted when its messages are read.
        let Ok(plain) = self.plain(number) else { return };
        add_names(&mut self.names, &plain);
        for entry in entries(&plain, number as u32) {
            *self.counts.entry(entry.channel).or_default() += 1;
        }
    }
}

/// Keeps the schemas and channels among plain records.
fn add_names(names: &mut Names, plain: &[u8]) {
    let mut fields = Fields(plain);
    while let Some((kind, record)) = fields.record() {
        let _ = names.add(kind, record);
    }
}
