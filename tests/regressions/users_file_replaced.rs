//! `run --out DIR` replaced files of the user whose names a run also writes.

use std::fs;

use crate::workplace::Workplace;

#[test]
fn a_users_file_in_the_folder_is_kept() {
    let workplace = Workplace::new();
    fs::create_dir(workplace.path("p")).unwrap();
    workplace.write("p/mesh.obj", "mine");
    for command in ["run --object cube70 --duration 0.2 --out p", "evaluate --objects cube70 --duration 0.2 --out p"] {
        let said = workplace.run(command).error();
        assert!(said.contains("mesh.obj") && said.contains("--overwrite"), "{command}: {said}");
    }
    assert_eq!(workplace.files("p").len(), 1);
    // With leave the run takes the folder, but the next one does not move it away.
    workplace.write("p/notes.txt", "mine");
    workplace.run("run --object cube70 --duration 0.2 --out p --overwrite --quiet").good();
    let said = workplace.run("run --object cube70 --duration 0.2 --out p").error();
    assert!(said.contains("--overwrite"), "{said}");
    assert_eq!(fs::read(workplace.path("p/notes.txt")).unwrap(), b"mine");
}
