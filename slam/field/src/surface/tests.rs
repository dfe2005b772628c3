use mvt_mesh::EdgeCount;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::*;
use crate::field::{FieldConfig, FieldTrainer, NeuralField, Sample};

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

#[test]
fn vertices_lie_on_spheres_and_boxes() {
    let block = rounded(Vec3::new(0.0301, 0.0252, 0.0203), 0.0);
    let rubik = rounded(RUBIK, 0.002);
    let check = |distance: &(dyn Fn(Vec3) -> f32 + Sync), volume: f64, mean_bound: f32, bound: f32| {
        let mesh = extract(&Formula(distance), BOUNDS, 0.0015);
        assert!(mesh.edges().watertight());
        assert_sound(&mesh, distance);
        let [mean, largest] = error(&mesh, distance);
        assert!(mean < mean_bound && largest < bound, "mean {mean} largest {largest}");
        assert!((mesh.volume_m3() / volume - 1.0).abs() < 2e-3, "{}", mesh.volume_m3());
    };
    // The remaining error is the sagitta of the triangles; without the projection the sphere would be at 23 um.
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
        let mesh = extract(&Formula(sphere), [low, BOUNDS[1]], random.random_range(0.001..0.02));
        assert!(mesh.edges().watertight());
        assert_sound(&mesh, sphere);
    }
    // Faces of the box fall on planes of nodes, where the distance is zero or nearly so.
    let aligned = rounded(Vec3::new(0.03, 0.02, 0.01), 0.0);
    let mesh = extract(&Formula(aligned), BOUNDS, 0.002);
    assert!(mesh.edges().watertight());
    assert_sound(&mesh, aligned);
}

