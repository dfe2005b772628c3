//! `touch evaluate`: errors of a touch network on images with known depth and contact.

use std::fs;
use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Context as _, Result, bail, ensure};
use clap::Args;
use image::imageops::{FilterType::Triangle, resize};
use image::{DynamicImage, GrayImage, ImageBuffer, Luma, RgbImage};
use mvt_feelsight::npy;
use mvt_files::input;
use mvt_images::levels;
use mvt_products::Instructions;
use mvt_robot::digit::gel::GelView;
use mvt_robot::digit::profile::SensorProfile;
use mvt_run::device::DeviceArguments;
use mvt_run::io::{print_line, read_any_image};
use mvt_run::source::weights_of;
use mvt_touch::accuracy::{Accuracy, Pixel, Scores};
use mvt_touch::engine::{Engine, Prediction};
use mvt_touch::untouched::{estimate, is_of_same_sensor, subtract_untouched};
use ndarray::Array2;
use serde::Serialize;

use mvt_run::image_size::ImageSize;

/// Score a touch network on images with known depth and contact
///
/// DIR holds three files for each image, as `touch data` writes them: ID_img.png (RGB), ID_depth_m.npy (32-bit
/// floats, rows x columns, metres along the camera's axis) and ID_mask.png (contact where it exceeds 127).
///
/// The untouched image of the sensor is subtracted before the network sees an image. It is read from ID_untouched.png;
/// where that file is missing, it is estimated from all images, provided that they show one sensor.
#[derive(Debug, Args)]
pub struct TouchEvaluateArguments {
    /// Weights of the network (.safetensors), as `touch train` writes them
    #[arg(long, value_name = "FILE")]
    weights: PathBuf,
    /// Folder of the images
    #[arg(long, value_name = "DIR")]
    data: PathBuf,
    /// Touch sensor of the images: tacto (a DIGIT), digit, gelsight_mini, or the path of a profile (.toml)
    #[arg(long, value_name = "NAME", default_value = "tacto")]
    profile: String,
    /// Leave out images whose indentation exceeds this anywhere, millimetres
    #[arg(long, value_name = "MM")]
    deepest_mm: Option<f32>,
    /// Resize images to this size before the network sees them, in pixels, as WIDTHxHEIGHT or one side of a square; its
    /// output is resized back and scored at the size of the sensor
    #[arg(long, value_name = "SIZE")]
    input: Option<ImageSize>,
    /// Do not subtract the untouched image
    #[arg(long, alias = "as-they-are")]
    no_subtraction: bool,
    #[command(flatten)]
    device: DeviceArguments,
    /// Print one JSON object instead of words
    #[arg(long)]
    json: bool,
}

/// The printed result.
#[derive(Debug, Serialize)]
struct Report {
    #[serde(flatten)]
    scores: Scores,
    ms_per_image: f64,
    untouched: Untouched,
}

/// Number of images by the origin of their untouched image: a file, an estimate from all images, or unknown.
#[derive(Debug, Default, Clone, Copy, Serialize)]
struct Untouched {
    file: usize,
    images: usize,
    unknown: usize,
}

/// Touch image with its true depth and contact.
struct Triple {
    image: RgbImage,
    depth_m: Array2<f32>,
    mask: GrayImage,
    untouched: Option<RgbImage>,
}

/// Runs the command.
pub fn run(arguments: &TouchEvaluateArguments) -> Result<()> {
    arguments.device.choose()?;
    let profile = SensorProfile::load(&arguments.profile)?;
    let gel = profile.gel_view();
    let engine = Engine::new(&weights_of(&arguments.weights, &profile)?, Instructions::best());
    let ids = ids(&arguments.data)?;
    ensure!(
        !ids.is_empty(),
        "--data {} contains no *_img.png; `touch data` writes such a folder",
        arguments.data.display()
    );
    let common = if arguments.no_subtraction { None } else { common_untouched(&engine, &arguments.data, &ids)? };
    let (mut accuracy, mut busy_s, mut prediction) = (Accuracy::default(), 0.0, Prediction::default());
    let mut untouched = Untouched::default();
    for id in &ids {
        let mut triple = Triple::read(&arguments.data, id, &gel)?;
        if arguments.deepest_mm.is_some_and(|most| triple.truth(&gel).any(|pixel| pixel.millimetres > most)) {
            continue;
        }
        let own = if arguments.no_subtraction { None } else { triple.untouched.take() };
        match (own, &common) {
            (Some(own), _) => {
                subtract_untouched(&own, &mut triple.image);
                untouched.file += 1;
            }
            (None, Some(common)) => {
                subtract_untouched(common, &mut triple.image);
                untouched.images += 1;
            }
            (None, None) => untouched.unknown += 1,
        }
        let started = Instant::now();
        match arguments.input {
            None => engine.infer(&triple.image, &mut prediction)?,
            Some(size) => prediction = infer_at(&engine, &triple.image, size)?,
        }
        busy_s += started.elapsed().as_secs_f64();
        accuracy.add(Pixel::all(&prediction).zip(triple.truth(&gel)));
    }
    let scores = accuracy.scores();
    ensure!(scores.images > 0, "every image exceeds --deepest-mm; give a larger depth");
    let report = Report { scores, ms_per_image: 1e3 * busy_s / scores.images as f64, untouched };
    if arguments.json {
        return print_line(&serde_json::to_string_pretty(&report)?);
    }
    let Untouched { file, images: common, unknown } = untouched;
    let Scores { images, rmse_mm, mae_mm, contact_mae_mm, contact_rmse_mm, iou, .. } = scores;
    print_line(&format!(
        "{images} images, {:.1} ms each\nall pixels: MAE {mae_mm:.4} mm, RMSE {rmse_mm:.4} mm\n\
         contact: MAE {contact_mae_mm:.4} mm, RMSE {contact_rmse_mm:.4} mm, IoU {iou:.4}\n\
         untouched image: from a file for {file} images, estimated for {common}, unknown for {unknown}",
        report.ms_per_image
    ))
}

