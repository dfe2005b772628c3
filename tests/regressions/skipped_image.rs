//! A log in which one touch image was skipped, as `import` writes it, was refused by `inspect` and `export`.

use std::fs;

use crate::workplace::Workplace;

#[test]
fn a_log_without_one_image_is_inspected_and_exported() {
    let workplace = Workplace::new();
    workplace.run("generate --object cube70 --logs 1 --duration 0.2 --cameras side --out set").good();
    let log = workplace.path("set/cube70/00");
    // As of another program.
    fs::remove_file(log.join("scene.json")).unwrap();
    fs::remove_file(log.join("allegro/index/image/3.jpg")).unwrap();
    for line in ["inspect set/cube70/00", "export mcap set/cube70/00 --out log.mcap"] {
        assert_eq!(workplace.run(line).code, Some(0), "{line}");
    }
    let said = workplace.run("export lerobot set/cube70/00 --out lerobot").error();
    assert!(said.contains("has no image of") && said.contains("export the log as MCAP"), "{said}");
    let said = workplace.run("inspect set/cube70/00").stdout;
    assert!(said.contains("note"), "{said}");
    // The image is missing in the middle: no frame at the end may be lost for it.
    let frames = |folder: &str| -> serde_json::Value {
        let said = workplace.run(&format!("inspect --json {folder}")).stdout;
        serde_json::from_str::<serde_json::Value>(&said).unwrap()["frames"].clone()
    };
    assert_eq!(frames("set/cube70/00"), 6, "0.2 s at 30 frames/s");
    // A compact log has all images of a frame.
    let said = workplace.run("convert set/cube70/00 --out compact").error();
    assert!(said.contains("index/image/3.jpg") && !workplace.path("compact").exists(), "{said}");
}
