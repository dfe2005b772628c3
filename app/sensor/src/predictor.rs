//! Indentation, contact and figures of images of one sensor, and their files.

use std::path::PathBuf;

use anyhow::Result;
use image::{GrayImage, Luma, Rgb, RgbImage};
use mvt_feelsight::array::Array;
use mvt_feelsight::npy;
use mvt_files::cells::quoted;
use mvt_files::folder::{ClaimedFolder, Earlier};
use mvt_picture::palette;
use mvt_robot::digit::profile::SensorProfile;
use mvt_robot::observation::Press;
use mvt_run::io::{png, write_file};
use mvt_shear::{ShearField, ShearFit, ShearSensor};
use mvt_touch::contact::{ContactConfig, Felt, TouchSensor};
use mvt_touch::engine::Engine;
use mvt_touch::figures::{GelScale, PressFigures};
use mvt_viewer::live::LiveFrame;
use ndarray::Array2;
use rayon::prelude::*;
use serde::Serialize;

use crate::pictures;

/// A line of predictions.csv.
#[derive(Debug, Clone, Serialize)]
pub(crate) struct Line {
    pub id: String,
    #[serde(flatten)]
    pub press: PressFigures,
    pub plausibility: f32,
    /// `None` for a sensor without dots.
    #[serde(flatten)]
    pub shear: Option<ShearFigures>,
}

impl Line {
    /// Returns whether the sensor has dots of which too few were found.
    pub fn has_lost_dots(&self) -> bool {
        self.shear.is_some_and(|shear| shear.dots == 0)
    }
}

/// Shear of an image; all are 0 without contact.
#[derive(Debug, Clone, Copy, Default, Serialize)]
pub(crate) struct ShearFigures {
    /// Displacement of the gel at the contact to the right and downwards.
    pub shear_right_mm: f64,
    pub shear_down_mm: f64,
    /// Turn of the gel at the contact, from right to down.
    pub twist_deg: f64,
    pub dilation: f64,
    /// Root mean square of the motion of the dots that these figures do not explain.
    pub shear_residual_mm: f64,
    /// Dots that were found again; with less than half of them the shear is unknown, and the figures are 0.
    pub dots: usize,
}

impl From<ShearFit> for ShearFigures {
    fn from(fit: ShearFit) -> Self {
        let [shear_right_mm, shear_down_mm] = fit.shear.displacement_mm;
        Self {
            shear_right_mm,
            shear_down_mm,
            twist_deg: fit.shear.twist_rad.to_degrees(),
            dilation: fit.dilation,
            shear_residual_mm: fit.residual_mm,
            dots: 0,
        }
    }
}

/// The contact that is found in an image.
pub(crate) struct Reading {
    pub line: Line,
    indentation_mm: Array2<f32>,
    contact: Array2<bool>,
    /// `None` for a sensor without dots, and where they are not found.
    field: Option<ShearField>,
}

/// Indentation that a picture shows brightest, millimetres.
const DEEPEST_SHOWN_MM: f32 = 1.5;

/// The settings for images of one sensor.
pub(crate) struct Predictor {
    pub engine: Engine,
    pub profile: SensorProfile,
    config: ContactConfig,
    sensor: TouchSensor,
    /// Sees the motion of the dots, for a sensor that has some.
    shear: Option<ShearSensor>,
    scale: GelScale,
    out: Option<OutFolder>,
}

/// Folder of the results.
struct OutFolder {
    path: PathBuf,
    _claimed: ClaimedFolder,
}

impl Predictor {
    /// Returns a predictor that writes no files.
    pub fn new(engine: Engine, profile: &SensorProfile, config: ContactConfig) -> Self {
        let sensor = TouchSensor::new(&engine, profile);
        Self { engine, profile: profile.clone(), config, sensor, shear: None, scale: GelScale::new(profile), out: None }
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

    /// Sets the untouched image of the sensor, which must stand upright.
    ///
    /// # Errors
    /// If the sensor has dots that the image does not show.
    pub fn set_untouched(&mut self, untouched: &RgbImage) -> Result<()> {
        self.shear = match self.profile.markers {
            Some(_) => Some(ShearSensor::new(&self.profile, untouched)?),
            None => None,
        };
        let seen = self.for_network(untouched);
        self.sensor.set_untouched(&self.engine, &seen)?;
        let light = self.sensor.light();
        if !light.is_usual() {
            tracing::warn!("{light}");
        }
        Ok(())
    }

    /// Returns an image as the network sees it: without dots, which it does not know.
    fn for_network(&self, image: &RgbImage) -> RgbImage {
        self.shear.as_ref().map_or_else(|| image.clone(), |shear| shear.erased(image))
    }

    /// Returns whether files are written.
    pub fn writes(&self) -> bool {
        self.out.is_some()
    }

    /// Reads images, one per thread, and writes their files.
    ///
    /// # Errors
    /// If files cannot be written.
    pub fn predict(&self, ids: &[String], images: &[RgbImage]) -> Result<Vec<Reading>> {
        let seen: Vec<RgbImage> = images.par_iter().map(|image| self.for_network(image)).collect();
        let felt = self.sensor.feel_each(&self.engine, &self.config, &seen)?;
        let each = ids.par_iter().zip(images).zip(felt);
        each.map(|((id, image), felt)| {
            let reading = self.reading(id, image, felt);
            self.write(id, image, &reading)?;
            Ok(reading)
        })
        .collect()
    }

    /// Writes the table of all images, and returns words that say where it is.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn write_table(&self, lines: &[Line]) -> Result<String> {
        let Some(OutFolder { path, .. }) = &self.out else { return Ok(String::new()) };
        let mut names = vec!["id", "area_mm2", "deepest_mm", "volume_mm3", "force_n", "force_sigma_n", "plausibility"];
        if self.shear.is_some() {
            names.extend(["shear_right_mm", "shear_down_mm", "twist_deg", "dilation", "shear_residual_mm", "dots"]);
        }
        let mut table = names.join(",") + "\n";
        for Line { id, press, plausibility, shear } in lines {
            let PressFigures { area_mm2, deepest_mm, volume_mm3, force_n, force_sigma_n } = press;
            let mut cells = vec![quoted(id).into_owned(), format!("{area_mm2:.3}"), format!("{deepest_mm:.4}")];
            cells.extend([volume_mm3, force_n, force_sigma_n].map(|figure| format!("{figure:.4}")));
            cells.push(format!("{plausibility:.3}"));
            if let Some(shear) = shear {
                let ShearFigures { shear_right_mm, shear_down_mm, twist_deg, dilation, shear_residual_mm, dots } =
                    shear;
                let four = |value: &f64| format!("{value:.4}");
                cells.extend([four(shear_right_mm), four(shear_down_mm), format!("{twist_deg:.2}")]);
                cells.extend([format!("{dilation:.3}"), four(shear_residual_mm), dots.to_string()]);
            }
            table += &(cells.join(",") + "\n");
        }
        write_file(path, "predictions.csv", table.as_bytes())?;
        Ok(format!("; see {}", path.join("predictions.csv").display()))
    }

