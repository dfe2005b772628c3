//! `inspect`: a damaged log leads to exit code 1 and a reason.

use std::fs;

use crate::workplace::Workplace;

fn with_log() -> Workplace {
    let workplace = Workplace::new();
    workplace.run("generate --object large_dice --logs 1 --duration 0.2 --out set").good();
    workplace.run("inspect set/large_dice/00 --sheet sheet.png").good();
    let sheet = image::open(workplace.path("sheet.png")).unwrap();
    assert!(sheet.width() > 1000 && sheet.height() > 500);
    workplace
}

/// Changes one file, inspects the log, and restores the file.
#[track_caller]
fn refused(workplace: &Workplace, file: &str, change: impl FnOnce(&mut Vec<u8>)) -> String {
    let path = workplace.path("set/large_dice/00").join(file);
    let intact = fs::read(&path).unwrap();
    let mut bytes = intact.clone();
    change(&mut bytes);
    fs::write(&path, bytes).unwrap();
    let said = workplace.run("inspect set/large_dice/00").error();
    fs::write(&path, intact).unwrap();
    assert!(said.contains(file), "{said} does not name {file}");
    said
}

#[test]
fn a_damaged_file_is_named() {
    let workplace = with_log();
    for length in [0, 1, 100, 1000] {
        refused(&workplace, "data.pkl", |bytes| bytes.truncate(length));
    }
    refused(&workplace, "data.pkl", |bytes| bytes.truncate(bytes.len() - 1));
    refused(&workplace, "scene.json", |bytes| bytes.truncate(bytes.len() / 2));
    let depth = "realsense/front-left/depth.npz";
    for eighth in 1..8 {
        refused(&workplace, depth, |bytes| {
            // A single bit may copy the same values from another place of the image, which is no damage.
            let middle = bytes.len() * eighth / 8;
            bytes[middle..middle + 8].iter_mut().for_each(|byte| *byte = !*byte);
        });
    }
    refused(&workplace, depth, |bytes| bytes.truncate(bytes.len() - 1));
    let camera = fs::read(workplace.path("set/large_dice/00/realsense/front-left/image/0.jpg")).unwrap();
    let said = refused(&workplace, "allegro/index/image/2.jpg", |bytes| bytes.clone_from(&camera));
    assert!(said.contains("640"), "{said}");
    refused(&workplace, "allegro/thumb/mask/0.jpg", |bytes| bytes.clone_from(&camera));
    refused(&workplace, "realsense/front-left/seg/5.jpg", |bytes| bytes.truncate(100));
    refused(&workplace, "realsense/front-left/image/5.jpg", Vec::clear);
    // All files are restored.
    workplace.run("inspect set/large_dice/00").good();
}

#[test]
fn a_missing_file_is_named() {
    for file in [
        "data.pkl",
        "allegro/ring/image/3.jpg",
        "allegro/ring/mask/5.jpg",
        "realsense/front-left/image/0.jpg",
        "realsense/front-left/seg/5.jpg",
        "realsense/front-left/depth.npz",
    ] {
        let workplace = with_log();
        fs::remove_file(workplace.path("set/large_dice/00").join(file)).unwrap();
        let said = workplace.run("inspect set/large_dice/00").error();
        let folder = file.rsplit_once('/').map_or(file, |(folder, _)| folder);
        assert!(said.contains(folder), "{said} does not name {folder}");
    }
    let workplace = Workplace::new();
    assert!(workplace.run("inspect nowhere").error().contains("nowhere"));
    fs::create_dir(workplace.path("empty")).unwrap();
    assert!(workplace.run("inspect empty").error().contains("empty/data.pkl"));
}

#[test]
fn a_hostile_pickle_is_not_executed() {
    let workplace = with_log();
    for program in [
        &b"cos\nsystem\n(S'touch hacked'\ntR."[..],
        b"\x80\x04\x8c\x05posix\x8c\x06system\x93\x8c\x0ctouch hacked\x85R.",
        b"cbuiltins\neval\n(S\"open('hacked','w')\"\ntR.",
        b"c__builtin__\nexec\n(S\"open('hacked','w')\"\ntR.",
        b"(S'touch hacked'\nios\nsystem\n.",
        b"cnumpy.core.multiarray\n_reconstruct\n(cos\nsystem\n(S'touch hacked'\ntRI0\nS'b'\ntR.",
    ] {
        let said = refused(&workplace, "data.pkl", |bytes| *bytes = program.to_vec());
        assert!(said.lines().count() == 1, "{said}");
        assert!(!workplace.path("hacked").exists());
    }
}

#[test]
fn poses_that_contradict_kinematics_are_refused() {
    let workplace = with_log();
    // With the other hand, forward kinematics leads to other poses than those of data.pkl.
    let path = workplace.path("set/large_dice/00/scene.json");
    let scene = fs::read_to_string(&path).unwrap();
    fs::write(&path, scene.replace("\"hand\": \"left\"", "\"hand\": \"right\"")).unwrap();
    let said = workplace.run("inspect set/large_dice/00").error();
    assert!(said.contains("kinematics"), "{said}");
}
