//! Shapes of links as primitives of a hand.

use glam::Vec3;
use mvt_objects::decompose;
use mvt_robot::hand::{Hull, Primitive};
use nalgebra as na;

/// Sides of the prism that replaces a cylinder: it lies within 0.5 % of the radius.
const SIDES: usize = 32;
/// Greatest coordinate of a hull, metres: of a hand in micrometres. Hulls of larger coordinates overflow.
const GREATEST_M: f32 = 1e6;

/// Returns a box.
pub(crate) fn block(place: &na::Isometry3<f64>, half: [f64; 3]) -> Primitive {
    Primitive::Box { centre: place.translation.vector.into(), half, orientation_wxyz: wxyz(&place.rotation) }
}

/// Returns an ellipsoid.
pub(crate) fn ellipsoid(place: &na::Isometry3<f64>, semi: [f64; 3]) -> Primitive {
    Primitive::Ellipsoid { centre: place.translation.vector.into(), semi, orientation_wxyz: wxyz(&place.rotation) }
}

/// Returns a capsule along the z axis of its place, with the half length of its axis.
pub(crate) fn capsule(place: &na::Isometry3<f64>, radius: f64, half: f64) -> Primitive {
    let end = |z: f64| (place * na::Point3::new(0.0, 0.0, z)).coords.into();
    Primitive::Capsule { from: end(-half), to: end(half), radius }
}

/// Returns a prism in the place of a cylinder along the z axis.
///
/// # Errors
/// If the cylinder is flat or not finite.
pub(crate) fn cylinder(place: &na::Isometry3<f64>, radius: f64, half: f64) -> Result<Primitive, String> {
    let corner = |k: usize| {
        let (sin, cos) = (std::f64::consts::TAU * k as f64 / SIDES as f64).sin_cos();
        [-half, half].map(|z| place * na::Point3::new(radius * cos, radius * sin, z))
    };
    let corners: Vec<[f64; 3]> = (0..SIDES).flat_map(corner).map(|p| p.coords.into()).collect();
    Hull::of(&corners).map(Primitive::Hull).map_err(|error| error.to_string())
}

/// Returns the convex hull of points, reduced to the number that MuJoCo collides quickly with.
///
/// # Errors
/// If the points are flat or not finite.
pub(crate) fn hull(points: impl Iterator<Item = na::Point3<f64>>) -> Result<Primitive, String> {
    let points: Vec<Vec3> = points.map(|p| Vec3::new(p.x as f32, p.y as f32, p.z as f32)).collect();
    if !points.iter().all(|p| p.abs().max_element() < GREATEST_M) {
        return Err(format!("a coordinate exceeds {GREATEST_M} m, or is not finite"));
    }
    let points = decompose::hull_points(&points).map_err(|error| error.to_string())?;
    let points: Vec<[f64; 3]> = points.iter().map(|p| p.to_array().map(f64::from)).collect();
    Hull::of(&points).map(Primitive::Hull).map_err(|error| error.to_string())
}

/// Returns a rotation as a quaternion (w, x, y, z).
pub(crate) fn wxyz(rotation: &na::UnitQuaternion<f64>) -> [f64; 4] {
    [rotation.w, rotation.i, rotation.j, rotation.k]
}

/// Returns points on the surface of a primitive, by which its extent is measured.
pub(crate) fn outline(shape: &Primitive) -> Vec<na::Point3<f64>> {
    let corners = |centre: &[f64; 3], extent: &[f64; 3], [w, x, y, z]: [f64; 4]| {
        let turn = na::UnitQuaternion::from_quaternion(na::Quaternion::new(w, x, y, z));
        let centre = na::Point3::from(*centre);
        let corner =
            |k: usize| na::Vector3::from_fn(|axis, _| if k >> axis & 1 == 1 { extent[axis] } else { -extent[axis] });
        (0..8).map(|k| centre + turn * corner(k)).collect()
    };
    match shape {
        Primitive::Box { centre, half, orientation_wxyz } => corners(centre, half, *orientation_wxyz),
        Primitive::Ellipsoid { centre, semi, orientation_wxyz } => corners(centre, semi, *orientation_wxyz),
        Primitive::Capsule { from, to, radius } => {
            let ends = [from, to].map(|end| corners(end, &[*radius; 3], mvt_robot::hand::UPRIGHT));
            ends.concat()
        }
        Primitive::Hull(hull) => hull.vertices().iter().map(|v| na::Point3::from(*v)).collect(),
    }
}

/// Checks a place of the file.
pub(crate) fn placing(position_m: [f64; 3], [w, x, y, z]: [f64; 4]) -> Result<na::Isometry3<f64>, String> {
    let quaternion = na::Quaternion::new(w, x, y, z);
    let norm = quaternion.norm();
    // Users write three digits.
    if !((norm - 1.0).abs() < 0.01 && position_m.iter().all(|v| v.is_finite())) {
        return Err(format!(
            "a place needs finite numbers and a quaternion (w, x, y, z) of length 1; that of orientation_wxyz is {norm:.3}"
        ));
    }
    let [x, y, z] = position_m;
    Ok(na::Isometry3::from_parts(na::Translation3::new(x, y, z), na::UnitQuaternion::from_quaternion(quaternion)))
}
