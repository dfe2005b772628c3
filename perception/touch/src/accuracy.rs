//! Errors of predicted touch.

use serde::Serialize;

use crate::engine::Prediction;

/// Errors over a set of images. Depth and indentation have the same errors, since the undeformed gel is known.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Scores {
    /// Images.
    pub images: usize,
    /// Root mean square error over all pixels of all images, millimetres.
    pub rmse_mm: f64,
    /// Mean error over all pixels of all images, millimetres.
    pub mae_mm: f64,
    /// Mean error over the pixels that are in contact, millimetres.
    pub contact_mae_mm: f64,
    /// Root mean square error over the pixels that are in contact, millimetres.
    pub contact_rmse_mm: f64,
    /// Pixels of contact in truth and prediction, over pixels of contact in either: the mean over images with contact.
    pub iou: f64,
    /// Images with contact.
    pub contact_images: usize,
    /// Share of the pixels of the other images with predicted contact.
    pub false_contact: f64,
}

/// Running sums of errors, image by image.
#[derive(Debug, Clone, Copy, Default)]
pub struct Accuracy {
    all: Sums,
    contact: Sums,
    images: usize,
    contact_images: usize,
    iou: f64,
    idle: usize,
    false_contact: usize,
}

/// Sums over pixels.
#[derive(Debug, Clone, Copy, Default)]
struct Sums {
    count: usize,
    absolute: f64,
    square: f64,
}

impl Sums {
    fn add(&mut self, error: f64) {
        self.count += 1;
        self.absolute += error.abs();
        self.square += error * error;
    }

    fn mean(self) -> f64 {
        self.absolute / self.count.max(1) as f64
    }

    fn root(self) -> f64 {
        (self.square / self.count.max(1) as f64).sqrt()
    }
}

/// Pixel of a prediction or of the truth.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pixel {
    /// Indentation, or depth in both prediction and truth, millimetres.
    pub millimetres: f32,
    /// Whether the pixel is in contact.
    pub contact: bool,
}

impl Pixel {
    /// Returns the pixels of a prediction, row by row; a pixel is in contact if the probability exceeds one half.
    pub fn all(prediction: &Prediction) -> impl Iterator<Item = Self> {
        let pixels = prediction.indentation_mm.iter().zip(&prediction.contact_logit);
        pixels.map(|(&millimetres, &logit)| Self { millimetres, contact: logit > 0.0 })
    }
}

impl Accuracy {
    /// Adds an image: pairs of prediction and truth.
    pub fn add(&mut self, pixels: impl Iterator<Item = (Pixel, Pixel)>) {
        let (mut shared, mut either, mut count, mut touched) = (0_usize, 0_usize, 0_usize, false);
        for (predicted, truth) in pixels {
            let error = f64::from(predicted.millimetres) - f64::from(truth.millimetres);
            self.all.add(error);
            if truth.contact {
                self.contact.add(error);
            }
            touched |= truth.contact;
            shared += usize::from(predicted.contact && truth.contact);
            either += usize::from(predicted.contact || truth.contact);
            count += 1;
        }
        self.images += 1;
        if touched {
            self.contact_images += 1;
            self.iou += shared as f64 / either as f64;
        } else {
            self.idle += count;
            self.false_contact += either;
        }
    }

    /// Returns the errors over all images so far.
    pub fn scores(&self) -> Scores {
        Scores {
            images: self.images,
            rmse_mm: self.all.root(),
            mae_mm: self.all.mean(),
            contact_mae_mm: self.contact.mean(),
            contact_rmse_mm: self.contact.root(),
            iou: self.iou / self.contact_images.max(1) as f64,
            contact_images: self.contact_images,
            false_contact: self.false_contact as f64 / self.idle.max(1) as f64,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// By hand, of two images of two and three pixels.
    #[test]
    fn scores_by_hand() {
        let pixel = |millimetres, contact| Pixel { millimetres, contact };
        let mut accuracy = Accuracy::default();
        let predicted = [pixel(1.0, true), pixel(0.5, true)];
        let truth = [pixel(0.6, true), pixel(0.2, false)];
        accuracy.add(predicted.into_iter().zip(truth));
        let empty = [pixel(0.0, false); 3];
        accuracy.add([pixel(0.0, false), pixel(0.1, true), pixel(0.0, false)].into_iter().zip(empty));
        let scores = accuracy.scores();
        let near = |a: f64, b: f64| assert!((a - b).abs() < 1e-6, "{a} for {b}");
        near(scores.mae_mm, 0.8 / 5.0);
        near(scores.rmse_mm, (0.26_f64 / 5.0).sqrt());
        near(scores.contact_mae_mm, 0.4);
        near(scores.contact_rmse_mm, 0.4);
        near(scores.iou, 0.5);
        near(scores.false_contact, 1.0 / 3.0);
        assert_eq!((scores.images, scores.contact_images), (2, 1));
    }
}
