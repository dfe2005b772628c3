//! What training makes small.

use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::tape::{Kernel, View};
use crate::network::Tensor;

/// What an error in indentation costs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Penalty {
    /// Its square.
    Mse,
    /// Its size. Of targets that are mostly zero it learns the median, which is zero: give contact more weight.
    L1,
    /// Its size, but the square near zero.
    Huber,
}

/// Loss of a batch: mean over all pixels of the weighted penalty, plus the weighted cross-entropy of contact.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LossConfig {
    /// What an error in indentation costs.
    pub penalty: Penalty,
    /// Where `huber` goes from square to straight, millimetres.
    pub huber_mm: f32,
    /// Weight of a pixel in contact, where the others have 1.
    pub contact_weight: f32,
    /// Weight of the cross-entropy of contact against the penalty in (square) millimetres.
    pub segmentation: f32,
}

impl Default for LossConfig {
    fn default() -> Self {
        Self { penalty: Penalty::Huber, huber_mm: 0.02, contact_weight: 3.0, segmentation: 0.1 }
    }
}

/// What a batch should have been.
#[derive(Debug, Clone, Default)]
pub struct Targets {
    /// Indentation of each pixel, millimetres.
    pub indentation_mm: Vec<f32>,
    /// How much of each pixel is in contact, 0 to 1.
    pub contact: Vec<f32>,
}

/// The loss as an op of the network's output; its result is one number.
#[derive(Debug, Clone)]
pub struct Loss {
    /// Which loss.
    pub config: LossConfig,
    /// What the batch should have been.
    pub targets: Arc<Targets>,
    /// Which of the batch's pixels the output has, from this one on; the mean is over all.
    pub first: usize,
}

impl Loss {
    /// Loss and slopes of each of the output's pixels, before the mean.
    fn pixels(&self, output: View<'_>) -> impl Iterator<Item = (f32, [f32; 2])> {
        let Targets { indentation_mm, contact } = &*self.targets;
        let targets = indentation_mm.iter().zip(contact).skip(self.first);
        output
            .values
            .as_chunks::<2>()
            .0
            .iter()
            .zip(targets)
            .map(|(pixel, (target, contact))| self.pixel(*pixel, *target, *contact))
    }

    /// Loss and slopes by indentation and logit, of one pixel, before the mean.
    fn pixel(&self, [indentation, logit]: [f32; 2], target: f32, contact: f32) -> (f32, [f32; 2]) {
        let LossConfig { penalty, huber_mm, contact_weight, segmentation } = self.config;
        let weight = 1.0 + (contact_weight - 1.0) * contact;
        let error = indentation - target;
        let (cost, slope) = match penalty {
            Penalty::Mse => (error * error, 2.0 * error),
            Penalty::L1 => (error.abs(), if error == 0.0 { 0.0 } else { error.signum() }),
            Penalty::Huber if error.abs() < huber_mm => (0.5 * error * error / huber_mm, error / huber_mm),
            Penalty::Huber => (error.abs() - 0.5 * huber_mm, error.signum()),
        };
        let fading = (-logit.abs()).exp();
        let entropy = logit.max(0.0) - logit * contact + fading.ln_1p();
        let probability = if logit >= 0.0 { 1.0 / (1.0 + fading) } else { fading / (1.0 + fading) };
        (weight * cost + segmentation * entropy, [weight * slope, segmentation * (probability - contact)])
    }
}

impl Kernel<1> for Loss {
    type Kept = ();

    fn forward(&self, [output]: [View<'_>; 1]) -> (Tensor, ()) {
        let sum: f64 = self.pixels(output).map(|(cost, _)| f64::from(cost)).sum();
        (Tensor { shape: vec![1], values: vec![(sum / self.targets.contact.len() as f64) as f32] }, ())
    }

    fn backward(&self, [output]: [View<'_>; 1], (): &(), gradient: View<'_>, _: [bool; 1]) -> [Option<Tensor>; 1] {
        let scale = gradient.values.iter().sum::<f32>() / self.targets.contact.len() as f32;
        let slopes = self.pixels(output).flat_map(|(_, slopes)| slopes.map(|slope| slope * scale));
        [Some(Tensor { shape: output.shape.to_vec(), values: slopes.collect() })]
    }
}
