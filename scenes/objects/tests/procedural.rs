//! The procedural objects: closed, centred, on their exact surface, and of the sizes of FeelSight's objects.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "a failed assumption in a test is a failed test"
)]

use mvt_frames::Point;
use mvt_mesh::Mesh;
use mvt_mesh::SignedDistance;
use mvt_objects::catalogue;
use mvt_objects::distance::MeshDistance;
use mvt_objects::object::Object;

fn objects() -> Vec<Object> {
    let mut warnings = Vec::new();
    let made =
        catalogue::entries().filter(catalogue::Entry::is_procedural).map(|entry| entry.load(&mut warnings).unwrap());
    let objects: Vec<Object> = made.collect();
    assert!(warnings.is_empty(), "{warnings:?}");
    objects
}

fn at(v: glam::Vec3) -> Point<mvt_frames::Object> {
    Point::new(v.x.into(), v.y.into(), v.z.into())
}

#[test]
fn meshes_are_closed_centred_and_on_the_exact_surface() {
    let objects = objects();
    assert!(objects.len() >= 8);
    for object in &objects {
        let name = &object.name;
        let mesh = &object.mesh;
        assert!(mesh.edges().watertight(), "{name}: {:?}", mesh.edges());
        assert!(mesh.volume_m3() > 0.0, "{name} is inside out");
        assert!((5_000..30_000).contains(&mesh.faces.len()), "{name}: {} faces", mesh.faces.len());
        let (clean, warnings) = mvt_mesh::repair(mesh, name).unwrap();
        assert!(warnings.is_empty() && clean.faces.len() == mesh.faces.len(), "{name}: {warnings:?}");
        let [low, high] = mesh.bounds_m();
        assert!((low + high).length() < 2e-6, "{name}: centre {}", 0.5 * (low + high));

        let exact = object.exact.as_ref().unwrap();
        let worst = |points: &mut dyn Iterator<Item = glam::Vec3>| {
            points.map(|p| exact.distance_m(at(p)).abs()).fold(0.0, f64::max)
        };
        let vertices = worst(&mut mesh.vertices.iter().copied());
        let centroids = worst(&mut mesh.triangles().map(|[a, b, c]| (a + b + c) / 3.0));
        let e = object.extents_m().map(|m| m * 1e3);
        let diagonal = e.iter().map(|x| x * x).sum::<f64>().sqrt();
        println!(
            "{name}: {:.1} x {:.1} x {:.1} mm, diagonal {diagonal:.1}, {:.0} g, {} faces, vertices to {:.4} mm, centroids to {:.4} mm, \
             {} piece(s)",
            e[0],
            e[1],
            e[2],
            object.mass_kg * 1e3,
            mesh.faces.len(),
            vertices * 1e3,
            centroids * 1e3,
            object.collision.len()
        );
        assert!(vertices < 1e-6, "{name}: a vertex is {} mm off", vertices * 1e3);
        assert!(centroids < 5e-5, "{name}: a face is {} mm off", centroids * 1e3);
    }
}

/// In a box around a shape, its exact distance and the distance to its mesh agree up to the error of the mesh: an
/// independent check of every closed form, inside and outside.
#[test]
fn closed_forms_agree_with_the_distance_to_their_meshes() {
    for object in objects() {
        let exact = object.exact.as_ref().unwrap();
        let to_mesh = MeshDistance::new(&object.mesh).unwrap();
        let reach = object.extents_m().map(|extent| 0.75 * extent);
        let (mut worst, mut inside, n) = (0.0_f64, 0, 13);
        let grid = |i: usize, axis: usize| reach[axis] * (2.0 * (i as f64 + 0.137 * axis as f64) / n as f64 - 1.0);
        for i in 0..n * n * n {
            let p = Point::new(grid(i % n, 0), grid(i / n % n, 1), grid(i / n / n, 2));
            let (claimed, measured) = (exact.distance_m(p), to_mesh.distance_m(p));
            inside += usize::from(claimed < 0.0);
            worst = worst.max((claimed - measured).abs());
        }
        println!("{}: {:.4} mm, {inside} of {} inside", object.name, worst * 1e3, n * n * n);
        assert!(inside > 20, "{}: the grid missed the inside", object.name);
        assert!(worst < 5e-5, "{}: {} mm", object.name, worst * 1e3);
    }
}

