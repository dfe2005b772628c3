//! Reads recordings, including those that still grow.

use std::collections::VecDeque;
use std::fs::TryLockError;
use std::io::{Read as _, Seek as _, SeekFrom};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use mvt_files::input;
use mvt_frames::{Isometry, World};
use mvt_mesh::Mesh;
use mvt_run::report::Event;
use serde::de::DeserializeOwned;

use super::feelsight_log::LogImages;
use super::lines::{AboutFile, EndFile, EventLine, FrameLine, ShapeLine, VersionFile};
use super::{
    About, BlockPlace, FOLDER, FrameImages, RecordedMoment, RecordedShape, RecordingError, ShapeEntry, Status, VERSION,
};
use super::{file_names, images, shape};

/// Number of images and shapes that are kept in memory.
const KEPT_IMAGES: usize = 12;
const KEPT_SHAPES: usize = 6;
/// Largest file of text, and largest block, that is read, bytes.
const LARGEST_TEXT: u64 = 256 << 20;
const LARGEST_BLOCK: u64 = 128 << 20;
/// Number of warnings about damaged lines of one file.
const MOST_WARNINGS: usize = 20;

/// Recording of a run, or a FeelSight log that is read like one.
pub struct Recording {
    /// The folder of the run or log.
    folder: PathBuf,
    source: Source,
    about: About,
    moments: Vec<RecordedMoment>,
    shapes: Vec<ShapeEntry>,
    events: Vec<Event>,
    warnings: Vec<String>,
    status: Status,
    /// Grows whenever anything is new.
    revision: u64,
    truth: Option<Mesh>,
    images: Kept<FrameImages>,
    known_shapes: Kept<RecordedShape>,
}

/// Origin of the recording.
enum Source {
    Run {
        /// Folder of the recording in the folder of the run.
        folder: PathBuf,
        /// Bytes of about.json. Other bytes mean that another run has started in the folder.
        about: Vec<u8>,
        frames: Lines,
        shapes: Lines,
        events: Lines,
    },
    Log(Box<LogImages>),
}

impl Recording {
    /// Opens the recording in the folder of a run.
    ///
    /// # Errors
    /// [`RecordingError`] names the file and the problem.
    pub fn open(folder: &Path) -> Result<Self, RecordingError> {
        let inner = folder.join(FOLDER);
        let (about, truth, text) = read_about(folder)?;
        let mut warnings = Vec::new();
        let meshes = inner.join(file_names::MESHES);
        let truth = truth.and_then(|place| match mesh(&meshes, place) {
            Ok((mesh, _)) => Some(mesh),
            Err(error) => {
                warnings.push(format!("the true shape is missing: {error}"));
                None
            }
        });
        let lines = |name: &str| Lines { path: inner.join(name), ..Lines::default() };
        let source = Source::Run {
            about: text,
            frames: lines(file_names::FRAMES),
            shapes: lines(file_names::SHAPES),
            events: lines(file_names::EVENTS),
            folder: inner,
        };
        let mut recording = Self::with(folder, source, about, truth, warnings);
        recording.refresh()?;
        Ok(recording)
    }

    /// Opens a FeelSight log as a recording without estimates. The true surface comes from the catalogue; a warning
    /// says if it is missing.
    ///
    /// # Errors
    /// [`RecordingError::Log`] if the log cannot be used.
    pub fn open_log(folder: &Path) -> Result<Self, RecordingError> {
        let (images, about, moments, truth, warnings) = LogImages::open(folder)?;
        let mut recording = Self::with(folder, Source::Log(Box::new(images)), about, truth, warnings);
        recording.moments = moments;
        recording.status = Status::Finished;
        Ok(recording)
    }

    fn with(folder: &Path, source: Source, about: About, truth: Option<Mesh>, warnings: Vec<String>) -> Self {
        Self {
            folder: folder.to_path_buf(),
            source,
            about,
            moments: Vec::new(),
            shapes: Vec::new(),
            events: Vec::new(),
            warnings,
            status: Status::Running,
            revision: 0,
            truth,
            images: Kept::new(KEPT_IMAGES),
            known_shapes: Kept::new(KEPT_SHAPES),
        }
    }

