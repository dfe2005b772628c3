//! Meshes of other programs gave a wrong shape without a word: concave polygons, vertices that differ by rounding, centimetres.

use std::fmt::Write as _;

use serde_json::Value;

use crate::workplace::{Ended, Workplace};

/// Outline of a bracket, metres.
const OUTLINE: [[f64; 2]; 6] = [[0.0, 0.0], [0.1, 0.0], [0.1, 0.012], [0.012, 0.012], [0.012, 0.1], [0.0, 0.1]];

/// A bracket of 50 mm height, with polygons that begin at the end of one arm.
fn bracket(per_metre: f64) -> String {
    let mut text = String::new();
    for z in [0.0, 0.05] {
        for [x, y] in OUTLINE {
            writeln!(text, "v {} {} {}", x * per_metre, y * per_metre, z * per_metre).unwrap();
        }
    }
    text += "f 5 4 3 2 1 6\nf 8 9 10 11 12 7\n";
    (1..=6).for_each(|a| writeln!(text, "f {a} {} {} {}", a % 6 + 1, a % 6 + 7, a + 6).unwrap());
    text
}

#[test]
fn polygons_and_seams_keep_the_shape() {
    let workplace = Workplace::new();
    workplace.write("bracket.obj", bracket(1.0));
    // The same as triangles, of which none shares a vertex, and each corner is off by nanometres.
    let triangles = [[6, 5, 4], [6, 4, 1], [4, 3, 2], [4, 2, 1], [12, 10, 11], [12, 7, 10], [10, 8, 9], [10, 7, 8]];
    let sides = (1..=6).flat_map(|a| [[a, a % 6 + 1, a % 6 + 7], [a, a % 6 + 7, a + 6]]);
    let mut text = "solid bracket\n".to_owned();
    for (k, corner) in triangles.into_iter().chain(sides).flatten().enumerate() {
        let [x, y] = OUTLINE[(corner - 1) % 6];
        let noise = 1e-9 * (k * 7 % 5) as f64;
        let facet = if k % 3 == 0 { "facet normal 0 0 0\nouter loop\n" } else { "" };
        let end = if k % 3 == 2 { "endloop\nendfacet\n" } else { "" };
        write!(text, "{facet}vertex {} {} {}\n{end}", x + noise, y - noise, if corner > 6 { 0.05 } else { noise })
            .unwrap();
    }
    workplace.write("truth.stl", text + "endsolid bracket\n");
    let truth = workplace.path("truth.stl");
    let ended = workplace.run(&format!("score --mesh bracket.obj --truth {} --json", truth.display()));
    let report: Value = serde_json::from_str(&ended.stdout).unwrap();
    let finest =
        report["shape"]["fine"]["scores"].as_array().unwrap().iter().find(|score| score["threshold_mm"] == 1.0);
    assert!(finest.unwrap()["f"].as_f64().unwrap() > 0.999, "{report}");
    let said = ended.warned();
    assert!(said.lines().count() == 1 && said.contains("at open edges"), "{said}");
}

#[test]
fn centimetres_are_asked_for_and_can_be_given() {
    let workplace = Workplace::new();
    workplace.write("bracket.obj", bracket(100.0));
    let said = workplace.run("simulate --object bracket.obj --duration 0.2 --controller shared").error();
    assert!(said.contains("bracket.obj: its largest side is 10 units: centimetres, millimetres or inches?"), "{said}");
    let said = workplace.run("simulate --object bracket.obj:cm --duration 0.2 --controller shared").warned();
    assert!(said.contains("has no mass"), "{said}");
}

#[test]
fn a_folder_of_meshes_needs_only_the_object_asked_for() {
    let workplace = Workplace::new();
    std::fs::create_dir(workplace.path("mine")).unwrap();
    let mut command = workplace.command("simulate --object 077_rubiks_cube");
    let said = Ended::of(command.env("YCB_DIR", workplace.path("mine"))).error();
    for part in ["YCB_DIR", "neither 077_rubiks_cube.stl nor 077_rubiks_cube/google_16k/nontextured.stl"] {
        assert!(said.contains(part), "{said} lacks {part}");
    }
    assert!(!said.contains("002_master_chef_can"), "{said}");
}
