//! Statistics of the pose errors of a run.

use serde::{Deserialize, Serialize};

/// NeuralFeels leaves out the errors of the first 5 s, because it starts at the true pose. Seconds.
pub const GRACE_S: f64 = 5.0;
/// NeuralFeels drops larger errors as failures of the ground truth. Metres.
pub const OUTLIER_M: f64 = 0.050;
/// A run with a larger last error has failed, as in NeuralFeels. Metres.
pub const FAILURE_M: f64 = 0.010;

/// Pose errors of a run, metres. Every frame counts, except in `mean_original_m`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct PoseStatistics {
    /// Mean error.
    pub mean_m: f64,
    /// Median error; of an even number of errors, the mean of the middle two.
    pub median_m: f64,
    /// 95th percentile, interpolated linearly between neighbours as NumPy does by default.
    pub p95_m: f64,
    /// Error of the last frame.
    pub final_m: f64,
    /// Mean as NeuralFeels computes it, see [`mean_original`]; `None` if it leaves out every error.
    pub mean_original_m: Option<f64>,
}

impl PoseStatistics {
    /// Computes the statistics of errors (time in seconds, error in metres) in order of time; `None` without errors. An error that is
    /// NaN counts as infinite, so that the statistics show it.
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

    /// Returns whether the last error exceeds [`FAILURE_M`].
    pub fn failed(&self) -> bool {
        self.final_m > FAILURE_M
    }
}

/// Returns the mean error as in NeuralFeels' plots: without errors before [`GRACE_S`] and without errors above [`OUTLIER_M`]; `None` if
/// no error is left. NeuralFeels' tables pool the errors of all runs of a kind: to compare with them, pass all these errors at once.
pub fn mean_original(errors: &[(f64, f64)]) -> Option<f64> {
    let kept = || errors.iter().filter(|&&(time_s, e)| time_s >= GRACE_S && e <= OUTLIER_M).map(|&(_, e)| e);
    let count = kept().count();
    (count > 0).then(|| kept().sum::<f64>() / count as f64)
}

/// Returns a quantile of sorted values, interpolated linearly. There is at least one value.
fn quantile(sorted: &[f64], share: f64) -> f64 {
    let position = share * (sorted.len() - 1) as f64;
    let (low, high) = (sorted[position.floor() as usize], sorted[position.ceil() as usize]);
    // Equal neighbours may both be infinite.
    if low == high { low } else { low + (high - low) * position.fract() }
}