    /// Reads appended data. Returns whether anything is new, including the status. A new recording in the same folder
    /// replaces this one.
    ///
    /// # Errors
    /// [`RecordingError`] if the appended data cannot be read. The data that was read before remain.
    pub fn refresh(&mut self) -> Result<bool, RecordingError> {
        let hand = Arc::clone(&self.about.hand);
        let (folder, about, frames, shapes, events) = match &mut self.source {
            Source::Run { folder, about, frames, shapes, events } => (folder, about, frames, shapes, events),
            Source::Log(log) => {
                let has_news = log.add_contacts(&mut self.moments);
                self.revision += u64::from(has_news);
                return Ok(has_news);
            }
        };
        let now = input::read(&folder.join(file_names::ABOUT), LARGEST_TEXT)
            .map_err(RecordingError::io(folder.join(file_names::ABOUT)))?;
        if now != *about {
            *self = Self { revision: self.revision + 1, ..Self::open(&self.folder)? };
            return Ok(true);
        }
        // Before the lines, so that no line of a run that ends now is missed.
        let status = status(folder);
        let before = (self.moments.len(), self.shapes.len(), self.events.len(), self.warnings.len(), self.status);
        let warnings = &mut self.warnings;
        for line in frames.read::<FrameLine>(warnings)? {
            match line.moment(&hand) {
                Ok(moment) if self.moments.last().is_some_and(|last| last.row.frame >= moment.row.frame) => {
                    frames.complain(warnings, &"its frame is not greater than the last");
                }
                Ok(moment) => self.moments.push(moment),
                Err(problem) => frames.complain(warnings, &problem),
            }
        }
        for ShapeLine { frame, point, place } in shapes.read(warnings)? {
            if self.shapes.last().is_some_and(|last| last.frame > frame) {
                shapes.complain(warnings, &"its frame is less than the last");
            } else {
                self.shapes.push(ShapeEntry { frame, point, place });
            }
        }
        for line in events.read(warnings)? {
            match line {
                EventLine::Event { time_s, text } => self.events.push(Event { time_s, text }),
                EventLine::Warning(text) => warnings.push(text),
            }
        }
        self.status = status;
        let now = (self.moments.len(), self.shapes.len(), self.events.len(), self.warnings.len(), self.status);
        self.revision += u64::from(before != now);
        Ok(before != now)
    }

    /// Returns a number that grows when [`Self::refresh`] finds anything new.
    pub fn revision(&self) -> u64 {
        self.revision
    }

    /// Returns the folder of the run or log.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// Returns the description of the run.
    pub fn about(&self) -> &About {
        &self.about
    }

    /// Returns the frames so far.
    pub fn moments(&self) -> &[RecordedMoment] {
        &self.moments
    }

    /// Returns the shapes so far, in order of their frames.
    pub fn shapes(&self) -> &[ShapeEntry] {
        &self.shapes
    }

    /// Returns the events so far, in order of time.
    pub fn events(&self) -> &[Event] {
        &self.events
    }

    /// Returns the warnings of the run and about damaged files.
    pub fn warnings(&self) -> &[String] {
        &self.warnings
    }

    /// Returns the status of the run.
    pub fn status(&self) -> Status {
        self.status
    }

    /// Returns the indices of the moments up to `moment` that have images.
    pub fn image_moments(&self, moment: usize) -> Vec<usize> {
        let until = self.moments.len().min(moment.saturating_add(1));
        match self.source {
            Source::Run { .. } => (0..until).filter(|&k| self.moments[k].images.is_some()).collect(),
            Source::Log(_) => (0..until).filter(|&k| super::has_images(k as u64)).collect(),
        }
    }

    /// Returns the index of the newest moment at or before `moment` that has images.
    pub fn images_at(&self, moment: usize) -> Option<usize> {
        let until = self.moments.get(..=moment).unwrap_or(&self.moments);
        match self.source {
            Source::Run { .. } => until.iter().rposition(|moment| moment.images.is_some()),
            Source::Log(_) => until.len().checked_sub(1),
        }
    }

