use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use scenes::mesh::EdgeCount;

use super::*;
use crate::field::{Config, Field, Sample, Trainer};

/// A shape from a formula; gradients by differences.
struct Formula<F>(F);

impl<F: Fn(Vec3) -> f32 + Sync> Shape for Formula<F> {
    fn distances(&self, points: &[Vec3], out: &mut [f32]) {
        out.iter_mut().zip(points).for_each(|(out, &p)| *out = self.0(p));
    }

    fn distances_and_gradients(&self, points: &[Vec3], out: &mut [Distance]) {
        const STEP: f32 = 1e-4;
        for (out, &p) in out.iter_mut().zip(points) {
            let slope = |axis: Vec3| (self.0(p + STEP * axis) - self.0(p - STEP * axis)) / (2.0 * STEP);
            *out = Distance { value_m: self.0(p), gradient: Vec3::new(slope(Vec3::X), slope(Vec3::Y), slope(Vec3::Z)) };
        }
    }
}

fn sphere(p: Vec3) -> f32 {
    p.length() - 0.035
}

/// Distance to a box with rounded edges; `half` is half its size.
fn rounded(half: Vec3, radius: f32) -> impl Fn(Vec3) -> f32 + Sync + Copy {
    move |p| {
        let q = p.abs() - (half - radius);
        q.max(Vec3::ZERO).length() + q.max_element().min(0.0) - radius
    }
}

const RUBIK: Vec3 = Vec3::new(0.0285, 0.029, 0.0285);
const BOUNDS: [Vec3; 2] = [Vec3::splat(-0.05), Vec3::splat(0.05)];

/// Points on the triangles, uniform by area.
fn on(mesh: &Mesh, count: usize) -> Vec<Vec3> {
    let mut random = ChaCha8Rng::seed_from_u64(1);
    let triangles: Vec<[Vec3; 3]> = mesh.triangles().collect();
    let mut sums = Vec::new();
    triangles.iter().fold(0.0, |sum, [a, b, c]| {
        sums.push(sum + (b - a).cross(c - a).length());
        sums[sums.len() - 1]
    });
    (0..count)
        .map(|_| {
            let at = random.random_range(0.0..sums[sums.len() - 1]);
            let [a, b, c] = triangles[sums.partition_point(|&sum| sum <= at)];
            let (u, v): (f32, f32) = (random.random_range(0.0..1.0), random.random_range(0.0..1.0));
            let (u, v) = if u + v > 1.0 { (1.0 - u, 1.0 - v) } else { (u, v) };
            a + u * (b - a) + v * (c - a)
        })
        .collect()
}

/// Mean and largest distance of the mesh from the surface of a formula, metres.
fn error(mesh: &Mesh, distance: impl Fn(Vec3) -> f32) -> [f32; 2] {
    let errors: Vec<f32> = on(mesh, 20_000).into_iter().map(|p| distance(p).abs()).collect();
    [errors.iter().sum::<f32>() / errors.len() as f32, errors.iter().fold(0.0, |a, &b| a.max(b))]
}

/// No triangle is a line, and all look where the distance grows.
fn assert_sound(mesh: &Mesh, distance: impl Fn(Vec3) -> f32 + Sync) {
    let shape = Formula(distance);
    let centres: Vec<Vec3> = mesh.triangles().map(|[a, b, c]| (a + b + c) / 3.0).collect();
    let mut out = vec![Distance::default(); centres.len()];
    shape.distances_and_gradients(&centres, &mut out);
    for ([a, b, c], d) in mesh.triangles().zip(&out) {
        let normal = (b - a).cross(c - a);
        let longest = (b - a).length().max((c - a).length()).max((c - b).length());
        assert!(normal.length() > 1e-3 * longest * longest, "{a} {b} {c}");
        assert!(normal.dot(d.gradient) > 0.0, "{a} {b} {c} {d:?}");
    }
}

fn everywhere(_: Vec3) -> bool {
    true
}

