//! Writer of a log from parts that come in any order, as recordings of other programs deliver them.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use mvt_frames::camera::PosedCamera;
use mvt_frames::{Isometry, MeshFile, Object, World};
use mvt_robot::hand::{Hand, JointAngles, Side};
use serde::Serialize;

use crate::error::LogError;
use crate::frame::finger_poses;
use crate::hand::{pad_folder, pad_size, world_from_base};
use crate::io::write_synced;
use crate::live::{LIVE_FILE, LiveFile};
use crate::npz::{DeflatedFrame, NpzWriter};
use crate::pickle;
use crate::picture::{color_of, gray_of, touch_of};
use crate::record::{CameraRecord, DigitInfo, Matrix, Record, is_plain_name};
use crate::scene::{SCENE_FILE, SceneFile};
use crate::writer::PartialFolder;

/// Kind of an image of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum LogImage {
    /// Colours of a camera, by its number.
    Colours(usize),
    /// Labels of a camera, by its number, grey: 0 background, 127 hand, 255 object.
    Labels(usize),
    /// Image of a touch sensor, by the index of its pad.
    Touch(usize),
    /// True depth of a touch sensor, by the index of its pad, in the levels of [`DigitInfo`].
    TouchDepth(usize),
    /// Contact mask of a touch sensor, by the index of its pad, grey: 0 or 255.
    Contact(usize),
}

/// Camera of a log that is assembled.
#[derive(Debug, Clone, PartialEq)]
pub struct LogCamera {
    /// Name, pinhole model and pose.
    pub camera: PosedCamera,
    /// k1, k2, p1, p2, k3 of OpenCV's model; `None` without distortion. Readers straighten the images.
    pub distortion: Option<[f64; 5]>,
}

/// Everything in a log besides images.
#[derive(Debug, Clone)]
pub struct Timeline {
    /// Name of the object.
    pub object_name: String,
    /// Time of each frame, seconds, increasing.
    pub times_s: Vec<f64>,
    /// Joint angles of each frame.
    pub joints: Vec<JointAngles>,
    /// Pose of the object in each frame; `None` where it is unknown.
    pub object_poses: Vec<Option<Isometry<Object, World>>>,
    /// Contents of scene.json, with the same hand; `None` for a log without it.
    pub scene: Option<SceneFile>,
    /// Contents of live.json; `None` for a log without it.
    pub live: Option<LiveFile>,
}

/// Depths of a camera.
struct Depths {
    path: PathBuf,
    writer: NpzWriter,
    pixels: usize,
    /// The next frame of the file.
    next: usize,
    /// Images that came before those of earlier frames; `None` of a frame without depth.
    waiting: BTreeMap<usize, Option<DeflatedFrame>>,
    /// Bytes of these images.
    bytes: usize,
}

/// Greatest size of depth images that wait for earlier ones, bytes: a minute of a camera.
const MOST_WAITING: usize = 1 << 30;

impl Depths {
    fn write(&mut self, image: Option<DeflatedFrame>) -> std::io::Result<()> {
        self.next += 1;
        let image = match image {
            Some(image) => image,
            None => DeflatedFrame::new(std::iter::repeat_n(0.0, self.pixels))?,
        };
        self.writer.push(&image)
    }

    fn add(&mut self, frame: usize, image: Option<DeflatedFrame>) -> std::io::Result<()> {
        if frame != self.next {
            let image = image.map(DeflatedFrame::shrink);
            self.bytes += image.as_ref().map_or(0, DeflatedFrame::size);
            self.waiting.insert(frame, image);
            return match self.bytes > MOST_WAITING {
                true => Err(std::io::Error::other("its images are too far from the order of time; sort the recording")),
                false => Ok(()),
            };
        }
        self.write(image)?;
        while let Some(image) = self.waiting.remove(&self.next) {
            self.bytes -= image.as_ref().map_or(0, DeflatedFrame::size);
            self.write(image)?;
        }
        Ok(())
    }

    /// Completes the file with as many frames, those that did not come without depth.
    fn finish(mut self, frames: usize) -> Result<(), LogError> {
        while self.next < frames {
            let image = self.waiting.remove(&self.next).flatten();
            self.write(image).map_err(LogError::io(&self.path))?;
        }
        self.writer.finish(1.0).map_err(LogError::io(self.path))
    }
}

