//! Triangle meshes of the primitives of the hand.

use std::f64::consts::{PI, TAU};

use mvt_mesh::Mesh;
use mvt_robot::hand::{Hull, Primitive};
use nalgebra as na;

/// Returns the surface of a primitive, with `segments` (rounded up to an even number, at least 8) around capsules and
/// ellipsoids. It deviates from the true surface by (pi / segments)^2 / 2 of the radius to either side. Boxes and hulls
/// keep hard edges: their faces share no vertices.
pub fn tessellate(shape: &Primitive, segments: usize) -> Mesh {
    let segments = segments.max(8).next_multiple_of(2);
    match shape {
        Primitive::Box { centre, half, orientation_wxyz } => {
            let (centre, turn) = (na::Vector3::from(*centre), turn(orientation_wxyz));
            cuboid((*half).into(), |p| centre + turn * p)
        }
        Primitive::Ellipsoid { centre, semi, orientation_wxyz } => {
            let (centre, semi, turn) = (na::Vector3::from(*centre), na::Vector3::from(*semi), turn(orientation_wxyz));
            globe(segments, 0.0, |p| centre + turn * p.component_mul(&semi))
        }
        Primitive::Capsule { from, to, radius } => {
            let (from, to, radius) = (na::Vector3::from(*from), na::Vector3::from(*to), *radius);
            let axis = to - from;
            let turn = na::Rotation3::rotation_between(&na::Vector3::z(), &axis)
                .unwrap_or_else(|| na::Rotation3::from_axis_angle(&na::Vector3::x_axis(), PI));
            let middle = (from + to) / 2.0;
            globe(segments, axis.norm() / 2.0 / radius, |p| middle + turn * p * radius)
        }
        Primitive::Hull(hull) => polyhedron(hull),
    }
}

/// Returns the rotation of a quaternion (w, x, y, z).
fn turn(&[w, x, y, z]: &[f64; 4]) -> na::UnitQuaternion<f64> {
    na::UnitQuaternion::from_quaternion(na::Quaternion::new(w, x, y, z))
}

fn polyhedron(hull: &Hull) -> Mesh {
    let mut mesh = Mesh::default();
    for triangle in hull.triangles() {
        let first = mesh.vertices.len() as u32;
        triangle.iter().for_each(|&corner| push(&mut mesh, hull.vertices()[corner as usize].into()));
        mesh.faces.push([first, first + 1, first + 2]);
    }
    mesh
}

/// Returns a box around the origin, moved by `place`.
fn cuboid(half: na::Vector3<f64>, place: impl Fn(na::Vector3<f64>) -> na::Vector3<f64>) -> Mesh {
    let mut mesh = Mesh::default();
    for axis in 0..3 {
        for sign in [-1.0, 1.0] {
            let first = mesh.vertices.len() as u32;
            // This order of the other two axes keeps the corners counter-clockwise from outside.
            let (a, b) = if sign > 0.0 { ((axis + 1) % 3, (axis + 2) % 3) } else { ((axis + 2) % 3, (axis + 1) % 3) };
            for (s, t) in [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)] {
                let mut corner = half;
                (corner[axis], corner[a], corner[b]) = (sign * half[axis], s * half[a], t * half[b]);
                push(&mut mesh, place(corner));
            }
            mesh.faces.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
        }
    }
    mesh
}

/// Returns a unit sphere around z, cut at the equator and drawn apart by `half_length` to either side, then moved by
/// `place`.
fn globe(segments: usize, half_length: f64, place: impl Fn(na::Vector3<f64>) -> na::Vector3<f64>) -> Mesh {
    let half_turn = segments / 2;
    // Vertices lie a little outside the sphere, and the middles of the faces as much inside.
    let radius = 1.0 / (PI / segments as f64).cos();
    let mut mesh = Mesh::default();
    // Polar angle and shift along the axis of each ring of vertices; a capsule has two at its equator.
    let polar = |k: usize| k as f64 * PI / half_turn as f64;
    let upper = (1..=half_turn / 2).map(|k| (polar(k), half_length));
    let lower = (half_turn / 2 + usize::from(half_length == 0.0)..half_turn).map(|k| (polar(k), -half_length));
    let rings: Vec<(f64, f64)> = upper.chain(lower).collect();
    push(&mut mesh, place(na::Vector3::new(0.0, 0.0, radius + half_length)));
    for &(polar, offset) in &rings {
        for k in 0..segments {
            let (sin, cos) = (k as f64 * TAU / segments as f64).sin_cos();
            let around = radius * polar.sin();
            push(&mut mesh, place(na::Vector3::new(around * cos, around * sin, radius * polar.cos() + offset)));
        }
    }
    push(&mut mesh, place(na::Vector3::new(0.0, 0.0, -radius - half_length)));
    let vertex = |ring: usize, k: usize| (1 + ring * segments + k % segments) as u32;
    let last = mesh.vertices.len() as u32 - 1;
    for k in 0..segments {
        mesh.faces.push([0, vertex(0, k), vertex(0, k + 1)]);
        for ring in 1..rings.len() {
            let [a, b] = [vertex(ring - 1, k), vertex(ring - 1, k + 1)];
            let [c, d] = [vertex(ring, k), vertex(ring, k + 1)];
            mesh.faces.extend([[a, c, d], [a, d, b]]);
        }
        mesh.faces.push([vertex(rings.len() - 1, k), last, vertex(rings.len() - 1, k + 1)]);
    }
    mesh
}

