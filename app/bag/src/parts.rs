//! The files of a bag, opened when they are needed.

use std::fs::File;
use std::io::{self, BufReader, BufWriter, Read as _};
use std::path::{Path, PathBuf};

use tempfile::NamedTempFile;

use crate::db3::{self, Db3Entry, Db3Reader};
use crate::error::BagError;
use crate::mcap::{self, McapCursor, McapEntry, McapReader};
use crate::packed;

/// First bytes of a bag of ROS 1.
const ROS1: &[u8] = b"#ROSBAG V";

/// Topic of one file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct PartTopic {
    /// Its number in the file.
    pub id: i64,
    pub name: String,
    pub type_name: String,
    pub encoding: String,
    pub count: u64,
}

/// File that is open.
#[derive(Debug)]
pub(crate) enum Storage {
    Mcap(McapReader),
    Db3(Db3Reader),
}

/// Where the data of a message are in a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Entry {
    Mcap(McapEntry),
    Db3(Db3Entry),
}

impl Entry {
    pub fn log_ns(self) -> i64 {
        match self {
            Self::Mcap(entry) => entry.log_ns,
            Self::Db3(entry) => entry.log_ns,
        }
    }

    /// Returns the number of its topic in the file.
    pub fn topic(self) -> i64 {
        match self {
            Self::Mcap(entry) => entry.channel.into(),
            Self::Db3(entry) => entry.topic,
        }
    }
}

/// Order in which the messages of a file are read.
#[derive(Debug)]
pub(crate) enum Cursor {
    Mcap(McapCursor),
    Db3(std::vec::IntoIter<Db3Entry>),
}

impl Storage {
    pub fn topics(&self) -> Vec<PartTopic> {
        match self {
            Self::Mcap(file) => {
                let topic = |(id, channel, count): (u16, &mcap::McapChannel, u64)| PartTopic {
                    id: id.into(),
                    name: channel.topic.clone(),
                    type_name: channel.schema.clone(),
                    encoding: channel.encoding.clone(),
                    count,
                };
                file.channels().map(topic).collect()
            }
            Self::Db3(file) => {
                let topic = |topic: &db3::Db3Topic| PartTopic {
                    id: topic.id,
                    name: topic.name.clone(),
                    type_name: topic.type_name.clone(),
                    encoding: topic.encoding.clone(),
                    count: topic.count,
                };
                file.topics().iter().map(topic).collect()
            }
        }
    }

    pub fn cursor(&self, wanted: &[i64]) -> io::Result<Cursor> {
        Ok(match self {
            Self::Mcap(file) => Cursor::Mcap(file.cursor()),
            Self::Db3(file) => Cursor::Db3(file.entries(wanted)?.into_iter()),
        })
    }

    pub fn next(&mut self, cursor: &mut Cursor, wanted: &[i64]) -> Option<Entry> {
        match (self, cursor) {
            (Self::Mcap(file), Cursor::Mcap(cursor)) => {
                file.next(cursor, |channel| wanted.contains(&channel.into())).map(Entry::Mcap)
            }
            (_, Cursor::Db3(entries)) => entries.next().map(Entry::Db3),
            (Self::Db3(_), Cursor::Mcap(_)) => None,
        }
    }

    pub fn data(&mut self, entry: Entry, head: Option<usize>) -> io::Result<Vec<u8>> {
        match (self, entry) {
            (Self::Mcap(file), Entry::Mcap(entry)) => file.data(entry, head),
            (Self::Db3(file), Entry::Db3(entry)) => file.data(entry.row, head),
            _ => Err(io::Error::other("the file changed while it was read")),
        }
    }
}

/// File of a bag.
#[derive(Debug)]
pub(crate) struct Part {
    pub path: PathBuf,
    /// Its contents, if the file is compressed.
    plain: Option<NamedTempFile>,
    storage: Option<Storage>,
}

impl Part {
    pub fn new(path: PathBuf) -> Self {
        Self { path, plain: None, storage: None }
    }

    /// Opens the file, if it is not open.
    pub fn storage(&mut self, notes: &mut Vec<String>) -> Result<&mut Storage, BagError> {
        if self.storage.is_none() {
            self.storage = Some(self.open(notes)?);
        }
        self.storage.as_mut().ok_or_else(|| BagError::fault(&self.path, "it cannot be opened"))
    }

    /// Closes the file.
    pub fn close(&mut self) {
        self.storage = None;
    }

