//! The user's own meshes are used, repaired with a warning, or refused with the file and its defect.

use std::fmt::Write as _;

use crate::workplace::Workplace;

/// Returns corners and outward faces of a box at `x`, as OBJ.
fn obj_box(half: f64, x: f64, first: usize) -> String {
    let mut text = String::new();
    for corner in 0..8 {
        let side = |bit: usize| if corner >> bit & 1 == 1 { half } else { -half };
        writeln!(text, "v {} {} {}", side(0) + x, side(1), side(2)).unwrap();
    }
    for [a, b, c] in FACES {
        writeln!(text, "f {} {} {}", a + first, b + first, c + first).unwrap();
    }
    text
}

/// Corner k has bit 0 for +x, bit 1 for +y and bit 2 for +z.
const FACES: [[usize; 3]; 12] = [
    [0, 2, 1],
    [1, 2, 3],
    [4, 5, 6],
    [5, 7, 6],
    [0, 1, 4],
    [1, 5, 4],
    [2, 6, 3],
    [3, 6, 7],
    [0, 4, 2],
    [2, 4, 6],
    [1, 3, 5],
    [3, 7, 5],
];

/// Returns the same box as text STL.
fn stl_box(half: f64) -> String {
    let mut text = "solid box\n".to_owned();
    for face in FACES {
        text += "facet normal 0 0 0\nouter loop\n";
        for corner in face {
            let side = |bit: usize| if corner >> bit & 1 == 1 { half } else { -half };
            writeln!(text, "vertex {} {} {}", side(0), side(1), side(2)).unwrap();
        }
        text += "endloop\nendfacet\n";
    }
    text + "endsolid box\n"
}

/// Returns the same box as PLY.
fn ply_box(half: f64) -> String {
    let mut text = "ply\nformat ascii 1.0\nelement vertex 8\nproperty float x\nproperty float y\nproperty float z\n\
                    element face 12\nproperty list uchar int vertex_indices\nend_header\n"
        .to_owned();
    for line in obj_box(half, 0.0, 0).lines() {
        let (kind, numbers) = line.split_once(' ').unwrap();
        writeln!(text, "{}{numbers}", if kind == "f" { "3 " } else { "" }).unwrap();
    }
    text
}

const HALF_M: f64 = 0.033;

#[test]
fn every_format_makes_the_same_object() {
    let workplace = Workplace::new();
    workplace.write("box.obj", obj_box(HALF_M, 0.0, 1));
    workplace.write("box.stl", stl_box(HALF_M));
    workplace.write("box.PLY", ply_box(HALF_M));
    let [obj, stl, ply] = ["box.obj", "box.stl", "box.PLY"].map(|file| {
        let ended = workplace.run(&format!("simulate --json --duration 1 --object {file}"));
        let outcome = ended.stdout.clone();
        let said = ended.warned();
        assert!(said.lines().count() == 1 && said.contains(file) && said.contains("has no mass"), "{said}");
        outcome
    });
    assert!(obj.contains("\"object\":\"box\""), "{obj}");
    assert_eq!(obj, ply);
    // The vertices of the STL file are in another order, so that sums are rounded differently.
    let survived = |text: &str| serde_json::from_str::<serde_json::Value>(text).unwrap()["survived_s"].clone();
    assert_eq!(survived(&obj), survived(&stl));

    let said = workplace.run("generate --object ./box.stl --logs 1 --duration 0.2 --out set").warned();
    assert!(said.contains("has no mass"), "{said}");
    assert_eq!(workplace.logs("set"), ["set/box/00"]);
    let ended = workplace.run("inspect set/box/00");
    assert!(ended.stdout.contains("object    box"), "{ended:?}");
    ended.warned();
    // A log made with another content of the file counts as made with other settings.
    workplace.write("box.stl", stl_box(HALF_M * 0.9));
    let ended = workplace.run("generate --object ./box.stl --logs 1 --duration 0.2 --out set");
    assert!(ended.code == Some(1) && ended.stderr.contains("other settings"), "{ended:?}");
}

