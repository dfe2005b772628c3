//! Names, user meshes and the warnings about them.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a failed assumption in a test is a failed test"
)]

use std::fs;

use mvt_objects::catalogue;
use mvt_objects::catalogue::{CatalogueError, CatalogueWarning};

#[test]
fn names_are_unique_and_complete() {
    let names: Vec<&str> = catalogue::entries().map(|entry| entry.name).collect();
    let mut unique = names.clone();
    unique.sort_unstable();
    unique.dedup();
    assert_eq!(unique.len(), names.len());
    assert_eq!(catalogue::entries().filter(|entry| !entry.is_procedural()).count(), 78);
    assert!(catalogue::entries().all(|entry| entry.mass_kg >= 0.005 && entry.mass_kg < 1.5));
    assert_eq!(catalogue::find("005_tomato_soup_can").unwrap().mass_kg, 0.349);
}

#[test]
fn mistyped_names_are_guessed() {
    for (typed, meant) in [
        ("rubiks_cube", "077_rubiks_cube"),
        ("077_rubik_cube", "077_rubiks_cube"),
        ("Tomato_Soup_Can", "005_tomato_soup_can"),
        ("bananna", "011_banana"),
        ("cube", "cube70"),
        ("large_die", "large_dice"),
    ] {
        let error = catalogue::find(typed).unwrap_err();
        assert!(error.nearest.contains(&meant), "{error}");
        assert!(error.to_string().contains(typed) && error.to_string().contains(meant));
    }
    assert_eq!(catalogue::find("").unwrap_err().nearest.len(), 3);
}

#[test]
fn a_users_mesh_is_loaded_by_path() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("block.obj");
    // 40 x 50 x 60, in millimetres and inside out.
    let mut obj = String::new();
    for i in 0..8 {
        obj += &format!("v {} {} {}\n", (i & 1) * 40, (i >> 1 & 1) * 50, (i >> 2) * 60);
    }
    for [a, b, c, d] in [[1, 2, 4, 3], [5, 7, 8, 6], [1, 5, 6, 2], [3, 4, 8, 7], [1, 3, 7, 5], [2, 6, 8, 4]] {
        obj += &format!("f {a} {b} {c} {d}\n");
    }
    fs::write(&path, obj).unwrap();
    let mut warnings = Vec::new();
    let object = catalogue::load(path.to_str().unwrap(), &mut warnings).unwrap();
    assert_eq!(object.name, "block");
    assert!((object.mass_kg - 0.06).abs() < 1e-6, "half of 120 cm^3: {}", object.mass_kg);
    assert_eq!(object.extents_m().map(|m| (m * 1e3).round()), [40.0, 50.0, 60.0]);
    assert_eq!(object.collision.len(), 1);
    assert_eq!(object.collision[0].len(), 8);
    assert!(object.exact.is_none());
    let said: Vec<String> = warnings.iter().map(ToString::to_string).collect();
    assert!(said.iter().all(|line| line.contains("block.obj")), "{said:?}");
    let [CatalogueWarning::Mesh(_), CatalogueWarning::Mesh(_), CatalogueWarning::EstimatedMass { .. }] = &warnings[..]
    else {
        panic!("{warnings:?}")
    };

    // The same file in another unit.
    let path = path.to_str().unwrap();
    let object = catalogue::load(&format!("{path}:cm"), &mut Vec::new()).map(|object| object.name);
    assert!(object.unwrap_err().to_string().contains("its largest side is 600.000 mm"));
    assert_eq!(catalogue::mesh_path(&format!("{path}:cm")).unwrap().to_str(), Some(path));
    assert_eq!(catalogue::mesh_path("cube70"), None);

    let missing = catalogue::load("no/such.ply", &mut Vec::new()).unwrap_err();
    assert!(matches!(&missing, CatalogueError::Mesh(_)) && missing.to_string().starts_with("no/such.ply"));
    assert!(matches!(catalogue::load("nothing_like_it", &mut Vec::new()), Err(CatalogueError::Unknown(_))));
}
