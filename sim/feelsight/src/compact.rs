//! Images of a compact log. docs/compact_log.md describes the layout.

use std::borrow::Cow;
use std::path::Path;
use std::sync::{Arc, LazyLock};

use image::{GrayImage, ImageBuffer, Luma, RgbImage};
use mvt_robot::digit::profile::SensorProfile;
use mvt_robot::hand::{Hand, PerPad};
use serde::{Deserialize, Serialize};

use crate::archive::{ARCHIVE, ArchiveReader, ArchiveWriter};
use crate::error::LogError;
use crate::hand::{pad_folder, pad_size};
use crate::levels::image_of;
use crate::picture::{MAX_FILE, color_of, encode_color, encode_png, encode_small, gray_of, levels16_of, touch_of};
use crate::record::DigitInfo;

/// Version of the layout that is written.
const LAYOUT: u32 = 1;
/// Name of the file that says the version.
const LAYOUT_FILE: &str = "layout.json";
/// Name of the image of the levels of the untouched gel of TACTO's DIGIT. Other sensors have one in their folders.
const GEL_FILE: &str = "allegro/gel.png";
/// Step of camera depth, metres: sensors measure in steps of 0.1 or 1 mm, so that their values are kept exactly.
const DEPTH_STEP_M: f64 = 1e-4;
/// Steps of depth that a layout may state, metres.
const DEPTH_STEPS_M: std::ops::RangeInclusive<f64> = 1e-6..=0.1;
/// JPEG quality of differences, 1 to 100: the error is below the sensor's noise.
const DIFFERENCE_QUALITY: u8 = 70;
/// JPEG quality of camera images, which estimation does not use.
const CAMERA_QUALITY: u8 = 60;
/// Level of no difference.
const MIDDLE: i16 = 128;

/// Contents of layout.json.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
struct Layout {
    layout: u32,
    depth_step_m: f64,
}

/// Open frames.zip with the images from which its own differ.
#[derive(Debug)]
pub(crate) struct CompactFrames {
    pub archive: ArchiveReader,
    hand: Arc<Hand>,
    depth_step_m: f64,
    untouched: PerPad<RgbImage>,
    gels: PerPad<GrayImage>,
}

impl CompactFrames {
    /// Opens the archive of a log; `None` if the log has none.
    pub fn open(log: &Path, hand: &Arc<Hand>) -> Result<Option<Self>, LogError> {
        let path = log.join(ARCHIVE);
        if path.symlink_metadata().is_err() {
            return Ok(None);
        }
        let archive = ArchiveReader::open(&path)?;
        let path = archive.path(LAYOUT_FILE);
        let bytes = archive.read(LAYOUT_FILE, 1 << 16)?;
        let Layout { layout, depth_step_m } =
            serde_json::from_slice(&bytes).map_err(|reason| LogError::Json { path: path.clone(), reason })?;
        if layout > LAYOUT {
            let defect = format!(
                "its layout {layout} is newer than {LAYOUT}, the newest that this version reads: update the program"
            );
            return Err(LogError::defect(path, defect));
        }
        if !DEPTH_STEPS_M.contains(&depth_step_m) {
            return Err(LogError::defect(path, format!("depth_step_m is {depth_step_m} and not 1e-6 to 0.1")));
        }
        let color = |pad: usize| {
            let name = format!("{}/untouched.png", pad_folder(hand, pad));
            color_of(&archive.read(&name, MAX_FILE)?, &archive.path(&name), pad_size(hand, pad))
        };
        let untouched = (0..hand.pads().len()).map(color).collect::<Result<_, LogError>>()?;
        let gel = |pad: usize| {
            let name = gel_file(hand, pad);
            gray_of(&archive.read(&name, MAX_FILE)?, &archive.path(&name), pad_size(hand, pad))
        };
        let gels = (0..hand.pads().len()).map(gel).collect::<Result<_, LogError>>()?;
        Ok(Some(Self { archive, hand: Arc::clone(hand), depth_step_m, untouched, gels }))
    }

    /// Returns the number of images of a touch sensor.
    pub fn touch_images(&self, pad: usize) -> usize {
        let count = |kind: &str| self.archive.count(&format!("{}/{kind}", pad_folder(&self.hand, pad)));
        count("difference") + count("image")
    }

    /// Reads the image of a touch sensor.
    pub fn touch_image(&self, pad: usize, frame: usize) -> Result<RgbImage, LogError> {
        let folder = pad_folder(&self.hand, pad);
        let (whole, size) = (format!("{folder}/image/{frame}.jpg"), pad_size(&self.hand, pad));
        if self.archive.contains(&whole) {
            return touch_of(&self.archive.read(&whole, MAX_FILE)?, &self.archive.path(&whole), size);
        }
        let name = format!("{folder}/difference/{frame}.jpg");
        let mut image = color_of(&self.archive.read(&name, MAX_FILE)?, &self.archive.path(&name), size)?;
        for (level, &untouched) in
            image.iter_mut().zip(self.untouched.get(pad).into_iter().flat_map(|image| image.iter()))
        {
            // The sum is at most 255 after the limits.
            *level = (i16::from(untouched) + i16::from(*level) - MIDDLE).clamp(0, 255) as u8;
        }
        Ok(image)
    }

