//! Writes recordings on a thread of its own, so that the run never waits.

use std::fs::{self, File, TryLockError};
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{self, Receiver, Sender};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use mvt_frames::depth::CameraDepth;
use mvt_mesh::Mesh;
use mvt_robot::hand::{Hand, JointAngles};
use mvt_robot::observation::{Percept, Press};
use mvt_run::io::write_file;
use mvt_run::pipeline::{FrameResult, Progress};
use mvt_run::report::{FrameRow, ShapePoint};
use mvt_run::sdf_grid::SdfGrid;
use mvt_run::source::{Pictures, Sensed};
use serde::Serialize;

use super::lines::{AboutFile, EndFile, EventLine, FrameLine, ShapeLine, VersionFile};
use super::{
    About, BlockPlace, CameraImages, FOLDER, FrameImages, RecordedMoment, RecordingError, TouchImages, Touching,
    VERSION,
};
use super::{file_names, has_images, images, shape};

/// Number of waiting frames from which on images are left out.
const PATIENCE: usize = 8;
/// Tries to lock the folder. A viewer that checks the status holds the lock for a moment.
const LOCK_TRIES: u32 = 20;
const LOCK_PAUSE: Duration = Duration::from_millis(50);

/// Data for the thread.
enum Message {
    Frame { row: FrameRow, joints: JointAngles, is_keyframe: bool, sensed: Option<Box<Sensed>> },
    Shape { frame: u64, mesh: Mesh, sdf: Option<SdfGrid>, point: Option<ShapePoint> },
    Event(EventLine),
    End { complete: bool },
}

/// Writer of the recording of a run.
pub struct RecordingWriter {
    messages: Sender<Message>,
    /// Number of waiting frames.
    waiting: Arc<AtomicUsize>,
    thread: JoinHandle<Result<(), RecordingError>>,
}

impl RecordingWriter {
    /// Begins a recording in the folder of a run and replaces an older one. `truth` is the true surface, where it is
    /// known.
    ///
    /// # Errors
    /// [`RecordingError::Io`] if a file cannot be written, or another run records into the folder.
    pub fn create(run: &Path, about: &About, truth: Option<&Mesh>) -> Result<Self, RecordingError> {
        let folder = run.join(FOLDER);
        fs::create_dir_all(&folder).map_err(RecordingError::io(&folder))?;
        // Before any file is removed, which may belong to another run.
        let lock = lock(&folder.join(file_names::RUNNING))?;
        for path in [file_names::ABOUT, file_names::END].map(|name| folder.join(name)) {
            if path.exists() {
                fs::remove_file(&path).map_err(RecordingError::io(&path))?;
            }
        }
        let create = |name: &str| {
            let path = folder.join(name);
            let file = File::create(&path).map_err(RecordingError::io(&path))?;
            Ok::<_, RecordingError>(Appended { file, path, length: 0 })
        };
        let mut files = Files {
            frames: create(file_names::FRAMES)?,
            images: create(file_names::IMAGES)?,
            shapes: create(file_names::SHAPES)?,
            meshes: create(file_names::MESHES)?,
            events: create(file_names::EVENTS)?,
            folder: folder.clone(),
            hand: Arc::clone(&about.hand),
            _lock: lock,
        };
        let truth = truth.map(|mesh| files.meshes.block(&shape::encode(mesh, None))).transpose()?;
        let mut about = about.clone();
        let strides: Vec<usize> = about.cameras.iter().map(|camera| images::stride(&camera.intrinsics)).collect();
        for camera in &mut about.cameras {
            camera.intrinsics = images::shrunk(&camera.intrinsics);
        }
        let rest = serde_json::to_value(AboutFile::new(&about, truth))
            .map_err(|error| RecordingError::damaged(folder.join(file_names::ABOUT), error))?;
        // Last, because readers take a folder with about.json for a recording.
        put(&folder, file_names::ABOUT, &VersionFile { version: VERSION, rest })?;
        let (messages, receiver) = mpsc::channel();
        let waiting = Arc::new(AtomicUsize::new(0));
        let others = Arc::clone(&waiting);
        let thread = thread::Builder::new().name("recording".to_owned());
        let thread =
            thread.spawn(move || files.record(&receiver, &others, &strides)).map_err(RecordingError::io(&folder))?;
        Ok(Self { messages, waiting, thread })
    }