#[test]
fn sizes_are_those_of_the_originals() {
    let diagonal_mm = |name: &str| {
        let object = catalogue::load(name, &mut Vec::new()).unwrap();
        1e3 * object.extents_m().iter().map(|x| x * x).sum::<f64>().sqrt()
    };
    // Bounding box diagonals that NeuralFeels lists for the FeelSight objects.
    for (name, expected) in [
        ("bell_pepper", 149.0),
        ("duck", 148.3),
        ("elephant", 185.1),
        ("large_dice", 87.2),
        ("pepper_grinder", 148.5),
        ("rubiks_cube_small", 90.4),
    ] {
        let found = diagonal_mm(name);
        assert!((found - expected).abs() < 0.1, "{name}: {found} mm, not {expected}");
    }
}

/// Distances on the die, computed by hand: opposite a face without pips nearby, in the middle, and in pips.
#[test]
fn distances_on_the_die() {
    let die = catalogue::load("large_dice", &mut Vec::new()).unwrap();
    let exact = die.exact.unwrap();
    let d_mm = |x: f64, y: f64, z: f64| 1e3 * exact.distance_m(Point::new(x * 1e-3, y * 1e-3, z * 1e-3));
    let half = 87.2 / 12_f64.sqrt();
    let near = |found: f64, expected: f64| assert!((found - expected).abs() < 1e-9, "{found}, not {expected}");
    // One pip of 1 mm in the middle of +x: its bottom, and above it the rim (radius 4.5 mm) once that is nearer.
    near(d_mm(half - 1.0, 0.0, 0.0), 0.0);
    near(d_mm(half, 0.0, 0.0), 1.0);
    near(d_mm(half + 30.0, 0.0, 0.0), 30_f64.hypot(4.5));
    // Two pips on +y, but not in the middle.
    near(d_mm(0.0, half + 3.0, 0.0), 3.0);
    // The middle is nearest to the pips that are 1 mm deep: the single one, and those of the odd sides.
    near(d_mm(0.0, 0.0, 0.0), 1.0 - half);
    // A corner: the rounding of 4 mm.
    near(d_mm(half, half, half), 4.0 * (3_f64.sqrt() - 1.0));
}

#[test]
fn a_mesh_is_its_own_distance_to_a_sphere() {
    let ball = catalogue::load("ball", &mut Vec::new()).unwrap();
    let exact = ball.exact.unwrap();
    for p in [[0.0, 0.0, 0.0], [0.01, -0.02, 0.005], [0.1, 0.2, -0.3], [0.0, 0.0, 0.05]] {
        let expected = p.iter().map(|x: &f64| x * x).sum::<f64>().sqrt() - 0.0325;
        assert!((exact.distance_m(Point::new(p[0], p[1], p[2])) - expected).abs() < 1e-12);
    }
    assert!(MeshDistance::new(&Mesh::default()).is_none());
}

proptest::proptest! {
    /// Flat soups have no hull; cutting them must fail, not panic.
    #[test]
    fn triangle_soups_never_panic_in_decomposition(
        points in proptest::collection::vec((0_u8..4, 0_u8..4, 0_u8..4), 3..12),
        triples in proptest::collection::vec((0_u32..14, 0_u32..14, 0_u32..14), 0..40),
    ) {
        let vertices =
            points.iter().map(|&(x, y, z)| glam::Vec3::new(x.into(), y.into(), z.into()) * 0.02).collect();
        let faces = triples.iter().map(|&(a, b, c)| [a, b, c]).collect();
        if let Ok((clean, _)) = mvt_mesh::repair(&Mesh { vertices, faces }, "soup") {
            let _ = mvt_objects::decompose::pieces(&clean);
        }
    }
}