    /// Reads the levels of touch depth.
    pub fn touch_levels(&self, pad: usize, frame: usize) -> Result<GrayImage, LogError> {
        let name = format!("{}/depth/{frame}.png", pad_folder(&self.hand, pad));
        let size = pad_size(&self.hand, pad);
        let mut levels = gray_of(&self.archive.read(&name, MAX_FILE)?, &self.archive.path(&name), size)?;
        let gel = self.gels.get(pad).into_iter().flat_map(|gel| gel.iter());
        levels.iter_mut().zip(gel).for_each(|(level, &gel)| *level = level.wrapping_add(gel));
        Ok(levels)
    }

    /// Reads a depth image of a camera: metres, positive, 0 where nothing was measured.
    pub fn depth_m(&self, camera: &str, frame: usize, size: (usize, usize)) -> Result<Vec<f32>, LogError> {
        let name = format!("realsense/{camera}/depth/{frame}.png");
        let steps = levels16_of(&self.archive.read(&name, MAX_FILE)?, &self.archive.path(&name), size)?;
        Ok(steps.iter().map(|&steps| (f64::from(steps) * self.depth_step_m) as f32).collect())
    }
}

/// Begins frames.zip with the images from which the others differ.
pub(crate) fn begin(log: &Path, hand: &Hand, untouched: &PerPad<RgbImage>) -> Result<ArchiveWriter, LogError> {
    let path = log.join(ARCHIVE);
    let mut archive = ArchiveWriter::create(path.clone())?;
    let layout = Layout { layout: LAYOUT, depth_step_m: DEPTH_STEP_M };
    archive.add(
        LAYOUT_FILE,
        &serde_json::to_vec(&layout).map_err(|reason| LogError::Json { path: path.clone(), reason })?,
    )?;
    let failed = |defect: String| LogError::defect(&path, defect);
    archive.add(GEL_FILE, &encode_png(&*GEL_LEVELS).map_err(failed)?)?;
    for (pad, image) in untouched.iter().enumerate() {
        let bytes = encode_png(image).map_err(failed)?;
        archive.add(&format!("{}/untouched.png", pad_folder(hand, pad)), &bytes)?;
    }
    for (pad, of) in hand.pads().iter().enumerate().filter(|(_, pad)| !pad.profile.is_tacto()) {
        archive.add(&gel_file(hand, pad), &encode_png(&*gel_levels(&of.profile)).map_err(failed)?)?;
    }
    Ok(archive)
}

/// Levels of the untouched gel of TACTO's DIGIT.
static GEL_LEVELS: LazyLock<GrayImage> = LazyLock::new(|| levels_of(&SensorProfile::tacto()));

/// Returns the levels of the untouched gel of a sensor.
fn gel_levels(profile: &SensorProfile) -> Cow<'static, GrayImage> {
    if profile.is_tacto() { Cow::Borrowed(&GEL_LEVELS) } else { Cow::Owned(levels_of(profile)) }
}

fn levels_of(profile: &SensorProfile) -> GrayImage {
    let info = DigitInfo::published().of(profile);
    image_of(profile.gel_view().depth_m(), |&depth_m| info.level(depth_m))
}

/// Returns the name of the image of the levels of a pad's untouched gel.
fn gel_file(hand: &Hand, pad: usize) -> String {
    match hand.pads().get(pad).is_none_or(|pad| pad.profile.is_tacto()) {
        true => GEL_FILE.to_owned(),
        false => format!("{}/gel.png", pad_folder(hand, pad)),
    }
}

/// Encodes the image of a touch sensor, and says whether as difference from the untouched image. A difference that does not fit into a byte is none.
pub(crate) fn encode_touch(image: &RgbImage, untouched: &RgbImage) -> Result<(Vec<u8>, bool), String> {
    let difference =
        |(&level, &untouched): (&u8, &u8)| u8::try_from(i16::from(level) - i16::from(untouched) + MIDDLE).ok();
    let levels: Option<Vec<u8>> = image.iter().zip(untouched.iter()).map(difference).collect();
    match levels.and_then(|levels| RgbImage::from_raw(image.width(), image.height(), levels)) {
        Some(difference) => Ok((encode_small(&difference, DIFFERENCE_QUALITY)?, true)),
        None => Ok((encode_color(image)?, false)),
    }
}

/// Encodes levels of touch depth as their difference from the untouched gel of a pad.
pub(crate) fn encode_levels(levels: &GrayImage, hand: &Hand, pad: usize) -> Result<Vec<u8>, String> {
    let gel = hand.pads().get(pad).map(|pad| gel_levels(&pad.profile)).ok_or("there is no such pad")?;
    let mut difference = levels.clone();
    difference.iter_mut().zip(gel.iter()).for_each(|(level, &gel)| *level = level.wrapping_sub(gel));
    encode_png(&difference)
}

/// Encodes colours of a camera.
pub(crate) fn encode_camera_color(image: &RgbImage) -> Result<Vec<u8>, String> {
    encode_small(image, CAMERA_QUALITY)
}

/// Encodes a depth image, metres, in steps of 0.1 mm. Depth beyond 6.5 m counts as not measured.
pub(crate) fn encode_camera_depth(depth_m: &[f32], (width, height): (usize, usize)) -> Result<Vec<u8>, String> {
    let steps = |&depth: &f32| {
        let steps = (f64::from(depth.abs()) / DEPTH_STEP_M).round();
        if steps <= f64::from(u16::MAX) { steps as u16 } else { 0 }
    };
    let image = ImageBuffer::<Luma<u16>, _>::from_raw(width as u32, height as u32, depth_m.iter().map(steps).collect());
    encode_png(&image.ok_or("the depth has holes")?)
}
