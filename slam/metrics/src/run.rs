//! The pose errors of a run in a few numbers.

use serde::{Deserialize, Serialize};

/// NeuralFeels leaves out the first seconds, as it starts at the true pose.
pub const GRACE_S: f64 = 5.0;
/// NeuralFeels drops errors above this, metres, as failures of the ground truth.
pub const OUTLIER_M: f64 = 0.050;
/// A run whose last error is above this has failed, metres; as in NeuralFeels.
pub const FAILURE_M: f64 = 0.010;

/// The pose errors of a run, metres. Every frame counts but in `mean_original_m`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct PoseStatistics {
    /// Mean.
    pub mean_m: f64,
    /// Median; the mean of the middle two of an even number.
    pub median_m: f64,
    /// 95 % of the errors are at most this: linearly interpolated between neighbours, as NumPy's default.
    pub p95_m: f64,
    /// That of the last frame.
    pub final_m: f64,
    /// NeuralFeels' mean, see [`mean_original`]; none if it leaves nothing.
    pub mean_original_m: Option<f64>,
}

impl PoseStatistics {
    /// Of the errors (time in seconds, error in metres), in order of time; none if there are no errors. An error that is NaN counts as
    /// infinite, so that it cannot go unnoticed.
    pub fn new(errors: &[(f64, f64)]) -> Option<Self> {
        let in_time: Vec<f64> = errors.iter().map(|&(_, e)| if e.is_nan() { f64::INFINITY } else { e }).collect();
        let final_m = *in_time.last()?;
        let mean_m = in_time.iter().sum::<f64>() / in_time.len() as f64;
        let mut sorted = in_time;
        sorted.sort_unstable_by(f64::total_cmp);
        Some(Self {
            mean_m,
            median_m: quantile(&sorted, 0.5),
            p95_m: quantile(&sorted, 0.95),
            final_m,
            mean_original_m: mean_original(errors),
        })
    }

    /// Whether the run ended astray.
    pub fn failed(&self) -> bool {
        self.final_m > FAILURE_M
    }
}

/// The mean error as NeuralFeels' plots take it: without what came before [`GRACE_S`] and without errors above [`OUTLIER_M`]; none if
/// that leaves nothing. Its tables pool the errors of all runs of a kind, so pass them all at once to compare with those.
pub fn mean_original(errors: &[(f64, f64)]) -> Option<f64> {
    let kept = || errors.iter().filter(|&&(time_s, e)| time_s >= GRACE_S && e <= OUTLIER_M).map(|&(_, e)| e);
    let count = kept().count();
    (count > 0).then(|| kept().sum::<f64>() / count as f64)
}

/// Of sorted values, of which there is at least one.
fn quantile(sorted: &[f64], share: f64) -> f64 {
    let position = share * (sorted.len() - 1) as f64;
    let (low, high) = (sorted[position.floor() as usize], sorted[position.ceil() as usize]);
    // Equal neighbours may both be infinite.
    if low == high { low } else { low + (high - low) * position.fract() }
}
