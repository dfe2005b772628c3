//! Lengths of files and crates, panics, and addresses that do not belong here.

use std::path::Path;

use crate::dependencies::members;
use crate::nothing_offends;
use crate::sources::{code, files, read, rust_files};

/// Most lines of a file.
const FILE: usize = 600;
/// Most lines of a crate with its tests and examples, and of the tests of the workspace.
const CRATE: usize = 9000;
/// The binary has fewer lines in src/.
const BINARY: usize = 4150;
/// Calls that panic.
const PANICS: [&str; 3] = [".unwrap()", ".expect(", "panic!"];
/// Parts of host names of package registries, in halves: this file holds none.
const REGISTRIES: [[&str; 2]; 8] = [
    ["://crates", ".io"],
    ["://index.crates", ".io"],
    ["://static.crates", ".io"],
    ["://pypi", "."],
    ["://files.python", "hosted."],
    ["://registry.npm", "js."],
    ["://proxy.go", "lang."],
    ["/simp", "le/"],
];

fn lines(file: &Path) -> usize {
    read(file).lines().count()
}

#[test]
fn files_and_crates_are_short() {
    let long = |file: &Path| (lines(file), file.display().to_string());
    let mut offenders: Vec<String> = rust_files(Path::new(""))
        .iter()
        .map(|file| long(file))
        .filter(|(lines, _)| *lines > FILE)
        .map(|(lines, file)| format!("{file}: {lines} lines, at most {FILE} are allowed"))
        .collect();
    for (name, package) in members() {
        // The tests of the root package are those of the whole workspace; its src/ has a limit of its own.
        let folder = if package.folder.is_empty() { "tests" } else { package.folder.as_str() };
        let total: usize = rust_files(Path::new(folder)).iter().map(|file| lines(file)).sum();
        if total > CRATE {
            offenders.push(format!("{name}: {total} lines, at most {CRATE} are allowed"));
        }
    }
    let binary: usize = rust_files(Path::new("src")).iter().map(|file| lines(file)).sum();
    if binary >= BINARY {
        offenders.push(format!("src/: {binary} lines, fewer than {BINARY} are allowed"));
    }
    nothing_offends("files and crates are too long", &offenders);
}

#[test]
fn library_code_does_not_panic() {
    let mut offenders = Vec::new();
    let libraries = members().filter(|(name, package)| !package.folder.is_empty() && *name != "mvt-results");
    for file in libraries.flat_map(|(_, package)| rust_files(&Path::new(&package.folder).join("src"))) {
        for (number, line) in code(&file).lines().enumerate() {
            let panics = PANICS.iter().filter(|call| line.contains(*call));
            offenders.extend(panics.map(|call| format!("{}:{}: {call}", file.display(), number + 1)));
        }
    }
    nothing_offends("library code outside tests may not panic", &offenders);
}

/// Calls that read a file without regard to what it is; `mvt_files::input` refuses FIFOs and devices.
const READS: [&str; 4] = ["fs::read(", "fs::read_to_string(", "File::open(", "image::open("];
/// Files that read only what this program or the operating system wrote.
const READERS: [&str; 7] = [
    "scenes/files/src/input.rs",
    "scenes/pinned/src/lib.rs",
    "sim/feelsight/src/io.rs",
    "app/ros/src/bus.rs",
    "app/run/src/report.rs",
    "src/bench.rs",
    "results/",
];

#[test]
fn files_that_people_name_are_never_waited_for() {
    let mut offenders = Vec::new();
    for file in members().flat_map(|(_, package)| rust_files(&Path::new(&package.folder).join("src"))) {
        let path = file.display().to_string();
        if READERS.iter().any(|reader| path.starts_with(reader)) {
            continue;
        }
        for (number, line) in code(&file).lines().enumerate() {
            let reads = READS.iter().filter(|call| line.contains(*call));
            offenders.extend(reads.map(|call| format!("{path}:{}: {call} instead of mvt_files::input", number + 1)));
        }
    }
    nothing_offends("files are opened by mvt_files::input", &offenders);
}

#[test]
fn no_file_names_a_package_registry() {
    let mut offenders = Vec::new();
    // Cargo writes the registry's address into its lock file.
    for file in files().into_iter().filter(|file| !file.ends_with("Cargo.lock")) {
        let Ok(bytes) = std::fs::read(crate::sources::root().join(&file)) else { continue };
        let Ok(text) = String::from_utf8(bytes) else { continue };
        for (number, line) in text.lines().enumerate() {
            let found = REGISTRIES.iter().map(|halves| halves.concat()).find(|address| line.contains(address));
            offenders.extend(found.map(|address| format!("{}:{}: {address}", file.display(), number + 1)));
        }
    }
    nothing_offends("addresses of package registries belong into the user's settings", &offenders);
}