fn write_json(path: &Path, value: &impl Serialize) -> Result<(), LogError> {
    let bytes = serde_json::to_vec_pretty(value).map_err(|reason| LogError::Json { path: path.to_owned(), reason })?;
    write_synced(path, &bytes)
}

/// Writer of a log in FeelSight's layout, whose images may come in any order and may be missing. The folder has its name only when the log is
/// complete; if the writer is dropped before [`LogAssembler::finish`], it removes its files.
pub struct LogAssembler {
    place: PathBuf,
    partial: PartialFolder,
    hand: Arc<Hand>,
    cameras: Vec<LogCamera>,
    depths: Vec<Depths>,
}

impl LogAssembler {
    /// Begins a log of a hand in the folder `place` with these cameras.
    ///
    /// # Errors
    /// [`LogError::NotEmpty`] if the folder is not empty; [`LogError::Defect`] for a camera whose name is no file name or occurs twice;
    /// [`LogError::Io`] if the folder cannot be created.
    pub fn create(place: &Path, hand: Arc<Hand>, cameras: Vec<LogCamera>) -> Result<Self, LogError> {
        let partial = PartialFolder::begin(place)?;
        fs::create_dir_all(partial.path()).map_err(LogError::io(place))?;
        let mut depths = Vec::new();
        for (number, LogCamera { camera, .. }) in cameras.iter().enumerate() {
            let name = &camera.name;
            if !is_plain_name(name) {
                return Err(LogError::defect(
                    place,
                    format!("the camera's name {name:?} cannot be the name of a file"),
                ));
            }
            if cameras.iter().take(number).any(|other| other.camera.name == *name) {
                return Err(LogError::defect(place, format!("two cameras have the name {name}; give each its own")));
            }
            let path = partial.path().join("realsense").join(name).join("depth.npz");
            fs::create_dir_all(path.with_file_name("")).map_err(LogError::io(&path))?;
            let writer = NpzWriter::create(&path, camera.intrinsics.height, camera.intrinsics.width);
            let writer = writer.map_err(LogError::io(&path))?;
            let pixels = camera.intrinsics.height * camera.intrinsics.width;
            depths.push(Depths { path, writer, pixels, next: 0, waiting: BTreeMap::new(), bytes: 0 });
        }
        Ok(Self { place: place.to_path_buf(), partial, hand, cameras, depths })
    }

    /// Returns the hand of the log.
    pub fn hand(&self) -> &Hand {
        &self.hand
    }

    /// Adds an image of a frame: a JPEG or PNG file, which is stored to the byte. `origin` names it in errors.
    ///
    /// # Errors
    /// [`LogError`] if it cannot be decoded, has not the size of the sensor's images, or cannot be written.
    pub fn image(&mut self, image: LogImage, frame: usize, file: &[u8], origin: &Path) -> Result<(), LogError> {
        let touch = |pad: usize, kind| match pad < self.hand.pads().len() {
            true => Ok((format!("{}/{kind}", pad_folder(&self.hand, pad)), pad_size(&self.hand, pad))),
            false => Err(LogError::defect(origin, format!("there is no pad {pad}"))),
        };
        let camera = |number: usize, kind| match self.cameras.get(number) {
            Some(LogCamera { camera: PosedCamera { name, intrinsics, .. }, .. }) => {
                Ok((format!("realsense/{name}/{kind}"), (intrinsics.width, intrinsics.height)))
            }
            None => Err(LogError::defect(origin, format!("there is no camera {number}"))),
        };
        let (folder, size) = match image {
            LogImage::Colours(number) => camera(number, "image")?,
            LogImage::Labels(number) => camera(number, "seg")?,
            LogImage::Touch(pad) => touch(pad, "image")?,
            LogImage::TouchDepth(pad) => touch(pad, "depth")?,
            LogImage::Contact(pad) => touch(pad, "mask")?,
        };
        // Decoded only to be checked: readers must find no damage.
        match image {
            LogImage::Colours(_) => drop(color_of(file, origin, size)?),
            LogImage::Touch(_) => drop(touch_of(file, origin, size)?),
            _ => drop(gray_of(file, origin, size)?),
        }
        let folder = self.partial.path().join(folder);
        if !folder.is_dir() {
            fs::create_dir_all(&folder).map_err(LogError::io(&folder))?;
        }
        let path = folder.join(format!("{frame}.jpg"));
        fs::write(&path, file).map_err(LogError::io(path))
    }