    /// Returns the newest images at or before a moment, or `None` before the first images. The last few are kept in
    /// memory.
    ///
    /// # Errors
    /// [`RecordingError`] if they cannot be read or decoded.
    pub fn images(&self, moment: usize) -> Result<Option<Arc<FrameImages>>, RecordingError> {
        let Some(index) = self.images_at(moment) else { return Ok(None) };
        let make = || match (&self.source, self.moments.get(index).and_then(|moment| moment.images)) {
            (Source::Run { folder, .. }, Some(place)) => {
                let path = folder.join(file_names::IMAGES);
                let block = block(&path, place)?;
                images::decode(&block, index, self.about.cameras.len(), self.about.hand.pads().len())
                    .map_err(|problem| RecordingError::damaged(path, problem))
            }
            (Source::Log(log), _) => Ok(log.images(index)),
            (Source::Run { .. }, None) => {
                let touch = self.about.hand.per_pad(|_| None);
                Ok(FrameImages { frame: index, cameras: vec![], touch })
            }
        };
        match &self.source {
            // The images of a log may be incomplete until the background thread has read them.
            Source::Log(log) if !log.is_read(index) => make().map(|images| Some(Arc::new(images))),
            _ => self.images.get(index, make).map(Some),
        }
    }

    /// Returns the index in [`Self::shapes`] of the newest shape at or before a moment.
    pub fn shape_at(&self, moment: usize) -> Option<usize> {
        let frame = self.moments.get(moment).or(self.moments.last())?.row.frame;
        self.shapes.partition_point(|entry| entry.frame <= frame).checked_sub(1)
    }

    /// Returns the newest shape at or before a moment, or `None` before the first shape. The last few are kept in
    /// memory.
    ///
    /// # Errors
    /// [`RecordingError`] if it cannot be read.
    pub fn shape(&self, moment: usize) -> Result<Option<Arc<RecordedShape>>, RecordingError> {
        let Source::Run { folder, .. } = &self.source else { return Ok(None) };
        let Some(index) = self.shape_at(moment) else { return Ok(None) };
        let make = || {
            let ShapeEntry { frame, point, place } = self.shapes[index];
            let (mesh, sdf) = mesh(&folder.join(file_names::MESHES), place)?;
            Ok(RecordedShape { frame, mesh, sdf, point })
        };
        self.known_shapes.get(index, make).map(Some)
    }

    /// Whether the recording may change, because the run goes on or the log is still being read.
    pub fn is_growing(&self) -> bool {
        let is_reading = matches!(&self.source, Source::Log(log) if !log.is_complete());
        self.status == Status::Running || is_reading
    }

    /// Waits until the background thread has read the log.
    pub fn finish_reading(&mut self) {
        if let Source::Log(log) = &mut self.source {
            log.finish();
            log.add_contacts(&mut self.moments);
        }
    }

    /// Returns the true surface of the object, where it is known.
    pub fn true_mesh(&self) -> Option<&Mesh> {
        self.truth.as_ref()
    }

    /// Whether the contacts of a moment are known: those of a log are read in the background.
    pub fn is_read(&self, moment: usize) -> bool {
        match &self.source {
            Source::Run { .. } => true,
            Source::Log(log) => log.is_read(moment),
        }
    }

    /// Returns the pose of the object at a moment: the estimated one, or in a log the true one.
    pub fn pose(&self, moment: usize) -> Option<Isometry<mvt_frames::Object, World>> {
        let moment = self.moments.get(moment)?;
        moment.estimate().or(moment.row.truth)
    }
}

/// Reads about.json of the recording in the folder of a run: its content, the place of the true shape, and its bytes.
fn read_about(folder: &Path) -> Result<(About, Option<BlockPlace>, Vec<u8>), RecordingError> {
    let path = folder.join(FOLDER).join(file_names::ABOUT);
    let text = match input::read(&path, LARGEST_TEXT) {
        Ok(text) => text,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
            return Err(RecordingError::NoRecording(folder.to_path_buf()));
        }
        Err(error) => return Err(RecordingError::io(path)(error)),
    };
    let damaged = |problem: &dyn std::fmt::Display| RecordingError::damaged(&path, problem);
    let VersionFile { version, rest } = serde_json::from_slice(&text).map_err(|error| damaged(&error))?;
    if version > VERSION {
        return Err(RecordingError::NewerVersion { folder: folder.to_path_buf(), found: version });
    }
    let about: AboutFile = serde_json::from_value(rest).map_err(|error| damaged(&error))?;
    let (about, truth) = about.about(version).map_err(|problem| damaged(&problem))?;
    Ok((about, truth, text))
}

impl About {
    /// Reads the description of the run in a folder, without its frames.
    ///
    /// # Errors
    /// [`RecordingError`] names the file and the problem.
    pub fn read(folder: &Path) -> Result<Self, RecordingError> {
        read_about(folder).map(|(about, ..)| about)
    }
}

