//! `touch predict`: indentation and contact from images of a touch sensor.

use std::path::{Path, PathBuf};

use anyhow::{Result, ensure};
use clap::Args;
use image::{GrayImage, Luma, RgbImage};
use mvt_feelsight::array::Array;
use mvt_feelsight::npy;
use mvt_files::folder::{ClaimedFolder, Earlier};
use mvt_picture::palette;
use mvt_robot::digit::profile::SensorProfile;
use mvt_robot::digit::{HEIGHT, WIDTH, gel};
use mvt_run::io::{png, print_line, write_file};
use mvt_run::progress;
use mvt_touch::contact::plausibility;
use mvt_touch::engine::Prediction;
use rayon::prelude::*;
use serde::Serialize;

use crate::images::{SensorImages, engine, infer};

/// Turn images of a touch sensor into indentation and contact
///
/// DIR receives for each image ID.png or ID_img.png: ID_indentation_mm.npy (32-bit floats, 320 x 240, millimetres),
/// ID_contact.png (white where an object touches) and ID_picture.png (image, indentation and contact side by side); and
/// predictions.csv with a line per image: area in contact, deepest indentation, volume pressed in, and from 0 to 1 how
/// far the image is one that such a sensor makes.
///
/// Images of other sizes are resized. Images of a sensor that lies on its side or stands on its head are turned, and
/// images in BGR order are put into RGB order, each with a warning: the light of the LEDs shows it.
#[derive(Debug, Args)]
pub struct TouchPredictArguments {
    /// Images (.png, .jpg), or folders of them; the file untouched.png and files ID_untouched.png are left out
    #[arg(long, value_name = "PATH", required = true, num_args = 1..)]
    images: Vec<PathBuf>,
    /// Image of the sensor that touches nothing; without it, the median of all images is used, which needs contacts at
    /// different places
    #[arg(long, value_name = "FILE")]
    untouched: Option<PathBuf>,
    /// Sensor: digit (a real DIGIT), tacto (as TACTO renders one), or the path of a profile (.toml)
    #[arg(long, value_name = "NAME", default_value = "digit")]
    profile: String,
    /// Weights of the network (.safetensors); without it, the shipped ones for the profile
    #[arg(long, value_name = "FILE")]
    weights: Option<PathBuf>,
    /// Least indentation of a pixel in contact, millimetres
    #[arg(long, value_name = "MM", default_value_t = 0.1)]
    threshold_mm: f32,
    /// Least probability of contact of a pixel in contact, between 0 and 1
    #[arg(long, value_name = "SHARE", default_value_t = 0.5)]
    probability: f32,
    /// Folder for the results; earlier ones in it are moved to DIR.1, DIR.2 and so on
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Write into a folder that contains other files
    #[arg(long)]
    overwrite: bool,
    /// Print one JSON object instead of words
    #[arg(long)]
    json: bool,
}

/// A line of predictions.csv.
#[derive(Debug, Clone, Serialize)]
struct Line {
    id: String,
    area_mm2: f64,
    deepest_mm: f32,
    volume_mm3: f64,
    plausibility: f32,
}

/// When a pixel is in contact.
#[derive(Debug, Clone, Copy)]
struct ContactRule {
    threshold_mm: f32,
    logit: f32,
}

/// Images that the network sees in one call.
const BATCH: usize = 16;
/// Contacts on a smaller share of the image are discarded.
const LEAST_AREA: f32 = 0.001;

