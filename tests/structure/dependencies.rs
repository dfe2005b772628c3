//! Who depends on whom, by `cargo metadata`.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::process::Command;
use std::sync::OnceLock;

use serde_json::Value;

use crate::nothing_offends;
use crate::sources::{code, root, rust_files};

/// The crates that may link libmujoco.
const LINKS_MUJOCO: [&str; 12] = [
    "mambavitact",
    "mvt-environment",
    "mvt-evaluation",
    "mvt-hands",
    "mvt-learning",
    "mvt-simulated",
    "mvt-simulated-robot",
    "mvt-mujoco-lib",
    "mvt-physics",
    "mvt-python",
    "mvt-sweep",
    "mvt-tuning",
];
/// The crates that may import the downloader: for meshes of objects and hands, in the build script that brings libmujoco, and for hashes of settings
/// and files.
const DOWNLOADS: [&str; 7] =
    ["mambavitact", "mvt-evaluation", "mvt-hands", "mvt-run", "mvt-simulated", "mvt-mujoco-lib", "mvt-objects"];
/// Folders, with the folders from which their crates may import. The binary, in the root, may import from all; the Python package also
/// imports the binary's library, "".
const LAYERS: [(&str, &[&str]); 7] = [
    ("scenes", &["scenes"]),
    ("sim", &["scenes", "sim"]),
    ("perception", &["scenes", "perception"]),
    ("slam", &["scenes", "slam"]),
    ("app", &["scenes", "sim", "perception", "slam", "app"]),
    ("python", &["scenes", "sim", "perception", "slam", "app", ""]),
    ("results", &[]),
];
/// A crate of the workspace or from elsewhere.
#[derive(Debug, Default)]
pub struct Package {
    /// First folder of its path in the workspace; empty for the root, none for a crate from elsewhere.
    pub layer: Option<String>,
    /// Folder relative to the root, of a crate of the workspace.
    pub folder: String,
    /// Names of the dependencies that are linked.
    pub normal: BTreeSet<String>,
    /// Names of the dependencies of the build script.
    build: BTreeSet<String>,
    /// Names of the dependencies of tests and examples.
    dev: BTreeSet<String>,
}

/// All packages by name. Versions of one name count as one package.
pub fn packages() -> &'static BTreeMap<String, Package> {
    static PACKAGES: OnceLock<BTreeMap<String, Package>> = OnceLock::new();
    PACKAGES.get_or_init(|| {
        let cargo = std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
        // For this platform alone: the packages of others are not on a machine that has only built the program.
        let version = Command::new("rustc").arg("-vV").output().unwrap();
        let version = String::from_utf8(version.stdout).unwrap();
        let host = version.lines().find_map(|line| line.strip_prefix("host: ")).unwrap();
        let arguments = ["metadata", "--format-version", "1", "--offline", "--locked", "--filter-platform", host];
        let output = Command::new(cargo).args(arguments).current_dir(root()).output().unwrap();
        assert!(output.status.success(), "cargo metadata: {}", String::from_utf8_lossy(&output.stderr));
        read_metadata(&serde_json::from_slice(&output.stdout).unwrap())
    })
}

fn read_metadata(metadata: &Value) -> BTreeMap<String, Package> {
    let text = |value: &Value| value.as_str().unwrap().to_owned();
    let list = |value: &Value| value.as_array().unwrap().clone();
    let members: BTreeSet<String> = list(&metadata["workspace_members"]).iter().map(text).collect();
    let home = text(&metadata["workspace_root"]);
    let mut packages = BTreeMap::<String, Package>::new();
    let mut names = BTreeMap::new();
    for package in list(&metadata["packages"]) {
        let (id, name) = (text(&package["id"]), text(&package["name"]));
        let entry = packages.entry(name.clone()).or_default();
        if members.contains(&id) {
            let manifest = text(&package["manifest_path"]);
            let folder = Path::new(&manifest).parent().unwrap().strip_prefix(&home).unwrap();
            let first = folder.iter().next().unwrap_or_default();
            entry.layer = Some(first.to_str().unwrap().to_owned());
            folder.to_str().unwrap().clone_into(&mut entry.folder);
        }
        names.insert(id, name);
    }
    for node in list(&metadata["resolve"]["nodes"]) {
        let entry = packages.get_mut(&names[&text(&node["id"])]).unwrap();
        for dependency in list(&node["deps"]) {
            let name = names[&text(&dependency["pkg"])].clone();
            for kind in list(&dependency["dep_kinds"]) {
                match kind["kind"].as_str() {
                    None => entry.normal.insert(name.clone()),
                    Some("build") => entry.build.insert(name.clone()),
                    Some(_) => entry.dev.insert(name.clone()),
                };
            }
        }
    }
    packages
}

