//! Image files of a log, for other containers.

use mvt_robot::hand::PerPad;

use super::Log;
use crate::error::LogError;
use crate::hand::pad_folder;
use crate::io::read_at_most;
use crate::picture::{MAX_FILE, encode_color, encode_exact, encode_png};

/// Image files of one instant, each a JPEG or PNG image.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub struct ImageFiles {
    /// Colours of each camera; `None` if the log has none, or none of this instant.
    pub colours: Vec<Option<Vec<u8>>>,
    /// Labels of each camera, grey: 0 background, 127 hand, 255 object. `None` if the log has none.
    pub labels: Option<Vec<Vec<u8>>>,
    /// Image of each touch sensor; `None` if the log has none, or none of this instant.
    pub touch: PerPad<Option<Vec<u8>>>,
    /// True depth of each touch sensor, in the levels of [`DigitInfo`](crate::DigitInfo), and its contact mask, grey: 0 or 255. `None` if the
    /// log has none.
    pub touch_truth: Option<PerPad<[Vec<u8>; 2]>>,
}

impl Log {
    /// Reads the image files of a frame. They are those of the log to the byte, with two exceptions: images of a camera whose lens distorts
    /// are straightened and encoded anew, and touch images and depths of a compact log become PNG.
    ///
    /// # Errors
    /// [`LogError`] if a file cannot be read.
    pub fn image_files(&self, frame: usize) -> Result<ImageFiles, LogError> {
        let (mut colours, mut labels) = (Vec::new(), Vec::new());
        for (k, camera) in self.cameras.iter().enumerate() {
            let folder = format!("realsense/{}", camera.name);
            let defect = |defect: String| LogError::defect(self.folder.join(&folder), defect);
            let distorts = self.lenses.get(k).is_some_and(Option::is_some);
            colours.push(match (self.coloured.get(k), distorts) {
                (Some(true), true) => match self.delivered(self.colour(k, frame))? {
                    Some(image) => Some(encode_color(&image).map_err(defect)?),
                    None => None,
                },
                (Some(true), false) => self.delivered(self.stored(&format!("{folder}/image/{frame}"), "jpg"))?,
                _ => None,
            });
            if self.segmentation {
                labels.push(if distorts {
                    encode_exact(&self.straight_labels(k, frame)?).map_err(defect)?
                } else {
                    self.stored(&format!("{folder}/seg/{frame}"), "png")?
                });
            }
        }
        let pads = 0..self.hand.pads().len();
        let touch = |pad: usize| {
            let folder = pad_folder(&self.hand, pad);
            if !self.has_touch_images(pad) {
                return Ok(None);
            }
            if self.compact.is_none() {
                return self.delivered(self.stored(&format!("{folder}/image/{frame}"), "jpg"));
            }
            let Some(image) = self.delivered(self.touch_image(pad, frame))? else { return Ok(None) };
            let file = encode_png(&image).map_err(|defect| LogError::defect(self.folder.join(folder), defect))?;
            Ok(Some(file))
        };
        let touch = pads.clone().map(touch).collect::<Result<_, LogError>>()?;
        let truth = |pad: usize| {
            let folder = pad_folder(&self.hand, pad);
            let depth = match &self.compact {
                None => self.stored(&format!("{folder}/depth/{frame}"), "jpg")?,
                Some(frames) => encode_exact(&frames.touch_levels(pad, frame)?)
                    .map_err(|defect| LogError::defect(self.folder.join(&folder), defect))?,
            };
            Ok([depth, self.stored(&format!("{folder}/mask/{frame}"), "png")?])
        };
        let touch_truth = self.touch_labels.then(|| pads.map(truth).collect::<Result<_, LogError>>()).transpose()?;
        Ok(ImageFiles { colours, labels: self.segmentation.then_some(labels), touch, touch_truth })
    }

    /// Reads a file by its name without extension: `extension` is that in an archive, folders have `.jpg` throughout.
    fn stored(&self, name: &str, extension: &str) -> Result<Vec<u8>, LogError> {
        match &self.compact {
            Some(frames) => frames.archive.read(&format!("{name}.{extension}"), MAX_FILE),
            None => read_at_most(&self.folder.join(format!("{name}.jpg")), MAX_FILE),
        }
    }
}
