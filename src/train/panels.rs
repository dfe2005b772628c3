//! `panels.png`: what the network makes of some validation images, side by side with the truth.

use std::fs;
use std::path::Path;

use anyhow::{Context as _, Result};
use image::{ImageFormat, Rgb, RgbImage};
use perception::network::Weights;
use perception::train::predict;

use super::batch;
use super::contacts::Example;

/// Indentation that is drawn white, and error that is drawn red or blue, millimetres.
const DEEPEST_MM: f32 = 1.5;
const ERROR_MM: f32 = 0.2;

/// A row per image: the image, its indentation, the predicted one, their difference (red too deep, blue too shallow), and contact
/// (green agreed, red predicted alone, blue missed).
pub fn write(path: &Path, examples: &[Example], weights: &Weights) -> Result<()> {
    let batch = batch(examples);
    let [count, rows, columns] = batch.shape;
    let predicted = predict(weights.architecture(), weights.tensors(), &batch.levels, batch.shape);
    let image = RgbImage::from_fn(5 * columns as u32, (count * rows) as u32, |x, y| {
        let (panel, u) = (x as usize / columns, x as usize % columns);
        let at = y as usize * columns + u;
        let [mm, logit] = predicted[at];
        let (truth_mm, contact) = (batch.targets.indentation_mm[at], batch.targets.contact[at] > 0.5);
        let grey = |mm: f32| Rgb([(mm / DEEPEST_MM * 255.0) as u8; 3]);
        match panel {
            0 => Rgb(std::array::from_fn(|c| batch.levels[3 * at + c])),
            1 => grey(truth_mm),
            2 => grey(mm),
            3 => {
                let error = (mm - truth_mm) / ERROR_MM;
                let fade = 255 - (error.abs() * 255.0) as u8;
                if error > 0.0 { Rgb([255, fade, fade]) } else { Rgb([fade, fade, 255]) }
            }
            _ => match (logit > 0.0, contact) {
                (true, true) => Rgb([0, 158, 115]),
                (true, false) => Rgb([213, 94, 0]),
                (false, true) => Rgb([0, 114, 178]),
                (false, false) => Rgb([30, 30, 30]),
            },
        }
    });
    let partial = path.with_extension("png.part");
    image
        .save_with_format(&partial, ImageFormat::Png)
        .and_then(|()| Ok(fs::rename(&partial, path)?))
        .with_context(|| format!("cannot write {}", path.display()))
}