fn push(mesh: &mut Mesh, p: na::Vector3<f64>) {
    mesh.vertices.push(glam::DVec3::new(p.x, p.y, p.z).as_vec3());
}

#[cfg(test)]
mod tests {
    use super::*;
    use mvt_robot::hand::UPRIGHT;

    /// A rotation by 120 degrees.
    const TURNED: [f64; 4] = [0.5, 0.5, 0.5, 0.5];

    /// Returns the enclosed volume. Each edge must occur once in either direction.
    fn closed_volume(mesh: &Mesh) -> f64 {
        let mut edges = std::collections::HashMap::new();
        let mut volume = 0.0;
        let key = |i: u32| mesh.vertices[i as usize].to_array().map(f32::to_bits);
        for face in &mesh.faces {
            let [a, b, c] = face.map(|i| mesh.vertices[i as usize].as_dvec3());
            volume += a.dot(b.cross(c)) / 6.0;
            for k in 0..3 {
                let (p, q) = (key(face[k]), key(face[(k + 1) % 3]));
                *edges.entry((p, q)).or_insert(0) += 1;
                *edges.entry((q, p)).or_insert(0) -= 1;
            }
        }
        assert!(edges.values().all(|&n| n == 0), "open edges");
        volume
    }

    fn brick(orientation_wxyz: [f64; 4]) -> Primitive {
        Primitive::Box { centre: [0.1, 0.2, -0.1], half: [0.01, 0.02, 0.03], orientation_wxyz }
    }

    fn egg(orientation_wxyz: [f64; 4]) -> Primitive {
        Primitive::Ellipsoid { centre: [0.0, 0.1, 0.0], semi: [0.009, 0.0128, 0.0165], orientation_wxyz }
    }

    /// The corners of the upright box.
    fn corners() -> Vec<[f64; 3]> {
        let side = |k: usize, axis: usize| if k >> axis & 1 == 1 { 1.0 } else { -1.0 };
        (0..8).map(|k| [0.1 + 0.01 * side(k, 0), 0.2 + 0.02 * side(k, 1), -0.1 + 0.03 * side(k, 2)]).collect()
    }

    #[test]
    fn primitives_lie_where_their_orientation_puts_them() {
        // The rotation takes x to y, y to z and z to x.
        let extent = |shape: &Primitive| {
            let vertices = tessellate(shape, 64).vertices;
            let low = vertices.iter().fold(glam::Vec3::INFINITY, |low, v| low.min(*v));
            let high = vertices.iter().fold(glam::Vec3::NEG_INFINITY, |high, v| high.max(*v));
            (high - low) / 2.0
        };
        assert!(extent(&brick(TURNED)).distance(glam::Vec3::new(0.03, 0.01, 0.02)) < 1e-6);
        assert!(extent(&egg(TURNED)).distance(glam::Vec3::new(0.0165, 0.009, 0.0128)) < 1e-4);
    }

    #[test]
    fn primitives_are_closed_and_have_their_volume() {
        let shapes = [
            (brick(UPRIGHT), 8.0 * 6e-6),
            (brick(TURNED), 8.0 * 6e-6),
            (Primitive::Hull(Hull::of(&corners()).unwrap()), 8.0 * 6e-6),
            (egg(UPRIGHT), 4.0 / 3.0 * PI * 1.900_8e-6),
            (egg(TURNED), 4.0 / 3.0 * PI * 1.900_8e-6),
            (
                Primitive::Capsule { from: [0.0, 0.0, 0.05], to: [0.0, 0.03, 0.05], radius: 0.01 },
                PI * 1e-4 * 0.03 + 4.0 / 3.0 * PI * 1e-6,
            ),
            (
                Primitive::Capsule { from: [0.0, 0.0, 0.05], to: [0.0, 0.0, 0.02], radius: 0.01 },
                PI * 1e-4 * 0.03 + 4.0 / 3.0 * PI * 1e-6,
            ),
        ];
        for (shape, volume) in shapes {
            let found = closed_volume(&tessellate(&shape, 64));
            assert!((found / volume - 1.0).abs() < 1.5e-3, "{shape:?}: {found} instead of {volume}");
        }
    }
}
