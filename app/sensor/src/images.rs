//! Images of one touch sensor, as people bring them.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result, bail, ensure};
use image::RgbImage;
use mvt_files::input::is_litter;
use mvt_products::Instructions;
use mvt_robot::digit::profile::SensorProfile;
use mvt_run::io::read_any_image;
use mvt_run::source::{shipped_weights, weights_of};
use mvt_touch::engine::{Engine, Prediction};
use mvt_touch::light::SensorLight;
use mvt_touch::untouched::{difference_from_untouched, estimate};
use rayon::prelude::*;

use crate::layout::ImageLayout;
use crate::window::GelWindow;

/// Images that cannot be read of which each is told.
const MOST_DEFECTS: usize = 5;
/// A median over fewer images than this may show contacts.
const FEW_IMAGES: usize = 15;
/// Greatest difference between an untouched image and the images where nothing touches, grey levels: two DIGITs differ by more.
const OTHER_SENSOR: f32 = 40.0;

/// Images of one sensor, upright, in RGB order and of the size that its profile states.
pub struct SensorImages {
    /// Names for results, one per image.
    pub ids: Vec<String>,
    /// The images.
    pub images: Vec<RgbImage>,
    /// The image of the sensor that touches nothing.
    pub untouched: RgbImage,
}

impl SensorImages {
    /// Reads images, or all images of folders, and the untouched one; without that, it is estimated from the images. Images that cannot be read
    /// are skipped with a warning.
    ///
    /// # Errors
    /// If there is no image that can be read, images differ in size, or the untouched image comes from another sensor.
    pub fn read(paths: &[PathBuf], untouched: Option<&Path>, profile: &SensorProfile, engine: &Engine) -> Result<Self> {
        let files = files(paths)?;
        ensure!(!files.is_empty(), "--images: there is no image (.png, .jpg) in {}", list(paths));
        let ids = ids(&files)?;
        let (mut known, mut images, mut defects) = (Vec::new(), Vec::new(), Vec::new());
        for (id, read) in ids.into_iter().zip(files.par_iter().map(|path| read(path, profile)).collect::<Vec<_>>()) {
            match read {
                Ok(image) => {
                    known.push(id);
                    images.push(image);
                }
                Err(error) => defects.push(error),
            }
        }
        if images.is_empty()
            && let Some(defect) = defects.pop()
        {
            return Err(defect);
        }
        for defect in defects.iter().take(MOST_DEFECTS) {
            tracing::warn!("{defect:#}; the image is skipped");
        }
        if defects.len() > MOST_DEFECTS {
            tracing::warn!("{} more images are skipped", defects.len() - MOST_DEFECTS);
        }
        let untouched = untouched.map(|path| read(path, profile)).transpose()?;

        if untouched.is_none() {
            if images.len() < FEW_IMAGES {
                tracing::warn!(
                    "there is no --untouched image, and the median of {} images may show contacts; give --untouched",
                    images.len()
                );
            } else {
                tracing::info!("there is no --untouched image; the median of {} images is used", images.len());
            }
        }
        let SensorState { untouched, .. } = SensorState::of(untouched, &mut images, profile, engine)?;
        Ok(Self { ids: known, images, untouched })
    }
}

/// How the images of a sensor lie, and its untouched image.
pub(crate) struct SensorState {
    pub layout: ImageLayout,
    /// Upright, in RGB order and of the size of the sensor's images.
    pub untouched: RgbImage,
}

impl SensorState {
    /// Puts images upright. The untouched image is estimated from them if none is given.
    ///
    /// # Errors
    /// If there is no image, sizes differ, or the untouched image comes from another sensor.
    pub fn of(
        untouched: Option<RgbImage>,
        images: &mut [RgbImage],
        profile: &SensorProfile,
        engine: &Engine,
    ) -> Result<Self> {
        let size_px = profile.size_px;
        let layout = place(untouched.as_ref(), images, profile)?;
        images.iter_mut().for_each(|image| *image = layout.upright(image, size_px));
        let untouched = match untouched {
            Some(image) => layout.upright(&image, size_px),
            None => estimate(engine, images)?.context("there is no image")?,
        };
        let mut differences: Vec<f32> =
            images.iter().map(|image| difference_from_untouched(image, &untouched)).collect();
        differences.sort_unstable_by(f32::total_cmp);
        let typical = differences.get(differences.len() / 2).copied().unwrap_or_default();
        ensure!(
            typical <= OTHER_SENSOR,
            "the untouched image seems to come from another sensor: where nothing touches, the images differ from it by \
             {typical:.0} grey levels; give an untouched image of this sensor"
        );
        Ok(Self { layout, untouched })
    }
}

