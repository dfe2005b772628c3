//! Commands that write one file replaced whatever had its name.

use std::fs;

use crate::workplace::Workplace;

#[test]
fn a_named_file_is_replaced_only_on_demand() {
    let workplace = Workplace::new();
    workplace.run("generate --object cube70 --logs 1 --duration 0.2 --cameras side --out set").good();
    workplace.run("run --log set/cube70/00 --quiet").good();
    for (line, file) in [
        ("mesh --run out --out mine.ply", "mine.ply"),
        ("view --run out --record mine.png --size 200x200", "mine.png"),
        ("view --run out --record mine.gif --size 200x200", "mine.gif"),
        ("inspect set/cube70/00 --sheet sheet.png", "sheet.png"),
    ] {
        workplace.write(file, "mine");
        let said = workplace.run(line).error();
        assert!(said.contains(file) && said.contains("--overwrite"), "{line}: {said}");
        assert_eq!(fs::read(workplace.path(file)).unwrap(), b"mine", "{line}");
        workplace.run(&format!("{line} --overwrite")).good();
        assert_ne!(fs::read(workplace.path(file)).unwrap(), b"mine", "{line}");
    }
    let names: Vec<_> = fs::read_dir(workplace.path("")).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    assert!(!names.iter().any(|name| name.to_string_lossy().starts_with('.')), "{names:?}");
}
