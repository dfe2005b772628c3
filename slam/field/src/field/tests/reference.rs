//! The field once more, from its definition: in double precision, point by point, corner by corner.

use super::*;

/// Parameters in double precision, with the field's configuration.
#[derive(Clone)]
pub(super) struct Reference {
    pub(super) config: FieldConfig,
    /// `[entry][feature]`, flattened.
    pub(super) table: Vec<f64>,
    pub(super) network: Vec<f64>,
}

impl Reference {
    pub(super) fn new(field: &NeuralField) -> Self {
        Self {
            config: field.config.clone(),
            table: field.parameters.table.as_flattened().iter().copied().map(f64::from).collect(),
            network: field.parameters.network.iter().copied().map(f64::from).collect(),
        }
    }

    /// In units of the truncation.
    pub(super) fn value(&self, point: [f64; 3]) -> f64 {
        let half = f64::from(self.config.half_extent_m);
        let mut features = Vec::new();
        let mut first = 0;
        for &resolution in &self.config.levels {
            let n = resolution as usize;
            let at = point.map(|x| (x.clamp(-half, half) + half) / (2.0 * half) * (n - 1) as f64);
            let cell = at.map(|t| (t.floor() as usize).min(n - 2));
            let slots = 1 << self.config.table_log2;
            let hashed = n * n * n > slots;
            let mut sum = [0.0; FEATURES];
            for c in 0..8 {
                let vertex: [usize; 3] = std::array::from_fn(|a| cell[a] + (c >> a & 1));
                let weight: f64 = (0..3).map(|a| 1.0 - (at[a] - vertex[a] as f64).abs()).product();
                let [x, y, z] = vertex;
                let entry = if hashed {
                    let hash = (y as u32).wrapping_mul(2_654_435_761) ^ (z as u32).wrapping_mul(805_459_861);
                    x + hash as usize % slots
                } else {
                    x + n * (y + n * z)
                };
                for (k, sum) in sum.iter_mut().enumerate() {
                    *sum += weight * self.table[FEATURES * (first + entry) + k];
                }
            }
            features.extend(sum);
            first += (if hashed { slots + n } else { n * n * n }).next_multiple_of(4);
        }
        let (inputs, hidden) = (features.len(), self.config.hidden);
        let (weights, rest) = self.network.split_at(inputs * hidden);
        let (biases, rest) = rest.split_at(hidden);
        let neurons = weights.chunks(inputs).zip(biases).map(|(weights, bias)| {
            let sum: f64 = weights.iter().zip(&features).map(|(w, x)| w * x).sum();
            (sum + bias).max(0.0)
        });
        neurons.zip(rest).map(|(h, w)| h * w).sum::<f64>() + rest[hidden]
    }

    /// The loss as [`FieldTrainer`] defines it.
    pub(super) fn loss(&self, samples: &[Sample]) -> f64 {
        let distances = samples.iter().map(|s| {
            let error = self.value(s.position.as_dvec3().to_array()) - f64::from(s.target.clamp(-1.0, 1.0));
            if s.at_least && error > 0.0 { 0.0 } else { f64::from(s.weight) * error * error }
        });
        let near: Vec<_> =
            samples.iter().filter(|s| s.target.abs() < 0.625 && !s.at_least).skip(15).step_by(16).collect();
        let step = 0.375 * f64::from(self.config.truncation_m);
        let lengths = near.iter().map(|s| {
            let centre = s.position.as_dvec3().to_array();
            let slopes = (0..3).map(|axis| {
                let mut ahead = centre;
                ahead[axis] += step;
                (self.value(ahead) - self.value(centre)) / 0.375
            });
            (slopes.map(|slope| slope * slope).sum::<f64>().sqrt() - 1.0).powi(2)
        });
        let eikonal = if near.is_empty() { 0.0 } else { lengths.sum::<f64>() / near.len() as f64 };
        distances.sum::<f64>() / samples.len() as f64 + f64::from(self.config.eikonal_weight) * eikonal
    }
}
