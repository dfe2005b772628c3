//! Indentation, contact and figures of images of one sensor, and their files.

use std::path::PathBuf;

use anyhow::{Result, ensure};
use image::{GrayImage, Luma, Rgb, RgbImage};
use mvt_feelsight::array::Array;
use mvt_feelsight::npy;
use mvt_files::folder::{ClaimedFolder, Earlier};
use mvt_picture::palette;
use mvt_robot::digit::profile::SensorProfile;
use mvt_robot::digit::{HEIGHT, WIDTH};
use mvt_run::io::{png, write_file};
use mvt_touch::contact::plausibility;
use mvt_touch::engine::{Engine, Prediction};
use rayon::prelude::*;
use serde::Serialize;

use crate::images::infer;

/// A line of predictions.csv.
#[derive(Debug, Clone, Serialize)]
pub(crate) struct Line {
    pub id: String,
    /// Area in contact.
    pub area_mm2: f64,
    pub deepest_mm: f32,
    pub volume_mm3: f64,
    pub plausibility: f32,
}

/// When a pixel is in contact.
#[derive(Debug, Clone, Copy)]
pub(crate) struct ContactRule {
    threshold_mm: f32,
    logit: f32,
}

impl ContactRule {
    /// Returns the rule for a least indentation and a least probability of contact.
    ///
    /// # Errors
    /// If one is out of range.
    pub fn new(threshold_mm: f32, probability: f32) -> Result<Self> {
        ensure!((0.0..=5.0).contains(&threshold_mm), "--threshold-mm {threshold_mm}: give 0 to 5");
        ensure!((0.001..=0.999).contains(&probability), "--probability {probability}: give 0.001 to 0.999");
        Ok(Self { threshold_mm, logit: (probability / (1.0 - probability)).ln() })
    }
}

/// Contacts on a smaller share of the image are discarded.
const LEAST_AREA: f32 = 0.001;
/// Indentation that a picture shows brightest, millimetres.
const DEEPEST_SHOWN_MM: f32 = 1.5;

/// What is needed to read images of one sensor.
pub(crate) struct Predictor {
    pub engine: Engine,
    gains: [f32; 3],
    rule: ContactRule,
    /// Area of the gel that a pixel sees, row by row.
    pixel_mm2: Vec<f64>,
    out: Option<OutFolder>,
}

/// Folder of the results.
struct OutFolder {
    path: PathBuf,
    _claimed: ClaimedFolder,
}

impl Predictor {
    /// Returns a predictor that writes no files.
    pub fn new(engine: Engine, profile: &SensorProfile, rule: ContactRule) -> Self {
        let camera = profile.intrinsics();
        let gel = profile.gel_surface();
        let side_m = |i: usize| gel.point(&camera, (i % WIDTH) as f64, (i / WIDTH) as f64).coords().x / camera.fx;
        let pixel_mm2 = (0..HEIGHT * WIDTH).map(|i| 1e6 * side_m(i).powi(2)).collect();
        Self { engine, gains: profile.gains(), rule, pixel_mm2, out: None }
    }

    /// Writes files into a folder from now on.
    ///
    /// # Errors
    /// If the folder cannot be used.
    pub fn write_into(&mut self, path: PathBuf, overwrite: bool) -> Result<()> {
        let claimed = ClaimedFolder::claim(&path, "touch predict", Earlier::Move, overwrite)?;
        if let Some(moved) = claimed.moved() {
            tracing::warn!("{} contained earlier results, which are now in {}", path.display(), moved.display());
        }
        self.out = Some(OutFolder { path, _claimed: claimed });
        Ok(())
    }

    /// Returns whether files are written.
    pub fn writes(&self) -> bool {
        self.out.is_some()
    }

    /// Reads images, one per thread, writes their files, and returns their lines.
    ///
    /// # Errors
    /// If files cannot be written.
    pub fn predict(&self, ids: &[String], images: &[RgbImage], untouched: &RgbImage) -> Result<Vec<Line>> {
        let predictions = infer(&self.engine, self.gains, untouched, images)?;
        let each = ids.par_iter().zip(images).zip(&predictions);
        each.map(|((id, image), prediction)| self.line(id, image, untouched, prediction)).collect()
    }

    /// Writes the table of all images, and returns words that say where it is.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn write_table(&self, lines: &[Line]) -> Result<String> {
        let Some(OutFolder { path, .. }) = &self.out else { return Ok(String::new()) };
        let mut table = String::from("id,area_mm2,deepest_mm,volume_mm3,plausibility\n");
        for Line { id, area_mm2, deepest_mm, volume_mm3, plausibility } in lines {
            table += &format!("{id},{area_mm2:.3},{deepest_mm:.4},{volume_mm3:.4},{plausibility:.3}\n");
        }
        write_file(path, "predictions.csv", table.as_bytes())?;
        Ok(format!("; see {}", path.join("predictions.csv").display()))
    }

    /// Returns the line of an image, and writes its files.
    fn line(&self, id: &str, image: &RgbImage, untouched: &RgbImage, prediction: &Prediction) -> Result<Line> {
        let rule = self.rule;
        let indentation_mm = prediction.indentation_mm.mapv(|mm| mm.max(0.0));
        let touches = |(&mm, &logit): (&f32, &f32)| mm > rule.threshold_mm && logit > rule.logit;
        let mut contact: Vec<bool> = indentation_mm.iter().zip(&prediction.contact_logit).map(touches).collect();
        let touching = contact.iter().filter(|&&touches| touches).count();
        if (touching as f32) < LEAST_AREA * contact.len() as f32 {
            contact.fill(false);
        }
        let plausibility = plausibility(image, untouched, prediction);
        let mut line = Line { id: id.to_owned(), area_mm2: 0.0, deepest_mm: 0.0, volume_mm3: 0.0, plausibility };
        for ((&mm, &touches), mm2) in indentation_mm.iter().zip(&contact).zip(&self.pixel_mm2) {
            if touches {
                line.area_mm2 += mm2;
                line.deepest_mm = line.deepest_mm.max(mm);
                line.volume_mm3 += f64::from(mm) * mm2;
            }
        }
        let Some(OutFolder { path, .. }) = &self.out else { return Ok(line) };
        let depth = Array::from_f32(vec![HEIGHT, WIDTH], indentation_mm.iter().copied());
        write_file(path, &format!("{id}_indentation_mm.npy"), &npy::to_bytes(&depth))?;
        let mask = GrayImage::from_fn(WIDTH as u32, HEIGHT as u32, |u, v| {
            Luma([if contact[v as usize * WIDTH + u as usize] { u8::MAX } else { 0 }])
        });
        write_file(path, &format!("{id}_contact.png"), &png(&mask)?)?;
        let picture = RgbImage::from_fn(3 * WIDTH as u32, HEIGHT as u32, |u, v| {
            let (panel, u) = (u as usize / WIDTH, u % WIDTH as u32);
            match panel {
                0 => *image.get_pixel(u, v),
                1 => palette::indentation(indentation_mm[[v as usize, u as usize]], DEEPEST_SHOWN_MM),
                _ => Rgb([mask.get_pixel(u, v).0[0]; 3]),
            }
        });
        write_file(path, &format!("{id}_picture.png"), &png(&picture)?)?;
        Ok(line)
    }
}
