//! Logs from one layout to the other.

use std::fs;
use std::path::Path;

use image::RgbImage;
use mvt_robot::hand::PerPad;
use rayon::prelude::*;

use crate::archive::ARCHIVE;
use crate::error::LogError;
use crate::format::LogFormat;
use crate::frames::{self, EncodedImages, FrameWriter, RawFrame};
use crate::hand::pad_size;
use crate::reader::Log;
use crate::writer::PartialFolder;

/// Frames that are decoded before any of them is written.
const FRAMES_AT_ONCE: usize = 32;
/// Images of a touch sensor of which the median is its untouched image, spread over the log.
const SAMPLES: usize = 31;

/// Writes a log in another layout. `data.pkl`, `scene.json` and previews stay as they are to the byte. `progress` receives the number of
/// frames that are done.
///
/// # Errors
/// [`LogError::NotEmpty`] if `out` is not empty, the errors of [`Log::open`], and [`LogError::Io`] if a file cannot be written.
pub fn convert(log: &Path, out: &Path, format: LogFormat, mut progress: impl FnMut(usize)) -> Result<(), LogError> {
    let source = Log::open(log)?;
    let hand = source.hand();
    let partial = PartialFolder::begin(out)?;
    let untouched = match format {
        LogFormat::Compact => Some(untouched(&source)?),
        LogFormat::FeelSight => None,
    };
    let cameras = source.cameras().iter().map(|c| (c.name.as_str(), (c.intrinsics.width, c.intrinsics.height)));
    let mut writer = FrameWriter::create(partial.path(), &cameras.collect::<Vec<_>>(), hand, untouched.as_ref())?;
    let mut depths = (0..source.cameras().len()).map(|camera| source.depths(camera)).collect::<Result<Vec<_>, _>>()?;
    for first in (0..source.len()).step_by(FRAMES_AT_ONCE) {
        let mut chunk = Vec::new();
        for frame in first..source.len().min(first + FRAMES_AT_ONCE) {
            let mut of_cameras = Vec::new();
            for reader in &mut depths {
                let depth = reader.read()?;
                of_cameras.push(depth.ok_or_else(|| LogError::defect(reader.path(), "depth ends early"))?);
            }
            chunk.push((frame, of_cameras));
        }
        let encode = |(frame, depths): (usize, Vec<Vec<f32>>)| {
            let raw: RawFrame = source.raw_frame(frame, depths)?;
            frames::encode(&raw, hand, untouched.as_ref())
                .map_err(|defect| LogError::defect(log, format!("frame {frame}: {defect}")))
        };
        let encoded: Vec<EncodedImages> = chunk.into_par_iter().map(encode).collect::<Result<_, _>>()?;
        for images in &encoded {
            writer.push(images)?;
        }
        progress(first + encoded.len());
    }
    writer.finish()?;
    for entry in fs::read_dir(log).map_err(LogError::io(log))? {
        let entry = entry.map_err(LogError::io(log))?;
        let path = entry.path();
        if entry.file_type().map_err(LogError::io(&path))?.is_file() && entry.file_name() != ARCHIVE {
            let target = partial.path().join(entry.file_name());
            fs::copy(&path, &target).map_err(LogError::io(&target))?;
        }
    }
    partial.place(out)
}

/// Returns an image of each touch sensor that is near to most of its images: the median of some of them, colour by colour. It is black if the log
/// has none.
fn untouched(log: &Log) -> Result<PerPad<RgbImage>, LogError> {
    let samples = SAMPLES.min(log.len());
    let median = |pad: usize| {
        let (width, height) = pad_size(log.hand(), pad);
        if !log.has_touch_images(pad) {
            return Ok(RgbImage::new(width as u32, height as u32));
        }
        let images: Vec<RgbImage> =
            (0..samples).map(|k| log.touch_image(pad, k * log.len() / samples)).collect::<Result<_, _>>()?;
        let mut levels = Vec::with_capacity(images.len());
        let level = |pixel: usize| {
            levels.clear();
            levels.extend(images.iter().filter_map(|image| image.as_raw().get(pixel).copied()));
            let middle = levels.len() / 2;
            if levels.is_empty() { 0 } else { *levels.select_nth_unstable(middle).1 }
        };
        let raw: Vec<u8> = (0..3 * width * height).map(level).collect();
        RgbImage::from_raw(width as u32, height as u32, raw)
            .ok_or_else(|| LogError::defect(log.folder(), "a touch image has another size than its sensor's"))
    };
    (0..log.hand().pads().len()).map(median).collect()
}