/// Returns the network's predictions for images of one sensor, in their order.
pub(crate) fn infer(
    engine: &Engine,
    gains: [f32; 3],
    untouched: &RgbImage,
    images: &[RgbImage],
) -> Result<Vec<Prediction>> {
    let light = SensorLight::known(gains);
    let mut seen = images.to_vec();
    for (image, seen) in images.iter().zip(&mut seen) {
        light.change(image, untouched, [1.0; 3], seen);
    }
    let mut predictions = Vec::new();
    engine.infer_each(&seen.iter().collect::<Vec<_>>(), &mut predictions)?;
    Ok(predictions)
}

/// Returns the network for a sensor: that of a file, that of its profile, or the shipped one.
pub(crate) fn engine(profile: &SensorProfile, weights: Option<&Path>) -> Result<Engine> {
    let weights = match weights.or(profile.weights.as_deref()) {
        Some(path) => weights_of(path, profile)?,
        None => shipped_weights(profile)?,
    };
    Ok(Engine::new(&weights, Instructions::best()))
}

/// Returns how the sensor's images lie, and warns unless they stand upright in RGB order.
fn place(untouched: Option<&RgbImage>, images: &[RgbImage], profile: &SensorProfile) -> Result<ImageLayout> {
    let Some(first) = images.first() else { return Ok(ImageLayout::default()) };
    if let Some(odd) = images.iter().chain(untouched).find(|image| image.dimensions() != first.dimensions()) {
        let ((width, height), (other_width, other_height)) = (first.dimensions(), odd.dimensions());
        bail!(
            "the images differ in size: {width} x {height} and {other_width} x {other_height} pixels; give images of one sensor"
        );
    }
    if profile.corners_px.is_some() {
        return Ok(ImageLayout::default());
    }
    let layout = ImageLayout::of(untouched.unwrap_or(first), profile.size_px);
    if layout.quarter_turns > 0 {
        tracing::warn!(
            "the images are turned by {} degrees: the light of the LEDs comes from another side",
            90 * u16::from(layout.quarter_turns)
        );
    }
    if layout.is_mirrored {
        tracing::warn!(
            "the images are mirrored: the light of the LEDs comes from the sides that a mirror exchanges; they are mirrored back"
        );
    }
    if layout.is_bgr {
        tracing::warn!(
            "the images are in BGR order: the LEDs' colours come from the wrong sides; red and blue are exchanged"
        );
    }
    Ok(layout)
}

/// Reads an image of a sensor as RGB: the part that shows the gel. Grey images have no colours to see slopes by.
pub(crate) fn read(path: &Path, profile: &SensorProfile) -> Result<RgbImage> {
    let image = read_any_image(path)?;
    let read = || -> Result<RgbImage> {
        let image = mvt_images::colours(image)?;
        match GelWindow::of(profile) {
            Some(window) => window.cut(&image),
            None => Ok(image),
        }
    };
    read().with_context(|| format!("cannot use {}", path.display()))
}

/// Returns the image files that are named or lie in the folders named, sorted within each folder.
fn files(paths: &[PathBuf]) -> Result<Vec<PathBuf>> {
    let mut files = Vec::new();
    for path in paths {
        if !path.is_dir() {
            files.push(path.clone());
            continue;
        }
        let cannot_read = || format!("cannot read {}", path.display());
        let mut inside = Vec::new();
        for entry in std::fs::read_dir(path).with_context(cannot_read)? {
            let entry = entry.with_context(cannot_read)?;
            if is_litter(&entry.file_name()) {
                continue;
            }
            let path = entry.path();
            let name = path.file_stem().map(|stem| stem.to_string_lossy().into_owned()).unwrap_or_default();
            let kind = path.extension().map(|kind| kind.to_string_lossy().to_ascii_lowercase()).unwrap_or_default();
            if ["png", "jpg", "jpeg"].contains(&kind.as_str())
                && !name.ends_with("untouched")
                && !name.ends_with("_mask")
            {
                inside.push(path);
            }
        }
        inside.sort_unstable();
        files.extend(inside);
    }
    Ok(files)
}

/// Returns the names under which results are written.
fn ids(files: &[PathBuf]) -> Result<Vec<String>> {
    let id = |path: &PathBuf| {
        let stem = path.file_stem().map(|stem| stem.to_string_lossy().into_owned()).unwrap_or_default();
        stem.strip_suffix("_img").map(str::to_owned).unwrap_or(stem)
    };
    let ids: Vec<String> = files.iter().map(id).collect();
    let mut seen = std::collections::BTreeSet::new();
    if let Some(twice) = ids.iter().find(|id| !seen.insert(id.as_str())) {
        bail!(
            "--images: two images are named {twice:?}; their results would have the same name: give one folder at a time"
        );
    }
    Ok(ids)
}

fn list(paths: &[PathBuf]) -> String {
    paths.iter().map(|path| path.display().to_string()).collect::<Vec<_>>().join(", ")
}
