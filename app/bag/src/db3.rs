//! Bags in SQLite, as `ros2 bag record --storage sqlite3` writes them.

use std::fmt::Write as _;
use std::io::{self, Read as _};
use std::path::Path;

use rusqlite::blob::Blob;
use rusqlite::limits::Limit;
use rusqlite::{Connection, MAIN_DB, OpenFlags};

use crate::packed;

/// First bytes of a file.
pub(crate) const MAGIC: [u8; 16] = *b"SQLite format 3\0";
/// Most bytes of the texts of a query, and of a file whose values may be as large.
const LEAST_LENGTH: i32 = 1 << 20;

/// Topic of a file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Db3Topic {
    pub id: i64,
    pub name: String,
    pub type_name: String,
    pub encoding: String,
    pub count: u64,
}

/// Message of a file: time of recording, row and topic.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Db3Entry {
    pub log_ns: i64,
    pub row: i64,
    pub topic: i64,
}

/// File of SQLite that is open for reading.
#[derive(Debug)]
pub(crate) struct Db3Reader {
    connection: Connection,
    topics: Vec<Db3Topic>,
}

/// Returns the words of SQLite and what to do.
fn failed(error: &rusqlite::Error) -> io::Error {
    let words = error.to_string();
    let words = words.lines().next().unwrap_or_default();
    io::Error::other(format!(
        "SQLite: {words}; if the bag was cut off, `sqlite3 BAG.db3 .recover | sqlite3 NEW.db3` keeps what is there"
    ))
}

impl Db3Reader {
    /// Opens a file. Nothing is written, not even beside it.
    pub fn open(path: &Path) -> io::Result<Self> {
        let mut first = Vec::new();
        let file = mvt_files::input::open(path)?;
        let size = file.metadata()?.len();
        file.take(MAGIC.len() as u64).read_to_end(&mut first)?;
        if first != MAGIC {
            return Err(io::Error::new(
                io::ErrorKind::InvalidData,
                "it is not an SQLite file: its first bytes are others",
            ));
        }
        let connection = connect(path).map_err(|error| failed(&error))?;
        let length = i32::try_from(size).unwrap_or(i32::MAX).max(LEAST_LENGTH);
        let set_up = || {
            connection.set_limit(Limit::SQLITE_LIMIT_LENGTH, length)?;
            connection
                .execute_batch("PRAGMA trusted_schema = OFF; PRAGMA cell_size_check = ON; PRAGMA mmap_size = 0;")?;
            tables(&connection)
        };
        let count = set_up().map_err(|error| failed(&error))?;
        if count != 2 {
            let defect = "it has no tables `topics` and `messages`: it is not a bag of ROS 2";
            return Err(io::Error::new(io::ErrorKind::InvalidData, defect));
        }
        let topics = topics(&connection).map_err(|error| failed(&error))?;
        Ok(Self { connection, topics })
    }

    /// Returns the topics.
    pub fn topics(&self) -> &[Db3Topic] {
        &self.topics
    }

    /// Returns the messages of topics in the order of recording.
    pub fn entries(&self, wanted: &[i64]) -> io::Result<Vec<Db3Entry>> {
        let read = || -> rusqlite::Result<Vec<Db3Entry>> {
            let mut entries = Vec::new();
            let mut list = self.connection.prepare("SELECT timestamp, id, topic_id FROM messages")?;
            let mut rows = list.query([])?;
            while let Some(row) = rows.next()? {
                let entry = Db3Entry { log_ns: row.get(0)?, row: row.get(1)?, topic: row.get(2)? };
                if wanted.contains(&entry.topic) {
                    entries.push(entry);
                }
            }
            entries.sort_by_key(|entry| (entry.log_ns, entry.row));
            Ok(entries)
        };
        read().map_err(|error| failed(&error))
    }

    /// Returns the data of a message, or its first `head` bytes.
    pub fn data(&self, row: i64, head: Option<usize>) -> io::Result<Vec<u8>> {
        let read = || -> rusqlite::Result<Vec<u8>> {
            let blob = self.connection.blob_open(MAIN_DB, "messages", "data", row, true)?;
            let first = first(&blob, 4)?;
            // A compressed message is needed whole.
            let head = head.filter(|_| !packed::is_zstd(&first));
            self::first(&blob, head.unwrap_or(usize::MAX))
        };
        let data = read().map_err(|error| failed(&error))?;
        packed::message(&data, head)
    }
}

/// Returns the first bytes of a blob.
fn first(blob: &Blob<'_>, most: usize) -> rusqlite::Result<Vec<u8>> {
    let mut bytes = vec![0; blob.len().min(most)];
    blob.read_at_exact(&mut bytes, 0)?;
    Ok(bytes)
}

fn connect(path: &Path) -> rusqlite::Result<Connection> {
    let flags = OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_NO_MUTEX | OpenFlags::SQLITE_OPEN_URI;
    let mut journal = path.as_os_str().to_owned();
    journal.push("-wal");
    // Messages that the recorder has not yet moved into the file stand in a journal beside it.
    if Path::new(&journal).metadata().is_ok_and(|journal| journal.len() > 0) {
        return Connection::open_with_flags(path, flags.difference(OpenFlags::SQLITE_OPEN_URI));
    }
    let mut address = String::from("file:");
    for byte in path.as_os_str().as_encoded_bytes() {
        match byte {
            b'a'..=b'z' | b'A'..=b'Z' | b'0'..=b'9' | b'/' | b'.' | b'_' | b'-' => address.push(char::from(*byte)),
            other => {
                let _ = write!(address, "%{other:02X}");
            }
        }
    }
    address.push_str("?immutable=1");
    Connection::open_with_flags(address, flags)
}

/// Counts the tables of a bag. A view could compute forever.
fn tables(connection: &Connection) -> rusqlite::Result<i64> {
    let query = "SELECT COUNT(*) FROM sqlite_schema WHERE type = 'table' AND name IN ('topics', 'messages')";
    connection.query_row(query, [], |row| row.get(0))
}

fn topics(connection: &Connection) -> rusqlite::Result<Vec<Db3Topic>> {
    let mut topics = Vec::new();
    let mut list = connection.prepare("SELECT id, name, type, serialization_format FROM topics ORDER BY id")?;
    let mut rows = list.query([])?;
    while let Some(row) = rows.next()? {
        let (id, name, type_name, encoding) = (row.get(0)?, row.get(1)?, row.get(2)?, row.get(3)?);
        topics.push(Db3Topic { id, name, type_name, encoding, count: 0 });
    }
    let mut counts = connection.prepare("SELECT topic_id, COUNT(*) FROM messages GROUP BY topic_id")?;
    let mut rows = counts.query([])?;
    while let Some(row) = rows.next()? {
        let (id, count): (i64, i64) = (row.get(0)?, row.get(1)?);
        if let Some(topic) = topics.iter_mut().find(|topic| topic.id == id) {
            topic.count = u64::try_from(count).unwrap_or(0);
        }
    }
    Ok(topics)
}
