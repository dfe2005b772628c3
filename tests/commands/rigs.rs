//! Rigs that the program brings along and that need no download: their controllers, and a log and a run of each.

use crate::workplace::Workplace;

#[test]
fn each_rig_has_a_controller_that_holds_the_object() {
    for (rig, pads) in [("three_fingers", 3), ("gripper_gelsight", 2)] {
        let line = format!("simulate --json --rig {rig} --object cube70 --duration 3");
        let outcome = Workplace::new().run(&line).json();
        assert_eq!(outcome["survived_s"], 3.0, "{rig}: {outcome}");
        assert_eq!(outcome["per_pad_contact"].as_array().unwrap().len(), pads, "{rig}: {outcome}");
        assert!(outcome["any_contact_fraction"].as_f64().unwrap() > 0.2, "{rig}: {outcome}");
    }
}

#[test]
fn each_rig_tracks_what_it_holds() {
    for rig in ["three_fingers", "gripper_gelsight"] {
        let workplace = Workplace::new();
        let line = format!("run --quiet --rig {rig} --object cube70 --duration 1.2 --touch-depth truth --out out");
        workplace.run(&line).good();
        let summary = workplace.json("out/summary.json");
        let add_s_mm = summary["add_s_mm"]["mean"].as_f64().unwrap();
        assert!(add_s_mm < 5.0, "{rig}: {summary}");
    }
}

#[test]
fn commands_of_the_hand_show_the_warnings_about_a_rig() {
    let rig = concat!(env!("CARGO_MANIFEST_DIR"), "/sim/hands/tests/data/pincer.toml");
    for command in ["hand score --object cube70 --controller auto", "controllers check absent.safetensors"] {
        let said = Workplace::new().run(&format!("{command} --rig {rig}")).stderr;
        assert!(said.contains("WARN 1 links that do not hang on palm are left out"), "{command}: {said}");
    }
}
