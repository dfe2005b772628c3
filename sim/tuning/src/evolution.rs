//! CMA-ES: a search that adapts mean, step size and covariance of a normal distribution to the best candidates.
//!
//! After N. Hansen, "The CMA Evolution Strategy: A Tutorial" (2016), with the constants of its table 1.

use nalgebra::{DMatrix, DVector, SymmetricEigen};
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

/// Most generations of a search whose state is read.
const MOST_GENERATIONS: u64 = 1_000_000;

/// State of a search. Everything on which the next generation depends is in it, so that a search that was written to a
/// file and read again continues bit for bit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Evolution {
    /// Mean of the candidates.
    #[serde(with = "vector")]
    mean: DVector<f64>,
    /// Step size.
    sigma: f64,
    #[serde(with = "square")]
    covariance: DMatrix<f64>,
    /// Evolution paths of covariance and step size.
    #[serde(with = "vector")]
    path: DVector<f64>,
    #[serde(with = "vector")]
    sigma_path: DVector<f64>,
    /// Number of finished generations.
    generation: u64,
    population: usize,
    seed: u64,
}

impl Evolution {
    /// Starts at the origin with a step size of 1 in each of `dimensions`. A generation has `population` candidates, at
    /// least 4.
    pub fn new(dimensions: usize, population: usize, sigma: f64, seed: u64) -> Self {
        Self {
            mean: DVector::zeros(dimensions),
            sigma,
            covariance: DMatrix::identity(dimensions, dimensions),
            path: DVector::zeros(dimensions),
            sigma_path: DVector::zeros(dimensions),
            generation: 0,
            population: population.max(4),
            seed,
        }
    }

    /// Returns the mean of the distribution: the answer of the search.
    pub fn mean(&self) -> &[f64] {
        self.mean.as_slice()
    }

    /// Returns the step size.
    pub fn sigma(&self) -> f64 {
        self.sigma
    }

    /// Returns whether this is a later state of a search that began as `start`.
    pub fn continues(&self, start: &Self) -> bool {
        let finite =
            self.mean.iter().chain(&self.covariance).all(|v| v.is_finite()) && (0.0..1e6).contains(&self.sigma);
        let lengths = [&self.mean, &self.path, &self.sigma_path].map(DVector::len);
        (self.seed, self.population) == (start.seed, start.population)
            && lengths == [start.mean.len(); 3]
            && self.covariance.nrows() == start.mean.len()
            && finite
            && self.generation <= MOST_GENERATIONS
    }

    /// Returns the number of finished generations.
    pub fn generation(&self) -> u64 {
        self.generation
    }

    /// Returns the candidates of the current generation. They depend on nothing but the state.
    pub fn candidates(&self) -> Vec<Vec<f64>> {
        let n = self.mean.len();
        let (axes, lengths) = self.axes();
        let mut rng = ChaCha8Rng::seed_from_u64(self.seed);
        rng.set_stream(self.generation);
        let candidate = |_| {
            let draw = DVector::from_fn(n, |_, _| normal(&mut rng));
            (&self.mean + self.sigma * &axes * draw.component_mul(&lengths)).as_slice().to_vec()
        };
        (0..self.population).map(candidate).collect()
    }

    /// Learns the scores of the current candidates, of which the greatest is the best; a score that is not a number is
    /// the worst.
    pub fn learn(&mut self, scores: &[f64]) {
        let n = self.mean.len() as f64;
        let candidates = self.candidates();
        let worst_if_nan = |score: f64| if score.is_nan() { f64::NEG_INFINITY } else { score };
        let mut order: Vec<(f64, &Vec<f64>)> = scores.iter().map(|s| worst_if_nan(*s)).zip(&candidates).collect();
        order.sort_by(|a, b| b.0.total_cmp(&a.0));
        let parents = self.population / 2;
        let raw: Vec<f64> = (1..=parents).map(|k| (parents as f64 + 0.5).ln() - (k as f64).ln()).collect();
        let total: f64 = raw.iter().sum();
        let weights: Vec<f64> = raw.iter().map(|w| w / total).collect();
        let mass = 1.0 / weights.iter().map(|w| w * w).sum::<f64>();

        let step = |x: &Vec<f64>| (DVector::from_column_slice(x) - &self.mean) / self.sigma;
        let steps: Vec<DVector<f64>> = order.iter().take(parents).map(|(_, x)| step(x)).collect();
        let mut mean_step = DVector::zeros(self.mean.len());
        for (weight, step) in weights.iter().zip(&steps) {
            mean_step += step * *weight;
        }

        let path_rate = (4.0 + mass / n) / (n + 4.0 + 2.0 * mass / n);
        let sigma_rate = (mass + 2.0) / (n + mass + 5.0);
        let rank_one = 2.0 / ((n + 1.3).powi(2) + mass);
        let rank_many = (1.0 - rank_one).min(2.0 * (mass - 2.0 + 1.0 / mass) / ((n + 2.0).powi(2) + mass));
        let damping = 1.0 + 2.0 * (((mass - 1.0) / (n + 1.0)).sqrt() - 1.0).max(0.0) + sigma_rate;
        // Mean length of a normal vector.
        let usual = n.sqrt() * (1.0 - 1.0 / (4.0 * n) + 1.0 / (21.0 * n * n));

        let (axes, lengths) = self.axes();
        let whitened = &axes * (axes.transpose() * &mean_step).component_div(&lengths);
        self.sigma_path *= 1.0 - sigma_rate;
        self.sigma_path += (sigma_rate * (2.0 - sigma_rate) * mass).sqrt() * whitened;
        let length = self.sigma_path.norm();
        let bias = (1.0 - (1.0 - sigma_rate).powf(2.0 * (self.generation as f64 + 1.0))).sqrt();
        let grows_slowly = length / bias < (1.4 + 2.0 / (n + 1.0)) * usual;
        self.path *= 1.0 - path_rate;
        if grows_slowly {
            self.path += (path_rate * (2.0 - path_rate) * mass).sqrt() * &mean_step;
        }
        let forgotten = if grows_slowly { 0.0 } else { rank_one * path_rate * (2.0 - path_rate) };
        self.covariance *= 1.0 - rank_one - rank_many + forgotten;
        self.covariance += rank_one * &self.path * self.path.transpose();
        for (weight, step) in weights.iter().zip(&steps) {
            self.covariance += rank_many * *weight * step * step.transpose();
        }
        self.mean += self.sigma * mean_step;
        self.sigma *= ((sigma_rate / damping) * (length / usual - 1.0)).exp();
        self.generation += 1;
    }

