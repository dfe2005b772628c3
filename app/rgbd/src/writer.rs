//! Writer of a sequence, as a live run records it, or as a copy of another.

use std::fs;
use std::path::{Path, PathBuf};

use image::{ExtendedColorType, RgbImage};
use mvt_feelsight::array::Array;
use mvt_feelsight::npy;
use mvt_frames::camera::Intrinsics;
use mvt_frames::{Camera, Frame, Isometry, MeshFile, World};
use ndarray::Array2;

use crate::description;
use crate::error::RgbdError;
use crate::text;

/// Writer of a folder `rgb/ depth/ masks/ cam_K.txt`, without loss: [`RgbdRecording`](crate::RgbdRecording) reads the frames to the bit.
///
/// The folder is complete after each frame, so that one of a run that was killed can be read.
///
/// ```
/// use mvt_frames::camera::Intrinsics;
/// use mvt_rgbd::{RgbdRecording, RgbdWriter, WrittenFrame};
/// use ndarray::Array2;
///
/// let folder = std::env::temp_dir().join("mvt-rgbd-writer-example");
/// # let _ = std::fs::remove_dir_all(&folder);
/// let lens = Intrinsics { width: 4, height: 3, fx: 5.0, fy: 5.0, cx: 1.5, cy: 1.0 };
/// let writer = RgbdWriter::create(&folder, &lens, 0.001)?;
/// let (depth_m, mask) = (Array2::from_elem((3, 4), 0.5), Array2::from_elem((3, 4), true));
/// writer.push(&WrittenFrame {
///     stamp_ns: 1_581_120_424_100_262_102,
///     color: &Default::default(),
///     depth_m: &depth_m,
///     mask: Some(&mask),
///     world_from_camera: None,
///     camera_from_object: None,
/// })?;
/// assert_eq!(RgbdRecording::open(&folder)?.frame(0)?.depth_m, depth_m);
/// # std::fs::remove_dir_all(&folder).map_err(|reason| mvt_rgbd::RgbdError::Io { path: folder, reason })?;
/// # Ok::<(), mvt_rgbd::RgbdError>(())
/// ```
#[derive(Debug)]
pub struct RgbdWriter {
    folder: PathBuf,
    depth_unit_m: f64,
    is_live: bool,
}

/// A frame that [`RgbdWriter`] adds.
#[derive(Debug, Clone, Copy)]
pub struct WrittenFrame<'a> {
    /// Stamp, nanoseconds, later than those before: the name of the frame.
    pub stamp_ns: u64,
    /// Colours of the size of depth, or none.
    pub color: &'a RgbImage,
    /// Metres, 0 where nothing was measured.
    pub depth_m: &'a Array2<f32>,
    /// Where the object is seen, of the size of depth.
    pub mask: Option<&'a Array2<bool>>,
    /// Pose of the camera: either all frames have one, or none has.
    pub world_from_camera: Option<Isometry<Camera, World>>,
    /// True pose of the object in the coordinates of its mesh, if it is known.
    pub camera_from_object: Option<Isometry<MeshFile, Camera>>,
}

impl RgbdWriter {
    /// Begins a sequence of a live run in a folder that does not exist or is empty: later runs use all its frames as that run did. Depth that is a whole multiple of `depth_unit_m`, metres, takes least
    /// space.
    ///
    /// # Errors
    /// [`RgbdError`] if the folder holds anything or cannot be written.
    pub fn create(folder: &Path, intrinsics: &Intrinsics, depth_unit_m: f64) -> Result<Self, RgbdError> {
        Self::begin(folder, intrinsics, depth_unit_m, true)
    }

    /// Begins a copy of a sequence of another layout, as [`RgbdWriter::create`].
    ///
    /// # Errors
    /// As [`RgbdWriter::create`].
    pub fn create_copy(folder: &Path, intrinsics: &Intrinsics, depth_unit_m: f64) -> Result<Self, RgbdError> {
        Self::begin(folder, intrinsics, depth_unit_m, false)
    }

