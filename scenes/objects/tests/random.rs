//! Random objects over 200 seeds: closed, of the stated sizes, a function of the seed, with true distances and pieces.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "a failed assumption in a test is a failed test"
)]

use std::collections::BTreeMap;

use glam::Vec3;
use mvt_frames::Point;
use mvt_mesh::SignedDistance;
use mvt_objects::catalogue::{self, CatalogueError};
use mvt_objects::decompose;
use mvt_objects::random::{RandomObject, ShapeFamily};
use mvt_objects::{MeshDistance, Object};

fn load(seed: u64) -> Object {
    catalogue::load(&format!("random:{seed}"), &mut Vec::new()).unwrap()
}

fn at(v: Vec3) -> Point<mvt_frames::Object> {
    Point::new(v.x.into(), v.y.into(), v.z.into())
}

/// Returns one seed of each family, the first ones from 0.
fn one_of_each() -> Vec<(ShapeFamily, u64)> {
    let first = |family| (0..200).find(|&seed| RandomObject::new(seed).family() == family).unwrap();
    ShapeFamily::ALL.map(|family| (family, first(family))).to_vec()
}

#[test]
fn shapes_of_200_seeds_are_closed_and_of_the_stated_sizes() {
    let mut families: BTreeMap<ShapeFamily, usize> = BTreeMap::new();
    for seed in 0..200 {
        let random = RandomObject::new(seed);
        let (mesh, family) = (random.mesh(), random.family());
        *families.entry(family).or_default() += 1;
        let name = format!("{family} {seed}");
        let extents = mesh.extents_m() * 1e3;
        assert!((40.0..=90.0).contains(&extents.max_element()) && extents.min_element() >= 35.0, "{name}: {extents}");
        assert!((5_000..=40_000).contains(&mesh.faces.len()), "{name}: {} faces", mesh.faces.len());
        assert!(mesh.edges().watertight(), "{name}: {:?}", mesh.edges());
        let share = mesh.volume_m3() * 1e9 / f64::from(extents.element_product());
        assert!((0.08..=1.0).contains(&share), "{name} fills {share} of its box");
        let [low, high] = mesh.bounds_m();
        assert!((low + high).length() < 2e-6, "{name}: centre {}", 0.5 * (low + high));
        // Stands: a part of its lowest millimetre is as wide as a foot.
        let foot = mesh.vertices.iter().filter(|v| v.z < low.z + 1e-3);
        let wide = |axis: usize| {
            let reach = foot.clone().map(|v| v.to_array()[axis]);
            reach.clone().fold(f32::MIN, f32::max) - reach.fold(f32::MAX, f32::min)
        };
        assert!(wide(0) > 0.010 && wide(1) > 0.010, "{name} stands on a point");
    }
    println!("{families:?}");
    assert!(ShapeFamily::ALL.iter().all(|family| families[family] >= 10), "{families:?}");
}

#[test]
fn a_seed_is_one_object() {
    for (family, seed) in one_of_each() {
        let (object, again) = (load(seed), load(seed));
        assert_eq!(object.name, format!("random-{seed}"));
        assert_eq!(object.mesh, again.mesh, "{family}");
        assert_eq!((object.collision, object.mass_kg), (again.collision, again.mass_kg), "{family}");
        assert_eq!(object.mesh, catalogue::load_mesh(&format!("random:{seed}"), &mut Vec::new()).unwrap());
        assert_ne!(object.mesh, RandomObject::new(seed + 200).mesh());
    }
}

#[test]
fn distances_agree_with_the_mesh() {
    for (family, seed) in one_of_each() {
        let object = load(seed);
        let exact = object.exact.as_ref().unwrap();
        let on_surface = object.mesh.triangles().map(|[a, b, c]| exact.distance_m(at((a + b + c) / 3.0)).abs());
        let worst = on_surface.fold(0.0, f64::max);
        assert!(worst < 5e-5, "{family}: a face is {} mm off", worst * 1e3);
        let to_mesh = MeshDistance::new(&object.mesh).unwrap();
        let (extents, n) = (object.mesh.extents_m(), 11);
        let mut inside = 0;
        for i in 0..n * n * n {
            let share = Vec3::new((i % n) as f32, (i / n % n) as f32, (i / n / n) as f32) / (n - 1) as f32 - 0.503;
            let p = at(share * 1.5 * extents);
            let (claimed, measured) = (exact.distance_m(p), to_mesh.distance_m(p));
            inside += usize::from(claimed < 0.0);
            assert!((claimed - measured).abs() < 5e-5, "{family}: {claimed} m, to the mesh {measured} m");
        }
        assert!(inside > 20, "{family}: the grid missed the inside");
    }
}

#[test]
fn convex_pieces_cover_the_shape_and_leave_cavities_open() {
    for (family, seed) in one_of_each() {
        let object = load(seed);
        assert!(!object.collision.is_empty() && object.collision.len() <= decompose::MAX_PIECES, "{family}");
        assert!(object.collision.iter().all(|piece| (4..=decompose::MAX_POINTS).contains(&piece.len())), "{family}");
        let points: Vec<Vec3> = object.collision.iter().flatten().copied().collect();
        let low = points.iter().fold(Vec3::MAX, |low, p| low.min(*p));
        let high = points.iter().fold(Vec3::MIN, |high, p| high.max(*p));
        let missing = object.mesh.extents_m() - (high - low);
        assert!(missing.abs().max_element() < 1.5e-3, "{family}: the pieces differ by {missing}");
        // No corner of a piece reaches far into the air, so no cavity is closed.
        let exact = object.exact.as_ref().unwrap();
        let outside = points.iter().map(|&p| exact.distance_m(at(p))).fold(0.0, f64::max);
        println!("{family} {seed}: {} pieces, {:.2} mm outside", object.collision.len(), outside * 1e3);
        assert!(outside < 2e-3, "{family}: a piece reaches {} mm outside", outside * 1e3);
        if matches!(family, ShapeFamily::Hollow | ShapeFamily::Handled | ShapeFamily::Concave) {
            assert!(object.collision.len() > 1, "{family} is one piece");
        }
    }
}

#[test]
fn names_without_a_valid_seed_are_errors() {
    for name in ["random:", "random:seventeen", "random:-3", "random:99999999999999999999"] {
        for error in [catalogue::load(name, &mut Vec::new()).err(), catalogue::check(name).err()] {
            let error = error.unwrap();
            assert!(matches!(error, CatalogueError::Seed(_)));
            assert!(error.to_string().contains("such as random:17"), "{error}");
        }
    }
    assert!(matches!(catalogue::check("random"), Err(CatalogueError::Unknown(_))));
    catalogue::check("random:0").unwrap();
    catalogue::check("mug").unwrap();
}
