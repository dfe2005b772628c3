//! Messages that were wrong, doubled, or missing.

use std::fs;

use crate::workplace::Workplace;

/// A square of 50 mm that is no solid.
const SHEET: &str = "v 0 0 0\nv 0.05 0 0\nv 0.05 0.05 0\nv 0 0.05 0\nf 1 2 3\nf 1 3 4\n";

/// A tetrahedron with legs of this length, metres.
fn tetrahedron(leg_m: f64) -> String {
    format!("v 0 0 0\nv {leg_m} 0 0\nv 0 {leg_m} 0\nv 0 0 {leg_m}\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n")
}

#[test]
fn a_mesh_is_refused_in_words() {
    let workplace = Workplace::new();
    workplace.write("flat.obj", SHEET);
    workplace.write("large.obj", tetrahedron(0.60004));
    fs::create_dir(workplace.path("folder")).unwrap();
    for (object, parts) in [
        ("flat.obj", &["flat.obj: ", "no volume"][..]),
        ("large.obj", &["600.040 mm", "5 to 600 mm"]),
        ("folder", &["folder is a folder", ".obj"]),
        ("./folder", &["folder is a folder"]),
    ] {
        let ended = workplace.run(&format!("simulate --object {object} --duration 0.1"));
        let said = ended.stderr.lines().last().unwrap_or_default();
        assert!(ended.code == Some(1) && parts.iter().all(|part| said.contains(part)), "{object}: {said}");
        assert!(!ended.stderr.contains("MuJoCo"), "{ended:?}");
    }
}

#[test]
fn a_reason_of_the_operating_system_is_given_once_and_in_words() {
    let workplace = Workplace::new();
    for line in ["mesh --run nowhere --out a.ply", "inspect nowhere", "run --log nowhere", "score --run nowhere"] {
        let said = workplace.run(line).error();
        assert_eq!(said.matches("No such file or directory").count(), 1, "{line}: {said}");
        assert!(said.contains("nowhere") && !said.contains("os error"), "{line}: {said}");
    }
}

#[test]
fn a_negative_number_is_out_of_range_and_not_an_unknown_argument() {
    let workplace = Workplace::new();
    for line in ["run --duration -1", "simulate --object cube70 --seed -1", "touch data --out d --images -3"] {
        let said = workplace.run(line).usage();
        assert!(said.contains("invalid value '-"), "{line}: {said}");
    }
}

#[test]
fn objects_are_listed_without_a_cache_folder() {
    let workplace = Workplace::new();
    let mut command = workplace.command("assets list");
    command.env_remove("HOME").env_remove("XDG_CACHE_HOME").env_remove("LOCALAPPDATA");
    let said = crate::workplace::Ended::of(&mut command).good();
    assert!(said.contains("077_rubiks_cube") && said.contains("cube70"), "{said}");
}

#[test]
fn a_file_name_with_spaces_and_umlauts_makes_a_log() {
    let workplace = Workplace::new();
    workplace.write("my cübe.obj", tetrahedron(0.08));
    let mut command = workplace.command("generate --logs 1 --duration 0.2 --cameras side");
    command.args(["--object", "my cübe.obj", "--out", "my set"]);
    let said = crate::workplace::Ended::of(&mut command);
    assert_eq!(said.code, Some(0), "{said:?}");
    assert_eq!(workplace.logs("my set"), ["my set/my_c_be/00"]);
    // The command can be copied.
    assert!(said.stdout.contains("`mambavitact inspect 'my set/my_c_be/00'`"), "{said:?}");
    fs::rename(workplace.path("my set"), workplace.path("set")).unwrap();
    workplace.run("inspect set/my_c_be/00").warned();
}

#[test]
fn the_end_of_a_command_says_what_to_look_at_next() {
    let workplace = Workplace::new();
    let generated = workplace.run("generate --object cube70 --logs 1 --duration 0.2 --cameras side --out set").good();
    assert!(generated.contains("1 log in set") && generated.contains("inspect set/cube70/00"), "{generated}");
    let drawn = workplace.run("touch data --objects mug --images 1 --out presses").good();
    assert!(drawn.contains("1 image in presses") && drawn.contains("touch evaluate"), "{drawn}");
    let ran = workplace.run("run --log set/cube70/00").good();
    assert!(ran.contains("view --run out"), "{ran}");
    let pictured = workplace.run("view --run out --record a.png --size 200x200").good();
    assert!(pictured.contains("a.png"), "{pictured}");
    let evaluated = workplace.run("evaluate --objects cube70 --seeds 1 --duration 0.2 --modes pose --out e").good();
    assert!(evaluated.contains("e/table.md"), "{evaluated}");
    assert!(evaluated.lines().all(|line| line.chars().count() <= 80), "{evaluated}");
    assert!(workplace.run("touch data --objects mug --images 0 --out none").error().contains("--images 0"));
}
