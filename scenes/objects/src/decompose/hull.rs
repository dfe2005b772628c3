//! Convex hulls.

use glam::Vec3;
use mvt_mesh::Mesh;
use parry3d::math::Vector;
use parry3d::transformation::try_convex_hull;

/// Mesh without a convex hull, with the reason.
#[derive(Debug, thiserror::Error)]
#[error("no convex hull: {0}; the mesh is flat or damaged")]
pub struct NoHull(String);

impl NoHull {
    /// The error of a mesh without a volume.
    pub(super) fn flat() -> Self {
        Self("it encloses no volume".to_owned())
    }
}

/// Number of points above which a hull is computed from the outermost ones: the time of parry3d grows with the square of the number of
/// points on the hull, and takes minutes for a million.
const MANY_POINTS: usize = 100_000;
/// Number of directions, 9 degrees apart: a ball of 100 mm loses 0.2 mm of its diameter.
const DIRECTIONS: usize = 512;

/// Returns the outermost point in each of [`DIRECTIONS`] directions, without repetitions.
fn outermost_points(points: &[Vec3]) -> Vec<Vec3> {
    // Fibonacci's lattice on the sphere: each direction is turned by the golden angle.
    let golden = std::f32::consts::PI * (3.0 - 5f32.sqrt());
    let direction = |k: usize| {
        let z = 1.0 - (2 * k + 1) as f32 / DIRECTIONS as f32;
        let (sin, cos) = (golden * k as f32).sin_cos();
        let radius = (1.0 - z * z).sqrt();
        Vec3::new(radius * cos, radius * sin, z)
    };
    let axes = [Vec3::X, Vec3::Y, Vec3::Z, Vec3::NEG_X, Vec3::NEG_Y, Vec3::NEG_Z];
    let mut kept: Vec<Vec3> = Vec::new();
    for direction in (0..DIRECTIONS).map(direction).chain(axes) {
        let farther = |best: Vec3, point: &Vec3| if point.dot(direction) > best.dot(direction) { *point } else { best };
        let outermost = points.iter().fold(points[0], farther);
        if !kept.contains(&outermost) {
            kept.push(outermost);
        }
    }
    kept
}

/// Convex polyhedron.
#[derive(Debug, Clone)]
pub(super) struct Hull {
    mesh: Mesh,
}

impl Hull {
    /// Computes the convex hull of points; of very many, the hull of the outermost in [`DIRECTIONS`] directions.
    pub(super) fn of(points: &[Vec3]) -> Result<Self, NoHull> {
        let outermost;
        let points = if points.len() > MANY_POINTS {
            outermost = outermost_points(points);
            &outermost
        } else {
            points
        };
        let points: Vec<Vector> = points.iter().map(|p| Vector::from_array(p.to_array())).collect();
        let (vertices, faces) = try_convex_hull(&points).map_err(|error| NoHull(error.to_string()))?;
        Ok(Self { mesh: Mesh { vertices: vertices.iter().map(|v| Vec3::from_array(v.to_array())).collect(), faces } })
    }

    /// Returns the volume, m^3.
    pub(super) fn volume_m3(&self) -> f64 {
        self.mesh.volume_m3()
    }

    /// Returns the corners.
    pub(super) fn vertices(&self) -> &[Vec3] {
        &self.mesh.vertices
    }

    /// Returns the outward normal of each face and the distance of its plane from the origin.
    fn planes(&self) -> Vec<(Vec3, f32)> {
        let plane = |[a, b, c]: [Vec3; 3]| {
            let normal = (b - a).cross(c - a).normalize_or_zero();
            (normal, normal.dot(a))
        };
        self.mesh.triangles().map(plane).collect()
    }

    /// Returns at most `limit` of the vertices, whose hull is nearly this one. Starts with the extremes along the axes,
    /// which keep the bounding box and with it the height at which the object stands; then adds the vertex that lies
    /// farthest outside.
    pub(super) fn reduced(&self, limit: usize) -> Vec<Vec3> {
        let vertices = &self.mesh.vertices;
        if vertices.len() <= limit {
            return vertices.clone();
        }
        let mut kept: Vec<Vec3> = Vec::with_capacity(limit);
        for axis in [Vec3::X, Vec3::Y, Vec3::Z, Vec3::NEG_X, Vec3::NEG_Y, Vec3::NEG_Z] {
            let reach = |v: &&Vec3| v.dot(axis);
            let extreme = vertices.iter().max_by(|a, b| reach(a).total_cmp(&reach(b)));
            kept.extend(extreme.filter(|v| !kept.contains(v)));
        }
        while kept.len() < limit {
            let planes: Vec<(Vec3, f32)> = Hull::of(&kept).map_or_else(|_| Vec::new(), |hull| hull.planes());
            // Until the kept points span a volume there is no outside, and the distance to the nearest kept point
            // replaces it.
            let outside = |v: &Vec3| match &*planes {
                [] => kept.iter().map(|k| k.distance(*v)).fold(f32::INFINITY, f32::min),
                planes => planes.iter().map(|(normal, at)| normal.dot(*v) - at).fold(f32::NEG_INFINITY, f32::max),
            };
            let farthest = vertices.iter().map(|v| (*v, outside(v))).max_by(|a, b| a.1.total_cmp(&b.1));
            match farthest {
                Some((v, distance)) if distance > 1e-6 => kept.push(v),
                _ => break,
            }
        }
        kept
    }
}
