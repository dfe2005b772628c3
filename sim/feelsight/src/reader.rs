//! Reads logs: ours, and those of the published data set with their liberties.

use std::fs;
use std::io::Read;
use std::path::{Path, PathBuf};

use image::{GrayImage, ImageBuffer, Luma, Pixel, RgbImage};
use mvt_frames::camera::{Intrinsics, PosedCamera};
use mvt_frames::depth::{BACKGROUND, HAND, OBJECT};
use mvt_frames::{Camera, HandBase, Isometry, MeshFile, Object, World};
use mvt_robot::digit;
use mvt_robot::hand::{Finger, JointAngles, PerFinger, Side, world_from_base};
use mvt_robot::observation::{GroundTruth, Observation, Rgbd, TouchTruth};
use ndarray::Array2;

use super::picture::{read_color, read_gray};
use super::record::{Matrix, Record};
use super::scene::{FORMAT_VERSION, SCENE_FILE, SceneFile};
use super::{DigitInfo, LogError, npz, pickle};

/// Ten times the largest data.pkl that thirty minutes of frames would make.
const MAX_PICKLE: u64 = 256 << 20;
const MAX_SCENE: u64 = 1 << 20;

/// A log, opened. Images and depths are read when they are asked for.
///
/// Everything is expressed in this program's frames: the world is that of [`world_from_base`] wherever the log's own world lies,
/// and depths are positive. Logs without scene.json are taken for recordings of a left hand, whose object frame is the mesh's.
#[derive(Debug)]
pub struct Log {
    folder: PathBuf,
    scene: Option<SceneFile>,
    object_name: String,
    times_s: Vec<f64>,
    joints: Vec<JointAngles>,
    /// `None` where the log has only zeros, as after a tracker was lost.
    object_poses: Vec<Option<Isometry<Object, World>>>,
    finger_poses: Option<Vec<[Matrix; 4]>>,
    /// From the log's world to ours.
    world: Isometry<World, World>,
    digit: DigitInfo,
    cameras: Vec<PosedCamera>,
    /// For every pixel of a camera with distortion the one to take instead.
    lenses: Vec<Option<Vec<Option<u32>>>>,
    touch_labels: bool,
    segmentation: bool,
    /// Defects of single sensors are noted, not refused.
    tolerant: bool,
    notes: Vec<String>,
}

/// One instant of a log.
#[derive(Debug, Clone, PartialEq)]
pub struct LogFrame {
    /// What was recorded.
    pub observation: Observation,
    /// What is true, if the log has a pose of the object and every label: in general simulated ones only.
    pub truth: Option<GroundTruth>,
}

/// The images of one instant but for the cameras' depths.
pub(super) struct Images {
    pub touch: PerFinger<RgbImage>,
    pub color: Vec<RgbImage>,
    pub touch_truth: Option<PerFinger<TouchTruth>>,
    pub segmentation: Option<Vec<GrayImage>>,
}

impl Log {
    /// Opens a log and checks everything but the images: data.pkl, scene.json, the number of files, the shape of depths.
    ///
    /// # Errors
    /// [`LogError`] that names the file and its defect.
    pub fn open(folder: &Path) -> Result<Self, LogError> {
        Self::open_as(folder, false)
    }

    /// Opens a log of which parts may be missing or damaged, to be read with [`Log::into_partial_frames`]. What is amiss with single
    /// sensors, or with the order of time, is in the [`notes`](Log::notes).
    ///
    /// # Errors
    /// [`LogError`] if data.pkl or scene.json cannot be used, or there is no frame at all.
    pub fn open_tolerant(folder: &Path) -> Result<Self, LogError> {
        Self::open_as(folder, true)
    }