/// Predicts at another size of the image, and resizes the prediction back.
fn infer_at(engine: &Engine, image: &RgbImage, size: ImageSize) -> Result<Prediction> {
    let (width, height) = image.dimensions();
    let mut prediction = Prediction::default();
    engine.infer(&resize(image, size.width, size.height, Triangle), &mut prediction)?;
    let back = |plane: Array2<f32>| -> Result<Array2<f32>> {
        let plane =
            ImageBuffer::<Luma<f32>, _>::from_raw(size.width, size.height, plane.into_iter().collect::<Vec<_>>());
        let plane =
            resize(&plane.context("the prediction does not have the size of its image")?, width, height, Triangle);
        Ok(Array2::from_shape_vec((height as usize, width as usize), plane.into_raw())?)
    };
    let Prediction { indentation_mm, contact_logit } = prediction;
    Ok(Prediction { indentation_mm: back(indentation_mm)?, contact_logit: back(contact_logit)? })
}

/// Fewer images than this may all be pressed at the same place, so that a median would show the press.
const LEAST_IMAGES: usize = 15;
/// At most this many images, evenly spread, enter the median: enough for it, at little memory.
const MOST_IMAGES: usize = 500;

/// Estimates the untouched image from all images. Returns `None` if they show several sensors or if each has a file of
/// its own.
fn common_untouched(engine: &Engine, folder: &Path, ids: &[String]) -> Result<Option<RgbImage>> {
    if ids.len() < LEAST_IMAGES || ids.iter().all(|id| path(folder, id, UNTOUCHED).exists()) {
        return Ok(None);
    }
    let some = ids.iter().step_by(ids.len().div_ceil(MOST_IMAGES));
    let images = some.map(|id| colours(folder, id, IMAGE)).collect::<Result<Vec<_>>>()?;
    let Some(common) = estimate(engine, &images)? else { return Ok(None) };
    let fitting = images.iter().filter(|image| is_of_same_sensor(image, &common)).count();
    Ok((10 * fitting >= 9 * images.len()).then_some(common))
}

/// Returns the first parts of the names of the images' files, sorted.
fn ids(folder: &Path) -> Result<Vec<String>> {
    let cannot_read = || format!("cannot read {}", folder.display());
    let mut ids = Vec::new();
    for entry in fs::read_dir(folder).with_context(cannot_read)? {
        let name = entry.with_context(cannot_read)?.file_name();
        if input::is_litter(&name) {
            continue;
        }
        ids.extend(name.to_str().and_then(|name| name.strip_suffix("_img.png")).map(str::to_owned));
    }
    ids.sort_unstable();
    Ok(ids)
}

const IMAGE: &str = "img.png";
const MASK: &str = "mask.png";
const UNTOUCHED: &str = "untouched.png";

fn path(folder: &Path, id: &str, rest: &str) -> PathBuf {
    folder.join(format!("{id}_{rest}"))
}

fn open(folder: &Path, id: &str, rest: &str) -> Result<DynamicImage> {
    read_any_image(&path(folder, id, rest))
}

fn colours(folder: &Path, id: &str, rest: &str) -> Result<RgbImage> {
    let image = open(folder, id, rest)?;
    mvt_images::colours(image).with_context(|| path(folder, id, rest).display().to_string())
}

impl Triple {
    fn read(folder: &Path, id: &str, gel: &GelView) -> Result<Self> {
        let path = |rest: &str| path(folder, id, rest);
        let image = colours(folder, id, IMAGE)?;
        let mask = levels(open(folder, id, MASK)?).with_context(|| path(MASK).display().to_string())?;
        let untouched = match path(UNTOUCHED).exists() {
            true => Some(colours(folder, id, UNTOUCHED)?),
            false => None,
        };
        let depth_path = path("depth_m.npy");
        let depth_m = npy::read(&depth_path).with_context(|| format!("cannot read {}", depth_path.display()))?;
        let &[rows, columns] = depth_m.shape() else {
            bail!("{} has the shape {:?} and not two axes", depth_path.display(), depth_m.shape());
        };
        let depth_m = Array2::from_shape_vec((rows, columns), depth_m.to_f64().map(|z| z as f32).collect())?;
        let depth_size = (depth_m.ncols() as u32, depth_m.nrows() as u32);
        let mut sizes = vec![(image.dimensions(), IMAGE), (mask.dimensions(), MASK), (depth_size, "depth_m.npy")];
        sizes.extend(untouched.as_ref().map(|image| (image.dimensions(), UNTOUCHED)));
        let (width, height) = (gel.camera().width, gel.camera().height);
        for ((columns, rows), name) in sizes {
            ensure!(
                (columns, rows) == (width as u32, height as u32),
                "{} is {columns} x {rows} pixels; images of this sensor are {width} wide and {height} high: give its --profile",
                path(name).display()
            );
        }
        ensure!(depth_m.iter().all(|d| d.is_finite()), "{} contains NaN or infinity", depth_path.display());
        Ok(Self { image, depth_m, mask, untouched })
    }

    /// Returns the indentation of the gel and the contact of each pixel.
    fn truth(&self, gel: &GelView) -> impl Iterator<Item = Pixel> {
        self.depth_m.indexed_iter().zip(self.mask.iter()).map(move |(((v, u), depth), level)| {
            let gel_m = gel.surface().point(gel.camera(), u as f64, v as f64).coords().x;
            Pixel { millimetres: ((gel_m - f64::from(*depth)) * 1e3) as f32, contact: *level > 127 }
        })
    }
}