/// Runs `touch predict`.
///
/// # Errors
/// If images or the profile cannot be read, or the results cannot be written.
pub fn predict(arguments: &TouchPredictArguments) -> Result<()> {
    let profile = SensorProfile::load(&arguments.profile)?;
    let gains = profile.gains();
    let engine = engine(&profile, arguments.weights.as_deref())?;
    let (threshold_mm, probability) = (arguments.threshold_mm, arguments.probability);
    ensure!((0.0..=5.0).contains(&threshold_mm), "--threshold-mm {threshold_mm}: give 0 to 5");
    ensure!((0.001..=0.999).contains(&probability), "--probability {probability}: give 0.001 to 0.999");
    let rule = ContactRule { threshold_mm, logit: (probability / (1.0 - probability)).ln() };
    let SensorImages { ids, images, untouched } =
        SensorImages::read(&arguments.images, arguments.untouched.as_deref(), &engine)?;
    let claimed = ClaimedFolder::claim(&arguments.out, "touch predict", Earlier::Move, arguments.overwrite)?;
    if let Some(moved) = claimed.moved() {
        tracing::warn!("{} contained earlier results, which are now in {}", arguments.out.display(), moved.display());
    }
    let bar = progress::bar(images.len() as u64, "images");
    let camera = profile.intrinsics();
    let pixel_mm2: Vec<f64> = (0..HEIGHT * WIDTH)
        .map(|i| 1e6 * (gel::point(&camera, (i % WIDTH) as f64, (i / WIDTH) as f64).coords().x / camera.fx).powi(2))
        .collect();
    let mut lines = Vec::with_capacity(images.len());
    for (ids, images) in ids.chunks(BATCH).zip(images.chunks(BATCH)) {
        let predictions = infer(&engine, gains, &untouched, images)?;
        let files = ids.par_iter().zip(images).zip(&predictions).map(|((id, image), prediction)| {
            let plausibility = plausibility(image, &untouched, prediction);
            bar.inc(1);
            write(&arguments.out, id, image, prediction, rule, &pixel_mm2, plausibility)
        });
        lines.extend(files.collect::<Result<Vec<_>>>()?);
    }
    bar.finish_and_clear();
    let mut table = String::from("id,area_mm2,deepest_mm,volume_mm3,plausibility\n");
    for Line { id, area_mm2, deepest_mm, volume_mm3, plausibility } in &lines {
        table += &format!("{id},{area_mm2:.3},{deepest_mm:.4},{volume_mm3:.4},{plausibility:.3}\n");
    }
    write_file(&arguments.out, "predictions.csv", table.as_bytes())?;
    if arguments.json {
        return print_line(&serde_json::to_string_pretty(&lines)?);
    }
    let touching = lines.iter().filter(|line| line.area_mm2 > 0.0).count();
    let count = lines.len();
    print_line(&format!(
        "{touching} of {count} images show contact; see {}",
        arguments.out.join("predictions.csv").display()
    ))
}

/// Writes the files of an image, and returns its line.
fn write(
    folder: &Path,
    id: &str,
    image: &RgbImage,
    prediction: &Prediction,
    rule: ContactRule,
    pixel_mm2: &[f64],
    plausibility: f32,
) -> Result<Line> {
    let indentation_mm = prediction.indentation_mm.mapv(|mm| mm.max(0.0));
    let touches = |(&mm, &logit): (&f32, &f32)| mm > rule.threshold_mm && logit > rule.logit;
    let mut contact: Vec<bool> = indentation_mm.iter().zip(&prediction.contact_logit).map(touches).collect();
    let touching = contact.iter().filter(|&&touches| touches).count();
    if (touching as f32) < LEAST_AREA * contact.len() as f32 {
        contact.fill(false);
    }
    let mut line = Line { id: id.to_owned(), area_mm2: 0.0, deepest_mm: 0.0, volume_mm3: 0.0, plausibility };
    for ((&mm, &touches), mm2) in indentation_mm.iter().zip(&contact).zip(pixel_mm2) {
        if touches {
            line.area_mm2 += mm2;
            line.deepest_mm = line.deepest_mm.max(mm);
            line.volume_mm3 += f64::from(mm) * mm2;
        }
    }
    let depth = Array::from_f32(vec![HEIGHT, WIDTH], indentation_mm.iter().copied());
    write_file(folder, &format!("{id}_indentation_mm.npy"), &npy::to_bytes(&depth))?;
    let mask = GrayImage::from_fn(WIDTH as u32, HEIGHT as u32, |u, v| {
        Luma([if contact[v as usize * WIDTH + u as usize] { u8::MAX } else { 0 }])
    });
    write_file(folder, &format!("{id}_contact.png"), &png(&mask)?)?;
    let picture = RgbImage::from_fn(3 * WIDTH as u32, HEIGHT as u32, |u, v| {
        let (panel, u) = (u as usize / WIDTH, u % WIDTH as u32);
        match panel {
            0 => *image.get_pixel(u, v),
            1 => palette::indentation(indentation_mm[[v as usize, u as usize]], DEEPEST_SHOWN_MM),
            _ => image::Rgb([mask.get_pixel(u, v).0[0]; 3]),
        }
    });
    write_file(folder, &format!("{id}_picture.png"), &png(&picture)?)?;
    Ok(line)
}

/// Indentation that a picture shows brightest, millimetres.
const DEEPEST_SHOWN_MM: f32 = 1.5;