    fn begin(folder: &Path, intrinsics: &Intrinsics, depth_unit_m: f64, is_live: bool) -> Result<Self, RgbdError> {
        let is_vacant = fs::read_dir(folder).map_or(true, |mut entries| entries.next().is_none());
        if !is_vacant {
            return Err(RgbdError::fault(folder, "the folder is not empty: name a new one"));
        }
        for part in ["rgb", "depth", "masks", "poses"] {
            let part = folder.join(part);
            fs::create_dir_all(&part).map_err(RgbdError::io(&part))?;
        }
        let Intrinsics { fx, fy, cx, cy, .. } = intrinsics;
        let writer = Self { folder: folder.to_owned(), depth_unit_m, is_live };
        writer.file("cam_K.txt", format!("{fx} 0 {cx}\n0 {fy} {cy}\n0 0 1\n").as_bytes())?;
        Ok(writer)
    }

    fn file(&self, name: &str, bytes: &[u8]) -> Result<(), RgbdError> {
        let path = self.folder.join(name);
        fs::write(&path, bytes).map_err(RgbdError::io(&path))
    }

    /// Adds a frame.
    ///
    /// # Errors
    /// [`RgbdError`] if a file cannot be written.
    pub fn push(&self, frame: &WrittenFrame<'_>) -> Result<(), RgbdError> {
        let WrittenFrame { stamp_ns, color, depth_m, mask, world_from_camera, camera_from_object } = *frame;
        let name = format!("{stamp_ns:019}");
        if !color.is_empty() {
            let size = color.dimensions().into();
            self.png(&format!("rgb/{name}.png"), color.as_raw(), size, ExtendedColorType::Rgb8)?;
        }
        let size = [depth_m.ncols() as u32, depth_m.nrows() as u32];
        match self.levels(depth_m) {
            Some(levels) => self.png(&format!("depth/{name}.png"), &levels, size, ExtendedColorType::L16)?,
            None => {
                let array = Array::from_f32(depth_m.shape().to_vec(), depth_m.iter().copied());
                self.file(&format!("depth/{name}.npy"), &npy::to_bytes(&array))?;
            }
        }
        if let Some(mask) = mask {
            let levels: Vec<u8> = mask.iter().map(|inside| if *inside { u8::MAX } else { 0 }).collect();
            self.png(&format!("masks/{name}.png"), &levels, size, ExtendedColorType::L8)?;
        }
        if let Some(pose) = world_from_camera {
            self.file(&format!("poses/{name}.txt"), &rows(text::from_opencv::<World>(pose.untyped())))?;
        }
        if let Some(pose) = camera_from_object {
            let path = self.folder.join(TRUTH);
            fs::create_dir_all(&path).map_err(RgbdError::io(&path))?;
            self.file(&format!("{TRUTH}/{name}.txt"), &rows(text::to_opencv::<MeshFile>(pose.untyped())))?;
        }
        if !self.folder.join(description::FILE).exists() {
            // Stamps of simulators begin at 0, so that their length does not say that they are nanoseconds.
            let poses = if world_from_camera.is_some() { "camera_poses = \"poses/*.txt\"\n" } else { "" };
            let unit = self.depth_unit_m;
            let live = if self.is_live { "live = true\n" } else { "" };
            let text = format!("{live}frame_hz = 1e9\ndepth_unit_m = {unit:?}\n{poses}");
            self.file(description::FILE, text.as_bytes())?;
        }
        Ok(())
    }

    /// Names the object, for scores.
    ///
    /// # Errors
    /// [`RgbdError`] if the file cannot be written.
    pub fn name_object(&self, name: &str) -> Result<(), RgbdError> {
        self.file("object.txt", format!("{name}\n").as_bytes())
    }

    /// The usual unit, metres, in whole multiples of which all depths of an image are; that of a millimetre if there is none.
    pub fn unit_of(depth_m: &Array2<f32>) -> f64 {
        let is_whole = |unit_m: &f64| depth_m.iter().all(|&depth_m| level_of(depth_m, *unit_m).is_some());
        USUAL_UNITS_M.into_iter().find(is_whole).unwrap_or(USUAL_UNITS_M[0])
    }

    /// Returns depth in levels of two bytes as PNG has them; `None` if these would not give it back to the bit.
    fn levels(&self, depth_m: &Array2<f32>) -> Option<Vec<u8>> {
        let mut bytes = Vec::with_capacity(2 * depth_m.len());
        for &depth_m in depth_m {
            bytes.extend(level_of(depth_m, self.depth_unit_m)?.to_ne_bytes());
        }
        Some(bytes)
    }

