//! Opening of a log: data.pkl, scene.json, the number of frames, and the defects that are tolerated.

use std::ffi::OsString;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use mvt_frames::camera::PosedCamera;
use mvt_frames::{Camera, HandBase, Isometry, MeshFile, Object, World};
use mvt_robot::hand::{Hand, JointMotion, Side};

use super::Log;
use crate::compact::CompactFrames;
use crate::error::LogError;
use crate::hand::world_from_base;
use crate::io::read_at_most;
use crate::lens::Lens;
use crate::live::LiveFile;
use crate::record::{Matrix, Record};
use crate::scene::{FORMAT_VERSION, SCENE_FILE, SceneFile};

/// Greatest size of scene.json, bytes: some times that of a hand whose every body has a hull.
const MAX_SCENE: u64 = 16 << 20;
/// Greatest distance of a camera or the object from the hand, metres: more than any room has.
const FARTHEST_M: f64 = 100.0;
/// Greatest absolute joint angle of a joint with narrow limits, radians or metres. No joint of an Allegro reaches half of it.
const LARGEST_ANGLE: f64 = std::f64::consts::TAU;
/// Longest time between two frames, seconds: a log in milliseconds or nanoseconds has more.
const LONGEST_GAP_S: f64 = 3600.0;

impl Log {
    /// Opens a log and checks everything but the images: data.pkl, scene.json, the number of files, the shape of
    /// depths.
    ///
    /// # Errors
    /// [`LogError`] that names the file and its defect.
    pub fn open(folder: &Path) -> Result<Self, LogError> {
        Self::open_as(folder, false)
    }

    /// Opens a log with missing or damaged parts, for [`Log::into_partial_frames`]. Defects of single sensors and of
    /// the order of time become [`notes`](Log::notes).
    ///
    /// # Errors
    /// [`LogError`] if data.pkl or scene.json is invalid, or the log has no frame.
    pub fn open_tolerant(folder: &Path) -> Result<Self, LogError> {
        Self::open_as(folder, true)
    }

    /// Returns the bytes of scene.json; `None` if the log has none.
    ///
    /// # Errors
    /// [`LogError`] if it cannot be read.
    pub fn scene_file(&self) -> Result<Option<Vec<u8>>, LogError> {
        self.scene.as_ref().map(|_| read_at_most(&self.folder.join(SCENE_FILE), MAX_SCENE)).transpose()
    }

    fn open_as(folder: &Path, tolerant: bool) -> Result<Self, LogError> {
        let path = folder.join("data.pkl");
        let record = Record::read(&path)?;
        let scene = read_scene(&folder.join(SCENE_FILE))?;
        let defect = |defect: String| LogError::defect(&path, defect);

        let hand = match &scene {
            Some(scene) => Arc::clone(&scene.hand),
            None => record.hand.unwrap_or_else(|| Hand::allegro(Side::Left)),
        };
        let counts = |what: &str, found: usize, expected: usize| match found == expected {
            true => Ok(()),
            false => Err(defect(format!("{what}: {found} per frame, and hand {} has {expected}", hand.name()))),
        };
        for joints in &record.joints {
            counts("allegro.joint_state", joints.len(), hand.joints().len())?;
        }
        for poses in record.finger_poses.iter().flatten() {
            counts("allegro.finger_poses", poses.len(), hand.pads().len())?;
        }
        let base = Isometry::<HandBase, World>::from_matrix(&record.base_pose);
        let base = base.map_err(|e| defect(format!("allegro.base_pose is {e}")))?;
        let world = world_from_base(&hand) * base.inverse();
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
        let lenses = record.cameras.iter().map(|c| c.distortion.and_then(|k| Lens::new(&c.intrinsics, k))).collect();
        let mut log = Self {
            folder: folder.to_path_buf(),
            scene,
            live: LiveFile::read(folder)?,
            object_name: record.object_name,
            times_s: record.times_s,
            joints: record.joints,
            object_poses,
            finger_poses: record.finger_poses,
            world,
            digit: record.digit,
            cameras,
            lenses,
            compact: CompactFrames::open(folder, &hand)?.map(Arc::new),
            felt: hand.per_pad(|_| false),
            hand,
            coloured: Vec::new(),
            touch_labels: false,
            segmentation: false,
            tolerant,
            notes: Vec::new(),
        };
        log.count()?;
        log.check_range().map_err(|message| LogError::defect(&path, message))?;
        Ok(log)
    }