/// Reads the status of a run.
fn status(folder: &Path) -> Status {
    // Why: notes/decisions/viewing.md, "A file lock shows whether a run lives".
    if let Ok(text) = input::read(&folder.join(file_names::END), LARGEST_TEXT) {
        return match serde_json::from_slice(&text) {
            Ok(EndFile { complete: true }) => Status::Finished,
            _ => Status::Interrupted,
        };
    }
    match input::open(&folder.join(file_names::RUNNING)).map(|file| file.try_lock_shared()) {
        Ok(Err(TryLockError::WouldBlock)) => Status::Running,
        // The run may have ended since the first check.
        _ if folder.join(file_names::END).exists() => Status::Finished,
        _ => Status::Crashed,
    }
}

/// Reads a block and checks its checksum.
fn block(path: &Path, BlockPlace { at, bytes, crc32 }: BlockPlace) -> Result<Vec<u8>, RecordingError> {
    if bytes > LARGEST_BLOCK {
        return Err(RecordingError::damaged(path, format_args!("a block of {bytes} bytes is too large")));
    }
    let mut file = input::open(path).map_err(RecordingError::io(path))?;
    file.seek(SeekFrom::Start(at)).map_err(RecordingError::io(path))?;
    let mut block = Vec::new();
    file.take(bytes).read_to_end(&mut block).map_err(RecordingError::io(path))?;
    if block.len() as u64 != bytes {
        return Err(RecordingError::damaged(path, format_args!("it ends before the block at {at}")));
    }
    if crc32fast::hash(&block) != crc32 {
        return Err(RecordingError::damaged(path, format_args!("the block at {at} has the wrong checksum")));
    }
    Ok(block)
}

fn mesh(path: &Path, place: BlockPlace) -> Result<(Mesh, Option<mvt_run::sdf_grid::SdfGrid>), RecordingError> {
    shape::decode(&block(path, place)?).map_err(|problem| RecordingError::damaged(path, problem))
}

/// File of lines that grows.
#[derive(Default)]
struct Lines {
    path: PathBuf,
    /// Bytes that were read.
    read: u64,
    /// Number of damaged lines.
    complaints: usize,
}

impl Lines {
    /// Returns the new complete lines.
    fn read<T: DeserializeOwned>(&mut self, warnings: &mut Vec<String>) -> Result<Vec<T>, RecordingError> {
        let mut file = input::open(&self.path).map_err(RecordingError::io(&self.path))?;
        file.seek(SeekFrom::Start(self.read)).map_err(RecordingError::io(&self.path))?;
        let mut text = Vec::new();
        file.take(LARGEST_TEXT).read_to_end(&mut text).map_err(RecordingError::io(&self.path))?;
        let Some(end) = text.iter().rposition(|&byte| byte == b'\n') else { return Ok(Vec::new()) };
        self.read += end as u64 + 1;
        let mut lines = Vec::new();
        for line in text[..end].split(|&byte| byte == b'\n') {
            match serde_json::from_slice(line) {
                Ok(line) => lines.push(line),
                Err(error) => self.complain(warnings, &error),
            }
        }
        Ok(lines)
    }

    /// Warns that a line is skipped.
    fn complain(&mut self, warnings: &mut Vec<String>, problem: &dyn std::fmt::Display) {
        self.complaints += 1;
        let path = self.path.display();
        match self.complaints {
            ..MOST_WARNINGS => warnings.push(format!("{path}: a damaged line is skipped: {problem}")),
            MOST_WARNINGS => warnings.push(format!("{path}: further damaged lines are skipped")),
            _ => {}
        }
    }
}

/// The last few values of a kind that takes time to read.
struct Kept<T> {
    most: usize,
    values: Mutex<VecDeque<(usize, Arc<T>)>>,
}

impl<T> Kept<T> {
    fn new(most: usize) -> Self {
        Self { most, values: Mutex::default() }
    }

    /// Returns the value of a number, which `make` makes unless it is kept.
    fn get(&self, number: usize, make: impl FnOnce() -> Result<T, RecordingError>) -> Result<Arc<T>, RecordingError> {
        let kept = || self.values.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, value)) = kept().iter().find(|(known, _)| *known == number) {
            return Ok(Arc::clone(value));
        }
        // Made without the lock, so that other threads can take kept values.
        let value = Arc::new(make()?);
        let mut kept = kept();
        kept.push_back((number, Arc::clone(&value)));
        if kept.len() > self.most {
            kept.pop_front();
        }
        Ok(value)
    }
}