#[test]
fn vertices_lie_on_spheres_and_boxes() {
    let block = rounded(Vec3::new(0.0301, 0.0252, 0.0203), 0.0);
    let rubik = rounded(RUBIK, 0.002);
    let check = |distance: &(dyn Fn(Vec3) -> f32 + Sync), volume: f64, mean_bound: f32, bound: f32| {
        let mesh = extract(&Formula(distance), BOUNDS, 0.0015, &everywhere);
        assert!(mesh.edges().watertight());
        assert_sound(&mesh, distance);
        let [mean, largest] = error(&mesh, distance);
        assert!(mean < mean_bound && largest < bound, "mean {mean} largest {largest}");
        assert!((mesh.volume_m3() / volume - 1.0).abs() < 2e-3, "{}", mesh.volume_m3());
    };
    // What is left is the sagitta of the triangles; without the projection the sphere would be at 23 um.
    check(&sphere, 4.0 / 3.0 * std::f64::consts::PI * 0.035f64.powi(3), 9e-6, 3e-5);
    // Sharp edges are cut off by a third of a cell.
    check(&block, 8.0 * 0.0301 * 0.0252 * 0.0203, 1.5e-5, 6e-4);
    // Steiner's formula for a box of `core` grown by `r`.
    let (core, r) = ((2.0 * (RUBIK - 0.002)).as_dvec3(), 0.002);
    let faces = 2.0 * (core.x * core.y + core.y * core.z + core.z * core.x);
    let edges = std::f64::consts::PI * core.element_sum();
    let volume = core.element_product() + faces * r + edges * r * r + 4.0 / 3.0 * std::f64::consts::PI * r.powi(3);
    check(&rubik, volume, 1e-5, 3e-4);
}

#[test]
fn any_place_and_size_of_cells_gives_a_closed_mesh() {
    let mut random = ChaCha8Rng::seed_from_u64(2);
    for _ in 0..30 {
        let low = BOUNDS[0] + random.random_range(-1e-3..1e-3f32) * Vec3::new(1.0, -0.7, 0.3);
        let mesh = extract(&Formula(sphere), [low, BOUNDS[1]], random.random_range(0.001..0.02), &everywhere);
        assert!(mesh.edges().watertight());
        assert_sound(&mesh, sphere);
    }
    // Faces of the box fall on planes of nodes, where the distance is zero or nearly so.
    let aligned = rounded(Vec3::new(0.03, 0.02, 0.01), 0.0);
    let mesh = extract(&Formula(aligned), BOUNDS, 0.002, &everywhere);
    assert!(mesh.edges().watertight());
    assert_sound(&mesh, aligned);
}

#[test]
fn what_is_smaller_than_a_block_is_found() {
    let mut random = ChaCha8Rng::seed_from_u64(3);
    for _ in 0..50 {
        let centre = Vec3::from_array(std::array::from_fn(|_| random.random_range(-0.03..0.03)));
        let small = move |p: Vec3| p.distance(centre) - 0.0014;
        let mesh = extract(&Formula(small), BOUNDS, 0.0015, &everywhere);
        assert!(!mesh.faces.is_empty() && mesh.edges().watertight(), "{centre}");
    }
}

/// Noise with features of the size of a cell, inside a small box.
fn noise(seed: u64) -> impl Fn(Vec3) -> f32 + Sync {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let waves: Vec<(Vec3, f32)> = (0..12)
        .map(|_| {
            let wave = Vec3::from_array(std::array::from_fn(|_| random.random_range(-2500.0..2500.0)));
            (wave, random.random_range(0.0..std::f32::consts::TAU))
        })
        .collect();
    move |p| {
        let waves: f32 = waves.iter().map(|(wave, phase)| (wave.dot(p) + phase).sin()).sum();
        (3e-4 * waves).max(p.abs().max_element() - 0.012)
    }
}

#[test]
fn noise_gives_no_holes_and_neighbours_agree_on_the_outside() {
    for seed in 0..5 {
        let mesh = extract(&Formula(noise(seed)), [Vec3::splat(-0.015), Vec3::splat(0.015)], 0.001, &everywhere);
        assert!(mesh.faces.len() > 10_000);
        assert_eq!(mesh.edges().open, 0);
        let mut directed: Vec<[u32; 2]> = mesh.faces.iter().flat_map(|&[a, b, c]| [[a, b], [b, c], [c, a]]).collect();
        let mut reversed: Vec<[u32; 2]> = directed.iter().map(|&[a, b]| [b, a]).collect();
        directed.sort_unstable();
        reversed.sort_unstable();
        assert_eq!(directed, reversed);
    }
}

