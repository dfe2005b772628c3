//! What a build costs: the packages that it compiles, their optimisation, and the files that the program carries.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use crate::dependencies::{members, packages};
use crate::nothing_offends;
use crate::sources::{read, root, rust_files};

/// Most packages in Cargo.lock. Lower it when their number falls; raise it only with a reason in the commit.
/// 62 of them are those of Foxglove's server, which only a build with the feature `foxglove` compiles.
const PACKAGES: usize = 671;
/// Packages in Cargo.lock beyond one version of each. Most come from the windows of other platforms.
/// 16 belong to Foxglove's server, most of them to parts of its libraries that are never compiled.
const EXTRA_VERSIONS: usize = 57;
/// Folders of the kernels: none of their dependencies runs unoptimised.
const KERNELS: [&str; 3] = ["sim", "perception", "slam"];
/// The crates that decode and encode files of others, whose own dependencies run optimised, too.
const CODECS: [&str; 3] = ["mvt-bag", "mvt-exchange", "mvt-recording"];
/// Dependencies of these that no frame and no byte of a file passes through.
const GLUE: [&str; 3] = ["anyhow", "clap", "indicatif"];
/// Packages that kernels and codecs link for what they never do, or do seldom: finding a message in a bag, colour profiles of images, names in
/// archives, text of settings.
const IDLE: [&str; 6] = ["libsqlite3-sys", "moxcms", "pxfm", "toml", "toml_parser", "typed-path"];
/// Most bytes of the files that the program carries, such as weights.
const CARRIED: u64 = 10 << 20;

fn versions() -> BTreeMap<String, Vec<String>> {
    let lock: toml::Table = read(Path::new("Cargo.lock")).parse().unwrap();
    let mut versions = BTreeMap::<String, Vec<String>>::new();
    for package in lock["package"].as_array().unwrap() {
        let [name, version] = ["name", "version"].map(|key| package[key].as_str().unwrap().to_owned());
        versions.entry(name).or_default().push(version);
    }
    versions
}

#[test]
fn packages_do_not_grow() {
    let count: usize = versions().values().map(Vec::len).sum();
    assert!(count <= PACKAGES, "Cargo.lock has {count} packages, not {PACKAGES}");
}

#[test]
fn duplicated_versions_do_not_grow() {
    let mut versions = versions();
    versions.retain(|_, versions| versions.len() > 1);
    let extra: usize = versions.values().map(|versions| versions.len() - 1).sum();
    assert!(extra <= EXTRA_VERSIONS, "{extra} versions beyond one of each package, not {EXTRA_VERSIONS}: {versions:?}");
}

/// All packages that are linked into these, and these.
fn linked(roots: impl IntoIterator<Item = String>) -> BTreeSet<String> {
    let mut stack: Vec<String> = roots.into_iter().collect();
    let mut all = BTreeSet::new();
    while let Some(name) = stack.pop() {
        stack.extend(packages()[&name].normal.iter().filter(|next| !all.contains(*next)).cloned());
        all.insert(name);
    }
    all
}

#[test]
fn dependencies_of_kernels_and_codecs_are_optimised() {
    let manifest: toml::Table = read(Path::new("Cargo.toml")).parse().unwrap();
    let profile = manifest["profile"]["release"]["package"].as_table().unwrap();
    let level =
        |name: &str| profile.get(name).and_then(|of| of.get("opt-level")).map(|level| level.as_integer().unwrap());
    assert_eq!(level("*"), None, "the default of all packages is that of the release profile, 3");
    assert!(
        !profile.contains_key("mambavitact"),
        "Cargo forgets to strip a program whose package has a section of its own"
    );
    let kernels = members().filter(|(_, package)| KERNELS.contains(&package.layer.as_deref().unwrap()));
    let of_codecs =
        CODECS.iter().flat_map(|name| &packages()[*name].normal).filter(|name| !GLUE.contains(&name.as_str()));
    let third_party = of_codecs.filter(|name| packages()[*name].layer.is_none());
    let roots = kernels.map(|(name, _)| name).chain(third_party).cloned();
    let offenders: Vec<String> = linked(roots)
        .into_iter()
        .filter(|name| !IDLE.contains(&name.as_str()) && level(name).is_some_and(|l| l < 2))
        .collect();
    nothing_offends("these packages run without optimisation in kernels or codecs", &offenders);
}

/// `test = false` saves a build of crates without tests in src/; one that is written there would never run.
#[test]
fn no_test_is_switched_off() {
    let manifest = |folder: &str| read(&Path::new(folder).join("Cargo.toml"));
    let libraries = members().map(|(_, package)| package.folder.as_str()).filter(|folder| !folder.is_empty());
    let silent = libraries.filter(|folder| manifest(folder).contains("test = false"));
    let sources = silent.flat_map(|folder| rust_files(&Path::new(folder).join("src")));
    let tests = sources.filter(|file| read(file).contains("#[test]")).map(|file| file.display().to_string());
    nothing_offends("these tests never run", &tests.collect::<Vec<_>>());
}

/// Paths in `include_bytes!` and `include_str!`, relative to the file that includes them.
fn carried(source: &str) -> impl Iterator<Item = &str> {
    ["include_bytes!(\"", "include_str!(\""]
        .into_iter()
        .flat_map(move |call| source.split(call).skip(1).filter_map(|rest| rest.split_once('"').map(|(path, _)| path)))
}

#[test]
fn the_program_carries_little() {
    let mut bytes = 0;
    let sources = members().flat_map(|(_, package)| rust_files(&Path::new(&package.folder).join("src")));
    for file in sources.filter(|file| !file.ends_with("tests.rs")) {
        let folder = root().join(&file).parent().unwrap().to_owned();
        bytes +=
            carried(&read(&file)).filter_map(|path| folder.join(path).metadata().ok()).map(|of| of.len()).sum::<u64>();
    }
    assert!(bytes > 1 << 20, "the weights are carried: {bytes} bytes");
    assert!(bytes <= CARRIED, "the program carries {bytes} bytes of files, at most {CARRIED} are allowed");
}