#[test]
fn what_is_smaller_than_a_block_is_found() {
    let mut random = ChaCha8Rng::seed_from_u64(3);
    for _ in 0..50 {
        let centre = Vec3::from_array(std::array::from_fn(|_| random.random_range(-0.03..0.03)));
        let small = move |p: Vec3| p.distance(centre) - 0.0014;
        let mesh = extract(&Formula(small), BOUNDS, 0.0015);
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
        let mesh = extract(&Formula(noise(seed)), [Vec3::splat(-0.015), Vec3::splat(0.015)], 0.001);
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
fn a_surface_that_leaves_the_box_is_open_there() {
    let mesh = extract(&Formula(|p: Vec3| p.length() - 0.055), BOUNDS, 0.002);
    assert!(mesh.edges().open > 0 && mesh.edges().crowded == 0);
    assert!(error(&mesh, |p| p.length() - 0.055)[1] < 1e-4);
}

#[test]
fn what_cannot_be_meshed_is_empty() {
    let shape = Formula(sphere);
    let [low, high] = BOUNDS;
    for cell in [0.0, -0.001, f32::NAN, f32::INFINITY, 1e-9] {
        assert_eq!(extract(&shape, BOUNDS, cell), Mesh::default(), "{cell}");
    }
    for bounds in [[high, low], [low, low], [low, Vec3::NAN], [low, Vec3::INFINITY]] {
        assert_eq!(extract(&shape, bounds, 0.01), Mesh::default());
    }
    assert_eq!(extract(&Formula(|_: Vec3| f32::NAN), BOUNDS, 0.01), Mesh::default());
}

#[test]
fn the_lattice_is_evaluated_near_the_surface_only() {
    let count = std::sync::atomic::AtomicUsize::new(0);
    let counted = Formula(|p: Vec3| {
        count.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
        sphere(p)
    });
    let mesh = extract(&counted, [Vec3::splat(-0.075), Vec3::splat(0.075)], 0.0015);
    // Each projection takes seven evaluations here.
    let lattice = count.into_inner() - 7 * STEPS * mesh.vertices.len();
    assert!(lattice < 101 * 101 * 101 / 3, "{lattice}");
}

#[test]
fn a_learnt_sphere_is_closed_and_in_place() {
    let config = FieldConfig::default();
    let mut trainer = FieldTrainer::new(NeuralField::new(&config, 1).unwrap());
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
    let learnt = |p: Vec3| {
        let mut out = [0.0];
        trainer.field().distances(&[p], &mut out);
        // Nothing was taught elsewhere.
        if (0.03..0.04).contains(&p.length()) { out[0] } else { sphere(p) }
    };
    let mesh = outer_surface(&Formula(learnt), 0.07, 0.0015);
    assert_eq!(mesh.edges(), EdgeCount::default());
    let [mean, largest] = error(&mesh, sphere);
    assert!(mean < 1e-4 && largest < 4e-4, "mean {mean} largest {largest}");
}

#[test]
fn the_largest_of_several_parts_is_kept() {
    let two =
        |p: Vec3| (p.distance(Vec3::new(-0.02, 0.0, 0.0)) - 0.01).min(p.distance(Vec3::new(0.02, 0.0, 0.0)) - 0.015);
    let mesh = extract(&Formula(two), BOUNDS, 0.002);
    let kept = largest_component(&mesh);
    assert!(kept.edges().watertight());
    assert!(kept.faces.len() < mesh.faces.len());
    let [low, high] = kept.bounds_m();
    assert!((low.x - 0.005).abs() < 1e-4 && (high.x - 0.035).abs() < 1e-4, "{low} {high}");
    assert_eq!(kept, largest_component(&kept));
    assert_eq!(largest_component(&Mesh::default()), Mesh::default());
}

/// Whatever lies in `a` and not in `b`.
fn without(
    a: impl Fn(Vec3) -> f32 + Sync + Copy,
    b: impl Fn(Vec3) -> f32 + Sync + Copy,
) -> impl Fn(Vec3) -> f32 + Sync + Copy {
    move |p| a(p).max(-b(p))
}

#[test]
fn hollows_behind_narrow_openings_are_filled() {
    let block = rounded(RUBIK, 0.002);
    // What noise leaves: a slot 7 mm high, 3 mm below the upper face, and two pits 4 mm wide that lead to it.
    let slot = move |p: Vec3| rounded(Vec3::new(0.022, 0.022, 0.0035), 0.001)(p - Vec3::new(0.0, 0.0, 0.022));
    let pit = |x: f32| move |p: Vec3| (p.truncate() - glam::Vec2::new(x, 0.008)).length().max(0.02 - p.z) - 0.002;
    let hollow = without(without(without(block, slot), pit(-0.01)), pit(0.01));
    let mesh = extract(&Formula(hollow), BOUNDS, 0.0015);
    let deepest = |mesh: &Mesh| mesh.vertices.iter().map(|&v| block(v)).fold(0.0, f32::min);
    assert_eq!(mesh, largest_component(&mesh), "the slot is connected with the outside");
    assert!(deepest(&mesh) < -0.009);

    let mesh = outer_surface(&Formula(hollow), 0.05, 0.0015);
    assert!(mesh.edges().watertight());
    // The pits stay as dents.
    assert!(deepest(&mesh) > -0.0045, "{}", deepest(&mesh));
    let [mean, largest] = error(&mesh, block);
    assert!(mean < 1e-4 && largest < 0.0045, "mean {mean} largest {largest}");
}

#[test]
fn wide_hollows_stay() {
    // A cup with walls 3 mm thick, and the gap between two balls.
    let cylinder = |radius: f32, low: f32, high: f32| {
        move |p: Vec3| (p.truncate().length() - radius).max(low - p.z).max(p.z - high)
    };
    let cup = without(cylinder(0.03, -0.03, 0.03), cylinder(0.027, -0.027, 0.1));
    let balls = |p: Vec3| (p.with_x(p.x.abs()) - Vec3::X * 0.02).length() - 0.0205;
    let plain = |shape: &dyn Shape| extract(shape, BOUNDS, 0.0015);
    for shape in [&Formula(cup) as &dyn Shape, &Formula(balls)] {
        let (before, after) = (plain(shape), outer_surface(shape, 0.05, 0.0015));
        assert!(
            (after.volume_m3() / before.volume_m3() - 1.0).abs() < 0.03,
            "{} {}",
            after.volume_m3(),
            before.volume_m3()
        );
    }
    // Half of the surface is the inner one, and only its lower edge may be filled a little.
    let [mean, largest] = error(&outer_surface(&Formula(cup), 0.05, 0.0015), cup);
    assert!(mean < 1e-4 && largest < 0.002, "mean {mean} largest {largest}");
}

#[test]
fn a_cube_of_any_size_is_looked_at() {
    for half in [0.04, 1.0, 10.0] {
        let scaled = move |p: Vec3| sphere(p * (0.04 / half)) * (half / 0.04);
        let mesh = outer_surface(&Formula(scaled), half, half / 30.0);
        let volume = 4.0 / 3.0 * std::f64::consts::PI * (f64::from(half) / 0.04 * 0.035).powi(3);
        assert!((mesh.volume_m3() / volume - 1.0).abs() < 0.01, "{half}: {} {volume}", mesh.volume_m3());
    }
    for half in [0.0, -1.0, f32::NAN] {
        assert_eq!(outer_surface(&Formula(sphere), half, 0.0015), Mesh::default());
    }
    // Full to the faces of the cube: nothing is outside, and there is no surface.
    assert_eq!(outer_surface(&Formula(|_: Vec3| -1.0), 0.05, 0.0015), Mesh::default());
}
