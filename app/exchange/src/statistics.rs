//! Statistics of a feature over all frames of a data set, as LeRobot stores them.

use serde_json::{Value, json};

/// Quantiles that LeRobot stores, with their names.
const QUANTILES: [(&str, f64); 5] = [("q01", 0.01), ("q10", 0.1), ("q50", 0.5), ("q90", 0.9), ("q99", 0.99)];

/// A value and how often it occurs.
type Counted = (f64, u64);

/// Values of the channels of a feature.
#[derive(Debug, Clone, Default)]
pub(crate) struct Statistics {
    /// Values of each channel, kept for quantiles; empty for images, which have counts of levels.
    values: Vec<Vec<f64>>,
    /// Number of pixels with each level, for each colour.
    levels: Vec<[u64; 256]>,
    frames: u64,
}

impl Statistics {
    /// Adds a frame of numbers.
    pub fn add(&mut self, numbers: &[f64]) {
        self.values.resize(numbers.len(), Vec::new());
        self.values.iter_mut().zip(numbers).for_each(|(channel, &number)| channel.push(number));
        self.frames += 1;
    }

    /// Adds a frame of pixels, a few of which stand for all.
    pub fn add_pixels<'a>(&mut self, pixels: impl Iterator<Item = &'a [u8; 3]>) {
        self.levels.resize(3, [0; 256]);
        for pixel in pixels {
            for (channel, &level) in self.levels.iter_mut().zip(pixel) {
                if let Some(count) = channel.get_mut(usize::from(level)) {
                    *count += 1;
                }
            }
        }
        self.frames += 1;
    }

    /// Returns the statistics; those of colours are between 0 and 1 and have the shape (3, 1, 1).
    pub fn to_json(&self) -> Value {
        let mut columns: Vec<Vec<Counted>> = Vec::new();
        for channel in &self.values {
            let mut sorted = channel.clone();
            sorted.sort_unstable_by(f64::total_cmp);
            columns.push(sorted.into_iter().map(|value| (value, 1)).collect());
        }
        for channel in &self.levels {
            let counted = channel.iter().enumerate().filter(|(_, count)| **count > 0);
            columns.push(counted.map(|(level, &count)| (level as f64 / 255.0, count)).collect());
        }
        let is_image = !self.levels.is_empty();
        let each = |of: &dyn Fn(&[Counted]) -> f64| {
            let numbers: Vec<Value> = columns.iter().map(|column| json!(of(column))).collect();
            if is_image {
                json!(numbers.into_iter().map(|number| json!([[number]])).collect::<Vec<_>>())
            } else {
                json!(numbers)
            }
        };
        let mut all = serde_json::Map::new();
        all.insert("min".into(), each(&|column| column.first().map_or(0.0, |(value, _)| *value)));
        all.insert("max".into(), each(&|column| column.last().map_or(0.0, |(value, _)| *value)));
        all.insert("mean".into(), each(&mean));
        all.insert(
            "std".into(),
            each(&|column| {
                let middle = mean(column);
                mean(&column.iter().map(|(value, count)| ((value - middle).powi(2), *count)).collect::<Vec<_>>()).sqrt()
            }),
        );
        all.insert("count".into(), json!([self.frames]));
        for (name, share) in QUANTILES {
            all.insert(name.into(), each(&|column| quantile(column, share)));
        }
        Value::Object(all)
    }
}

fn mean(column: &[Counted]) -> f64 {
    let count: u64 = column.iter().map(|(_, count)| count).sum();
    column.iter().map(|(value, times)| value * *times as f64).sum::<f64>() / count.max(1) as f64
}

/// Returns the smallest value that so large a share does not exceed.
fn quantile(column: &[Counted], share: f64) -> f64 {
    let count: u64 = column.iter().map(|(_, count)| count).sum();
    let wanted = (share * count as f64).ceil().max(1.0) as u64;
    let mut below = 0;
    let found = column.iter().find(|(_, count)| {
        below += count;
        below >= wanted
    });
    found.or(column.last()).map_or(0.0, |(value, _)| *value)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn statistics_are_those_of_the_values() {
        let mut numbers = Statistics::default();
        (0..=100).for_each(|k| numbers.add(&[f64::from(k), 1.0]));
        let found = numbers.to_json();
        assert_eq!(found["mean"], json!([50.0, 1.0]));
        assert_eq!(found["q10"], json!([10.0, 1.0]));
        assert!((found["std"][0].as_f64().unwrap() - 850.0_f64.sqrt()).abs() < 1e-12);
        assert_eq!((&found["count"], &found["max"]), (&json!([101]), &json!([100.0, 1.0])));
        let mut image = Statistics::default();
        image.add_pixels([[0, 51, 255], [0, 255, 255]].iter());
        assert_eq!(image.to_json()["mean"], json!([[[0.0]], [[0.6]], [[1.0]]]));
    }
}
