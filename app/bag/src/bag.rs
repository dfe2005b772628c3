//! Bag of ROS 2: topics, and messages in the order of recording.

use std::path::{Path, PathBuf};

use crate::error::BagError;
use crate::parts::{Cursor, Entry, Part, Storage, add_note, find, is_bag};

/// Topic of a bag.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct BagTopic {
    /// Its name, such as `/camera/color/image_raw`.
    pub name: String,
    /// Type of its messages, such as `sensor_msgs/msg/Image`.
    pub type_name: String,
    /// Number of messages. Of a bag that was cut off it may be less than the number that is read.
    pub count: u64,
    /// Encoding of its messages: `cdr` is decoded.
    pub encoding: String,
}

/// Place of a message in a bag, by which it can be read again.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct BagPlace {
    part: usize,
    entry: Entry,
}

impl BagPlace {
    /// Returns when the message was recorded, nanoseconds.
    pub fn log_ns(self) -> i64 {
        self.entry.log_ns()
    }
}

/// Message of a bag.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct BagMessage {
    /// Number of its topic in [`Bag::topics`].
    pub topic: usize,
    /// When it was recorded, nanoseconds.
    pub log_ns: i64,
    /// Where it stands.
    pub place: BagPlace,
    /// The bytes, without a compression of their own.
    pub data: Vec<u8>,
}

/// Bag of ROS 2: a file of MCAP or SQLite, or a folder with such files. Of compressed files, temporary copies exist until it is dropped.
#[derive(Debug)]
pub struct Bag {
    path: PathBuf,
    parts: Vec<Part>,
    topics: Vec<BagTopic>,
    /// Numbers of the topics of each file, with their numbers in the file.
    ids: Vec<Vec<(i64, usize)>>,
    notes: Vec<String>,
}

/// Most names of topics in a message.
const MOST_NAMES: usize = 24;

/// Returns names in one line.
pub(crate) fn names<'a>(names: impl Iterator<Item = &'a str>) -> String {
    let mut all: Vec<&str> = names.collect();
    let more = all.len().saturating_sub(MOST_NAMES);
    all.truncate(MOST_NAMES);
    let list = if all.is_empty() { "none".to_owned() } else { all.join(", ") };
    if more > 0 { format!("{list} and {more} others") } else { list }
}

impl Bag {
    /// Opens a bag: a file `.mcap` or `.db3`, either of them compressed as `.zstd`, or a folder of such files.
    ///
    /// # Errors
    /// [`BagError`] if a file cannot be read, or is no bag of ROS 2.
    pub fn open(path: &Path) -> Result<Self, BagError> {
        let mut notes = Vec::new();
        let parts = find(path, &mut notes)?;
        let mut bag = Self { path: path.to_owned(), parts, topics: Vec::new(), ids: Vec::new(), notes };
        for number in 0..bag.parts.len() {
            let found = bag.storage(number)?.topics();
            let mut ids = Vec::new();
            for found in found {
                let same = |topic: &BagTopic| {
                    topic.name == found.name && topic.type_name == found.type_name && topic.encoding == found.encoding
                };
                let place = bag.topics.iter().position(same).unwrap_or(bag.topics.len());
                match bag.topics.get_mut(place) {
                    Some(topic) => topic.count = topic.count.saturating_add(found.count),
                    None => bag.topics.push(BagTopic {
                        name: found.name,
                        type_name: found.type_name,
                        count: found.count,
                        encoding: found.encoding,
                    }),
                }
                ids.push((found.id, place));
            }
            bag.ids.push(ids);
        }
        Ok(bag)
    }

    /// Returns whether a path is that of a bag by its name or, of a folder, by the names of its files.
    pub fn is_here(path: &Path) -> bool {
        is_bag(path)
    }

    /// Returns the path of the bag.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Returns the topics.
    pub fn topics(&self) -> &[BagTopic] {
        &self.topics
    }

    /// Returns notes on omissions and assumptions, in sentences. Reading may add some.
    pub fn notes(&self) -> &[String] {
        &self.notes
    }