    fn open_as(folder: &Path, tolerant: bool) -> Result<Self, LogError> {
        let path = folder.join("data.pkl");
        let bytes = read_at_most(&path, MAX_PICKLE)?;
        let value = pickle::from_bytes(&bytes).map_err(|reason| LogError::Pickle { path: path.clone(), reason })?;
        let record = Record::from_value(&value).map_err(|defect| LogError::defect(&path, defect))?;
        let scene = read_scene(&folder.join(SCENE_FILE))?;
        let defect = |defect: String| LogError::defect(&path, defect);

        let base = Isometry::<HandBase, World>::from_matrix(&record.base_pose);
        let base = base.map_err(|e| defect(format!("allegro.base_pose is {e}")))?;
        let world = world_from_base() * base.inverse();
        let object_from_file = match &scene {
            Some(scene) => Isometry::<MeshFile, Object>::from_matrix(&scene.object.object_from_file)
                .map_err(|e| LogError::defect(folder.join(SCENE_FILE), format!("object_from_file is {e}")))?,
            None => Isometry::identity(),
        };
        let object_pose = |(i, matrix): (usize, &Matrix)| {
            if matrix.iter().flatten().all(|&x| x == 0.0) {
                return Ok(None);
            }
            let pose = Isometry::<MeshFile, World>::from_matrix(matrix);
            let pose = pose.map_err(|e| defect(format!("object.pose of frame {i} is {e}")))?;
            Ok(Some(world * pose * object_from_file.inverse()))
        };
        let object_poses = record.object_poses.iter().enumerate().map(object_pose).collect::<Result<_, LogError>>()?;
        let mut cameras = Vec::new();
        for camera in &record.cameras {
            let pose = Isometry::<Camera, World>::from_matrix(&camera.pose);
            let pose = pose.map_err(|e| defect(format!("realsense.{}.pose is {e}", camera.name)))?;
            cameras.push(PosedCamera { name: camera.name.clone(), intrinsics: camera.intrinsics, pose: world * pose });
        }
        if scene.as_ref().is_some_and(|s| !s.cameras.iter().eq(cameras.iter().map(|camera| &camera.name))) {
            return Err(defect("the cameras are not those of scene.json".into()));
        }
        let lenses = record.cameras.iter().map(|c| c.distortion.and_then(|k| lens(&c.intrinsics, k))).collect();
        let mut log = Self {
            folder: folder.to_path_buf(),
            scene,
            object_name: record.object_name,
            times_s: record.times_s,
            joints: record.joints,
            object_poses,
            finger_poses: record.finger_poses,
            world,
            digit: record.digit,
            cameras,
            lenses,
            touch_labels: false,
            segmentation: false,
            tolerant,
            notes: Vec::new(),
        };
        log.count()?;
        Ok(log)
    }

    /// Settles the number of frames, and which labels there are.
    fn count(&mut self) -> Result<(), LogError> {
        let pkl = self.folder.join("data.pkl");
        let mut counts = vec![
            (pkl.clone(), "times", self.times_s.len()),
            (pkl.clone(), "joint states", self.joints.len()),
            (pkl.clone(), "object poses", self.object_poses.len()),
        ];
        if let Some(poses) = &self.finger_poses {
            counts.push((pkl.clone(), "finger poses", poses.len()));
        }
        for finger in Finger::ALL {
            let folder = self.touch_folder(finger).join("image");
            counts.push((folder.clone(), "images", count_files(&folder)?.unwrap_or(0)));
        }
        for (i, camera) in self.cameras.iter().enumerate() {
            let folder = self.camera_folder(&camera.name);
            counts.push((folder.join("image"), "images", count_files(&folder.join("image"))?.unwrap_or(0)));
            match self.depths(i) {
                Ok((path, reader)) => counts.push((path, "depth images", reader.shape()[0])),
                // Said when it is to be read.
                Err(_) if self.tolerant => {}
                Err(error) => return Err(error),
            }
        }
        let fewest = counts.iter().map(|&(.., n)| n).min().unwrap_or(0);
        let frames = match (&self.scene, self.tolerant) {
            (_, true) => self.times_s.len().min(self.joints.len()),
            (Some(_), false) => self.times_s.len(),
            (None, false) => fewest,
        };
        for (path, what, n) in counts {
            if n != frames {
                let defect = format!("{n} {what} for {frames} frames");
                self.tolerate(path, defect)?;
            }
        }
        if frames == 0 {
            return Err(LogError::defect(&self.folder, "the log has no frames"));
        }
        self.times_s.truncate(frames);
        self.joints.truncate(frames);
        self.object_poses.truncate(frames);
        let ours = self.scene.is_some();
        if self.times_s.windows(2).any(|t| t[1] < t[0] || (ours && t[1] == t[0])) {
            let defect = LogError::defect(pkl, "time does not increase");
            if !self.tolerant {
                return Err(defect);
            }
            self.notes.push(defect.to_string());
        }
        let touch = ["depth", "mask"].iter().flat_map(|kind| Finger::ALL.map(|f| self.touch_folder(f).join(kind)));
        self.touch_labels = self.has_all(touch.collect())?;
        let segmentation = self.cameras.iter().map(|camera| self.camera_folder(&camera.name).join("seg"));
        self.segmentation = self.has_all(segmentation.collect())?;
        Ok(())
    }

