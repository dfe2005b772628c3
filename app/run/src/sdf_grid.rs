//! Signed distances on a coarse grid, for slices of a shape.

use glam::Vec3;

/// Signed distances on a coarse grid, x fastest.
#[derive(Debug, Clone, PartialEq)]
pub struct SdfGrid {
    /// The first node, metres.
    pub low: Vec3,
    /// Between two nodes, metres.
    pub cell_m: f32,
    /// Nodes along x, y and z.
    pub counts: [u32; 3],
    /// Distances in steps of [`SdfGrid::STEP_M`], negative inside, clamped to what fits.
    pub values: Vec<i8>,
}

impl SdfGrid {
    /// Distance of a value of 1, metres.
    pub const STEP_M: f32 = 0.00025;

    /// Distance at a point, interpolated between the nodes, metres; `None` outside of the grid.
    pub fn distance_m(&self, point: Vec3) -> Option<f32> {
        let at = (point - self.low) / self.cell_m;
        let last = Vec3::from(self.counts.map(|count| count as f32 - 1.0));
        // Written so that NaN fails.
        if !(at.cmpge(Vec3::ZERO).all() && at.cmple(last).all()) {
            return None;
        }
        let first = at.floor().min(last - 1.0).max(Vec3::ZERO);
        let within = at - first;
        let [x, y, z] = first.to_array().map(|c| c as usize);
        let [width, height, _] = self.counts.map(|count| count as usize);
        let mut sum = 0.0;
        for corner in 0..8usize {
            let step = [corner & 1, corner >> 1 & 1, corner >> 2];
            let value = self.values.get(x + step[0] + width * (y + step[1] + height * (z + step[2])))?;
            let weight: f32 = (0..3).map(|k| if step[k] == 1 { within[k] } else { 1.0 - within[k] }).product();
            sum += weight * f32::from(*value);
        }
        Some(sum * Self::STEP_M)
    }
}
