//! `mesh` wrote other coordinates than the run's mesh.ply, and `score` compared them with the truth.

use crate::workplace::Workplace;

fn f_score(workplace: &Workplace, line: &str) -> f64 {
    let report = workplace.run(line).json();
    let scores = report["shape"]["original"]["scores"].as_array().unwrap().clone();
    let at_5_mm = scores.iter().find(|score| score["threshold_mm"] == 5.0).unwrap();
    at_5_mm["f"].as_f64().unwrap()
}

#[test]
fn a_mesh_of_a_run_fits_its_poses() {
    let workplace = Workplace::new();
    workplace.run("run --object rubiks_cube_small --duration 2 --quiet").good();
    workplace.run("mesh --run out --out fine.ply").good();
    workplace.run("mesh --run out --out fine.obj").good();
    let expected = f_score(&workplace, "score --run out --json");
    assert!(expected > 0.5, "{expected}");
    for mesh in ["out/mesh.ply", "out/mesh.obj", "fine.ply", "fine.obj"] {
        // The files say that they are in the object's coordinates.
        let line = format!("score --mesh {mesh} --pose out/trajectory.csv --truth rubiks_cube_small --json");
        let f = f_score(&workplace, &line);
        assert!((f - expected).abs() < 0.03, "{mesh}: {f} and not {expected}");
        let said = workplace.run(&format!("{line} --frame file")).error();
        assert!(said.contains("\"object\""), "{said}");
    }
    // A field alone does not say where the object is.
    assert!(workplace.run("mesh --run out/field.safetensors --out field.ply").warned().contains("summary.json"));
    let said = workplace.run("score --mesh field.ply --truth rubiks_cube_small").error();
    assert!(said.contains("field"), "{said}");
}