    /// Returns the principal axes of the covariance as columns, and the standard deviations along them.
    fn axes(&self) -> (DMatrix<f64>, DVector<f64>) {
        /// Least variance, so that rounding cannot make it negative.
        const LEAST: f64 = 1e-12;
        let eigen = SymmetricEigen::new(self.covariance.clone());
        (eigen.eigenvectors, eigen.eigenvalues.map(|value| value.max(LEAST).sqrt()))
    }
}

/// A vector in a file: its numbers.
mod vector {
    use nalgebra::DVector;
    use serde::{Deserialize, Deserializer, Serialize, Serializer};

    pub fn serialize<S: Serializer>(vector: &DVector<f64>, to: S) -> Result<S::Ok, S::Error> {
        vector.as_slice().serialize(to)
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<DVector<f64>, D::Error> {
        Vec::deserialize(from).map(DVector::from_vec)
    }
}

/// A square matrix in a file: its numbers by columns.
mod square {
    use nalgebra::DMatrix;
    use serde::{Deserialize, Deserializer, Serialize, Serializer, de};

    pub fn serialize<S: Serializer>(matrix: &DMatrix<f64>, to: S) -> Result<S::Ok, S::Error> {
        matrix.as_slice().serialize(to)
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<DMatrix<f64>, D::Error> {
        let numbers = Vec::deserialize(from)?;
        let rows = numbers.len().isqrt();
        if rows * rows != numbers.len() {
            return Err(de::Error::custom("a covariance must have as many rows as columns"));
        }
        Ok(DMatrix::from_vec(rows, rows, numbers))
    }
}

/// Draws a standard normal number, by Box and Muller.
fn normal(rng: &mut ChaCha8Rng) -> f64 {
    let (radius, angle): (f64, f64) = (rng.random(), rng.random());
    (-2.0 * (1.0 - radius).ln()).sqrt() * (std::f64::consts::TAU * angle).cos()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rosenbrock's valley in 8 dimensions, whose best point is (1, ..., 1).
    fn valley(x: &[f64]) -> f64 {
        -x.windows(2).map(|p| 100.0 * (p[1] - p[0] * p[0]).powi(2) + (1.0 - p[0]).powi(2)).sum::<f64>()
    }

    #[test]
    fn finds_the_end_of_a_curved_valley() {
        let mut search = Evolution::new(8, 12, 0.3, 3);
        for _ in 0..700 {
            let scores: Vec<f64> = search.candidates().iter().map(|x| valley(x)).collect();
            search.learn(&scores);
        }
        assert!(search.mean().iter().all(|x| (x - 1.0).abs() < 1e-4), "{:?}", search.mean());
    }

    #[test]
    fn continues_from_text_bit_for_bit() {
        let mut search = Evolution::new(3, 6, 1.0, 1);
        let advance = |search: &mut Evolution| {
            let scores: Vec<f64> = search.candidates().iter().map(|x| -x.iter().map(|v| v * v).sum::<f64>()).collect();
            search.learn(&scores);
        };
        advance(&mut search);
        let mut read: Evolution = toml::from_str(&toml::to_string(&search).unwrap()).unwrap();
        for _ in 0..3 {
            advance(&mut search);
            advance(&mut read);
        }
        assert_eq!(search, read);
    }

    #[test]
    fn a_score_that_is_no_number_counts_as_the_worst() {
        let mut search = Evolution::new(2, 4, 1.0, 1);
        search.learn(&[f64::NAN, 1.0, 2.0, f64::NAN]);
        assert!(search.mean().iter().all(|x| x.is_finite()));
    }
}
