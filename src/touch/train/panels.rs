//! `panels.png`: predictions for some validation images beside the truth.

use std::path::Path;

use anyhow::{Context as _, Result};
use image::{Rgb, RgbImage};
use mvt_files::output;
use mvt_presses::Example;
use mvt_run::io::png;
use mvt_touch::engine::Prediction;

/// Indentation that is drawn white, and error that is drawn in full red or blue, millimetres.
const DEEPEST_MM: f32 = 1.5;
const ERROR_MM: f32 = 0.2;

/// Writes a row per image: the image, its true indentation, the predicted one, their difference (red: too deep, blue:
/// too shallow), and contact (green: both, red: predicted only, blue: missed).
pub fn write<'a>(path: &Path, examples: impl ExactSizeIterator<Item = (&'a Example, &'a Prediction)>) -> Result<()> {
    let mut examples = examples.peekable();
    let [rows, columns] = examples.peek().map_or([0, 0], |(example, _)| example.size);
    let mut image = RgbImage::new(5 * columns as u32, (examples.len() * rows) as u32);
    for (k, (example, prediction)) in examples.enumerate() {
        for (at, (&mm, &logit)) in prediction.indentation_mm.iter().zip(&prediction.contact_logit).enumerate() {
            let (truth_mm, contact) = (example.indentation_mm[at], example.contact[at] > 0.5);
            let grey = |mm: f32| Rgb([(mm / DEEPEST_MM * 255.0) as u8; 3]);
            let error = (mm - truth_mm) / ERROR_MM;
            let fade = 255 - (error.abs() * 255.0) as u8;
            let agreement = match (logit > 0.0, contact) {
                (true, true) => [0, 158, 115],
                (true, false) => [213, 94, 0],
                (false, true) => [0, 114, 178],
                (false, false) => [30, 30, 30],
            };
            let panels = [
                Rgb([example.levels[3 * at], example.levels[3 * at + 1], example.levels[3 * at + 2]]),
                grey(truth_mm),
                grey(mm),
                Rgb(if error > 0.0 { [255, fade, fade] } else { [fade, fade, 255] }),
                Rgb(agreement),
            ];
            for (panel, colour) in panels.into_iter().enumerate() {
                image.put_pixel((panel * columns + at % columns) as u32, (k * rows + at / columns) as u32, colour);
            }
        }
    }
    output::replace(path, &png(&image)?).with_context(|| format!("cannot write {}", path.display()))
}