#[test]
fn only_kept_cells_take_part() {
    let all = extract(&Formula(sphere), BOUNDS, 0.002, &everywhere);
    let upper = extract(&Formula(sphere), BOUNDS, 0.002, &|p| p.z > 0.0);
    let fraction = upper.faces.len() as f32 / all.faces.len() as f32;
    assert!((0.45..0.55).contains(&fraction), "{fraction}");
    assert!(upper.vertices.iter().all(|v| v.z > -0.002));
    assert!(upper.edges().open > 50);
    assert!(extract(&Formula(sphere), BOUNDS, 0.002, &|_| false).vertices.is_empty());
}

#[test]
fn a_surface_that_leaves_the_box_is_open_there() {
    let mesh = extract(&Formula(|p: Vec3| p.length() - 0.055), BOUNDS, 0.002, &everywhere);
    assert!(mesh.edges().open > 0 && mesh.edges().crowded == 0);
    assert!(error(&mesh, |p| p.length() - 0.055)[1] < 1e-4);
}

#[test]
fn what_cannot_be_meshed_is_empty() {
    let shape = Formula(sphere);
    let [low, high] = BOUNDS;
    for cell in [0.0, -0.001, f32::NAN, f32::INFINITY, 1e-9] {
        assert_eq!(extract(&shape, BOUNDS, cell, &everywhere), Mesh::default(), "{cell}");
    }
    for bounds in [[high, low], [low, low], [low, Vec3::NAN], [low, Vec3::INFINITY]] {
        assert_eq!(extract(&shape, bounds, 0.01, &everywhere), Mesh::default());
    }
    assert_eq!(extract(&Formula(|_: Vec3| f32::NAN), BOUNDS, 0.01, &everywhere), Mesh::default());
}

#[test]
fn the_lattice_is_evaluated_near_the_surface_only() {
    let count = std::sync::atomic::AtomicUsize::new(0);
    let counted = Formula(|p: Vec3| {
        count.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
        sphere(p)
    });
    let mesh = extract(&counted, [Vec3::splat(-0.075), Vec3::splat(0.075)], 0.0015, &everywhere);
    // Each projection takes seven evaluations here.
    let lattice = count.into_inner() - 7 * STEPS * mesh.vertices.len();
    assert!(lattice < 101 * 101 * 101 / 3, "{lattice}");
}

#[test]
fn a_learnt_sphere_is_closed_and_in_place() {
    let config = Config::default();
    let mut trainer = Trainer::new(Field::new(&config, 1).unwrap());
    let mut random = ChaCha8Rng::seed_from_u64(4);
    for _ in 0..200 {
        let samples: Vec<Sample> = (0..2048)
            .map(|_| {
                let direction = Vec3::from_array(std::array::from_fn(|_| random.random_range(-1.0..1.0)));
                let position = direction.normalize_or(Vec3::X) * random.random_range(0.028..0.045);
                Sample { position, target: sphere(position) / config.truncation_m, weight: 1.0, at_least: false }
            })
            .collect();
        trainer.step(&samples);
    }
    // Nothing was taught elsewhere.
    let taught = |p: Vec3| (0.03..0.04).contains(&p.length());
    let mesh = extract(trainer.field(), [Vec3::splat(-0.07), Vec3::splat(0.07)], 0.0015, &taught);
    let mesh = largest_component(&mesh);
    assert_eq!(mesh.edges(), EdgeCount::default());
    let [mean, largest] = error(&mesh, sphere);
    assert!(mean < 1e-4 && largest < 4e-4, "mean {mean} largest {largest}");
}

#[test]
fn the_largest_of_several_parts_is_kept() {
    let two =
        |p: Vec3| (p.distance(Vec3::new(-0.02, 0.0, 0.0)) - 0.01).min(p.distance(Vec3::new(0.02, 0.0, 0.0)) - 0.015);
    let mesh = extract(&Formula(two), BOUNDS, 0.002, &everywhere);
    let kept = largest_component(&mesh);
    assert!(kept.edges().watertight());
    assert!(kept.faces.len() < mesh.faces.len());
    let [low, high] = kept.bounds_m();
    assert!((low.x - 0.005).abs() < 1e-4 && (high.x - 0.035).abs() < 1e-4, "{low} {high}");
    assert_eq!(kept, largest_component(&kept));
    assert_eq!(largest_component(&Mesh::default()), Mesh::default());
}