/// Crates of the workspace by name.
pub fn members() -> impl Iterator<Item = (&'static String, &'static Package)> {
    packages().iter().filter(|(_, package)| package.layer.is_some())
}

/// The shortest chain of linked dependencies from a crate to another one, both included.
fn path(from: &str, to: &str) -> Option<Vec<String>> {
    let mut chains = std::collections::VecDeque::from([vec![from.to_owned()]]);
    let mut seen = BTreeSet::new();
    while let Some(chain) = chains.pop_front() {
        let last = chain.last()?;
        if last == to {
            return Some(chain);
        }
        for next in &packages()[last].normal {
            if seen.insert(next.clone()) {
                chains.push_back(chain.iter().chain([next]).cloned().collect());
            }
        }
    }
    None
}

#[test]
fn only_the_simulator_and_its_drivers_link_libmujoco() {
    let offenders: Vec<String> = members()
        .filter(|(name, _)| !LINKS_MUJOCO.contains(&name.as_str()))
        .flat_map(|(name, _)| ["mvt-mujoco-lib", "mujoco-rs"].into_iter().filter_map(|library| path(name, library)))
        .map(|chain| chain.join(" -> "))
        .collect();
    nothing_offends("these crates reach libmujoco", &offenders);
    // The walk finds chains that exist.
    for name in LINKS_MUJOCO {
        assert!(path(name, "mvt-mujoco-lib").is_some(), "{name} no longer links libmujoco: take it from LINKS_MUJOCO");
    }
}

#[test]
fn crates_import_only_from_layers_below() {
    let mut offenders = Vec::new();
    for (name, package) in members() {
        let layer = package.layer.as_deref().unwrap();
        if layer.is_empty() {
            continue;
        }
        let Some((_, allowed)) = LAYERS.iter().find(|(folder, _)| *folder == layer) else {
            offenders.push(format!("{name} lies in {layer}/, which is no layer"));
            continue;
        };
        let kinds = [("", &package.normal), ("build-", &package.build), ("dev-", &package.dev)];
        for (kind, other) in kinds.iter().flat_map(|(kind, names)| names.iter().map(move |name| (kind, name))) {
            let Some(theirs) = &packages()[other].layer else { continue };
            if !allowed.contains(&theirs.as_str()) {
                let theirs = if theirs.is_empty() { "the binary" } else { theirs };
                offenders.push(format!("{name} ({layer}) has the {kind}dependency {other} ({theirs})"));
            }
        }
    }
    nothing_offends("scenes <- sim, perception, slam <- app <- the binary", &offenders);
}

#[test]
fn the_downloader_is_imported_by_few() {
    let direct = members()
        .filter(|(name, _)| !DOWNLOADS.contains(&name.as_str()))
        .filter(|(_, package)| package.normal.contains("mvt-pinned") || package.build.contains("mvt-pinned"))
        .map(|(name, _)| format!("{name} imports mvt-pinned"));
    let reached = members()
        .filter(|(_, package)| package.layer.as_deref().is_some_and(|layer| ["perception", "slam"].contains(&layer)))
        .filter_map(|(name, _)| path(name, "mvt-pinned"))
        .map(|chain| chain.join(" -> "));
    nothing_offends("few crates import the downloader", &direct.chain(reached).collect::<Vec<_>>());
}

#[test]
fn only_commands_read_arguments() {
    let is_library = |layer: &String| ["scenes", "sim", "perception", "slam"].contains(&layer.as_str());
    let libraries = members().filter(|(_, package)| package.layer.as_ref().is_some_and(is_library));
    let chains = libraries.filter_map(|(name, _)| path(name, "clap")).map(|chain| chain.join(" -> "));
    nothing_offends("libraries below app/ know no command line", &chains.collect::<Vec<_>>());
}

#[test]
fn only_evaluations_tell_an_explorer_what_it_cannot_know() {
    let offends =
        |file: &std::path::PathBuf| !file.starts_with("app/evaluation") && code(file).contains("UnknownSurface for ");
    let offenders: Vec<String> =
        rust_files(Path::new("")).into_iter().filter(offends).map(|file| file.display().to_string()).collect();
    nothing_offends("an oracle of unknown surface belongs in app/evaluation", &offenders);
}
