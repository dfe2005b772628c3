//! Planes that cut meshes, and triangles that are split.

use glam::Vec3A;

/// Position and colour of a corner.
type Corner = (Vec3A, Vec3A);

/// Plane that cuts a mesh, in the coordinates of the mesh.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CutPlane {
    /// Direction in which the mesh is cut off.
    pub normal: Vec3A,
    /// Position of the plane along the normal, metres.
    pub offset_m: f32,
}

impl CutPlane {
    /// Returns how far a point lies beyond the plane, metres.
    pub fn above_m(self, point: Vec3A) -> f32 {
        self.normal.dot(point) - self.offset_m
    }
}

/// Splits a triangle whose corners have a height, a position and a colour where the height is 0. Returns the polygons
/// below and above; each is empty or convex.
pub fn split(corners: [(f32, Vec3A, Vec3A); 3]) -> [Vec<Corner>; 2] {
    let [mut below, mut above] = [Vec::new(), Vec::new()];
    for k in 0..3 {
        let [(height, point, colour), (next_height, next, next_colour)] = [corners[k], corners[(k + 1) % 3]];
        if height <= 0.0 {
            below.push((point, colour));
        }
        if height >= 0.0 {
            above.push((point, colour));
        }
        if height * next_height < 0.0 {
            let along = height / (height - next_height);
            let crossing = (point.lerp(next, along), colour.lerp(next_colour, along));
            below.push(crossing);
            above.push(crossing);
        }
    }
    [below, above]
}

/// Returns the triangles of a convex polygon.
pub fn fan(corners: &[Corner]) -> impl Iterator<Item = [Corner; 3]> {
    let others = corners.get(1..).unwrap_or_default();
    corners.first().into_iter().flat_map(|&first| others.windows(2).map(move |pair| [first, pair[0], pair[1]]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_split_triangle_is_two_polygons_that_share_an_edge() {
        let corner = |height: f32, x: f32, y: f32| (height, Vec3A::new(x, y, -1.0), Vec3A::splat(height));
        let [below, above] = split([corner(-1.0, 0.0, 0.0), corner(1.0, 1.0, 0.0), corner(1.0, 0.0, 1.0)]);
        assert_eq!((below.len(), above.len()), (3, 4));
        assert_eq!(below.iter().filter(|corner| above.contains(corner)).count(), 2);
        assert_eq!((fan(&below).count(), fan(&above).count()), (1, 2));
        let area = |polygon: &[Corner]| -> f32 {
            fan(polygon).map(|[a, b, c]| 0.5 * (b.0 - a.0).cross(c.0 - a.0).length()).sum()
        };
        assert!((area(&below) - 0.125).abs() < 1e-6 && (area(&above) - 0.375).abs() < 1e-6);
        let [below, above] = split([corner(-1.0, 0.0, 0.0), corner(-1.0, 1.0, 0.0), corner(0.0, 0.0, 1.0)]);
        assert_eq!((fan(&below).count(), fan(&above).count()), (1, 0));
        let [below, above] = split([corner(f32::NAN, 0.0, 0.0); 3]);
        assert!(below.is_empty() && above.is_empty());
    }
}
