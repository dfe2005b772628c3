//! Touch sensors that are cameras of this computer, by their serial numbers.

use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

use anyhow::{Result, bail};
use image::RgbImage;
use mvt_robot::digit::profile::SensorProfile;

use crate::layout::ImageLayout;
use crate::stream::{Pace, StreamSource, VideoStream};

/// Folder in which Linux names cameras by maker, product and serial number.
const BY_SERIAL: &str = "/dev/v4l/by-id";
/// End of the names of cameras there; other ends are those of their descriptions.
const IMAGES: &str = "-video-index0";
/// Most frames that are taken at once: as many as wait.
const AT_ONCE: usize = 16;

/// A touch sensor whose images come through ffmpeg, upright and in the size of its profile.
pub struct TouchCamera {
    stream: VideoStream,
    size_px: [usize; 2],
    /// How its images lie, which the first one shows unless its profile says where their corners are.
    layout: Option<ImageLayout>,
    read: usize,
}

impl TouchCamera {
    /// Opens the sensor with this serial number, or of this device, such as `/dev/video0`. It is asked for the size and rate of its
    /// profile.
    ///
    /// # Errors
    /// If there is no such sensor, or several, or ffmpeg cannot be started.
    pub fn open(name: &str, profile: &SensorProfile) -> Result<Self> {
        let device = if name.starts_with('/') { PathBuf::from(name) } else { of_serial(Path::new(BY_SERIAL), name)? };
        let stream = StreamSource::Camera(device).open(Pace::Fastest, profile)?;
        let layout = profile.corners_px.is_some().then(ImageLayout::default);
        Ok(Self { stream, size_px: profile.size_px, layout, read: 0 })
    }

    /// Waits for an image and returns the newest; `None` when the camera has ended or `stop` is set.
    pub fn newest(&mut self, stop: &AtomicBool) -> Option<RgbImage> {
        let images = self.stream.receive(1, AT_ONCE, stop);
        self.read += images.len();
        let image = images.last()?;
        let layout = *self.layout.get_or_insert_with(|| ImageLayout::of(image, self.size_px));
        Some(layout.upright(image, self.size_px))
    }

    /// Returns why a camera has ended.
    pub fn ended(self) -> String {
        self.stream
            .finish(self.read)
            .err()
            .map_or_else(|| "the camera has ended".to_owned(), |reason| reason.to_string())
    }
}

/// Finds the camera with a serial number among those of a folder.
fn of_serial(folder: &Path, serial: &str) -> Result<PathBuf> {
    let names =
        folder.read_dir().into_iter().flatten().flatten().filter_map(|entry| entry.file_name().into_string().ok());
    let mut cameras: Vec<String> = names.filter(|name| name.ends_with(IMAGES)).collect();
    cameras.sort();
    let of_name = |name: &&String| name.contains(serial);
    match cameras.iter().filter(of_name).collect::<Vec<_>>()[..] {
        [only] => Ok(folder.join(only)),
        [] if cameras.is_empty() => {
            bail!("there is no camera in {}: connect the touch sensor {serial}", folder.display())
        }
        [] => bail!(
            "there is no touch sensor with the serial number {serial}: connect it; these cameras are there: {}",
            cameras.join(", ")
        ),
        _ => bail!("several cameras have {serial} in their names: write more of the serial number, or the device"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_camera_is_found_by_its_serial_number() {
        let folder = tempfile::tempdir().unwrap();
        let of = |serial| of_serial(folder.path(), serial);
        assert!(of("D20123").unwrap_err().to_string().contains("connect the touch sensor D20123"));
        for name in [
            "usb-Facebook_DIGIT_D20123-video-index0",
            "usb-Facebook_DIGIT_D20123-video-index1",
            "usb-Facebook_DIGIT_D20124-video-index0",
        ] {
            std::fs::write(folder.path().join(name), "").unwrap();
        }
        assert!(of("D20123").unwrap().ends_with("usb-Facebook_DIGIT_D20123-video-index0"));
        assert!(of("D2012").unwrap_err().to_string().contains("several"));
        let other = of("D30000").unwrap_err().to_string();
        assert!(other.contains("D20123") && other.contains("D20124"), "{other}");
    }
}
