//! Convex pieces for collision. MuJoCo collides with the convex hull of a mesh, so a shape that differs from its hull
//! is cut into pieces first.

use glam::Vec3;
use mvt_mesh::Mesh;
use parry3d::math::Vector;
use parry3d::transformation::vhacd::{VHACD, VHACDParameters};

mod hull;
mod polar;

use hull::Hull;
pub use hull::NoHull;

/// Limit for the points of one piece. More points only slow MuJoCo's collision down.
pub const MAX_POINTS: usize = 64;
/// Limit for the pieces of one object.
pub const MAX_PIECES: usize = 64;
/// Ratio of the hull's volume to the cube of the diagonal below which a mesh is flat. A sheet of paper is just above.
const FLAT_RATIO: f64 = 1e-6;
/// Ratio of hull to mesh volume up to which the hull replaces the mesh. Cans with recessed lids and fruit with dimples
/// are below; a banana (1.55), duplo (1.4) and all hollow objects are above.
pub const CONVEX_RATIO: f64 = 1.25;
/// Ratio of the pieces' volume to the mesh's above which the voxel decomposition has filled a cavity, because the walls
/// are thin.
const FILLED_RATIO: f64 = 1.3;

/// Returns the convex pieces of a mesh for collision. A mesh whose hull has at most [`CONVEX_RATIO`] times its volume
/// is one piece; see [`pieces_above`].
///
/// # Errors
/// [`NoHull`] if the mesh is flat.
pub fn pieces(mesh: &Mesh) -> Result<Vec<Vec<Vec3>>, NoHull> {
    pieces_above(mesh, CONVEX_RATIO)
}

/// Returns the convex pieces of a mesh for collision, each as at most [`MAX_POINTS`] points whose hull it is. A mesh
/// whose hull has at most `convex_ratio` times its volume is one piece. Other meshes are decomposed by parry3d's VHACD (Mamou 2016), and cups and
/// bowls, which VHACD fills, by a decomposition around the vertical axis.
///
/// # Errors
/// [`NoHull`] if the mesh is flat.
pub fn pieces_above(mesh: &Mesh, convex_ratio: f64) -> Result<Vec<Vec<Vec3>>, NoHull> {
    let hull = Hull::of(&mesh.vertices)?;
    let [low, high] = mesh.bounds_m();
    if hull.volume_m3() < FLAT_RATIO * f64::from((high - low).length()).powi(3) {
        return Err(NoHull::flat());
    }
    let solid_m3 = mesh.volume_m3();
    // An open mesh has no volume to compare with.
    if !mesh.edges().watertight() || hull.volume_m3() <= convex_ratio * solid_m3 {
        return Ok(vec![hull.reduced(MAX_POINTS)]);
    }
    let ratio = |hulls: &[Hull]| hulls.iter().map(Hull::volume_m3).sum::<f64>() / solid_m3;
    let mut hulls = by_voxels(mesh);
    if hulls.is_empty() || ratio(&hulls) > FILLED_RATIO {
        let around = polar::decompose(mesh, MAX_PIECES);
        if hulls.is_empty() || (ratio(&around) > 0.8 && ratio(&around) < ratio(&hulls)) {
            hulls = around;
        }
    }
    if hulls.is_empty() {
        hulls.push(hull);
    }
    Ok(hulls.iter().map(|hull| hull.reduced(MAX_POINTS)).collect())
}

/// Decomposes a mesh by VHACD.
fn by_voxels(mesh: &Mesh) -> Vec<Hull> {
    let parameters = VHACDParameters { max_convex_hulls: MAX_PIECES as u32, ..VHACDParameters::default() };
    let vertices: Vec<Vector> = mesh.vertices.iter().map(|v| Vector::from_array(v.to_array())).collect();
    let parts = VHACD::decompose(&parameters, &vertices, &mesh.faces, true);
    parts
        .compute_primitive_intersections(&vertices, &mesh.faces)
        .iter()
        // Drops parts without a volume, which are scraps of surface between the others.
        .filter_map(|points| Hull::of(&points.iter().map(|v| Vec3::from_array(v.to_array())).collect::<Vec<_>>()).ok())
        .collect()
}

/// Returns at most [`MAX_POINTS`] of some points, whose convex hull is nearly that of all.
///
/// # Errors
/// [`NoHull`] if the points are flat.
pub fn hull_points(points: &[Vec3]) -> Result<Vec<Vec3>, NoHull> {
    Ok(Hull::of(points)?.reduced(MAX_POINTS))
}

/// Returns the volume of the convex hull of a mesh, m^3.
///
/// # Errors
/// [`NoHull`] if the mesh is flat.
pub fn hull_volume_m3(mesh: &Mesh) -> Result<f64, NoHull> {
    Ok(Hull::of(&mesh.vertices)?.volume_m3())
}