    /// Whether every frame has its label in each folder.
    fn has_all(&mut self, folders: Vec<PathBuf>) -> Result<bool, LogError> {
        let mut complete = true;
        let mut missing = 0;
        let number = folders.len();
        for folder in folders {
            let found = count_files(&folder)?.unwrap_or(0);
            if found != self.len() {
                complete = false;
                missing += usize::from(found == 0);
                if found > 0 || self.scene.is_some() {
                    let defect = format!("{found} labels for {} frames", self.len());
                    self.tolerate(folder, defect)?;
                }
            }
        }
        if !complete && missing < number {
            self.notes.push("incomplete labels are passed over".into());
        }
        Ok(complete)
    }

    /// What cannot be in a log of this program, and is put up with in others.
    fn tolerate(&mut self, path: PathBuf, defect: String) -> Result<(), LogError> {
        if self.scene.is_some() && !self.tolerant {
            return Err(LogError::Defect { path, defect });
        }
        self.notes.push(format!("{}: {defect}", path.display()));
        Ok(())
    }

    /// The depths of a camera, from the first on, with their file.
    pub(super) fn depths(&self, camera: usize) -> Result<(PathBuf, npz::NpzReader), LogError> {
        let PosedCamera { name, intrinsics: Intrinsics { width: w, height: h, .. }, .. } = &self.cameras[camera];
        let path = self.camera_folder(name).join("depth.npz");
        let reader = npz::NpzReader::open(&path).map_err(|reason| npz_error(&path, reason))?;
        let [_, height, width] = reader.shape();
        if (width, height) != (*w, *h) {
            return Err(LogError::defect(path, format!("depth is {width} x {height} and the camera {w} x {h}")));
        }
        Ok((path, reader))
    }

    /// The next depth of a camera, positive; NaN and infinite where the file has that.
    pub(super) fn next_depth(
        &self,
        camera: usize,
        (path, reader): &mut (PathBuf, npz::NpzReader),
    ) -> Result<Array2<f32>, LogError> {
        let values = reader.read().map_err(|reason| npz_error(path, reason))?;
        let mut depth = values.ok_or_else(|| LogError::defect(&*path, "depth ends early"))?;
        // The sign differs between simulated and recorded logs, and means nothing.
        depth.iter_mut().for_each(|z| *z = z.abs());
        if let Some(lens) = &self.lenses[camera] {
            depth = bend(lens, &depth);
        }
        let [_, height, width] = reader.shape();
        Array2::from_shape_vec((height, width), depth).map_err(|e| LogError::defect(&*path, e.to_string()))
    }

    fn touch_folder(&self, finger: Finger) -> PathBuf {
        self.folder.join("allegro").join(finger.name())
    }

    fn camera_folder(&self, camera: &str) -> PathBuf {
        self.folder.join("realsense").join(camera)
    }

    /// Where the log is.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// scene.json, which only logs of this program have.
    pub fn scene(&self) -> Option<&SceneFile> {
        self.scene.as_ref()
    }

    /// Name of the object.
    pub fn object_name(&self) -> &str {
        &self.object_name
    }

    /// Which hand.
    pub fn side(&self) -> Side {
        self.scene.as_ref().map_or(Side::Left, |scene| scene.hand)
    }

    /// Number of frames.
    #[allow(clippy::len_without_is_empty, reason = "a log without frames is not opened")]
    pub fn len(&self) -> usize {
        self.times_s.len()
    }

    /// Time of each frame, seconds.
    pub fn times_s(&self) -> &[f64] {
        &self.times_s
    }

    /// Joint angles of each frame.
    pub fn joints(&self) -> &[JointAngles] {
        &self.joints
    }

    /// Pose of the object in each frame, also in logs without other labels. Those of recorded data are estimates; `None` where
    /// there is not even one.
    pub fn object_poses(&self) -> &[Option<Isometry<Object, World>>] {
        &self.object_poses
    }

    /// The cameras, in the order of the observations.
    pub fn cameras(&self) -> &[PosedCamera] {
        &self.cameras
    }

