//! Means with confidence intervals, and paired tests.

use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

/// Resamples of a bootstrap.
pub const RESAMPLES: usize = 2000;
/// Fewest values of which an interval is computed.
pub const LEAST: usize = 5;
/// Most pairs of which the test is exact.
const MOST_EXACT: usize = 100;

/// Mean with an interval.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Estimate {
    /// Mean.
    pub mean: f64,
    /// Ends of the 95 % interval (percentiles of a bootstrap); `None` below [`LEAST`] values.
    pub interval: Option<[f64; 2]>,
    /// Number of values.
    pub count: usize,
}

impl Estimate {
    /// Estimates the mean of finite values; `None` without values. The same values give the same interval.
    pub fn new(values: &[f64]) -> Option<Self> {
        let count = values.len();
        if count == 0 {
            return None;
        }
        let mean = mean(values);
        let interval = (count >= LEAST).then(|| {
            let mut random = ChaCha8Rng::seed_from_u64(0);
            let mut resample =
                || (0..count).filter_map(|_| values.get(random.random_range(0..count))).sum::<f64>() / count as f64;
            let mut means: Vec<f64> = (0..RESAMPLES).map(|_| resample()).collect();
            means.sort_by(f64::total_cmp);
            [0.025, 0.975].map(|share| quantile(&means, share))
        });
        Some(Self { mean, interval, count })
    }
}

/// Returns the mean; NaN without values.
pub fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

/// Returns a quantile of sorted values, interpolated; NaN without values.
pub fn quantile(sorted: &[f64], share: f64) -> f64 {
    let position = share * sorted.len().saturating_sub(1) as f64;
    let low = position.floor() as usize;
    match (sorted.get(low), sorted.get(low + 1)) {
        (Some(a), Some(b)) => a + (b - a) * (position - low as f64),
        (Some(a), None) => *a,
        _ => f64::NAN,
    }
}

/// Returns the two-sided p-value of Wilcoxon's signed-rank test that differences are symmetric about 0; `None` if all
/// are 0. Zeros are left out, and ties share their ranks. The value is exact up to 100 differences; beyond, it is that of
/// the normal distribution.
pub fn wilcoxon(differences: &[f64]) -> Option<f64> {
    let mut sizes: Vec<(f64, bool)> =
        differences.iter().filter(|d| **d != 0.0).map(|d| (d.abs(), d.is_sign_positive())).collect();
    sizes.sort_by(|a, b| a.0.total_cmp(&b.0));
    let count = sizes.len();
    if count == 0 {
        return None;
    }
    // Twice the ranks, which are whole numbers also for ties.
    let mut ranks: Vec<(usize, bool)> = Vec::with_capacity(count);
    for ties in sizes.chunk_by(|a, b| a.0 == b.0) {
        let double_rank = 2 * ranks.len() + ties.len() + 1;
        ranks.extend(ties.iter().map(|(_, is_positive)| (double_rank, *is_positive)));
    }
    let total: usize = ranks.iter().map(|(rank, _)| rank).sum();
    let positive: usize = ranks.iter().filter(|(_, is_positive)| *is_positive).map(|(rank, _)| rank).sum();
    let least = positive.min(total - positive);
    let p = if count <= MOST_EXACT {
        // Probability of each sum of positive ranks, when each sign is that of a fair coin.
        let mut of_sum = vec![0.0; total + 1];
        if let Some(first) = of_sum.first_mut() {
            *first = 1.0;
        }
        let mut reached = 0;
        for (rank, _) in &ranks {
            reached += rank;
            for sum in (0..=reached).rev() {
                let without = sum.checked_sub(*rank).and_then(|sum| of_sum.get(sum)).copied().unwrap_or(0.0);
                if let Some(probability) = of_sum.get_mut(sum) {
                    *probability = 0.5 * (*probability + without);
                }
            }
        }
        2.0 * of_sum.iter().take(least + 1).sum::<f64>()
    } else {
        let deviation = ranks.iter().map(|(rank, _)| (*rank as f64).powi(2)).sum::<f64>().sqrt() / 2.0;
        let distance = (total as f64 / 2.0 - least as f64) / deviation;
        upper_tail(distance) * 2.0
    };
    Some(p.min(1.0))
}