    /// Returns the messages of topics in the order of recording. The files of a bag follow one another.
    ///
    /// # Errors
    /// [`BagError`] if there is no such topic.
    pub fn messages(&mut self, topics: &[&str]) -> Result<BagMessages<'_>, BagError> {
        for topic in topics {
            if !self.topics.iter().any(|found| found.name == *topic) {
                let found = names(self.topics.iter().map(|topic| topic.name.as_str()));
                return Err(BagError::NoTopic { path: self.path.clone(), topic: (*topic).to_owned(), found });
            }
        }
        let wanted: Vec<bool> = self.topics.iter().map(|topic| topics.contains(&topic.name.as_str())).collect();
        let heads = vec![None; wanted.len()];
        Ok(self.messages_of(wanted, heads))
    }

    /// Returns the messages of the wanted topics, of some topics only so many bytes.
    pub(crate) fn messages_of(&mut self, wanted: Vec<bool>, heads: Vec<Option<usize>>) -> BagMessages<'_> {
        BagMessages { bag: self, wanted, heads, part: 0, cursor: None, has_failed: false }
    }

    /// Reads a message again.
    ///
    /// # Errors
    /// [`BagError`] if the file is damaged there, or the place belongs to another bag.
    pub fn read(&mut self, place: BagPlace) -> Result<Vec<u8>, BagError> {
        let path = self.parts.get(place.part).map_or_else(|| self.path.clone(), |part| part.path.clone());
        let data = self.storage(place.part)?.data(place.entry, None);
        data.map_err(BagError::io(&path))
    }

    /// Returns an open file and closes the others.
    fn storage(&mut self, number: usize) -> Result<&mut Storage, BagError> {
        // The files before and after it stay open: frames lie across their border.
        for (other, part) in self.parts.iter_mut().enumerate() {
            if other.abs_diff(number) > 1 {
                part.close();
            }
        }
        let Some(part) = self.parts.get_mut(number) else {
            return Err(BagError::fault(&self.path, "there is no such file in the bag"));
        };
        part.storage(&mut self.notes)?;
        part.move_notes(&mut self.notes);
        part.storage(&mut self.notes)
    }
}

/// Messages of a bag in the order of recording. Only some chunks of the bag are in memory.
#[derive(Debug)]
pub struct BagMessages<'a> {
    bag: &'a mut Bag,
    wanted: Vec<bool>,
    heads: Vec<Option<usize>>,
    part: usize,
    /// Numbers of the wanted topics in the file, and what comes next.
    cursor: Option<(Vec<i64>, Cursor)>,
    has_failed: bool,
}

impl BagMessages<'_> {
    fn step(&mut self) -> Result<Option<BagMessage>, BagError> {
        while self.part < self.bag.parts.len() {
            let number = self.part;
            let ids = self.bag.ids.get(number).cloned().unwrap_or_default();
            let path = self.bag.parts.get(number).map(|part| part.path.clone()).unwrap_or_default();
            if self.cursor.is_none() {
                let is_wanted = |topic: usize| self.wanted.get(topic).copied().unwrap_or(false);
                let wanted: Vec<i64> = ids.iter().filter(|(_, topic)| is_wanted(*topic)).map(|(id, _)| *id).collect();
                let cursor = self.bag.storage(number)?.cursor(&wanted).map_err(BagError::io(&path))?;
                self.cursor = Some((wanted, cursor));
            }
            if let Some((wanted, cursor)) = &mut self.cursor {
                let storage = self.bag.storage(number)?;
                if let Some(entry) = storage.next(cursor, wanted) {
                    let topic = ids.iter().find(|(id, _)| *id == entry.topic()).map_or(0, |(_, topic)| *topic);
                    let head = self.heads.get(topic).copied().flatten();
                    let data = storage.data(entry, head).map_err(BagError::io(&path))?;
                    let place = BagPlace { part: number, entry };
                    return Ok(Some(BagMessage { topic, log_ns: entry.log_ns(), place, data }));
                }
            }
            // Notes of the last chunks.
            self.bag.storage(number)?;
            self.cursor = None;
            self.part += 1;
        }
        Ok(None)
    }
}

impl Iterator for BagMessages<'_> {
    type Item = Result<BagMessage, BagError>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.has_failed {
            return None;
        }
        let step = self.step().transpose();
        self.has_failed = matches!(step, Some(Err(_)));
        step
    }
}

/// Adds notes to those of a bag.
impl Bag {
    pub(crate) fn add_note(&mut self, note: String) {
        add_note(&mut self.notes, note);
    }
}
