//! Small films of runs for the page: some JPEG pictures, which the page shows one after the other.

use mvt_images::{Chroma, encode_jpeg};
use mvt_recording::Recording;
use mvt_recording::image::RgbImage;
use mvt_viewer::mvt_picture::palette::Theme;
use mvt_viewer::{Dashboard, DashboardLayout, Eye, Layers, Preset};
use serde_json::{Value, json};

use crate::encode::base64;

/// Pictures of a film.
const PICTURES: usize = 20;
/// Width and height of a picture, pixels.
const SIZE: [u32; 2] = [848, 480];
/// Quality of the pictures of a film, 1 to 100: letters are readable.
const QUALITY: u8 = 50;

/// Film of a run.
#[derive(Debug, Clone, PartialEq)]
pub struct PageFilm {
    /// JPEG pictures in base64 and their times in seconds, as the page reads them.
    pub pictures: Value,
    /// JPEG in base64 of the moment with the largest error; of the last moment if no error is known.
    pub poster: String,
    /// Time of that moment, seconds.
    pub poster_s: f64,
}

impl PageFilm {
    /// Paints the film of a recording; `None` if it has no frame.
    ///
    /// # Errors
    /// Those of the encoder, as a line.
    pub fn new(recording: &Recording) -> Result<Option<Self>, String> {
        let moments = recording.moments();
        let Some(last) = moments.len().checked_sub(1) else { return Ok(None) };
        let eye = Eye::of(recording, Preset::Oblique);
        let mut page = Dashboard::new(DashboardLayout::All, SIZE, Layers::default(), Theme::LIGHT);
        let mut picture = |moment: usize| jpeg(&page.paint(recording, moment, &eye)).map(|bytes| base64(&bytes));
        let time_s = |moment: usize| moments.get(moment).map_or(0.0, |moment| moment.row.time_s);
        let count = PICTURES.min(moments.len());
        let mut pictures = Vec::with_capacity(count);
        for k in 0..count {
            let moment = last * k / (count - 1).max(1);
            pictures.push(json!([time_s(moment), picture(moment)?]));
        }
        let error = |moment: usize| moments.get(moment)?.row.add_s.map(|error| error.one_directional_m);
        let worst = (0..=last).filter(|&moment| error(moment).is_some());
        let worst = worst.max_by(|&a, &b| error(a).unwrap_or(0.0).total_cmp(&error(b).unwrap_or(0.0))).unwrap_or(last);
        Ok(Some(Self { pictures: Value::Array(pictures), poster: picture(worst)?, poster_s: time_s(worst) }))
    }
}

fn jpeg(image: &RgbImage) -> Result<Vec<u8>, String> {
    encode_jpeg(image, QUALITY, Chroma::Half).map_err(|error| error.to_string())
}