    /// Adds the depth of a camera, by its number, in a frame: metres along the axis, row by row, 0 where nothing was measured; `None` of a
    /// frame without depth. Depth that comes before that of an earlier frame is kept in memory until then, unless it is given as `None` at
    /// once. A frame of which nothing comes has no depth.
    ///
    /// # Errors
    /// [`LogError`] if it has not the size of the camera's images, cannot be written, or too many images wait.
    pub fn depth(&mut self, camera: usize, frame: usize, depth_m: Option<&[f32]>) -> Result<(), LogError> {
        let Some(depths) = self.depths.get_mut(camera) else {
            return Err(LogError::defect(&self.place, format!("there is no camera {camera}")));
        };
        // The camera's z is negative in front of it.
        let signed =
            |depth_m: &[f32]| DeflatedFrame::new(depth_m.iter().map(|&depth| if depth > 0.0 { -depth } else { 0.0 }));
        let image = depth_m.map(signed).transpose();
        image.and_then(|image| depths.add(frame, image)).map_err(LogError::io(&depths.path))
    }

    /// Completes the log and gives its folder the final name.
    ///
    /// # Errors
    /// [`LogError::Defect`] if there is no frame or the lists differ in length, else [`LogError::Io`].
    pub fn finish(mut self, timeline: Timeline) -> Result<(), LogError> {
        let Timeline { object_name, times_s, joints, object_poses, scene, live } = timeline;
        if times_s.is_empty() || joints.len() != times_s.len() || object_poses.len() != times_s.len() {
            let defect =
                format!("{} times, {} joint states, {} poses", times_s.len(), joints.len(), object_poses.len());
            return Err(LogError::defect(&self.place, defect));
        }
        let hand = &self.hand;
        if let Some(state) = joints.iter().find(|state| state.len() != hand.joints().len()) {
            let defect =
                format!("{} joint angles in a frame; hand {} has {}", state.len(), hand.name(), hand.joints().len());
            return Err(LogError::defect(&self.place, defect));
        }
        for depths in std::mem::take(&mut self.depths) {
            depths.finish(times_s.len())?;
        }
        let object_from_file = match &scene {
            Some(scene) => Isometry::<MeshFile, Object>::from_matrix(&scene.object.object_from_file)
                .map_err(|e| LogError::defect(SCENE_FILE, format!("object_from_file is {e}")))?,
            None => Isometry::identity(),
        };
        let pose = |pose: &Option<Isometry<Object, World>>| match pose {
            Some(pose) => (*pose * object_from_file).to_matrix(),
            // Readers take it for unknown.
            None => Matrix::default(),
        };
        let camera = |LogCamera { camera, distortion }: &LogCamera| CameraRecord {
            name: camera.name.clone(),
            pose: camera.pose.to_matrix(),
            intrinsics: camera.intrinsics,
            distortion: *distortion,
        };
        let record = Record {
            object_mesh: scene.as_ref().map_or_else(String::new, |scene| scene.object.mesh.clone()),
            object_name,
            object_poses: object_poses.iter().map(pose).collect(),
            base_pose: world_from_base(hand).to_matrix(),
            // Without both files readers take the left Allegro.
            hand: (scene.is_none() && *hand != Hand::allegro(Side::Left)).then(|| Arc::clone(hand)),
            finger_poses: Some(joints.iter().map(|joints| finger_poses(hand, joints)).collect()),
            times_s,
            joints,
            digit: DigitInfo::published(),
            cameras: self.cameras.iter().map(camera).collect(),
        };
        let folder = self.partial.path();
        write_synced(&folder.join("data.pkl"), &pickle::to_bytes(&record.to_value()))?;
        if let Some(scene) = &scene {
            write_json(&folder.join(SCENE_FILE), scene)?;
        }
        if let Some(live) = &live {
            write_json(&folder.join(LIVE_FILE), live)?;
        }
        self.partial.place(&self.place)
    }
}
