//! Free shapes. Each is defined as the polyhedron of its mesh.

use std::f64::consts::{PI, TAU};

use mvt_mesh::Mesh;
use nalgebra::{Vector2, Vector3};

use super::lathe::Profile;
use super::nets;
use super::shape::Shape;

/// Makes a bell pepper with four lobes, dimpled at both ends. Its diagonal is that of FeelSight's, 149.0 mm.
pub(super) fn bell_pepper() -> Shape {
    const RINGS: usize = 64;
    const SECTORS: usize = 112;
    // Apple-like profile over the angle from the bottom: the height dips towards the axis, and the top is broader.
    let point = |ring: usize, sector: usize| {
        let polar = PI * ring as f64 / RINGS as f64;
        let azimuth = TAU * sector as f64 / SECTORS as f64;
        let lobes = 1.0 + 0.07 * polar.sin() * (4.0 * azimuth).cos();
        let radius = polar.sin() * (0.95 - 0.12 * polar.cos()) * lobes;
        let height = -1.4 * polar.cos() * (1.0 - 0.25 * (-(polar.sin() / 0.35).powi(2)).exp());
        Vector3::new(radius * azimuth.cos(), radius * azimuth.sin(), height)
    };
    let points: Vec<Vector3<f64>> =
        (0..=RINGS).flat_map(|ring| (0..SECTORS).map(move |sector| 0.05 * point(ring, sector))).collect();
    let at = |ring: usize, sector: usize| (ring * SECTORS + sector % SECTORS) as u32;
    let faces: Vec<[u32; 3]> = (0..RINGS)
        .flat_map(|ring| (0..SECTORS).map(move |sector| (ring, sector)))
        .flat_map(|(r, s)| [[at(r, s), at(r, s + 1), at(r + 1, s + 1)], [at(r, s), at(r + 1, s + 1), at(r + 1, s)]])
        .collect();
    Shape::polyhedron(scaled_to(mvt_mesh::weld(&points, &faces), 0.1490))
}

/// Makes a mug of 80 mm with 5 mm walls and a handle along x.
pub(super) fn mug() -> Shape {
    let body = Profile::rounded(&[
        ([0.0, -42.0], 0.0),
        ([39.0, -42.0], 5.0),
        ([39.0, 42.0], 2.2),
        ([34.0, 42.0], 2.2),
        ([34.0, -37.0], 6.0),
        ([0.0, -37.0], 0.0),
    ]);
    let field = |p: Vector3<f64>| smooth_min(body.distance_m(p), ring_handle(p, 0.037, 0.025, 0.006), 0.004);
    moulded(field, Vector3::new(0.075, 0.045, 0.048), 0.0024, None)
}

/// Makes a duck: body, tail, head, beak and wings. Its diagonal is that of the rubber duck in FeelSight, 148.3 mm.
pub(super) fn duck() -> Shape {
    let field = |p: Vector3<f64>| {
        let body = ellipsoid(p, [0.0, 0.0, -10.0], [44.0, 34.0, 27.0]);
        let tail = capsule(p, [-34.0, 0.0, -2.0], [-50.0, 0.0, 14.0], 11.0, 4.0);
        let head = ball(p, [20.0, 0.0, 30.0], 22.0);
        let beak = ellipsoid(p, [45.0, 0.0, 26.0], [14.0, 11.0, 5.0]);
        let wings = ellipsoid(mirrored(p), [-6.0, 31.0, -4.0], [22.0, 7.0, 13.0]);
        let soft = [tail, head, wings].into_iter().fold(body, |field, part| smooth_min(field, part, 0.010));
        on_table(smooth_min(soft, beak, 0.004), p, -31.0)
    };
    moulded(field, Vector3::new(0.070, 0.055, 0.060), 0.0021, Some(0.1483))
}

/// Makes an elephant: body, legs, head, ears and trunk. Its diagonal is that of the elephant in FeelSight, 185.1 mm.
pub(super) fn elephant() -> Shape {
    let field = |p: Vector3<f64>| {
        let m = mirrored(p);
        let body = ellipsoid(p, [-10.0, 0.0, 8.0], [46.0, 34.0, 34.0]);
        let fore = capsule(m, [14.0, 19.0, -10.0], [14.0, 20.0, -55.0], 14.0, 13.0);
        let hind = capsule(m, [-34.0, 19.0, -10.0], [-34.0, 20.0, -55.0], 14.0, 13.0);
        let head = ball(p, [38.0, 0.0, 30.0], 25.0);
        let ear = ellipsoid(m, [28.0, 32.0, 32.0], [6.0, 18.0, 20.0]);
        let trunk = capsule(p, [58.0, 0.0, 24.0], [70.0, 0.0, -14.0], 11.0, 8.0);
        let tip = capsule(p, [70.0, 0.0, -14.0], [80.0, 0.0, -28.0], 8.0, 6.5);
        let whole = [fore, hind, head, trunk, tip].into_iter().fold(body, |field, part| smooth_min(field, part, 0.008));
        on_table(smooth_min(whole, ear, 0.005), p, -52.0)
    };
    moulded(field, Vector3::new(0.095, 0.065, 0.075), 0.0027, Some(0.1851))
}

