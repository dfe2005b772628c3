//! Draws from a seed.

use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

/// Sequence of draws that is the same on every machine.
pub(super) struct Draw(ChaCha8Rng);

impl Draw {
    pub(super) fn new(seed: u64) -> Self {
        Self(ChaCha8Rng::seed_from_u64(seed))
    }

    /// Returns a number from a range, evenly distributed.
    pub(super) fn between(&mut self, [low, high]: [f64; 2]) -> f64 {
        low + (high - low) * self.0.random::<f64>()
    }

    /// Returns a length in metres from a range in millimetres.
    pub(super) fn mm(&mut self, range_mm: [f64; 2]) -> f64 {
        1e-3 * self.between(range_mm)
    }

    /// Returns a whole number from `low` to `high`.
    pub(super) fn count(&mut self, low: usize, high: usize) -> usize {
        low + ((high - low + 1) as f64 * self.0.random::<f64>()) as usize
    }

    /// Returns one of the choices.
    pub(super) fn one_of<T: Copy, const N: usize>(&mut self, choices: [T; N]) -> T {
        choices[self.count(0, N - 1)]
    }

    /// Returns true in half of the cases.
    pub(super) fn coin(&mut self) -> bool {
        self.one_of([false, true])
    }
}
