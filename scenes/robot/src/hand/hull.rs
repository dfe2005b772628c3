//! Convex hulls of the meshes of links.

use std::sync::Arc;

use glam::Vec3A;
use parry3d::math::Vector;
use parry3d::transformation::try_convex_hull;
use serde::{Deserialize, Serialize};

/// Convex hull of points, at most [`Hull::MOST_VERTICES`]. It serialises as the list of its vertices.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "Vec<[f64; 3]>", into = "Vec<[f64; 3]>")]
pub struct Hull(Arc<Polyhedron>);

#[derive(Debug, PartialEq)]
struct Polyhedron {
    vertices: Vec<[f64; 3]>,
    /// Corners of the triangles, counterclockwise from outside.
    triangles: Vec<[u32; 3]>,
    faces: Vec<Face>,
    /// Centre and radius of a sphere around it.
    bound: (Vec3A, f32),
}

/// Triangle of a hull in the plane of the points with normal . p = offset.
#[derive(Debug, PartialEq)]
struct Face {
    normal: Vec3A,
    offset: f32,
    corners: [Vec3A; 3],
}

/// Points without a convex hull.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum HullError {
    /// The points lie in a plane, or a coordinate is not finite.
    #[error("the points have no convex hull: {0}")]
    Flat(String),
    /// Too many points.
    #[error("a hull of {0} points; {most} are allowed", most = Hull::MOST_VERTICES)]
    Large(usize),
}

impl Hull {
    /// Largest number of points: MuJoCo's collisions with larger hulls are slow.
    pub const MOST_VERTICES: usize = 256;

    /// Computes the hull of points, metres. Points inside it are dropped.
    ///
    /// # Errors
    /// [`HullError`] if the points lie in a plane, are not finite, or are too many.
    pub fn of(points: &[[f64; 3]]) -> Result<Self, HullError> {
        if points.len() > Self::MOST_VERTICES {
            return Err(HullError::Large(points.len()));
        }
        // parry3d computes in f32, whose steps are 0.01 micrometres at 0.1 m.
        let narrow: Vec<Vector> = points.iter().map(|p| Vector::from_array(p.map(|c| c as f32))).collect();
        let (vertices, triangles) = try_convex_hull(&narrow).map_err(|error| HullError::Flat(error.to_string()))?;
        let vertices: Vec<Vec3A> = vertices.iter().map(|v| Vec3A::from_array(v.to_array())).collect();
        let face = |corners: &[u32; 3]| {
            let corners = corners.map(|k| vertices[k as usize]);
            let normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]).normalize_or_zero();
            Face { normal, offset: normal.dot(corners[0]), corners }
        };
        let faces: Vec<Face> = triangles.iter().map(face).filter(|face| face.normal != Vec3A::ZERO).collect();
        let low = vertices.iter().fold(Vec3A::INFINITY, |low, v| low.min(*v));
        let high = vertices.iter().fold(Vec3A::NEG_INFINITY, |high, v| high.max(*v));
        let centre = (low + high) / 2.0;
        let radius = vertices.iter().map(|v| v.distance(centre)).fold(0.0, f32::max);
        if faces.len() < 4 || !radius.is_finite() {
            return Err(HullError::Flat("they enclose no volume".to_owned()));
        }
        let vertices = vertices.iter().map(|v| v.to_array().map(f64::from)).collect();
        Ok(Self(Arc::new(Polyhedron { vertices, triangles, faces, bound: (centre, radius) })))
    }

    /// Returns the vertices, metres.
    pub fn vertices(&self) -> &[[f64; 3]] {
        &self.0.vertices
    }

    /// Returns the corners of the triangles, counterclockwise from outside.
    pub fn triangles(&self) -> &[[u32; 3]] {
        &self.0.triangles
    }

    /// Returns centre and radius of a sphere around the hull.
    pub(super) fn bound(&self) -> (Vec3A, f32) {
        self.0.bound
    }

    /// Returns the signed distance of a point, negative inside, and the unit direction in which it grows.
    pub(super) fn distance(&self, p: Vec3A) -> (f32, Vec3A) {
        let height = |face: &Face| face.normal.dot(p) - face.offset;
        let nearest = self.0.faces.iter().map(|face| (height(face), face.normal));
        let inside =
            nearest.fold((f32::NEG_INFINITY, Vec3A::Z), |best, next| if next.0 > best.0 { next } else { best });
        if inside.0 <= 0.0 {
            return inside;
        }
        // The nearest point of a convex body lies on a face that the point sees.
        let seen = self.0.faces.iter().filter(|face| height(face) > 0.0);
        let away = seen.map(|face| p - nearest_of_triangle(p, &face.corners));
        let away = away.fold(
            Vec3A::INFINITY,
            |best, next| {
                if next.length_squared() < best.length_squared() { next } else { best }
            },
        );
        let distance = away.length();
        if distance > 0.0 { (distance, away / distance) } else { inside }
    }
}