    /// Returns what was felt in an image.
    fn reading(&self, id: &str, image: &RgbImage, felt: Felt) -> Reading {
        let Felt { press, plausibility, .. } = felt;
        let none = || Press {
            indentation_mm: Array2::zeros(self.profile.shape()),
            contact: Array2::from_elem(self.profile.shape(), false),
            sigma_mm: 0.0,
        };
        let press = press.unwrap_or_else(none);
        let figures = self.scale.figures(&press);
        let Press { indentation_mm, contact, .. } = press;
        // Images of this size are the only ones that the network reads.
        let field = self.shear.as_ref().and_then(|shear| shear.see(image, &contact, &indentation_mm).ok());
        let of_dots = |field: &ShearField| ShearFigures {
            dots: field.dots.len(),
            ..field.fit.map(ShearFigures::from).unwrap_or_default()
        };
        let shear = self.shear.is_some().then(|| field.as_ref().map(of_dots).unwrap_or_default());
        let line = Line { id: id.to_owned(), press: figures, plausibility, shear };
        Reading { line, indentation_mm, contact, field }
    }

    /// Writes the files of an image.
    fn write(&self, id: &str, image: &RgbImage, reading: &Reading) -> Result<()> {
        let Some(OutFolder { path, .. }) = &self.out else { return Ok(()) };
        let Reading { indentation_mm, contact, field, .. } = reading;
        let depth = Array::from_f32(self.profile.shape().to_vec(), indentation_mm.iter().copied());
        write_file(path, &format!("{id}_indentation_mm.npy"), &npy::to_bytes(&depth))?;
        let touches = |u: u32, v: u32| contact[[v as usize, u as usize]];
        let [width, height] = self.profile.size_px.map(|side| side as u32);
        let mask = GrayImage::from_fn(width, height, |u, v| Luma([if touches(u, v) { u8::MAX } else { 0 }]));
        write_file(path, &format!("{id}_contact.png"), &png(&mask)?)?;
        let picture = RgbImage::from_fn(3 * width, height, |u, v| {
            let (panel, u) = (u / width, u % width);
            match panel {
                0 => *image.get_pixel(u, v),
                1 => palette::indentation(indentation_mm[[v as usize, u as usize]], DEEPEST_SHOWN_MM),
                _ => Rgb([mask.get_pixel(u, v).0[0]; 3]),
            }
        });
        write_file(path, &format!("{id}_picture.png"), &png(&picture)?)?;
        match field {
            Some(field) => write_file(path, &format!("{id}_shear.png"), &png(&pictures::shear(image, field))?),
            None => Ok(()),
        }
    }
}

impl Reading {
    /// Returns pictures and figures for a window.
    pub fn live(&self, image: &RgbImage, rate_hz: f64) -> LiveFrame {
        let Line { press, plausibility, shear, .. } = &self.line;
        let PressFigures { area_mm2, deepest_mm, volume_mm3, force_n, force_sigma_n } = press;
        let named = |name: &str, value: String| (name.to_owned(), value);
        let mut frame = LiveFrame {
            pictures: vec![
                ("image".to_owned(), image.clone()),
                (
                    "indentation".to_owned(),
                    pictures::indentation(&self.indentation_mm, &self.contact, DEEPEST_SHOWN_MM),
                ),
            ],
            figures: vec![
                named("area", format!("{area_mm2:.1} mm²")),
                named("deepest", format!("{deepest_mm:.2} mm")),
                named("volume", format!("{volume_mm3:.1} mm³")),
                named("force", format!("{force_n:.1} ± {force_sigma_n:.1} N")),
                named("plausibility", format!("{plausibility:.2}")),
                named("frames/s", format!("{rate_hz:.0}")),
            ],
        };
        if let Some(shear) = shear {
            let words = if self.field.is_some() {
                format!("{:+.2}, {:+.2} mm", shear.shear_right_mm, shear.shear_down_mm)
            } else {
                "no dots".to_owned()
            };
            frame.figures.push(named("shear right, down", words));
            frame.figures.push(named("twist", format!("{:+.1}°", shear.twist_deg)));
        }
        if let Some(field) = &self.field {
            frame.pictures.push(("shear".to_owned(), pictures::shear(image, field)));
        }
        frame
    }
}