    /// Returns the storage and moves its notes to those of the bag.
    pub fn move_notes(&mut self, notes: &mut Vec<String>) {
        if let Some(Storage::Mcap(file)) = &mut self.storage {
            for note in file.take_notes() {
                add_note(notes, format!("{}: {note}", self.path.display()));
            }
        }
    }

    fn open(&mut self, notes: &mut Vec<String>) -> Result<Storage, BagError> {
        let path = self.path.clone();
        let file = mvt_files::input::open(&path).map_err(BagError::io(&path))?;
        let first = first(&file).map_err(BagError::io(&path))?;
        if packed::is_zstd(&first) && self.plain.is_none() {
            self.plain = Some(self.unpack().map_err(BagError::io(&path))?);
            add_note(notes, format!("{} was decompressed into a temporary file", path.display()));
        }
        let (from, first) = match &self.plain {
            Some(plain) => (plain.path().to_owned(), self::first(plain.as_file()).map_err(BagError::io(&path))?),
            None => (path.clone(), first),
        };
        if first.starts_with(ROS1) {
            return Err(BagError::Ros1 { path });
        }
        if first.starts_with(&mcap::MAGIC) {
            return Ok(Storage::Mcap(McapReader::open(&from).map_err(BagError::io(&path))?));
        }
        if first.starts_with(&db3::MAGIC) {
            return Ok(Storage::Db3(Db3Reader::open(&from).map_err(BagError::io(&path))?));
        }
        let fault = match first.len() {
            0 => "the file is empty: copy it again",
            _ => "it is no bag of ROS 2: it is neither MCAP nor SQLite, or its beginning is lost",
        };
        Err(BagError::fault(&path, fault))
    }

    fn unpack(&self) -> io::Result<NamedTempFile> {
        let file = mvt_files::input::open(&self.path)?;
        let size = file.metadata()?.len();
        let mut plain = NamedTempFile::new()?;
        let mut out = BufWriter::with_capacity(1 << 20, plain.as_file_mut());
        let unpacked = packed::unpack(BufReader::with_capacity(1 << 18, file), size, &mut out)
            .and_then(|_| out.into_inner().map(|_| ()).map_err(io::Error::from));
        unpacked
            .map_err(|error| io::Error::new(error.kind(), format!("{error}; `zstd -d` decompresses it by hand")))?;
        Ok(plain)
    }
}

/// Returns the first bytes of a file.
fn first(file: &File) -> io::Result<Vec<u8>> {
    use std::io::Seek as _;
    let mut file = file;
    file.rewind()?;
    let mut first = Vec::new();
    file.take(16).read_to_end(&mut first)?;
    Ok(first)
}

/// Adds a note if it is new.
pub(crate) fn add_note(notes: &mut Vec<String>, note: String) {
    if !notes.contains(&note) {
        notes.push(note);
    }
}

/// Name of the description in the folder of a bag.
const METADATA: &str = "metadata.yaml";
/// Endings of the files of bags; `.zstd` may follow.
const ENDINGS: [&str; 2] = [".mcap", ".db3"];

/// Returns whether the name of a file is that of a bag, `.bag` of ROS 1 included.
fn is_named_as_bag(name: &str) -> bool {
    let stem = name.strip_suffix(".zstd").unwrap_or(name);
    ENDINGS.iter().any(|ending| stem.ends_with(ending)) || name.ends_with(".bag")
}

/// Returns whether a path is that of a file that is named as a bag, or a folder holds a description or a file that is.
pub(crate) fn is_bag(path: &Path) -> bool {
    if !path.is_dir() {
        return path.file_name().is_some_and(|name| is_named_as_bag(&name.to_string_lossy()));
    }
    let is_part =
        |name: &std::ffi::OsStr| !mvt_files::input::is_litter(name) && is_named_as_bag(&name.to_string_lossy());
    path.join(METADATA).is_file()
        || path.read_dir().is_ok_and(|files| files.flatten().any(|file| is_part(&file.file_name())))
}