/// Returns the point of a triangle that is nearest to `p` (Ericson, Real-Time Collision Detection, section 5.1.5).
fn nearest_of_triangle(p: Vec3A, [a, b, c]: &[Vec3A; 3]) -> Vec3A {
    let (ab, ac, ap) = (*b - *a, *c - *a, p - *a);
    let (d1, d2) = (ab.dot(ap), ac.dot(ap));
    if d1 <= 0.0 && d2 <= 0.0 {
        return *a;
    }
    let bp = p - *b;
    let (d3, d4) = (ab.dot(bp), ac.dot(bp));
    if d3 >= 0.0 && d4 <= d3 {
        return *b;
    }
    let vc = d1 * d4 - d3 * d2;
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        return *a + ab * (d1 / (d1 - d3));
    }
    let cp = p - *c;
    let (d5, d6) = (ab.dot(cp), ac.dot(cp));
    if d6 >= 0.0 && d5 <= d6 {
        return *c;
    }
    let vb = d5 * d2 - d1 * d6;
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        return *a + ac * (d2 / (d2 - d6));
    }
    let va = d3 * d6 - d5 * d4;
    if va <= 0.0 && d4 - d3 >= 0.0 && d5 - d6 >= 0.0 {
        return *b + (*c - *b) * ((d4 - d3) / ((d4 - d3) + (d5 - d6)));
    }
    let scale = 1.0 / (va + vb + vc);
    *a + ab * (vb * scale) + ac * (vc * scale)
}

impl TryFrom<Vec<[f64; 3]>> for Hull {
    type Error = HullError;
    fn try_from(points: Vec<[f64; 3]>) -> Result<Self, HullError> {
        Self::of(&points)
    }
}

impl From<Hull> for Vec<[f64; 3]> {
    fn from(hull: Hull) -> Self {
        hull.vertices().to_vec()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_hull_drops_inner_points_and_comes_back_from_its_text() {
        let corner = |k: usize| [k & 1, k >> 1 & 1, k >> 2 & 1].map(|bit| 0.02 * bit as f64);
        let points: Vec<[f64; 3]> = (0..8).map(corner).chain([[0.01; 3]]).collect();
        let hull = Hull::of(&points).unwrap();
        assert_eq!((hull.vertices().len(), hull.triangles().len()), (8, 12));
        let text =
            toml::to_string(&toml::Table::from_iter([("hull".to_owned(), toml::Value::try_from(&hull).unwrap())]));
        let back: Hull = toml::from_str::<toml::Table>(&text.unwrap()).unwrap()["hull"].clone().try_into().unwrap();
        assert_eq!(back.vertices(), hull.vertices());
    }

    #[test]
    fn distances_are_those_of_a_box() {
        let corner =
            |k: usize| [0.01, 0.02, 0.03].iter().enumerate().map(move |(a, h)| if k >> a & 1 == 1 { *h } else { -h });
        let points: Vec<[f64; 3]> =
            (0..8).map(|k| <[f64; 3]>::try_from(corner(k).collect::<Vec<_>>()).unwrap()).collect();
        let hull = Hull::of(&points).unwrap();
        let half = Vec3A::new(0.01, 0.02, 0.03);
        for k in 0..1000u32 {
            let at = |step: u32| (k.wrapping_mul(step) % 1009) as f32 / 1009.0 * 0.12 - 0.06;
            let p = Vec3A::new(at(17), at(229), at(631));
            let beyond = p.abs() - half;
            let expected = beyond.max(Vec3A::ZERO).length() + beyond.max_element().min(0.0);
            let (distance, direction) = hull.distance(p);
            assert!((distance - expected).abs() < 1e-6, "{p}: {distance} {expected}");
            let ahead = hull.distance(p + 1e-4 * direction).0;
            assert!(((ahead - distance) / 1e-4 - 1.0).abs() < 0.02, "{p}");
        }
    }

    #[test]
    fn flat_points_and_numbers_that_are_not_finite_are_refused() {
        assert!(matches!(Hull::of(&[[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]), Err(HullError::Flat(_))));
        assert!(Hull::of(&[[f64::NAN; 3]; 8]).is_err());
        assert!(matches!(Hull::of(&vec![[0.0; 3]; 300]), Err(HullError::Large(300))));
    }
}
