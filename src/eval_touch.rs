//! `eval-touch`: how exact a network is on touch images whose truth is known.

use std::fs;
use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Context as _, Result, ensure};
use clap::Args;
use image::imageops::{FilterType::Triangle, resize};
use image::{DynamicImage, GrayImage, ImageBuffer, Luma, RgbImage};
use mvt_products::Instructions;
use mvt_robot::digit::{HEIGHT, WIDTH, gel};
use mvt_touch::accuracy::{Accuracy, Pixel, Scores};
use mvt_touch::engine::{Engine, Prediction};
use mvt_touch::network::Weights;
use mvt_touch::untouched::{estimate, is_of_same_sensor, subtract_untouched};
use ndarray::Array2;
use ndarray_npy::read_npy;
use serde::Serialize;

use crate::network::ImageSize;
use mvt_run::io::print_line;

/// Score a touch network on images whose truth is known
///
/// DIR holds triples: ID_img.png (RGB, 240 x 320), ID_depth_m.npy (32-bit floats, 320 x 240, metres along the camera's axis) and
/// ID_mask.png (contact where over 127); and perhaps ID_untouched.png, what the sensor shows without contact, which is taken off before
/// the network sees an image. Where there is none, it is had from all images, if they are of one sensor.
#[derive(Debug, Args)]
pub struct Arguments {
    /// Weights: safetensors as `train` writes them
    #[arg(long)]
    weights: PathBuf,
    /// Folder of the triples
    #[arg(long)]
    data: PathBuf,
    /// Leave out images in which the object is deeper in the gel than this anywhere, mm
    #[arg(long)]
    deepest_mm: Option<f32>,
    /// Size that images are resized to before they enter the network, WIDTHxHEIGHT or the side of a square; what it makes of them is resized
    /// back and scored at the sensor's size
    #[arg(long, value_name = "SIZE")]
    input: Option<ImageSize>,
    /// Take nothing off: the network sees images as they are
    #[arg(long)]
    as_they_are: bool,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// What is printed.
#[derive(Debug, Serialize)]
struct Report {
    #[serde(flatten)]
    scores: Scores,
    ms_per_image: f64,
    /// Of how many images what the sensor shows without contact was in a file, had from all, and was not known.
    untouched: Untouched,
}

/// Of how many images it is known what their sensor shows without contact, and from where.
#[derive(Debug, Default, Clone, Copy, Serialize)]
struct Untouched {
    file: usize,
    images: usize,
    unknown: usize,
}

/// A touch image with its truth.
struct Triple {
    image: RgbImage,
    depth_m: Array2<f32>,
    mask: GrayImage,
    untouched: Option<RgbImage>,
}

/// Runs the command.
pub fn run(arguments: &Arguments) -> Result<()> {
    let engine = Engine::new(&Weights::read(&arguments.weights)?, Instructions::best());
    let ids = ids(&arguments.data)?;
    ensure!(!ids.is_empty(), "{} holds no *_img.png", arguments.data.display());
    let common = if arguments.as_they_are { None } else { common_untouched(&engine, &arguments.data, &ids)? };
    let (mut accuracy, mut busy_s, mut prediction) = (Accuracy::default(), 0.0, Prediction::default());
    let mut untouched = Untouched::default();
    for id in &ids {
        let mut triple = Triple::read(&arguments.data, id)?;
        if arguments.deepest_mm.is_some_and(|most| triple.truth().any(|pixel| pixel.millimetres > most)) {
            continue;
        }
        let own = if arguments.as_they_are { None } else { triple.untouched.take() };
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
        accuracy.add(Pixel::all(&prediction).zip(triple.truth()));
    }
    let scores = accuracy.scores();
    ensure!(scores.images > 0, "every image is deeper than --deepest-mm");
    let report = Report { scores, ms_per_image: 1e3 * busy_s / scores.images as f64, untouched };
    if arguments.json {
        return print_line(&serde_json::to_string_pretty(&report)?);
    }
    let Untouched { file, images: common, unknown } = untouched;
    let Scores { images, rmse_mm, mae_mm, contact_mae_mm, contact_rmse_mm, iou, .. } = scores;
    print_line(&format!(
        "{images} images, {:.1} ms each\nall pixels: MAE {mae_mm:.4} mm, RMSE {rmse_mm:.4} mm\n\
         contact: MAE {contact_mae_mm:.4} mm, RMSE {contact_rmse_mm:.4} mm, IoU {iou:.4}\n\
         untouched sensor: of {file} images in a file, of {common} had from all images, of {unknown} not known",
        report.ms_per_image
    ))
}

/// What a network makes of an image at another size, at the image's size.
fn infer_at(engine: &Engine, image: &RgbImage, size: ImageSize) -> Result<Prediction> {
    let (width, height) = image.dimensions();
    let mut prediction = Prediction::default();
    engine.infer(&resize(image, size.width, size.height, Triangle), &mut prediction)?;
    let back = |plane: Array2<f32>| -> Result<Array2<f32>> {
        let plane =
            ImageBuffer::<Luma<f32>, _>::from_raw(size.width, size.height, plane.into_iter().collect::<Vec<_>>());
        let plane = resize(&plane.context("a prediction of another size than its image")?, width, height, Triangle);
        Ok(Array2::from_shape_vec((height as usize, width as usize), plane.into_raw())?)
    };
    let Prediction { indentation_mm, contact_logit } = prediction;
    Ok(Prediction { indentation_mm: back(indentation_mm)?, contact_logit: back(contact_logit)? })
}

/// In fewer images than this contacts may be at the same place.
const LEAST_IMAGES: usize = 15;
/// No more images than this are looked at, evenly spread: enough for a median, and little memory.
const MOST_IMAGES: usize = 500;

/// What the sensor of all images shows without contact; none if they are not of one sensor, or have files of their own.
fn common_untouched(engine: &Engine, folder: &Path, ids: &[String]) -> Result<Option<RgbImage>> {
    if ids.len() < LEAST_IMAGES || ids.iter().all(|id| path(folder, id, UNTOUCHED).exists()) {
        return Ok(None);
    }
    let some = ids.iter().step_by(ids.len().div_ceil(MOST_IMAGES));
    let images = some.map(|id| Ok(open(folder, id, IMAGE)?.to_rgb8())).collect::<Result<Vec<_>>>()?;
    let Some(common) = estimate(engine, &images)? else { return Ok(None) };
    let fitting = images.iter().filter(|image| is_of_same_sensor(image, &common)).count();
    Ok((10 * fitting >= 9 * images.len()).then_some(common))
}

/// What the names of the triples start with, in order.
fn ids(folder: &Path) -> Result<Vec<String>> {
    let cannot_read = || format!("cannot read {}", folder.display());
    let mut ids = Vec::new();
    for entry in fs::read_dir(folder).with_context(cannot_read)? {
        let name = entry.with_context(cannot_read)?.file_name();
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
    let path = path(folder, id, rest);
    image::open(&path).with_context(|| format!("{} is no image that can be read", path.display()))
}

impl Triple {
    fn read(folder: &Path, id: &str) -> Result<Self> {
        let path = |rest: &str| path(folder, id, rest);
        let (image, mask) = (open(folder, id, IMAGE)?.to_rgb8(), open(folder, id, MASK)?.to_luma8());
        let untouched = match path(UNTOUCHED).exists() {
            true => Some(open(folder, id, UNTOUCHED)?.to_rgb8()),
            false => None,
        };
        let depth_path = path("depth_m.npy");
        let depth_m: Array2<f32> =
            read_npy(&depth_path).with_context(|| format!("{} is no array of 32-bit floats", depth_path.display()))?;
        let depth_size = (depth_m.ncols() as u32, depth_m.nrows() as u32);
        let mut sizes = vec![(image.dimensions(), IMAGE), (mask.dimensions(), MASK), (depth_size, "depth_m.npy")];
        sizes.extend(untouched.as_ref().map(|image| (image.dimensions(), UNTOUCHED)));
        for ((columns, rows), name) in sizes {
            ensure!(
                (columns, rows) == (WIDTH as u32, HEIGHT as u32),
                "{} is {columns} x {rows} pixels; a DIGIT's image is {WIDTH} wide and {HEIGHT} high",
                path(name).display()
            );
        }
        ensure!(depth_m.iter().all(|d| d.is_finite()), "{} holds what is no number", depth_path.display());
        Ok(Self { image, depth_m, mask, untouched })
    }

    /// Indentation over the empty gel and contact of each pixel.
    fn truth(&self) -> impl Iterator<Item = Pixel> {
        self.depth_m.indexed_iter().zip(self.mask.iter()).map(|(((v, u), depth), level)| {
            let gel_m = gel::point(u as f64, v as f64).coords().x;
            Pixel { millimetres: ((gel_m - f64::from(*depth)) * 1e3) as f32, contact: *level > 127 }
        })
    }
}