/// Returns the files of a bag in their order, with notes.
pub(crate) fn find(path: &Path, notes: &mut Vec<String>) -> Result<Vec<Part>, BagError> {
    if !path.is_dir() {
        return Ok(vec![Part::new(path.to_owned())]);
    }
    let description = path.join(METADATA);
    let mut names = Vec::new();
    if description.exists() {
        let text = mvt_files::input::read_text(&description, 16 << 20).map_err(BagError::io(&description))?;
        names = listed(&text);
        if names.is_empty() {
            add_note(notes, format!("{} names no files: all bags in the folder are read", description.display()));
        }
    }
    if names.is_empty() {
        return in_folder(path);
    }
    let mut parts = Vec::new();
    for name in names {
        // Only names of files in this folder: a description does not point elsewhere.
        let file = Path::new(&name).file_name().map(|name| path.join(name)).unwrap_or_default();
        let mut packed = file.clone().into_os_string();
        packed.push(".zstd");
        let plain = file.with_extension("");
        let is_packed = file.extension().is_some_and(|ending| ending == "zstd");
        let candidates = [Some(file.clone()), Some(packed.into()), is_packed.then_some(plain)];
        match candidates.into_iter().flatten().find(|file| file.is_file()) {
            Some(found) => parts.push(Part::new(found)),
            None => add_note(notes, format!("{} is missing and left out: copy it beside the others", file.display())),
        }
    }
    if parts.is_empty() {
        return Err(BagError::fault(
            path,
            format!("no file that {METADATA} names is there: copy them into the folder"),
        ));
    }
    Ok(parts)
}

/// Returns the bags in a folder without a description.
fn in_folder(path: &Path) -> Result<Vec<Part>, BagError> {
    let mut files = Vec::new();
    for entry in path.read_dir().map_err(BagError::io(path))? {
        let file = entry.map_err(BagError::io(path))?.path();
        let Some(name) = file.file_name().filter(|name| !mvt_files::input::is_litter(name)) else { continue };
        let name = name.to_string_lossy().into_owned();
        let stem = name.strip_suffix(".zstd").unwrap_or(&name);
        if ENDINGS.iter().any(|ending| stem.ends_with(ending)) {
            files.push((natural(&name), file));
        } else if name.ends_with(".bag") {
            return Err(BagError::Ros1 { path: file });
        }
    }
    files.sort();
    if files.is_empty() {
        return Err(BagError::fault(
            path,
            "there is no bag in the folder: neither metadata.yaml nor files *.mcap or *.db3",
        ));
    }
    Ok(files.into_iter().map(|(_, file)| Part::new(file)).collect())
}

/// Returns a name in pieces by which 10 comes after 9.
fn natural(name: &str) -> Vec<(u128, String)> {
    let mut pieces = vec![(0, String::new())];
    let mut digits = String::new();
    for letter in name.chars().chain([' ']) {
        if letter.is_ascii_digit() {
            digits.push(letter);
            continue;
        }
        if !digits.is_empty() {
            pieces.push((digits.parse().unwrap_or(u128::MAX), String::new()));
            digits.clear();
        }
        if let Some((_, text)) = pieces.last_mut() {
            text.push(letter);
        }
    }
    pieces
}

/// Returns the names below `relative_file_paths` in a description. It is YAML of a fixed form, which programs write.
fn listed(text: &str) -> Vec<String> {
    let unquoted = |name: &str| name.trim().trim_matches(['"', '\'']).to_owned();
    let mut lines = text.lines().map(str::trim).skip_while(|line| !line.starts_with("relative_file_paths:"));
    let inline = lines.next().and_then(|line| line.split_once(':')).map_or("", |(_, rest)| rest.trim());
    let names: Vec<String> = match inline.strip_prefix('[').and_then(|list| list.strip_suffix(']')) {
        Some(list) => list.split(',').map(unquoted).collect(),
        None => lines.map_while(|line| line.strip_prefix("- ")).map(unquoted).collect(),
    };
    names.into_iter().filter(|name| !name.is_empty()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_description_lists_its_files_in_block_and_in_line() {
        let block = "rosbag2_bagfile_information:\n  version: 5\n  relative_file_paths:\n    - a_0.db3\n    - \"a_1.db3\"\n  duration:\n    - b\n";
        assert_eq!(listed(block), ["a_0.db3", "a_1.db3"]);
        assert_eq!(listed("relative_file_paths: [a.mcap, 'b.mcap']\nx: 1"), ["a.mcap", "b.mcap"]);
        assert!(listed("version: 5").is_empty());
    }

    #[test]
    fn numbers_in_names_are_counted() {
        let mut names = ["a_10.mcap", "a_9.mcap", "a_0.mcap"];
        names.sort_by_key(|name| natural(name));
        assert_eq!(names, ["a_0.mcap", "a_9.mcap", "a_10.mcap"]);
    }
}
