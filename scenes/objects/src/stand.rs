//! Moves published meshes to the object's frame.

use mvt_frames::{Isometry, MeshFile, Object};
use mvt_mesh::Mesh;
use nalgebra as na;

/// Moves a mesh to the object's frame and returns the rigid motion. `up`, a direction in the file, becomes z; the
/// smaller turn aligns the smallest rectangle around the footprint with x and y; the centre of the bounding box becomes
/// the origin.
pub fn stand(mesh: &Mesh, up: [f64; 3]) -> (Mesh, Isometry<MeshFile, Object>) {
    let points: Vec<na::Vector3<f64>> = mesh.vertices.iter().map(|v| v.to_array().map(f64::from).into()).collect();
    let z = na::Vector3::z();
    let upright = na::UnitQuaternion::rotation_between(&up.into(), &z)
        // Only the opposite direction has no unique shortest turn.
        .unwrap_or_else(|| na::UnitQuaternion::from_axis_angle(&na::Vector3::x_axis(), std::f64::consts::PI));
    let footprint = points.iter().map(|p| (upright * p).xy()).collect();
    let level = na::UnitQuaternion::from_axis_angle(&na::Vector3::z_axis(), -yaw(footprint));
    let rotation = level * upright;
    let turned = points.iter().map(|p| rotation * p);
    let (low, high) = turned
        .clone()
        .fold((na::Vector3::repeat(f64::INFINITY), na::Vector3::repeat(f64::NEG_INFINITY)), |(low, high), p| {
            (low.inf(&p), high.sup(&p))
        });
    let centre = if points.is_empty() { na::Vector3::zeros() } else { (low + high) * 0.5 };
    let vertices = turned.map(|p| glam::DVec3::from((p - centre).as_slice().try_into().unwrap_or([0.0; 3])).as_vec3());
    let standing = Mesh { vertices: vertices.collect(), faces: mesh.faces.clone() };
    (standing, Isometry::new(na::Isometry3::from_parts((-centre).into(), rotation)))
}

/// Returns the angle of the smallest rectangle around points of the plane, -45 to 45 degrees, in radians. One side of
/// it lies along a side of the convex hull (Freeman and Shapira 1975).
fn yaw(points: Vec<na::Vector2<f64>>) -> f64 {
    let hull = hull_2d(points);
    let mut best = (f64::INFINITY, 0.0);
    for (i, a) in hull.iter().enumerate() {
        let along = (hull[(i + 1) % hull.len()] - a).normalize();
        let across = na::Vector2::new(-along.y, along.x);
        let width = |axis: na::Vector2<f64>| {
            let reach = hull.iter().map(|p| p.dot(&axis));
            reach.clone().fold(f64::NEG_INFINITY, f64::max) - reach.fold(f64::INFINITY, f64::min)
        };
        let area = width(along) * width(across);
        // Opposite sides give the same rectangle up to rounding errors; the first one is kept.
        if area < best.0 * (1.0 - 1e-9) {
            best = (area, along.y.atan2(along.x));
        }
    }
    let quarter = std::f64::consts::FRAC_PI_2;
    best.1 - (best.1 / quarter).round() * quarter
}

/// Returns the convex hull of points of the plane, counter-clockwise (Andrew's monotone chain).
fn hull_2d(mut points: Vec<na::Vector2<f64>>) -> Vec<na::Vector2<f64>> {
    points.sort_unstable_by(|a, b| a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)));
    points.dedup();
    let half = |points: &mut dyn Iterator<Item = &na::Vector2<f64>>| {
        let mut chain: Vec<na::Vector2<f64>> = Vec::new();
        for &p in points {
            while let [.., a, b] = chain[..] {
                if (b - a).perp(&(p - b)) > 0.0 {
                    break;
                }
                chain.pop();
            }
            chain.push(p);
        }
        chain.pop();
        chain
    };
    let mut hull = half(&mut points.iter());
    hull.extend(half(&mut points.iter().rev()));
    hull
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;
    use mvt_frames::Point;

    #[test]
    fn a_turned_box_is_levelled_and_centred() {
        // A 60 x 40 x 20 mm box, turned by 30 degrees and moved.
        let turn = glam::Quat::from_rotation_z(30_f32.to_radians());
        let corner = |i: u32| Vec3::new((i & 1) as f32 * 0.06, (i >> 1 & 1) as f32 * 0.04, (i >> 2) as f32 * 0.02);
        let vertices: Vec<Vec3> = (0..8).map(|i| turn * corner(i) + Vec3::new(0.3, -0.2, 0.1)).collect();
        let file = Mesh { vertices: vertices.clone(), faces: vec![] };
        let (standing, object_from_file) = stand(&file, [0.0, 0.0, 1.0]);
        assert!((standing.extents_m() - Vec3::new(0.06, 0.04, 0.02)).length() < 1e-6, "{}", standing.extents_m());
        let [low, high] = standing.bounds_m();
        assert!((low + high).length() < 1e-7);
        for (v, s) in vertices.iter().zip(&standing.vertices) {
            let moved = (object_from_file * Point::from(na::Vector3::from(v.to_array().map(f64::from)))).coords();
            assert!((moved - na::Vector3::from(s.to_array().map(f64::from))).norm() < 1e-7);
        }
        // On its long side, and upside down.
        let along = (turn * Vec3::X).to_array().map(f64::from);
        assert!((stand(&file, along).0.extents_m().z - 0.06).abs() < 1e-6);
        let [.., z] = stand(&file, [0.0, 0.0, -1.0]).0.vertices[0].to_array();
        assert!((z - 0.01).abs() < 1e-6, "the floor of the file is on top: {z}");
    }
}