    fn png(&self, name: &str, pixels: &[u8], size: [u32; 2], of: ExtendedColorType) -> Result<(), RgbdError> {
        let file = mvt_images::fast_png(pixels, size, of);
        self.file(name, &file.map_err(|reason| RgbdError::fault(&self.folder.join(name), reason.to_string()))?)
    }
}

/// Units of depth images: of most cameras, of TUM's, of RealSense's close range.
const USUAL_UNITS_M: [f64; 3] = [1e-3, 2e-4, 1e-4];

/// The level that gives back a depth to the bit; `None` without one.
fn level_of(depth_m: f32, unit_m: f64) -> Option<u16> {
    let level = (f64::from(depth_m) / unit_m).round();
    ((0.0..=f64::from(u16::MAX)).contains(&level) && (level * unit_m) as f32 == depth_m).then_some(level as u16)
}

/// Folder of the true poses of the object.
const TRUTH: &str = "annotated_poses";

/// The 4 x 4 numbers of a motion, row by row.
fn rows<From: Frame, To: Frame>(motion: Isometry<From, To>) -> Vec<u8> {
    motion.to_matrix().map(|row| row.map(|x| x.to_string()).join(" ")).join("\n").into_bytes()
}

#[cfg(test)]
mod tests {
    use image::Rgb;

    use super::*;
    use crate::RgbdRecording;

    #[test]
    fn frames_are_read_to_the_bit_also_without_colours() {
        let folder = tempfile::tempdir().unwrap();
        let lens = Intrinsics { width: 7, height: 5, fx: 610.1, fy: 611.3, cx: 3.137_2, cy: 2.001 };
        // Stamps of a simulator, which begin near 0.
        let stamps_ns = [5_000_000, 38_333_333, 71_666_667];
        let color = RgbImage::from_fn(7, 5, |u, v| Rgb([(40 * u) as u8, (50 * v) as u8, (u * v) as u8]));
        let levels = Array2::from_shape_fn((5, 7), |(v, u)| (f64::from((60_000 * v + u) as u16) * 0.001) as f32);
        let depths_m = [levels.clone(), levels.mapv(|z| z * 1.000_1), levels];
        let mask = Array2::from_shape_fn((5, 7), |(v, u)| v > 2 && u % 2 == 0);
        let masks = [Array2::from_elem((5, 7), false), mask.clone(), mask];
        let pose = Isometry::from_parts([0.1, -0.2, 0.3], [0.5, 0.5, -0.5, 0.5]);
        let writer = RgbdWriter::create(folder.path(), &lens, 0.001).unwrap();
        for (k, (&stamp_ns, (depth_m, mask))) in stamps_ns.iter().zip(depths_m.iter().zip(&masks)).enumerate() {
            let color = if k == 1 { RgbImage::default() } else { color.clone() };
            let (mask, world_from_camera) = (Some(mask), Some(pose));
            let frame =
                WrittenFrame { stamp_ns, color: &color, depth_m, mask, world_from_camera, camera_from_object: None };
            writer.push(&frame).unwrap();
            // Whatever ends the program, the frames so far can be read.
            assert_eq!(RgbdRecording::open(folder.path()).unwrap().len(), k + 1);
        }
        let recording = RgbdRecording::open(folder.path()).unwrap();
        assert_eq!((recording.notes(), recording.carries_masks()), (&[][..], false));
        assert!(folder.path().join("depth/0000000000038333333.npy").exists(), "levels would round it");
        for (k, (depth_m, mask)) in depths_m.iter().zip(masks).enumerate() {
            let frame = recording.frame(k).unwrap();
            assert_eq!((&frame.depth_m, frame.mask, frame.intrinsics), (depth_m, Some(mask), lens));
            assert_eq!(frame.time_s, (stamps_ns[k] - stamps_ns[0]) as f64 * 1e-9);
            assert_eq!(frame.color, if k == 1 { RgbImage::default() } else { color.clone() });
            let apart = frame.world_from_camera.to_matrix().concat().into_iter().zip(pose.to_matrix().concat());
            assert!(apart.into_iter().all(|(a, b)| (a - b).abs() < 1e-12));
        }
        let refused = RgbdWriter::create(folder.path(), &lens, 0.001).unwrap_err().to_string();
        assert!(refused.contains("not empty"), "{refused}");
    }
}
