//! The choice of `auto`, and its warnings before an episode, against the episode.

#![expect(clippy::unwrap_used, reason = "a failed assumption is a failed test")]

use mvt_gaits::controller_file;
use mvt_gaits::gait::AUTO;
use mvt_gaits::shape::ObjectShape;
use mvt_objects::catalogue;
use mvt_objects::object::Object;
use mvt_robot::hand::{Hand, Side};
use mvt_tuning::seeds;
use mvt_tuning::survey::{SurveyRow, survey};
use mvt_tuning::trial::{EPISODE_STEPS, TrialConditions};

/// Returns a box with these sides in millimetres, of 0.5 g/cm^3.
fn block(sides_mm: [f64; 3]) -> Object {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("block.obj");
    let mut text = String::new();
    for k in 0..8 {
        let [x, y, z] = [0, 1, 2].map(|axis| sides_mm[axis] * 1e-3 * f64::from(k >> axis & 1));
        text += &format!("v {x} {y} {z}\n");
    }
    for [a, b, c, d] in [[1, 5, 7, 3], [2, 4, 8, 6], [1, 2, 6, 5], [3, 7, 8, 4], [1, 3, 4, 2], [5, 6, 8, 7]] {
        text += &format!("f {a} {b} {c}\nf {a} {c} {d}\n");
    }
    std::fs::write(&path, text).unwrap();
    catalogue::load(path.to_str().unwrap(), &mut Vec::new()).unwrap()
}

fn play(object: &Object) -> SurveyRow {
    let hand = Hand::allegro(Side::Left);
    let chosen = controller_file::choose(AUTO, object, &hand).unwrap();
    let conditions = TrialConditions { hand, duration_s: 12.0, steps: EPISODE_STEPS };
    let seeds = [seeds::tuning().at(5), seeds::tuning().at(6)];
    survey((&chosen.name, &chosen.gait), object, &seeds, &conditions).unwrap()
}

/// Says that a test is skipped, and fails where every test must run.
fn skip(reason: impl std::fmt::Display) {
    use std::io::Write as _;
    let _ = writeln!(std::io::stderr(), "SKIPPED: {reason}");
    assert!(
        std::env::var_os("REQUIRE_ALL").is_none_or(|value| value != "1"),
        "REQUIRE_ALL=1 allows no skipped test: {reason}"
    );
}

#[test]
fn most_of_what_is_refused_falls() {
    let mut kept = Vec::new();
    for (name, reason) in [
        ("003_cracker_box", "too long"),
        ("004_sugar_box", "too slender"),
        ("022_windex_bottle", "too heavy"),
        ("030_fork", "too long"),
        ("040_large_marker", "too thin"),
        ("070-a_colored_wood_blocks", "too large"),
    ] {
        let object = match catalogue::load(name, &mut Vec::new()) {
            Ok(object) => object,
            Err(error) => return skip(format!("no YCB meshes: {error}")),
        };
        let unsuited = ObjectShape::of(&object).unsuited().unwrap();
        assert!(unsuited.falls && unsuited.reason.starts_with(reason), "{name}: {}", unsuited.reason);
        if play(&object).kept {
            kept.push(name);
        }
    }
    assert!(kept.len() <= 2, "{kept:?}");
}

#[test]
fn what_is_warned_of_rests_in_the_hand() {
    for (sides_mm, reason) in [
        ([22.0, 22.0, 22.0], "too small"),
        ([44.0, 32.0, 35.0], "too small"),
        ([88.0, 72.0, 30.0], "too flat"),
        ([113.0, 90.0, 39.0], "too long to turn"),
    ] {
        let object = block(sides_mm);
        let unsuited = ObjectShape::of(&object).unsuited().unwrap();
        assert!(!unsuited.falls && unsuited.reason.starts_with(reason), "{}", unsuited.reason);
        let row = play(&object);
        assert!(row.kept && row.turned_rad() < 3.6, "{sides_mm:?}: {row:?}");
    }
}

#[test]
fn what_suits_is_turned() {
    for object in ["cube70", "ball", "large_dice", "bell_pepper", "soup_can"] {
        let object = catalogue::load(object, &mut Vec::new()).unwrap();
        assert_eq!(ObjectShape::of(&object).unsuited(), None);
        let row = play(&object);
        assert!(row.turned_rad() > 3.6, "{row:?}");
    }
}

#[test]
fn a_small_block_is_tumbled() {
    let object = block([33.0, 33.0, 43.0]);
    assert_eq!(ObjectShape::of(&object).unsuited(), None);
    let row = play(&object);
    assert!(row.controller == "tumble_block" && row.turned_rad() > 3.6, "{row:?}");
}
