//! `evaluate` counted an object that was named twice as two runs.

use crate::workplace::Workplace;

#[test]
fn a_repeated_name_is_refused() {
    let workplace = Workplace::new();
    for (options, name) in [
        ("--objects cube70,cube70", "\"cube70\""),
        ("--objects cube70 --cameras side;side", "\"side\""),
        ("--objects cube70 --modes pose,pose", "Pose"),
        ("--objects cube70 --modalities vi,vi", "Vi"),
    ] {
        let said = workplace.run(&format!("evaluate {options} --duration 0.2 --out e")).error();
        assert!(said.contains(name) && said.contains("twice"), "{options}: {said}");
    }
    assert!(!workplace.path("e").exists());
}