    /// How touch depth was encoded.
    pub fn digit(&self) -> &DigitInfo {
        &self.digit
    }

    /// What was put up with, in sentences.
    pub fn notes(&self) -> &[String] {
        &self.notes
    }

    /// DIGIT cameras in the world as data.pkl has them.
    pub(super) fn finger_poses(&self) -> Option<&[[Matrix; 4]]> {
        self.finger_poses.as_deref()
    }

    /// Whether the log's world is this program's.
    pub(super) fn world(&self) -> Isometry<World, World> {
        self.world
    }

    /// All frames, in order; depths are decompressed as they come.
    ///
    /// # Errors
    /// [`LogError`] if a depth.npz cannot be opened; the iterator gives one, and then ends, at the first defect.
    pub fn frames(&self) -> Result<LogFrames<'_>, LogError> {
        self.frames_from(0)
    }

    /// The frames from number `first` on.
    ///
    /// # Errors
    /// As [`Log::frames`]. Passing over frames costs their decompression.
    pub fn frames_from(&self, first: usize) -> Result<LogFrames<'_>, LogError> {
        let mut depths = Vec::new();
        for camera in 0..self.cameras.len() {
            let (path, mut reader) = self.depths(camera)?;
            for _ in 0..first.min(self.len()) {
                reader.skip().map_err(|reason| npz_error(&path, reason))?;
            }
            depths.push((path, reader));
        }
        Ok(LogFrames { log: self, next: first, depths })
    }

    /// LogFrame number `i`; `None` beyond the last.
    ///
    /// # Errors
    /// As [`Log::frames_from`].
    pub fn frame(&self, i: usize) -> Result<Option<LogFrame>, LogError> {
        self.frames_from(i)?.next().transpose()
    }

    /// The images of a frame, checked.
    pub(super) fn images(&self, i: usize) -> Result<Images, LogError> {
        let name = format!("{i}.jpg");
        let mut touch = Vec::new();
        let mut touch_truth = Vec::new();
        for finger in Finger::ALL {
            touch.push(self.touch_image(finger, i)?);
            if self.touch_labels {
                touch_truth.push(self.touch_truth(finger, i)?);
            }
        }
        let mut color = Vec::new();
        let mut segmentation = Vec::new();
        for (camera, lens) in self.cameras.iter().zip(&self.lenses) {
            let folder = self.camera_folder(&camera.name);
            let size = (camera.intrinsics.width, camera.intrinsics.height);
            color.push(straighten(lens.as_deref(), read_color(&folder.join("image").join(&name), size)?));
            if self.segmentation {
                let path = folder.join("seg").join(&name);
                let mut levels = read_gray(&path, size)?;
                if self.scene.is_some() && levels.iter().any(|&l| ![BACKGROUND, HAND, OBJECT].contains(&l)) {
                    return Err(LogError::defect(path, "a segmentation holds other levels than 0, 127 and 255"));
                }
                levels.iter_mut().for_each(|level| *level = segment(*level));
                segmentation.push(straighten(lens.as_deref(), levels));
            }
        }
        let four = |images: Vec<RgbImage>| <[RgbImage; 4]>::try_from(images).map(PerFinger);
        Ok(Images {
            touch: four(touch).map_err(|_| LogError::defect(&self.folder, "a finger is missing"))?,
            color,
            touch_truth: <[TouchTruth; 4]>::try_from(touch_truth).ok().map(PerFinger),
            segmentation: self.segmentation.then_some(segmentation),
        })
    }

    /// What a camera, by index, sees in a frame.
    ///
    /// # Errors
    /// [`LogError`] if there is no such image or it cannot be read.
    pub fn colour(&self, camera: usize, frame: usize) -> Result<RgbImage, LogError> {
        let Some((posed, lens)) = self.cameras.get(camera).zip(self.lenses.get(camera)) else {
            return Err(LogError::defect(&self.folder, format!("there is no camera {camera}")));
        };
        let path = self.camera_folder(&posed.name).join("image").join(format!("{frame}.jpg"));
        let size = (posed.intrinsics.width, posed.intrinsics.height);
        Ok(straighten(lens.as_deref(), read_color(&path, size)?))
    }

    /// What a DIGIT shows in a frame.
    ///
    /// # Errors
    /// [`LogError`] if there is no such image or it cannot be read.
    pub fn touch_image(&self, finger: Finger, frame: usize) -> Result<RgbImage, LogError> {
        let path = self.touch_folder(finger).join("image").join(format!("{frame}.jpg"));
        read_color(&path, (digit::WIDTH, digit::HEIGHT))
    }

    /// True depth and contact of a DIGIT in a frame.
    ///
    /// # Errors
    /// [`LogError`] if the log does not have them or they cannot be read.
    pub fn touch_truth(&self, finger: Finger, frame: usize) -> Result<TouchTruth, LogError> {
        let size = (digit::WIDTH, digit::HEIGHT);
        let name = format!("{frame}.jpg");
        let folder = self.touch_folder(finger);
        let levels = read_gray(&folder.join("depth").join(&name), size)?;
        let path = folder.join("mask").join(&name);
        let mask = read_gray(&path, size)?;
        if self.scene.is_some() && mask.iter().any(|&m| m != 0 && m != 255) {
            return Err(LogError::defect(path, "a mask holds other levels than 0 and 255"));
        }
        let depth = |row, column| self.digit.depth_m(levels.get_pixel(column as u32, row as u32).0[0]);
        Ok(TouchTruth {
            depth_m: Array2::from_shape_fn((digit::HEIGHT, digit::WIDTH), |(row, column)| depth(row, column)),
            // As loaders do: a JPEG mask has every level.
            contact: GrayImage::from_fn(mask.width(), mask.height(), |x, y| {
                Luma([if mask.get_pixel(x, y).0[0] > 127 { 255 } else { 0 }])
            }),
        })
    }

    /// Whether a DIGIT has images.
    pub fn has_touch_images(&self, finger: Finger) -> bool {
        self.touch_folder(finger).join("image").is_dir()
    }

    /// Whether a DIGIT has true depths.
    pub fn has_touch_truth(&self, finger: Finger) -> bool {
        self.touch_folder(finger).join("depth").is_dir()
    }
}

