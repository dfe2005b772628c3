//! Writer of a log, frame by frame.

use std::fs;
use std::path::{Path, PathBuf};

use mvt_frames::camera::{Intrinsics, PosedCamera};

use crate::error::LogError;
use crate::frame::EncodedFrame;
use crate::frames::FrameWriter;
use crate::hand::world_from_base;
use crate::io::{sync_folder, write_synced};
use crate::pickle;
use crate::preview::Preview;
use crate::record::{CameraRecord, DigitInfo, Record, is_plain_name};
use crate::scene::{EpisodeEnd, LogMeta, SCENE_FILE};

/// Writer of a log. It writes into `.<name>.partial` beside the final folder and renames that when the log is complete:
/// a folder with the final name is a complete log even if the process is killed. If it is dropped before
/// [`LogWriter::finish`], it removes its files.
pub struct LogWriter {
    place: PathBuf,
    partial: PathBuf,
    overwrite: bool,
    meta: LogMeta,
    record: Record,
    /// `None` once they are complete.
    frames: Option<FrameWriter>,
    preview: Preview,
}

impl LogWriter {
    /// Begins a log in the folder `place`.
    ///
    /// # Errors
    /// [`LogError::NotEmpty`] if the folder is not empty and `overwrite` is false; [`LogError::Defect`] for names that
    /// are no file names; [`LogError::Io`] if the folder cannot be created.
    pub fn create(place: &Path, meta: LogMeta, overwrite: bool) -> Result<Self, LogError> {
        if !overwrite && !is_vacant(place)? {
            return Err(LogError::NotEmpty { path: place.to_path_buf() });
        }
        let object = &meta.scene.object.name;
        let names = std::iter::once(object).chain(&meta.scene.cameras);
        if let Some(name) = names.into_iter().find(|name| !is_plain_name(name)) {
            return Err(LogError::defect(place, format!("{name:?} cannot be the name of a file")));
        }
        if !meta.cameras.iter().map(|camera| &camera.name).eq(&meta.scene.cameras) {
            return Err(LogError::defect(place, "the cameras are not those of the scene"));
        }
        let hand = &meta.scene.hand;
        if meta.untouched.as_ref().is_some_and(|images| images.len() != hand.pads().len()) {
            return Err(LogError::defect(
                place,
                format!("hand {} has another number of untouched images", hand.name()),
            ));
        }
        let partial = sibling(place, "partial")?;
        // A killed process leaves this folder behind.
        remove(&partial)?;
        let size = |camera: &Intrinsics| (camera.width, camera.height);
        let sizes = meta.cameras.iter().map(|camera| (camera.name.as_str(), size(&camera.intrinsics)));
        let frames = FrameWriter::create(&partial, &sizes.collect::<Vec<_>>(), hand, meta.untouched.as_ref())?;
        let camera = |camera: &PosedCamera| CameraRecord {
            name: camera.name.clone(),
            pose: camera.pose.to_matrix(),
            intrinsics: camera.intrinsics,
            distortion: None,
        };
        let record = Record {
            times_s: Vec::new(),
            object_name: object.clone(),
            object_mesh: meta.scene.object.mesh.clone(),
            object_poses: Vec::new(),
            hand: None,
            base_pose: world_from_base(hand).to_matrix(),
            joints: Vec::new(),
            finger_poses: Some(Vec::new()),
            digit: DigitInfo::published(),
            cameras: meta.cameras.iter().map(camera).collect(),
        };
        let preview = Preview::create(&partial, object, meta.scene.frame_rate_hz);
        Ok(Self { place: place.to_path_buf(), partial, overwrite, meta, record, frames: Some(frames), preview })
    }

    /// Returns the description of the log, for [`EncodedFrame::encode`].
    pub fn meta(&self) -> &LogMeta {
        &self.meta
    }

    /// Appends a frame.
    ///
    /// # Errors
    /// [`LogError::Frame`] if its time is not later than the last frame's, [`LogError::Io`] if it cannot be written.
    pub fn push(&mut self, frame: &EncodedFrame) -> Result<(), LogError> {
        let EncodedFrame { time_s, .. } = *frame;
        let joints = self.meta.scene.hand.joints().len();
        let fits = |frames: &&mut FrameWriter| frames.fits(&frame.images) && frame.joints.len() == joints;
        let is_late = self.record.times_s.last().is_none_or(|&last| time_s > last);
        let Some(frames) = self.frames.as_mut().filter(fits).filter(|_| is_late) else {
            let defect =
                "its time is not later than that of the last frame, or its hand or cameras are those of another log"
                    .into();
            return Err(LogError::Frame { time_s, defect });
        };
        frames.push(&frame.images)?;
        self.preview.push(&frame.preview);
        self.record.times_s.push(time_s);
        self.record.joints.push(frame.joints.clone());
        self.record.object_poses.push(frame.object_pose);
        self.record.finger_poses.get_or_insert_default().push(frame.finger_poses.clone());
        Ok(())
    }

