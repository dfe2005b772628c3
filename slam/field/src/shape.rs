//! Shapes that can be asked for their signed distance, in batches.

use glam::Vec3;

/// Signed distance and its gradient at a point.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Distance {
    /// Distance to the surface, metres, negative inside. Truncated shapes stop at their truncation distance.
    pub value_m: f32,
    /// Gradient of exactly the function that `value_m` is a value of, metres per metre; not normalised.
    pub gradient: Vec3,
}

/// A shape in the model's frame.
pub trait Shape: Sync {
    /// Signed distances (metres) at points in the model's frame (metres). `out` is as long as `points`.
    fn distances(&self, points: &[Vec3], out: &mut [f32]);

    /// Signed distances with gradients. `out` is as long as `points`.
    fn distances_and_gradients(&self, points: &[Vec3], out: &mut [Distance]);
}