    /// Checks that lengths, angles and times are those of a hand and its cameras. Their message names the value.
    fn check_range(&self) -> Result<(), String> {
        let far = |what: &dyn std::fmt::Display, metres: f64| match metres <= FARTHEST_M {
            true => Ok(()),
            false => Err(format!("{what} is {metres:.3e} m from the hand; more than {FARTHEST_M} m cannot be")),
        };
        for camera in &self.cameras {
            far(&format_args!("camera {}", camera.name), camera.pose.origin().coords().norm())?;
        }
        for (i, pose) in self.object_poses.iter().enumerate() {
            if let Some(pose) = pose {
                far(&format_args!("the object in frame {i}"), pose.origin().coords().norm())?;
            }
        }
        for (i, joints) in self.joints.iter().enumerate() {
            for (angle, joint) in joints.iter().zip(self.hand.joints()) {
                let [low, high] = joint.range;
                if angle.abs() > LARGEST_ANGLE.max(2.0 * low.abs().max(high.abs())) {
                    let unit = if joint.motion == JointMotion::Hinge { "rad" } else { "m" };
                    let name = &joint.name;
                    return Err(format!(
                        "the joint angle of {name} in frame {i} is {angle:.3e} {unit}; it lies between {low} and {high}"
                    ));
                }
            }
        }
        let gaps = self.times_s.windows(2).map(|t| t[1] - t[0]).enumerate();
        match gaps.into_iter().find(|(_, gap)| gap.is_nan() || *gap > LONGEST_GAP_S) {
            Some((i, gap)) => {
                Err(format!("{gap:.3e} s lie between the frames {i} and {}; times are in seconds", i + 1))
            }
            None => Ok(()),
        }
    }

