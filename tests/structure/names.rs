//! Public type names are unique in the workspace.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use crate::dependencies::members;
use crate::modules::Tree;
use crate::nothing_offends;

/// Names of the types that a line defines for all crates to see.
fn defined(line: &str) -> Option<&str> {
    let rest = line.trim_start().strip_prefix("pub ")?;
    let rest = rest.strip_prefix("unsafe ").unwrap_or(rest);
    let (kind, rest) = rest.split_once(' ')?;
    if !["struct", "enum", "trait", "type", "union"].contains(&kind) {
        return None;
    }
    let end = rest.find(|c: char| !c.is_alphanumeric() && c != '_').unwrap_or(rest.len());
    (end > 0).then(|| &rest[..end])
}

#[test]
fn public_type_names_are_unique() {
    let mut places = BTreeMap::<String, BTreeSet<String>>::new();
    for (_, package) in members().filter(|(_, package)| !package.folder.is_empty()) {
        let tree = Tree::new(&Path::new(&package.folder).join("src"));
        for module in tree.modules() {
            for name in module.code.lines().filter_map(defined).filter(|name| tree.is_public(module, name)) {
                places.entry(name.to_owned()).or_default().insert(module.file.display().to_string());
            }
        }
    }
    let offenders: Vec<String> = places
        .iter()
        .filter(|(_, files)| files.len() > 1)
        .map(|(name, files)| format!("{name}: {}", files.iter().cloned().collect::<Vec<_>>().join(", ")))
        .collect();
    nothing_offends("the name of a public type means one thing in the whole workspace", &offenders);
}

#[test]
fn definitions_are_found() {
    assert_eq!(defined("    pub struct Tracker<'a> {"), Some("Tracker"));
    assert_eq!(defined("pub enum Label;"), Some("Label"));
    assert_eq!(defined("pub type Pose = Isometry<Object, World>;"), Some("Pose"));
    for line in ["pub(crate) struct Hidden;", "struct Hidden;", "pub fn f() {}", "pub struct $name {"] {
        assert_eq!(defined(line), None, "{line}");
    }
}