    /// Records the progress of a run. FrameImages are left out if writing lags behind.
    pub fn receive(&self, progress: Progress<'_>) {
        let message = match progress {
            Progress::Started { .. } | Progress::Choice(_) => return,
            Progress::Frame { results, sensed } => {
                // A recording shows the first estimator.
                if let Some(FrameResult { row, estimate, .. }) = results.first().and_then(Option::as_ref) {
                    self.frame(row, estimate.keyframe, sensed);
                }
                return;
            }
            Progress::Shape(_, shape) => Message::Shape {
                frame: shape.frame,
                mesh: shape.mesh.clone(),
                sdf: Some(shape.sdf.clone()),
                point: shape.point,
            },
            Progress::Warning(text) => Message::Event(EventLine::Warning(text.to_owned())),
            Progress::Event(event) => {
                Message::Event(EventLine::Event { time_s: event.time_s, text: event.text.clone() })
            }
        };
        // If the thread has ended, `finish` returns its error.
        let _ = self.messages.send(message);
    }

    /// Records a frame. Its images are left out while the writer is behind.
    pub fn frame(&self, row: &FrameRow, is_keyframe: bool, sensed: Box<Sensed>) {
        let is_late = self.waiting.fetch_add(1, Ordering::Relaxed) >= PATIENCE;
        let joints = sensed.percept.joints.clone();
        let sensed = (!is_late).then_some(sensed);
        // A thread that has ended says why at the end.
        let _ = self.messages.send(Message::Frame { row: *row, joints, is_keyframe, sensed });
    }

    /// Records a shape that is given and does not grow.
    pub fn given(&self, mesh: &Mesh) {
        let _ = self.messages.send(Message::Shape { frame: 0, mesh: mesh.clone(), sdf: None, point: None });
    }

    /// Waits until all frames are written.
    #[cfg(test)]
    pub fn wait(&self) {
        while self.waiting.load(Ordering::Relaxed) > 0 {
            thread::sleep(Duration::from_millis(1));
        }
    }

    /// Ends like a process that is killed.
    #[cfg(test)]
    pub fn die(self) {
        drop(self.messages);
        let _ = self.thread.join();
    }

    /// Ends the recording; `complete` says whether the run came to its end.
    ///
    /// # Errors
    /// [`RecordingError::Io`] if any file could not be written.
    pub fn finish(self, complete: bool) -> Result<(), RecordingError> {
        let _ = self.messages.send(Message::End { complete });
        drop(self.messages);
        self.thread.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
    }
}

fn lock(path: &Path) -> Result<File, RecordingError> {
    let file = File::create(path).map_err(RecordingError::io(path))?;
    for _ in 0..LOCK_TRIES {
        match file.try_lock() {
            Ok(()) => return Ok(file),
            Err(TryLockError::WouldBlock) => thread::sleep(LOCK_PAUSE),
            // A file system without locks, on which a viewer cannot see whether the run goes on.
            Err(TryLockError::Error(error)) => {
                tracing::debug!("{}: {error}", path.display());
                return Ok(file);
            }
        }
    }
    Err(RecordingError::io(path)(std::io::Error::other("another run writes into this folder")))
}

fn put(folder: &Path, name: &str, value: &impl Serialize) -> Result<(), RecordingError> {
    let failed = |error: String| RecordingError::io(folder.join(name))(std::io::Error::other(error));
    let text = serde_json::to_string_pretty(value).map_err(|error| failed(error.to_string()))?;
    write_file(folder, name, text.as_bytes()).map_err(|error| failed(format!("{error:#}")))
}

/// File that grows.
struct Appended {
    file: File,
    path: PathBuf,
    length: u64,
}

