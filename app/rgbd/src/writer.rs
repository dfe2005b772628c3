//! Writer of a sequence that a live run records.

use std::fs;
use std::path::{Path, PathBuf};

use image::{ExtendedColorType, RgbImage};
use mvt_feelsight::array::Array;
use mvt_feelsight::npy;
use mvt_frames::camera::Intrinsics;
use mvt_frames::{Camera, Isometry, World};
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
/// use mvt_rgbd::{RgbdRecording, RgbdWriter};
/// use ndarray::Array2;
///
/// let folder = std::env::temp_dir().join("mvt-rgbd-writer-example");
/// # let _ = std::fs::remove_dir_all(&folder);
/// let lens = Intrinsics { width: 4, height: 3, fx: 5.0, fy: 5.0, cx: 1.5, cy: 1.0 };
/// let writer = RgbdWriter::create(&folder, &lens, 0.001)?;
/// let (depth_m, mask) = (Array2::from_elem((3, 4), 0.5), Array2::from_elem((3, 4), true));
/// writer.push(1_581_120_424_100_262_102, &Default::default(), &depth_m, Some(&mask), None)?;
/// assert_eq!(RgbdRecording::open(&folder)?.frame(0)?.depth_m, depth_m);
/// # std::fs::remove_dir_all(&folder).map_err(|reason| mvt_rgbd::RgbdError::Io { path: folder, reason })?;
/// # Ok::<(), mvt_rgbd::RgbdError>(())
/// ```
#[derive(Debug)]
pub struct RgbdWriter {
    folder: PathBuf,
    depth_unit_m: f64,
}

impl RgbdWriter {
    /// Begins a sequence in a folder that does not exist or is empty. Depth that is a whole multiple of `depth_unit_m`, metres, takes least
    /// space.
    ///
    /// # Errors
    /// [`RgbdError`] if the folder holds anything or cannot be written.
    pub fn create(folder: &Path, intrinsics: &Intrinsics, depth_unit_m: f64) -> Result<Self, RgbdError> {
        let is_vacant = fs::read_dir(folder).map_or(true, |mut entries| entries.next().is_none());
        if !is_vacant {
            return Err(RgbdError::fault(folder, "the folder is not empty: name a new one"));
        }
        for part in ["rgb", "depth", "masks", "poses"] {
            let part = folder.join(part);
            fs::create_dir_all(&part).map_err(RgbdError::io(&part))?;
        }
        let Intrinsics { fx, fy, cx, cy, .. } = intrinsics;
        let writer = Self { folder: folder.to_owned(), depth_unit_m };
        writer.file("cam_K.txt", format!("{fx} 0 {cx}\n0 {fy} {cy}\n0 0 1\n").as_bytes())?;
        Ok(writer)
    }

    fn file(&self, name: &str, bytes: &[u8]) -> Result<(), RgbdError> {
        let path = self.folder.join(name);
        fs::write(&path, bytes).map_err(RgbdError::io(&path))
    }

    /// Adds a frame with a stamp, nanoseconds, later than those before. Colours may be empty. `depth_m` is metres, 0 where nothing was
    /// measured. Either all frames have a pose of the camera, or none has.
    ///
    /// # Errors
    /// [`RgbdError`] if a file cannot be written.
    pub fn push(
        &self,
        stamp_ns: u64,
        color: &RgbImage,
        depth_m: &Array2<f32>,
        mask: Option<&Array2<bool>>,
        world_from_camera: Option<Isometry<Camera, World>>,
    ) -> Result<(), RgbdError> {
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
            let rows = text::from_opencv::<World>(pose.untyped()).to_matrix();
            let rows = rows.map(|row| row.map(|x| x.to_string()).join(" "));
            self.file(&format!("poses/{name}.txt"), rows.join("\n").as_bytes())?;
        }
        if !self.folder.join(description::FILE).exists() {
            // Stamps of simulators begin at 0, so that their length does not say that they are nanoseconds.
            let poses = if world_from_camera.is_some() { "camera_poses = \"poses/*.txt\"\n" } else { "" };
            let unit = self.depth_unit_m;
            let text = format!("live = true\nframe_hz = 1e9\ndepth_unit_m = {unit:?}\n{poses}");
            self.file(description::FILE, text.as_bytes())?;
        }
        Ok(())
    }

    /// Returns depth in levels of two bytes as PNG has them; `None` if these would not give it back to the bit.
    fn levels(&self, depth_m: &Array2<f32>) -> Option<Vec<u8>> {
        let mut bytes = Vec::with_capacity(2 * depth_m.len());
        for &depth_m in depth_m {
            let level = (f64::from(depth_m) / self.depth_unit_m).round();
            if !(0.0..=f64::from(u16::MAX)).contains(&level) || (level * self.depth_unit_m) as f32 != depth_m {
                return None;
            }
            bytes.extend((level as u16).to_ne_bytes());
        }
        Some(bytes)
    }

    fn png(&self, name: &str, pixels: &[u8], size: [u32; 2], of: ExtendedColorType) -> Result<(), RgbdError> {
        let file = mvt_images::fast_png(pixels, size, of);
        self.file(name, &file.map_err(|reason| RgbdError::fault(&self.folder.join(name), reason.to_string()))?)
    }
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
            writer.push(stamp_ns, &color, depth_m, Some(mask), Some(pose)).unwrap();
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