/// Meshes the zero set of a field, scaled to a diagonal if one is given.
fn moulded(field: impl Fn(Vector3<f64>) -> f64, half_m: Vector3<f64>, cell_m: f64, diagonal_m: Option<f32>) -> Shape {
    let mesh = centred(nets::mesh(field, half_m, cell_m));
    Shape::polyhedron(match diagonal_m {
        Some(diagonal_m) => scaled_to(mesh, diagonal_m),
        None => mesh,
    })
}

/// Moves the bounding box to the origin.
fn centred(mut mesh: Mesh) -> Mesh {
    let [low, high] = mesh.bounds_m();
    mesh.vertices.iter_mut().for_each(|v| *v -= 0.5 * (low + high));
    mesh
}

/// Moves the bounding box to the origin and scales it to a diagonal.
fn scaled_to(mesh: Mesh, diagonal_m: f32) -> Mesh {
    let mut mesh = centred(mesh);
    let scale = diagonal_m / mesh.extents_m().length();
    mesh.vertices.iter_mut().for_each(|v| *v *= scale);
    mesh
}

// Fields in metres with centres and sizes in millimetres. Only their zero sets matter.

fn mm(millimetres: [f64; 3]) -> Vector3<f64> {
    Vector3::from(millimetres) * 1e-3
}

/// Mirrors the half space y < 0, which makes a shape symmetric.
fn mirrored(p: Vector3<f64>) -> Vector3<f64> {
    Vector3::new(p.x, p.y.abs(), p.z)
}

fn ball(p: Vector3<f64>, centre: [f64; 3], radius: f64) -> f64 {
    (p - mm(centre)).norm() - radius * 1e-3
}

/// Returns the first-order distance to an ellipsoid (Quilez).
fn ellipsoid(p: Vector3<f64>, centre: [f64; 3], axes: [f64; 3]) -> f64 {
    let (p, axes) = (p - mm(centre), mm(axes));
    let unit = p.component_div(&axes);
    let slope = unit.component_div(&axes).norm();
    // At the centre the slope vanishes.
    unit.norm() * (unit.norm() - 1.0) / slope.max(1e-9)
}

/// Returns the distance to a capsule from `a` to `b` whose radius changes from `from` to `to`.
fn capsule(p: Vector3<f64>, a: [f64; 3], b: [f64; 3], from: f64, to: f64) -> f64 {
    let (offset, along) = (p - mm(a), mm(b) - mm(a));
    let share = (offset.dot(&along) / along.norm_squared()).clamp(0.0, 1.0);
    (offset - share * along).norm() - 1e-3 * (from + share * (to - from))
}

/// Returns the distance to the handle of a cup, metres: half of a ring in the plane y = 0, made of a tube, whose ends
/// lie `end_m` from the axis within the wall of the cup.
pub(super) fn ring_handle(p: Vector3<f64>, end_m: f64, ring_m: f64, tube_m: f64) -> f64 {
    let ring = Vector2::new(p.x - end_m, p.z);
    let on_ring = if ring.x >= 0.0 { ring.normalize() * ring_m } else { Vector2::new(0.0, ring_m * ring.y.signum()) };
    let handle = Vector2::new((ring - on_ring).norm(), p.y).norm() - tube_m;
    // Only outside: the ends must not come through the wall.
    smooth_max(handle, end_m - p.x.hypot(p.y), 0.002)
}

/// Returns the minimum with a fillet of about `k` metres (Quilez, quadratic).
pub(super) fn smooth_min(a: f64, b: f64, k: f64) -> f64 {
    let h = (k - (a - b).abs()).max(0.0);
    a.min(b) - h * h / (4.0 * k)
}

pub(super) fn smooth_max(a: f64, b: f64, k: f64) -> f64 {
    -smooth_min(-a, -b, k)
}

/// Cuts a shape off below a height, so that it stands.
pub(super) fn on_table(field: f64, p: Vector3<f64>, height: f64) -> f64 {
    smooth_max(field, height * 1e-3 - p.z, 0.003)
}
