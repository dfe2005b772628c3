//! `export`.

use crate::workplace::Workplace;

#[test]
fn a_log_becomes_an_mcap_file_that_nothing_else_replaces() {
    let workplace = Workplace::new();
    workplace.run("generate --object cube70 --logs 1 --duration 0.2 --cameras side --out set").good();
    let said = workplace.run("export mcap set/cube70/00 --out cube.mcap").good();
    assert!(said.starts_with("6 frames in 18 channels, "), "{said}");
    let file = std::fs::read(workplace.path("cube.mcap")).unwrap();
    assert!(file.starts_with(b"\x89MCAP0\r\n") && file.ends_with(b"\x89MCAP0\r\n"));

    let refused = workplace.run("export mcap set/cube70/00 --out cube.mcap").error();
    assert!(refused.contains("cube.mcap already exists"), "{refused}");
    workplace.run("export mcap set/cube70/00 --out cube.mcap --overwrite").good();
    assert!(std::fs::read(workplace.path("cube.mcap")).unwrap() == file, "the same bytes again");

    let refused = workplace.run("export mcap set --out set.mcap").error();
    assert!(refused.contains("data.pkl"), "{refused}");
    std::fs::remove_file(workplace.path("set/cube70/00/realsense/side/image/3.jpg")).unwrap();
    workplace.run("export mcap set/cube70/00 --out broken.mcap").error();
    assert!(workplace.files("").keys().all(|path| path.extension().is_none_or(|end| end != "partial")));
    assert!(!workplace.path("broken.mcap").exists());
}