    /// Determines the number of frames and the labels of the log.
    fn count(&mut self) -> Result<(), LogError> {
        let pkl = self.folder.join("data.pkl");
        let mut counts = vec![
            (pkl.clone(), "times", Numbered::all(self.times_s.len())),
            (pkl.clone(), "joint states", Numbered::all(self.joints.len())),
            (pkl.clone(), "object poses", Numbered::all(self.object_poses.len())),
        ];
        if let Some(poses) = &self.finger_poses {
            counts.push((pkl.clone(), "finger poses", Numbered::all(poses.len())));
        }
        for pad in 0..self.hand.pads().len() {
            let folder = self.touch_folder(pad).join("image");
            let images = match &self.compact {
                Some(frames) => Numbered::all(frames.touch_images(pad)),
                None => Numbered::files(&folder)?,
            };
            self.felt[pad] = images.count > 0;
            counts.push((folder, "images", images));
        }
        for i in 0..self.cameras.len() {
            let folder = self.camera_folder(&self.cameras[i].name).join("image");
            let images = self.count_images(&folder)?;
            self.coloured.push(images.count > 0);
            counts.push((folder, "images", images));
            match self.depths(i) {
                Ok(reader) => {
                    let (path, depths) = (reader.path().to_path_buf(), reader.count());
                    if depths < self.times_s.len() && !self.tolerant {
                        let defect = format!("it has {depths} depth images for {} frames", self.times_s.len());
                        return Err(LogError::defect(path, defect));
                    }
                    counts.push((path, "depth images", Numbered::all(depths)));
                }
                // Reported when the depths are read.
                Err(_) if self.tolerant => {}
                Err(error) => return Err(error),
            }
        }
        // A sensor without any image is absent; one without some images reaches as many frames as the others.
        let fewest = counts.iter().map(|(.., images)| images.end).filter(|end| *end > 0).min().unwrap_or(0);
        let frames = match (&self.scene, self.tolerant) {
            (_, true) => self.times_s.len().min(self.joints.len()),
            (Some(_), false) => self.times_s.len(),
            (None, false) => fewest,
        };
        for (path, what, Numbered { count, .. }) in counts {
            if count != frames {
                let defect = format!("{count} {what} for {frames} frames");
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
        let standing = self.times_s.windows(2).filter(|t| t[1] <= t[0]).count();
        if 2 * standing > frames {
            let defect = format!(
                "the times of {standing} of {frames} frames are not after that of the frame before; 32-bit floats cannot hold seconds since 1970: \
                 write `time` as 64-bit floats"
            );
            return Err(LogError::defect(pkl, defect));
        }
        if standing > 0 {
            self.notes.push(format!(
                "the times of {standing} of {frames} frames are not after that of the frame before; such frames are skipped in a run"
            ));
        }
        if self.times_s.windows(2).any(|t| t[1] < t[0] || (ours && t[1] == t[0])) {
            let defect = LogError::defect(pkl, "time does not increase");
            if !self.tolerant {
                return Err(defect);
            }
            self.notes.push(defect.to_string());
        }
        self.notes.extend(jump(&self.times_s));
        let of_pads = |kind| self.hand.per_pad(|pad| self.touch_folder(pad).join(kind));
        let touch = ["depth", "mask"].into_iter().flat_map(of_pads);
        self.touch_labels = self.has_all(touch.collect())?;
        let segmentation = self.cameras.iter().map(|camera| self.camera_folder(&camera.name).join("seg"));
        self.segmentation = self.has_all(segmentation.collect())?;
        Ok(())
    }

    /// Returns whether every frame has its label in each folder.
    fn has_all(&mut self, folders: Vec<PathBuf>) -> Result<bool, LogError> {
        let mut complete = true;
        let mut missing = 0;
        let number = folders.len();
        for folder in folders {
            let found = self.count_images(&folder)?.count;
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
            self.notes.push("incomplete labels are skipped".into());
        }
        Ok(complete)
    }

    /// Returns the images in a folder of the log, or of its archive.
    fn count_images(&self, folder: &Path) -> Result<Numbered, LogError> {
        let Some(frames) = &self.compact else { return Numbered::files(folder) };
        let inside = folder.strip_prefix(&self.folder).unwrap_or(folder);
        let parts: Vec<_> = inside.iter().map(|part| part.to_string_lossy()).collect();
        Ok(Numbered::all(frames.archive.count(&parts.join("/"))))
    }

    /// Refuses a defect in a log of this program, and notes it in a log of another program.
    fn tolerate(&mut self, path: PathBuf, defect: String) -> Result<(), LogError> {
        if self.scene.is_some() && !self.tolerant {
            return Err(LogError::Defect { path, defect });
        }
        self.notes.push(format!("{}: {defect}", path.display()));
        Ok(())
    }
}

/// Reads scene.json; `None` if the file does not exist.
fn read_scene(path: &Path) -> Result<Option<SceneFile>, LogError> {
    if !path.exists() {
        return Ok(None);
    }
    let bytes = read_at_most(path, MAX_SCENE)?;
    let scene: SceneFile =
        serde_json::from_slice(&bytes).map_err(|reason| LogError::Json { path: path.to_path_buf(), reason })?;
    if scene.format_version > FORMAT_VERSION {
        let defect = format!(
            "its format {} is newer than format {FORMAT_VERSION}, the newest that this version reads: update the program",
            scene.format_version
        );
        return Err(LogError::defect(path, defect));
    }
    Ok(Some(scene))
}

/// Images whose names are the numbers of frames.
struct Numbered {
    count: usize,
    /// The greatest number plus one.
    end: usize,
}

impl Numbered {
    /// Returns as many images without a gap.
    fn all(count: usize) -> Self {
        Self { count, end: count }
    }

    /// Returns the images of a folder; none if it does not exist.
    fn files(folder: &Path) -> Result<Self, LogError> {
        let entries = match fs::read_dir(folder) {
            Ok(entries) => entries,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(Self::all(0)),
            Err(reason) => return Err(LogError::Io { path: folder.to_path_buf(), reason }),
        };
        let (mut count, mut end) = (0, 0);
        let names = entries.map(|entry| entry.map_or_else(|_| OsString::new(), |entry| entry.file_name()));
        for name in names.filter(|name| !mvt_files::input::is_litter(name)) {
            count += 1;
            let number = Path::new(&name).file_stem().and_then(|stem| stem.to_str()?.parse::<usize>().ok());
            end = end.max(number.map_or(0, |number| number.saturating_add(1)));
        }
        // Names that are no numbers are found out when the images are read.
        Ok(Self { count, end: if end == 0 { count } else { end } })
    }
}

/// A time between two frames is a jump of the clock from this multiple of the usual time on. Loss of one or two images is
/// common on real cameras and does no harm.
const JUMP: f64 = 5.0;

/// Returns a note on the longest jump forward of the times of the frames, in seconds.
fn jump(times_s: &[f64]) -> Option<String> {
    let mut gaps: Vec<f64> = times_s.windows(2).map(|t| t[1] - t[0]).collect();
    let (frame, gap) = gaps.iter().copied().enumerate().max_by(|a, b| a.1.total_cmp(&b.1))?;
    gaps.sort_by(f64::total_cmp);
    let usual = *gaps.get(gaps.len() / 2)?;
    (gap > JUMP * usual).then_some(())?;
    Some(format!(
        "the time jumps by {gap:.2} s after frame {frame}, where {usual:.3} s are usual; frames are missing or the clock was set"
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn jumps_of_the_clock_are_noted_and_lost_images_are_not() {
        let mut times_s: Vec<f64> = (0..30).map(|k| f64::from(k) / 30.0).collect();
        assert_eq!(jump(&times_s), None);
        times_s.drain(10..12);
        assert_eq!(jump(&times_s), None);
        times_s.iter_mut().skip(20).for_each(|time_s| *time_s += 1.2);
        assert!(jump(&times_s).unwrap().starts_with("the time jumps by 1.23 s after frame 19, where 0.033 s"));
        assert_eq!(jump(&[]), None);
        assert_eq!(jump(&[0.0]), None);
    }
}