/// Iterator over the frames of a log.
pub struct LogFrames<'a> {
    log: &'a Log,
    next: usize,
    depths: Vec<(PathBuf, npz::NpzReader)>,
}

impl LogFrames<'_> {
    fn read(&mut self) -> Result<LogFrame, LogError> {
        let log = self.log;
        let i = self.next;
        let images = log.images(i)?;
        let mut cameras = Vec::new();
        for ((camera, color), depths) in images.color.into_iter().enumerate().zip(&mut self.depths) {
            let mut depth_m = log.next_depth(camera, depths)?;
            depth_m.mapv_inplace(|z| if z.is_finite() { z } else { 0.0 });
            cameras.push(Rgbd { color, depth_m });
        }
        let truth = match (images.touch_truth, images.segmentation, log.object_poses[i]) {
            (Some(touch), Some(segmentation), Some(object_pose)) => {
                Some(GroundTruth { object_pose, touch, segmentation })
            }
            _ => None,
        };
        let observation = Observation { time_s: log.times_s[i], joints: log.joints[i], touch: images.touch, cameras };
        Ok(LogFrame { observation, truth })
    }
}

impl Iterator for LogFrames<'_> {
    type Item = Result<LogFrame, LogError>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.next >= self.log.len() {
            return None;
        }
        let frame = self.read();
        self.next = if frame.is_ok() { self.next + 1 } else { self.log.len() };
        Some(frame)
    }
}

pub(super) fn npz_error(path: &Path, reason: npz::NpzError) -> LogError {
    LogError::Npz { path: path.to_path_buf(), reason }
}

/// The bytes of a file that is not larger than `limit`.
pub(super) fn read_at_most(path: &Path, limit: u64) -> Result<Vec<u8>, LogError> {
    let mut bytes = Vec::new();
    let file = fs::File::open(path).map_err(LogError::io(path))?;
    file.take(limit + 1).read_to_end(&mut bytes).map_err(LogError::io(path))?;
    if bytes.len() as u64 > limit {
        return Err(LogError::defect(path, format!("the file is larger than {} MiB", limit >> 20)));
    }
    Ok(bytes)
}

fn read_scene(path: &Path) -> Result<Option<SceneFile>, LogError> {
    if !path.exists() {
        return Ok(None);
    }
    let bytes = read_at_most(path, MAX_SCENE)?;
    let scene: SceneFile =
        serde_json::from_slice(&bytes).map_err(|reason| LogError::Json { path: path.to_path_buf(), reason })?;
    if scene.format_version > FORMAT_VERSION {
        let defect =
            format!("format {} is newer than this program, which reads {FORMAT_VERSION}", scene.format_version);
        return Err(LogError::defect(path, defect));
    }
    Ok(Some(scene))
}