    /// Completes the log and moves it to its final folder. data.pkl, scene.json and the depths are synced to the disk
    /// before. The numbered images are not, which would take 12,000 syncs: the operating system keeps them if the
    /// process dies.
    ///
    /// # Errors
    /// [`LogError::Defect`] if no frame was pushed, [`LogError::NotEmpty`] if the folder is no longer empty, [`LogError::Interrupted`] if
    /// the log is in its place without a film, because a signal has ended ffmpeg; else [`LogError::Io`].
    pub fn finish(mut self, end: EpisodeEnd) -> Result<(), LogError> {
        if self.record.times_s.is_empty() {
            return Err(LogError::defect(&self.place, "the episode ended before its first frame"));
        }
        self.frames.take().map_or(Ok(()), FrameWriter::finish)?;
        let film = std::mem::replace(&mut self.preview, Preview::Ended).finish();
        write_synced(&self.partial.join("data.pkl"), &pickle::to_bytes(&self.record.to_value()))?;
        self.meta.scene.end = end;
        let path = self.partial.join(SCENE_FILE);
        let scene = serde_json::to_vec_pretty(&self.meta.scene)
            .map_err(|reason| LogError::Json { path: path.clone(), reason })?;
        write_synced(&path, &scene)?;
        sync_folder(&self.partial)?;
        self.put_in_place()?;
        // The frames are kept: what a robot delivered cannot be written again.
        film
    }

    fn put_in_place(&self) -> Result<(), LogError> {
        let old = sibling(&self.place, "old")?;
        remove(&old)?;
        if is_vacant(&self.place)? {
            // Some systems do not rename onto an empty folder.
            if self.place.exists() {
                fs::remove_dir(&self.place).map_err(LogError::io(&self.place))?;
            }
        } else if self.overwrite {
            fs::rename(&self.place, &old).map_err(LogError::io(&self.place))?;
        } else {
            return Err(LogError::NotEmpty { path: self.place.clone() });
        }
        fs::rename(&self.partial, &self.place).map_err(LogError::io(&self.place))?;
        if let Some(parent) = self.partial.parent() {
            sync_folder(parent)?;
        }
        remove(&old)
    }
}

impl Drop for LogWriter {
    fn drop(&mut self) {
        // ffmpeg must close its file first.
        self.preview = Preview::Ended;
        let _ = fs::remove_dir_all(&self.partial);
    }
}

/// Folder of a log that is being written under another name. It is removed unless it is placed.
pub(super) struct PartialFolder(PathBuf);

impl PartialFolder {
    /// Begins a log in `place`, which must not exist or be empty. The folder is not created yet; one that a killed process left is removed.
    pub fn begin(place: &Path) -> Result<Self, LogError> {
        if !is_vacant(place)? {
            return Err(LogError::NotEmpty { path: place.to_path_buf() });
        }
        let partial = sibling(place, "partial")?;
        remove(&partial)?;
        Ok(Self(partial))
    }

    /// Returns the path until the log is complete.
    pub fn path(&self) -> &Path {
        &self.0
    }

    /// Gives the complete log its name.
    pub fn place(&self, place: &Path) -> Result<(), LogError> {
        sync_folder(&self.0)?;
        fs::rename(&self.0, place).map_err(LogError::io(place))
    }
}

impl Drop for PartialFolder {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

/// Returns `.<name>.<suffix>` beside a place.
pub(super) fn sibling(place: &Path, suffix: &str) -> Result<PathBuf, LogError> {
    let name = place.file_name().ok_or_else(|| LogError::defect(place, "the path does not end in a folder name"))?;
    let mut hidden = std::ffi::OsString::from(".");
    hidden.push(name);
    hidden.push(format!(".{suffix}"));
    Ok(place.with_file_name(hidden))
}

/// Returns whether a path does not exist or is an empty folder.
pub(super) fn is_vacant(place: &Path) -> Result<bool, LogError> {
    match fs::read_dir(place) {
        Ok(mut entries) => Ok(entries.next().is_none()),
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(true),
        Err(reason) => Err(LogError::Io { path: place.to_path_buf(), reason }),
    }
}

/// Removes a folder if it exists.
pub(super) fn remove(folder: &Path) -> Result<(), LogError> {
    let mut removed = fs::remove_dir_all(folder);
    // The ffmpeg of a killed writer may create its only file during the removal.
    if removed.as_ref().is_err_and(|reason| reason.kind() == std::io::ErrorKind::DirectoryNotEmpty) {
        removed = fs::remove_dir_all(folder);
    }
    match removed {
        Err(reason) if reason.kind() != std::io::ErrorKind::NotFound => {
            Err(LogError::Io { path: folder.to_path_buf(), reason })
        }
        _ => Ok(()),
    }
}
