//! Running mean and variance of observed numbers.

use ndarray::{Array1, Array2, ArrayView2, Axis, Zip};

/// Greatest absolute value of a normalised number.
pub(crate) const NORMALISED: f32 = 5.0;
/// Least standard deviation by which is divided: numbers that never change stay small.
const LEAST_STD: f64 = 1e-2;

/// Count, mean and sum of squared deviations of each number.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Moments {
    pub(crate) count: f64,
    pub(crate) mean: Array1<f64>,
    pub(crate) squares: Array1<f64>,
}

impl Moments {
    pub(crate) fn new(numbers: usize) -> Self {
        Self { count: 0.0, mean: Array1::zeros(numbers), squares: Array1::zeros(numbers) }
    }

    /// Adds rows, by the formula of Chan, Golub and LeVeque (1983).
    pub(crate) fn add(&mut self, rows: &ArrayView2<'_, f32>) {
        let rows = rows.mapv(f64::from);
        let count = rows.nrows() as f64;
        let Some(mean) = rows.mean_axis(Axis(0)) else { return };
        let squares = (&rows - &mean).mapv(|x| x * x).sum_axis(Axis(0));
        let change = mean - &self.mean;
        let all = self.count + count;
        self.squares = &self.squares + squares + change.mapv(|x| x * x) * (self.count * count / all);
        self.mean = &self.mean + change * (count / all);
        self.count = all;
    }

    /// Returns mean and standard deviation as a policy stores them; 0 and 1 before anything was added.
    pub(crate) fn mean_and_std(&self) -> (Array1<f32>, Array1<f32>) {
        if self.count == 0.0 {
            return (Array1::zeros(self.mean.len()), Array1::ones(self.mean.len()));
        }
        let std = self.squares.mapv(|squares| (squares / self.count).sqrt().max(LEAST_STD) as f32);
        (self.mean.mapv(|mean| mean as f32), std)
    }

    /// Normalises rows, as the policy does when it is played.
    pub(crate) fn normalise(&self, mut rows: Array2<f32>) -> Array2<f32> {
        let (mean, std) = self.mean_and_std();
        for mut row in rows.rows_mut() {
            Zip::from(&mut row)
                .and(&mean)
                .and(&std)
                .for_each(|x, mean, std| *x = ((*x - mean) / std).clamp(-NORMALISED, NORMALISED));
        }
        rows
    }
}