#[test]
fn repairs_are_reported() {
    let workplace = Workplace::new();
    let good = obj_box(HALF_M, 0.0, 1);
    let inverted: String = good.lines().map(|line| format!("{}\n", turned(line))).collect();
    let half_turned: String =
        good.lines().enumerate().map(|(i, line)| if i == 9 { turned(line) } else { line.to_owned() } + "\n").collect();
    for (file, text, word) in [
        ("inverted.obj", inverted, "normals looked inward"),
        ("disagree.obj", half_turned, "turned 1 face(s)"),
        ("millimetres.obj", obj_box(1e3 * HALF_M, 0.0, 1), "millimetres"),
        ("two.obj", obj_box(HALF_M, 0.0, 1) + &obj_box(0.004, 0.1, 9), "kept the largest part; dropped 1 other(s)"),
        ("open.obj", good.lines().take(18).map(|line| format!("{line}\n")).collect(), "not watertight"),
        ("twice.obj", good.clone() + "f 1 3 2\n", "there twice"),
        ("flat.obj", good.clone() + "f 1 1 2\n", "without area"),
    ] {
        workplace.write(file, text);
        let ended = workplace.run(&format!("simulate --json --duration 0.5 --object {file}"));
        assert!(ended.stdout.contains("survived_s"), "{file}: {ended:?}");
        let said = ended.warned();
        assert!(said.lines().any(|line| line.contains(file) && line.contains(word)), "{file}: {said}");
    }

    // A repaired mesh behaves like a correct one.
    workplace.write("good.obj", good);
    let [good, repaired] = ["good.obj", "inverted.obj"].map(|file| {
        let outcome = workplace.run(&format!("simulate --json --duration 0.5 --object {file}")).stdout;
        serde_json::from_str::<serde_json::Value>(&outcome).unwrap()["survived_s"].clone()
    });
    assert_eq!(good, repaired);
}

/// Returns a line of an OBJ file with its face turned over.
fn turned(line: &str) -> String {
    match line.split(' ').collect::<Vec<_>>()[..] {
        ["f", a, b, c] => format!("f {a} {c} {b}"),
        _ => line.to_owned(),
    }
}

#[test]
fn meshes_beyond_repair_are_refused() {
    let workplace = Workplace::new();
    let good = obj_box(HALF_M, 0.0, 1);
    let stl_with_nan = stl_box(HALF_M).replacen(&format!("vertex {HALF_M}"), "vertex nan", 1);
    let ply_with_nan = ply_box(HALF_M).replacen(&format!("\n{HALF_M}"), "\nnan", 1);
    for (file, text, word) in [
        ("nan.obj", good.replacen(&format!("v {HALF_M}"), "v nan", 1), "not a finite number"),
        ("nan.stl", stl_with_nan, "not a finite number"),
        ("nan.ply", ply_with_nan, "not a finite number"),
        ("index.obj", good.clone() + "f 1 2 99\n", "vertex"),
        ("index.ply", ply_box(HALF_M).replacen("3 0 2 1", "3 0 2 77", 1), "77"),
        ("points.obj", good.lines().take(8).map(|line| format!("{line}\n")).collect(), "no faces"),
        ("line.obj", "v 0 0 0\nv 0.1 0 0\nv 0.2 0 0\nf 1 2 3\n".to_owned(), "no faces"),
        ("empty.obj", String::new(), "no faces"),
        ("empty.stl", String::new(), "empty.stl"),
        ("empty.ply", String::new(), "empty.ply"),
        ("cut.ply", ply_box(HALF_M)[..400].to_owned(), "cut.ply"),
        ("cut.stl", stl_box(HALF_M)[..400].to_owned(), "cut.stl"),
        ("tiny.obj", obj_box(0.0001, 0.0, 1), "must be from 5 to 600 mm"),
        ("huge.obj", obj_box(800.0, 0.0, 1), "must be from 5 to 600 mm"),
        ("picture.obj", "\u{89}PNG\r\n".to_owned(), "picture.obj"),
    ] {
        workplace.write(file, text);
        let said = workplace.run(&format!("simulate --duration 0.5 --object {file}")).error();
        assert!(said.contains(file) && said.contains(word), "{said}");
    }
    assert!(workplace.run("simulate --object nowhere.obj").error().contains("nowhere.obj"));
    assert!(workplace.run("simulate --object ./mesh.step").error().contains(".obj, .stl or .ply"));
}
