//! A damaged field or keyframe file gave a mesh or a resumed run.

use std::fs;

use crate::workplace::Workplace;

#[test]
fn a_damaged_field_and_damaged_keyframes_are_refused() {
    let workplace = Workplace::new();
    workplace.run("run --object cube70 --duration 0.3 --quiet").good();
    for (file, line) in [
        ("field.safetensors", "mesh --run out --out m.ply"),
        ("field.safetensors", "run --object cube70 --duration 0.2 --resume out --out again"),
        ("keyframes.safetensors", "run --object cube70 --duration 0.2 --resume out --out again"),
    ] {
        let path = workplace.path("out").join(file);
        let whole = fs::read(&path).unwrap();
        for at in [whole.len() / 2, whole.len() - 3] {
            let mut damaged = whole.clone();
            // A mantissa's bit: the number stays finite and plausible.
            damaged[at / 4 * 4] ^= 0x10;
            fs::write(&path, damaged).unwrap();
            let said = workplace.run(line).error();
            assert!(said.contains(file) && said.contains("damaged"), "{said}");
        }
        fs::write(&path, whole).unwrap();
        assert!(!workplace.path("again").exists() && !workplace.path("m.ply").exists());
    }
    workplace.run("mesh --run out --out m.ply").good();
}