impl Appended {
    fn block(&mut self, bytes: &[u8]) -> Result<BlockPlace, RecordingError> {
        self.file.write_all(bytes).map_err(RecordingError::io(&self.path))?;
        let place = BlockPlace { at: self.length, bytes: bytes.len() as u64, crc32: crc32fast::hash(bytes) };
        self.length += place.bytes;
        Ok(place)
    }

    fn line(&mut self, line: &impl Serialize) -> Result<(), RecordingError> {
        let mut text = serde_json::to_vec(line).map_err(|error| RecordingError::damaged(&self.path, error))?;
        text.push(b'\n');
        self.block(&text).map(drop)
    }
}

struct Files {
    folder: PathBuf,
    hand: Arc<Hand>,
    frames: Appended,
    images: Appended,
    shapes: Appended,
    meshes: Appended,
    events: Appended,
    /// Held while the run goes on.
    _lock: File,
}

impl Files {
    fn record(
        mut self,
        messages: &Receiver<Message>,
        waiting: &AtomicUsize,
        strides: &[usize],
    ) -> Result<(), RecordingError> {
        for message in messages {
            match message {
                Message::Frame { row, joints, is_keyframe, sensed } => {
                    let mut moment = RecordedMoment {
                        row,
                        joints,
                        touching: self.hand.per_pad(|_| None),
                        is_keyframe,
                        is_estimated: true,
                        images: None,
                    };
                    if let Some(sensed) = sensed {
                        self.see(&mut moment, *sensed, strides)?;
                    }
                    self.frames.line(&FrameLine::new(&moment))?;
                    waiting.fetch_sub(1, Ordering::Relaxed);
                }
                Message::Shape { frame, mesh, sdf, point } => {
                    let place = self.meshes.block(&shape::encode(&mesh, sdf.as_ref()))?;
                    self.shapes.line(&ShapeLine { frame, point, place })?;
                }
                Message::Event(line) => self.events.line(&line)?,
                Message::End { complete } => put(&self.folder, file_names::END, &EndFile { complete })?,
            }
        }
        Ok(())
    }

    /// Adds the sensed images to a moment.
    fn see(&mut self, moment: &mut RecordedMoment, sensed: Sensed, strides: &[usize]) -> Result<(), RecordingError> {
        let Sensed { percept, pictures, .. } = sensed;
        moment.touching = self.hand.per_pad(|pad| {
            let force_n = pictures.forces_n.as_ref().and_then(|forces| forces.get(pad)).map(|force| *force as f32);
            Touching::of(percept.touch.get(pad)?.as_ref()?, self.hand.gel_views().get(pad)?, force_n)
        });
        if has_images(moment.row.frame) {
            let images = pictured(moment.row.frame as usize, &self.hand, percept, pictures, strides);
            let block =
                images::encode(&images).map_err(|problem| RecordingError::damaged(&self.images.path, problem))?;
            moment.images = Some(self.images.block(&block)?);
        }
        Ok(())
    }
}

/// The images of a frame as they are recorded.
fn pictured(frame: usize, hand: &Hand, percept: Percept, pictures: Pictures, strides: &[usize]) -> FrameImages {
    let Pictures { touch: mut seen, mut true_indentation_mm, .. } = pictures;
    let camera = |(camera, &stride): (Option<CameraDepth>, &usize)| {
        let CameraDepth { depth_m, labels, colour, .. } = camera?;
        Some(CameraImages {
            colour: images::thinned(&colour.unwrap_or_default(), stride),
            depth_m: images::thinned_array(&depth_m, stride),
            labels: images::thinned_array(&labels, stride),
        })
    };
    let cameras = percept.cameras.into_iter().zip(strides).map(camera).collect();
    let mut felt = percept.touch;
    let touch = hand.per_pad(|pad| {
        let Press { indentation_mm, contact, .. } = felt.get_mut(pad)?.take()?;
        let image = seen.get_mut(pad).map(std::mem::take).unwrap_or_default();
        let true_indentation_mm = true_indentation_mm.get_mut(pad).and_then(Option::take);
        Some(TouchImages { image, indentation_mm, contact, true_indentation_mm })
    });
    FrameImages { frame, cameras, touch }
}
