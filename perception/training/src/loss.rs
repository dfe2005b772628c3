//! Loss that training minimises.

use std::sync::Arc;

use mvt_settings::settings;
use pulp::WithSimd;
use serde::{Deserialize, Serialize};

use crate::lanes::{LANES, each, load, sigmoid, softplus};
use crate::tape::{Inputs, Kernel, Slopes};
use mvt_touch::network::WeightTensor;

/// Cost of an error in indentation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Penalty {
    /// Square of the error.
    Mse,
    /// Size of the error. From targets that are mostly zero it learns the median, zero; give contact more weight then.
    L1,
    /// Size of the error, but its square near zero.
    Huber,
}

impl mvt_settings::Unlimited for Penalty {}

settings! {
    /// Loss of a batch: the mean over all pixels of the weighted penalty, plus the weighted cross-entropy of contact.
    #[derive(Copy)]
    pub struct LossConfig {
        /// Penalty of an error in indentation.
        pub penalty: Penalty = Penalty::Huber;
        /// Error at which the penalty `huber` changes from square to linear, millimetres.
        pub huber_mm: f32 = 0.02, 1e-6..=100.0;
        /// Weight of a pixel in contact; other pixels have weight 1.
        pub contact_weight: f32 = 3.0, 1e-6..=1e6;
        /// Weight of the cross-entropy of contact; the penalty, in (square) millimetres, has weight 1.
        pub segmentation: f32 = 0.1, 0.0..=1e6;
    }
}

// Why: notes/decisions/touch.md, "Indentation, not depth".
/// Correct answers for a batch.
#[derive(Debug, Clone, Default)]
pub struct Targets {
    /// Indentation of each pixel, millimetres.
    pub indentation_mm: Vec<f32>,
    /// Share of each pixel that is in contact, 0 to 1.
    pub contact: Vec<f32>,
}

/// Loss as an op of the network's output; its result is one number.
#[derive(Debug, Clone)]
pub struct TouchLoss {
    /// Settings.
    pub config: LossConfig,
    /// Correct answers for the batch.
    pub targets: Arc<Targets>,
    /// First pixel of the batch that the output has; the mean is over all pixels of the batch.
    pub first: usize,
}

/// Some pixels of a batch.
struct Pixels<'a> {
    config: LossConfig,
    output: &'a [f32],
    indentation_mm: &'a [f32],
    contact: &'a [f32],
    /// Slopes by indentation and logit, before the mean.
    slopes: &'a mut [f32],
}

impl WithSimd for Pixels<'_> {
    /// Sum of the pixels' losses.
    type Output = f64;

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) -> f64 {
        let Self { config, output, indentation_mm, contact, slopes } = self;
        let LossConfig { penalty, huber_mm, contact_weight, segmentation } = config;
        let pixels = output.chunks(2 * LANES).zip(slopes.chunks_mut(2 * LANES));
        let mut sum = 0.0;
        for (k, (output, slopes)) in pixels.enumerate() {
            let (target, contact) = (load(indentation_mm, k * LANES), load(contact, k * LANES));
            let of_pixel = |j: usize, part: usize| output.get(2 * j + part).copied().unwrap_or(0.0);
            let (indentation, logit) = (each(|j| of_pixel(j, 0)), each(|j| of_pixel(j, 1)));
            let (entropy, probability) = (softplus(logit), sigmoid(logit));
            let mut costs = [0.0; LANES];
            for j in 0..output.len() / 2 {
                let weight = 1.0 + (contact_weight - 1.0) * contact[j];
                let error = indentation[j] - target[j];
                let (cost, slope) = match penalty {
                    Penalty::Mse => (error * error, 2.0 * error),
                    Penalty::L1 => (error.abs(), if error == 0.0 { 0.0 } else { error.signum() }),
                    Penalty::Huber if error.abs() < huber_mm => (0.5 * error * error / huber_mm, error / huber_mm),
                    Penalty::Huber => (error.abs() - 0.5 * huber_mm, error.signum()),
                };
                costs[j] = weight * cost + segmentation * (entropy[j] - logit[j] * contact[j]);
                slopes[2 * j] = weight * slope;
                slopes[2 * j + 1] = segmentation * (probability[j] - contact[j]);
            }
            sum += f64::from(costs.iter().sum::<f32>());
        }
        sum
    }
}

impl Kernel<1> for TouchLoss {
    /// Slopes by the output.
    type Kept = Vec<f32>;

    fn forward(&self, [output]: Inputs<'_, 1>) -> (WeightTensor, Vec<f32>) {
        let Targets { indentation_mm, contact } = &*self.targets;
        let pixels = contact.len() as f32;
        let (indentation_mm, contact) = (&indentation_mm[self.first..], &contact[self.first..]);
        let mut slopes = vec![0.0; output.values.len()];
        let (config, output) = (self.config, output.values);
        let sum = pulp::Arch::new().dispatch(Pixels { config, output, indentation_mm, contact, slopes: &mut slopes });
        slopes.iter_mut().for_each(|slope| *slope /= pixels);
        (WeightTensor { shape: vec![1], values: vec![(sum / f64::from(pixels)) as f32] }, slopes)
    }

    fn backward(&self, [output]: Inputs<'_, 1>, slopes: &Vec<f32>, gradient: &[f32], _: [bool; 1]) -> Slopes<1> {
        let scale: f32 = gradient.iter().sum();
        let values = slopes.iter().map(|slope| slope * scale).collect();
        [Some(output.like(values))]
    }
}