/// Number of files in a folder, which is how loaders count frames; `None` if there is no folder.
fn count_files(folder: &Path) -> Result<Option<usize>, LogError> {
    match fs::read_dir(folder) {
        Ok(entries) => Ok(Some(entries.count())),
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(None),
        Err(reason) => Err(LogError::Io { path: folder.to_path_buf(), reason }),
    }
}

/// The level nearest to a grey that JPEG may have changed: `round(grey / 127.5)` of 0, 1, 2.
fn segment(grey: u8) -> u8 {
    match grey {
        0..64 => BACKGROUND,
        64..192 => HAND,
        192.. => OBJECT,
    }
}

/// For each pixel of an image without distortion the pixel of the camera's image to take: OpenCV's model with coefficients k1, k2,
/// p1, p2, k3, nearest pixel, same intrinsics, as loaders do. `None` where there is no distortion.
fn lens(intrinsics: &Intrinsics, [k1, k2, p1, p2, k3]: [f64; 5]) -> Option<Vec<Option<u32>>> {
    if [k1, k2, p1, p2, k3] == [0.0; 5] {
        return None;
    }
    let &Intrinsics { width, height, fx, fy, cx, cy } = intrinsics;
    let pixels = (0..height).flat_map(|row| (0..width).map(move |column| (row, column)));
    let source = |(row, column): (usize, usize)| {
        let (x, y) = ((column as f64 - cx) / fx, (row as f64 - cy) / fy);
        let r2 = x * x + y * y;
        let radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
        let u = (x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)) * fx + cx;
        let v = (y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y) * fy + cy;
        let (u, v) = (u.round(), v.round());
        let inside = (0.0..width as f64).contains(&u) && (0.0..height as f64).contains(&v);
        inside.then(|| (v as usize * width + u as usize) as u32)
    };
    Some(pixels.map(source).collect())
}

/// Values moved through a lens; zero where it shows nothing.
fn bend<T: Copy + Default>(lens: &[Option<u32>], values: &[T]) -> Vec<T> {
    lens.iter().map(|&from| from.and_then(|i| values.get(i as usize).copied()).unwrap_or_default()).collect()
}

fn straighten<P>(lens: Option<&[Option<u32>]>, image: ImageBuffer<P, Vec<u8>>) -> ImageBuffer<P, Vec<u8>>
where
    P: Pixel<Subpixel = u8>,
{
    let Some(lens) = lens else { return image };
    let pixel = |i: usize| lens.get(i).copied().flatten();
    let width = image.width();
    let black = P::from_slice(&[0; 4][..usize::from(P::CHANNEL_COUNT)]);
    ImageBuffer::from_fn(width, image.height(), |x, y| {
        pixel((y * width + x) as usize).map_or(*black, |from| *image.get_pixel(from % width, from / width))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn segmentation_survives_jpeg_as_in_the_loaders() {
        for grey in 0..=255u8 {
            let rounded = (f64::from(grey) / 127.5).round() as usize;
            assert_eq!(segment(grey), [BACKGROUND, HAND, OBJECT][rounded], "{grey}");
        }
    }

    #[test]
    fn a_lens_takes_pixels_from_further_out_where_it_is_a_barrel() {
        let intrinsics = Intrinsics { width: 64, height: 48, fx: 60.0, fy: 60.0, cx: 31.5, cy: 23.5 };
        let lens = lens(&intrinsics, [-0.2, 0.0, 0.0, 0.0, 0.0]).unwrap();
        // x = y = 0.4: radius^2 0.32, factor 1 - 0.2 * 0.32 = 0.936, 24 -> 22.464 pixels from the centre.
        let (row, column) = (47, 55);
        let (x, y) = ((55.0 - 31.5) / 60.0, (47.0 - 23.5) / 60.0);
        let factor = 1.0 - 0.2 * (x * x + y * y);
        let from = f64::round(23.5 + 60.0 * y * factor) * 64.0 + f64::round(31.5 + 60.0 * x * factor);
        assert_eq!(lens[row * 64 + column], Some(from as u32));
        assert_eq!(lens[24 * 64 + 32], Some(24 * 64 + 32));
    }
}