/// Returns the probability that a standard normal variable exceeds z >= 0, with an error below 1e-7 (Abramowitz and
/// Stegun 26.2.17).
fn upper_tail(z: f64) -> f64 {
    let t = 1.0 / (1.0 + 0.231_641_9 * z);
    let series = [1.330_274_429, -1.821_255_978, 1.781_477_937, -0.356_563_782, 0.319_381_530];
    let polynomial = series.iter().fold(0.0, |sum, factor| (sum + factor) * t);
    polynomial * (-0.5 * z * z).exp() / std::f64::consts::TAU.sqrt()
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn the_test_agrees_with_scipy() {
        // The example of scipy.stats.wilcoxon, Darwin's plants.
        let plants = [6.0, 8.0, 14.0, 16.0, 23.0, 24.0, 28.0, 29.0, 41.0, -48.0, 49.0, 56.0, 60.0, -67.0, 75.0];
        assert!((wilcoxon(&plants).unwrap() - 0.041_259_765_625).abs() < 1e-12);
        assert_eq!(wilcoxon(&[0.0, 0.0]), None);
        assert_eq!(wilcoxon(&[]), None);
        // One pair says nothing; five of one sign have 2 of 32 chances.
        assert_eq!(wilcoxon(&[0.3]), Some(1.0));
        assert!((wilcoxon(&[1.0, 2.0, 3.0, 4.0, 5.0]).unwrap() - 0.0625).abs() < 1e-12);
        // With ties and zeros: a count over all 1,024 signs with SciPy's ranks.
        let tied = [1.0, 1.0, 2.0, -2.0, 3.0, -1.0, 4.0, 5.0, -2.0, 2.0, 0.0, 0.0];
        assert!((wilcoxon(&tied).unwrap() - 0.160_156_25).abs() < 1e-12);
    }

    #[test]
    fn many_pairs_agree_with_scipy() {
        let differences: Vec<f64> = (1..=101).map(|k| if k % 3 == 0 { -f64::from(k) } else { f64::from(k) }).collect();
        // method="exact", then method="approx" without correction.
        assert!((wilcoxon(&differences[..100]).unwrap() - 0.003_526_003_801_650_468).abs() < 1e-12);
        assert!((wilcoxon(&differences).unwrap() - 0.002_498_973_103_418_4).abs() < 2e-7);
        assert!((upper_tail(1.959_963_985) - 0.025).abs() < 1e-7);
    }

    #[test]
    fn the_interval_is_that_of_the_normal_distribution_for_many_values() {
        // Values evenly over 0 to 1: the standard error is 1 / sqrt(12 n).
        let values: Vec<f64> = (0..400).map(|k| (f64::from(k) + 0.5) / 400.0).collect();
        let Estimate { mean, interval, count } = Estimate::new(&values).unwrap();
        let [low, high] = interval.unwrap();
        let half = 1.96 / (12.0_f64 * 400.0).sqrt();
        assert!((mean - 0.5).abs() < 1e-12 && count == 400);
        assert!((low - (0.5 - half)).abs() < 0.1 * half && (high - (0.5 + half)).abs() < 0.1 * half, "{low} {high}");
        assert_eq!(Estimate::new(&values[..4]).unwrap().interval, None);
        assert_eq!(Estimate::new(&[]), None);
    }

    proptest! {
        #[test]
        fn intervals_contain_the_mean_and_signs_do_not_matter(values in prop::collection::vec(-1e3..1e3f64, 5..60)) {
            let Estimate { mean, interval, .. } = Estimate::new(&values).unwrap();
            let [low, high] = interval.unwrap();
            prop_assert!(low <= mean + 1e-9 && mean <= high + 1e-9);
            let negative: Vec<f64> = values.iter().map(|value| -value).collect();
            let (p, q) = (wilcoxon(&values).unwrap(), wilcoxon(&negative).unwrap());
            prop_assert!((p - q).abs() < 1e-9 && (0.0..=1.0).contains(&p));
        }
    }
}
