//! Distances to the nearest point of a cloud.

use glam::Vec3;
use kiddo::{ImmutableKdTree, SquaredEuclidean};

/// A k-d tree over points.
#[derive(Debug)]
pub(super) struct Nearest(Option<ImmutableKdTree<f32, 3>>);

impl Nearest {
    /// Over finite points, of which there may be none.
    pub(super) fn new(points: &[Vec3]) -> Self {
        let rows: Vec<[f32; 3]> = points.iter().map(Vec3::to_array).collect();
        // It refuses only more points than a u32 can number.
        Self(if rows.is_empty() { None } else { ImmutableKdTree::new_from_slice(&rows).ok() })
    }

    /// Distance to the nearest point, metres; infinite if there is none.
    pub(super) fn distance_m(&self, p: Vec3) -> f32 {
        self.0.as_ref().map_or(f32::INFINITY, |tree| {
            tree.query(&p.to_array()).nearest_one::<SquaredEuclidean<f32>>().execute().distance.sqrt()
        })
    }
}
