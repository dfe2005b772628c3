//! How well measurements support the learnt surface.

use std::collections::HashMap;

use glam::{IVec3, Vec3};

use super::Map;
use mvt_field::shape::Shape as _;

/// Most measured points that are compared with the surface: a fraction of a second, and some per cell of the largest object.
const POINTS: usize = 200_000;

/// Sum of squared distances, square metres, and their number.
type Squares = (f64, u32);

impl Map {
    /// For each vertex of a surface in the field's frame, the root mean square of the distances, along the normal, of the points that were measured
    /// around it from the learnt surface, metres; `None` where no sensor saw a surface, so that the vertex is a guess. The points around a vertex
    /// are those in its cell of [`Space`](crate::space::Space) and in the 26 beside it.
    pub fn vertex_deviations_m(&self, vertices: &[Vec3]) -> Vec<Option<f32>> {
        let squares = self.squares_by_cell();
        let nothing = (0.0, 0);
        let around = |vertex: Vec3| {
            let cell = self.support_cell(vertex);
            (0..27).fold(nothing, |(sum, count): Squares, k| {
                let beside = cell + IVec3::new(k % 3, k / 3 % 3, k / 9) - 1;
                let (more, others) = squares.get(&beside).copied().unwrap_or(nothing);
                (sum + more, count + others)
            })
        };
        let deviation_m = |vertex: &Vec3| {
            let (sum, count) = self.space.is_near_surface(*vertex).then(|| around(*vertex))?;
            (count > 0).then(|| (sum / f64::from(count)).sqrt() as f32)
        };
        vertices.iter().map(deviation_m).collect()
    }

    fn support_cell(&self, point: Vec3) -> IVec3 {
        (point / self.space.resolution_m()).floor().as_ivec3()
    }

    /// Distances of measured points from the surface, by cells.
    fn squares_by_cell(&self) -> HashMap<IVec3, Squares> {
        let hits = || {
            self.keyframes.iter().flat_map(|keyframe| keyframe.scan().views.iter().map(move |view| (keyframe, view)))
        };
        let stride = hits().map(|(_, view)| view.hits.len()).sum::<usize>().div_ceil(POINTS).max(1);
        let points: Vec<Vec3> = hits()
            .flat_map(|(keyframe, view)| view.hits.iter().map(move |hit| keyframe.to_field(view.point(hit))))
            .step_by(stride)
            .filter(|point| self.space.is_near_surface(*point))
            .collect();
        let mut distances_m = vec![0.0; points.len()];
        self.field().distances(&points, &mut distances_m);
        let mut squares = HashMap::<IVec3, Squares>::new();
        for (point, distance_m) in points.iter().zip(distances_m) {
            let (sum, count) = squares.entry(self.support_cell(*point)).or_default();
            *sum += f64::from(distance_m).powi(2);
            *count += 1;
        }
        squares
    }
}
