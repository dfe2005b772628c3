//! A link in the place of the folder of results was itself moved aside, so that the next results lay beside the place that the user chose.

#![cfg(unix)]

use std::fs;
use std::os::unix::fs::symlink;

use crate::workplace::Workplace;

#[test]
fn results_stay_behind_the_link() {
    let workplace = Workplace::new();
    fs::create_dir_all(workplace.path("disk/results")).unwrap();
    symlink("disk/results", workplace.path("out")).unwrap();
    symlink("nowhere", workplace.path("dangling")).unwrap();
    symlink("loop", workplace.path("loop")).unwrap();
    let line = "run --object cube70 --duration 0.2 --quiet";
    workplace.run(line).good();
    let said = workplace.run(line).warned();
    assert!(said.contains("disk/results.1"), "{said}");
    assert!(workplace.path("out").is_symlink() && workplace.path("disk/results.1/summary.json").exists());
    workplace.run("score --run out").good();
    let said = workplace.run("run --object cube70 --duration 0.2 --out dangling").error();
    assert!(said.contains("dangling: it is a link that leads nowhere; remove it"), "{said}");
    for line in ["run --object cube70 --duration 0.2 --out loop", "inspect loop", "run --log loop"] {
        assert!(workplace.run(line).error().contains("Too many levels of symbolic links"), "{line}");
    }
}
