//! Convex pieces for collision. MuJoCo collides with the convex hull of a mesh, so a shape that its hull would misrepresent
//! is cut into pieces first.

use glam::Vec3;
use parry3d::math::Vector;
use parry3d::transformation::try_convex_hull;
use parry3d::transformation::vhacd::{VHACD, VHACDParameters};

use mvt_mesh::Mesh;

mod polar;

/// Most points of one piece. Above it MuJoCo's collision only gets slower.
pub const MAX_POINTS: usize = 64;
/// Most pieces of one object.
pub const MAX_PIECES: usize = 64;
/// Up to this ratio of hull to mesh volume the hull stands for the mesh: cans with recessed lids and fruit with dimples
/// are below, a banana (1.55), duplo (1.4) and everything hollow above.
pub const CONVEX_RATIO: f64 = 1.25;
/// Above this ratio of the pieces' volume to the mesh's the voxel decomposition has filled a cavity: the walls are too thin for it.
const FILLED_RATIO: f64 = 1.3;

/// Why a mesh has no convex hull.
#[derive(Debug, thiserror::Error)]
#[error("no convex hull: {0}; the mesh is flat or damaged")]
pub struct NoHull(String);

/// The convex pieces that stand for a mesh in collision, each as at most [`MAX_POINTS`] points whose hull it is: the hull of the
/// mesh where that is nearly the mesh, else parry3d's VHACD (Mamou 2016), and for what VHACD fills, cups and bowls, a
/// decomposition round the vertical axis.
///
/// # Errors
/// [`NoHull`] if the mesh is flat.
pub fn pieces(mesh: &Mesh) -> Result<Vec<Vec<Vec3>>, NoHull> {
    let hull = Hull::of(&mesh.vertices)?;
    let solid_m3 = mesh.volume_m3();
    // An open mesh has no volume to compare with.
    if !mesh.edges().watertight() || hull.volume_m3() <= CONVEX_RATIO * solid_m3 {
        return Ok(vec![hull.reduced(MAX_POINTS)]);
    }
    let ratio = |hulls: &[Hull]| hulls.iter().map(Hull::volume_m3).sum::<f64>() / solid_m3;
    let mut hulls = by_voxels(mesh);
    if hulls.is_empty() || ratio(&hulls) > FILLED_RATIO {
        let around = polar::decompose(mesh);
        if hulls.is_empty() || (ratio(&around) > 0.8 && ratio(&around) < ratio(&hulls)) {
            hulls = around;
        }
    }
    if hulls.is_empty() {
        hulls.push(hull);
    }
    Ok(hulls.iter().map(|hull| hull.reduced(MAX_POINTS)).collect())
}

fn by_voxels(mesh: &Mesh) -> Vec<Hull> {
    let parameters = VHACDParameters { max_convex_hulls: MAX_PIECES as u32, ..VHACDParameters::default() };
    let vertices: Vec<Vector> = mesh.vertices.iter().map(|v| Vector::from_array(v.to_array())).collect();
    let parts = VHACD::decompose(&parameters, &vertices, &mesh.faces, true);
    parts
        .compute_primitive_intersections(&vertices, &mesh.faces)
        .iter()
        // A part that touches no volume is a scrap of surface between the others.
        .filter_map(|points| Hull::of(&points.iter().map(|v| Vec3::from_array(v.to_array())).collect::<Vec<_>>()).ok())
        .collect()
}

/// Volume of the convex hull of a mesh, m^3.
///
/// # Errors
/// [`NoHull`] if the mesh is flat.
pub fn hull_volume_m3(mesh: &Mesh) -> Result<f64, NoHull> {
    Ok(Hull::of(&mesh.vertices)?.volume_m3())
}

/// A convex polyhedron.
#[derive(Debug, Clone)]
pub(crate) struct Hull {
    mesh: Mesh,
}

impl Hull {
    pub(crate) fn of(points: &[Vec3]) -> Result<Self, NoHull> {
        let points: Vec<Vector> = points.iter().map(|p| Vector::from_array(p.to_array())).collect();
        let (vertices, faces) = try_convex_hull(&points).map_err(|error| NoHull(error.to_string()))?;
        Ok(Self { mesh: Mesh { vertices: vertices.iter().map(|v| Vec3::from_array(v.to_array())).collect(), faces } })
    }

    pub(crate) fn volume_m3(&self) -> f64 {
        self.mesh.volume_m3()
    }

    /// The corners.
    pub(crate) fn vertices(&self) -> &[Vec3] {
        &self.mesh.vertices
    }

    /// Outward normal of each face and its distance from the origin along it.
    fn planes(&self) -> Vec<(Vec3, f32)> {
        let plane = |[a, b, c]: [Vec3; 3]| {
            let normal = (b - a).cross(c - a).normalize_or_zero();
            (normal, normal.dot(a))
        };
        self.mesh.triangles().map(plane).collect()
    }

    /// At most `limit` of the vertices, whose hull is nearly this one: start from the extremes along the axes, which keep the
    /// bounding box and with it the height at which the object stands, then add what lies farthest outside.
    pub(crate) fn reduced(&self, limit: usize) -> Vec<Vec3> {
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
            // Before the kept points span a volume there is no outside: distance to the nearest kept point stands in.
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
