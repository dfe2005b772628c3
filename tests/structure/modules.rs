//! The modules of a crate, their imports, and circles among them.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::path::{Path, PathBuf};

use crate::dependencies::members;
use crate::nothing_offends;
use crate::sources::{code, is_test_file, rust_files};

/// Names from the crate's root to a module; empty for the root.
type Place = Vec<String>;

/// Imports are followed through at most so many re-exports.
const REEXPORTS: usize = 8;

/// A file of a crate.
pub struct Module {
    /// The file, relative to the workspace.
    pub file: PathBuf,
    /// Its code without comments, texts and tests.
    pub code: String,
    place: Place,
    /// Names that `use` brings into the module, with their paths as written, and whether the import is public. A `*` brings all names.
    imports: Vec<Import>,
}

struct Import {
    name: String,
    path: Vec<String>,
    is_public: bool,
}

/// The files of a crate as a tree of modules.
pub struct Tree(BTreeMap<Place, Module>);

impl Tree {
    /// Reads the files below a folder `src`.
    pub fn new(src: &Path) -> Self {
        let module = |file: PathBuf| {
            let code = code(&file);
            let mut place: Place = file
                .strip_prefix(src)
                .unwrap()
                .with_extension("")
                .iter()
                .map(|p| p.to_str().unwrap().to_owned())
                .collect();
            if place.last().is_some_and(|last| last == "mod")
                || ["lib", "main"].map(|n| vec![n.to_owned()]).contains(&place)
            {
                place.pop();
            }
            let imports = imports(&code);
            (place.clone(), Module { file, code, place, imports })
        };
        Self(rust_files(src).into_iter().filter(|file| !is_test_file(file)).map(module).collect())
    }

    /// All modules.
    pub fn modules(&self) -> impl Iterator<Item = &Module> {
        self.0.values()
    }

    /// Whether other crates can name a `pub` type of a module: each module above it is public, or a public `use` names the type.
    pub fn is_public(&self, module: &Module, name: &str) -> bool {
        let place = &module.place;
        let is_open = (0..place.len()).all(|k| {
            let parent = self.0.get(&place[..k]).map_or("", |parent| &parent.code);
            parent.contains(&format!("pub mod {};", place[k])) || parent.contains(&format!("pub mod {} {{", place[k]))
        });
        let exports = |import: &Import, from: &Module| {
            import.is_public
                && match import.path.last().map(String::as_str) {
                    Some("*") => {
                        self.target(&from.place, &import.path[..import.path.len() - 1], 0).as_ref() == Some(place)
                    }
                    last => last == Some(name) && self.target(&from.place, &import.path, 0).as_ref() == Some(place),
                }
        };
        is_open || self.modules().any(|from| from.imports.iter().any(|import| exports(import, from)))
    }

    /// The module in which the item of a path lies that is written in module `from`; none if it is of another crate.
    fn target(&self, from: &[String], path: &[String], depth: usize) -> Option<Place> {
        let (first, rest) = path.split_first()?;
        let (start, rest) = match first.as_str() {
            "crate" => (Place::new(), rest),
            "self" => (from.to_vec(), rest),
            "super" => return self.target(from.split_last()?.1, &[&["self".to_owned()], rest].concat(), depth),
            // A module or an import of this module; else a crate.
            name => {
                let is_here = self.0.contains_key(&[from, &[name.to_owned()]].concat());
                let import = self.0.get(from)?.imports.iter().find(|import| import.name == name && import.path != path);
                return match import {
                    _ if is_here => self.walk(from.to_vec(), path, depth),
                    Some(import) if depth < REEXPORTS => {
                        self.target(from, &[import.path.as_slice(), rest].concat(), depth + 1)
                    }
                    _ => None,
                };
            }
        };
        self.walk(start, rest, depth)
    }

    /// Goes down from a module along a path, through re-exports, to the module that defines its item.
    fn walk(&self, mut place: Place, path: &[String], depth: usize) -> Option<Place> {
        for (k, name) in path.iter().enumerate() {
            if let Some("super" | "self") = Some(name.as_str()).filter(|_| k == 0) {
                return self.target(&place, path, depth);
            }
            place.push(name.clone());
            if self.0.contains_key(&place) {
                continue;
            }
            place.pop();
            let import =
                self.0.get(&place).and_then(|module| module.imports.iter().find(|import| &import.name == name));
            if let Some(import) = import.filter(|_| depth < REEXPORTS) {
                return self.target(&place, &[import.path.as_slice(), &path[k + 1..]].concat(), depth + 1);
            }
            break;
        }
        Some(place)
    }

    /// The modules of this crate that a module imports from, without its own submodules and those that it is a submodule of.
    fn neighbours(&self, module: &Module) -> BTreeSet<Place> {
        let paths = module.imports.iter().map(|import| import.path.clone()).chain(inline_paths(&module.code));
        let targets = paths.filter_map(|path| self.target(&module.place, &path, 0));
        targets.filter(|to| !to.starts_with(&module.place) && !module.place.starts_with(to)).collect()
    }

    /// For each group of modules that import one another, a shortest circle, by file.
    fn circles(&self) -> Vec<String> {
        let graph: BTreeMap<&Place, BTreeSet<Place>> =
            self.0.iter().map(|(place, module)| (place, self.neighbours(module))).collect();
        let mut circles = Vec::new();
        let mut told = BTreeSet::new();
        for place in self.0.keys().filter(|place| self.0.contains_key(*place)) {
            let Some(circle) = shortest_circle(&graph, place) else { continue };
            let members: BTreeSet<&Place> = circle.iter().collect();
            if told.insert(members.into_iter().cloned().collect::<Vec<_>>()) {
                let files = circle.iter().chain([place]).map(|place| self.0[place].file.display().to_string());
                circles.push(files.collect::<Vec<_>>().join(" -> "));
            }
        }
        circles
    }
}

/// A shortest way from a module back to it, the module first.
fn shortest_circle(graph: &BTreeMap<&Place, BTreeSet<Place>>, place: &Place) -> Option<Vec<Place>> {
    let mut ways = VecDeque::from([vec![place.clone()]]);
    let mut seen = BTreeSet::new();
    while let Some(way) = ways.pop_front() {
        for next in graph.get(way.last()?).into_iter().flatten() {
            if next == place {
                return Some(way);
            }
            if seen.insert(next.clone()) {
                ways.push_back(way.iter().chain([next]).cloned().collect());
            }
        }
    }
    None
}

/// The imports of blanked code, one for each name.
fn imports(code: &str) -> Vec<Import> {
    let mut imports = Vec::new();
    for statement in code.split_inclusive([';', '{', '}']).scan(String::new(), collect_use).flatten() {
        let (is_public, tree) = match statement.split_once("use ") {
            Some((before, tree)) => (before.trim_end().ends_with("pub"), tree),
            None => continue,
        };
        expand(&[], tree.trim_end_matches(';'), is_public, &mut imports);
    }
    imports
}

/// Puts the parts of a `use` with braces together again; gives each statement once it is complete.
fn collect_use(pending: &mut String, part: &str) -> Option<Option<String>> {
    let begins = part.trim_start().starts_with("use ")
        || part.trim_start().starts_with("pub") && part.contains(" use ")
        || part.lines().any(|line| line.trim_start().starts_with("use ") || line.trim_start().starts_with("pub use "));
    if pending.is_empty() && !begins {
        return Some(None);
    }
    pending.push_str(part);
    Some(part.ends_with(';').then(|| std::mem::take(pending).split_whitespace().collect::<Vec<_>>().join(" ")))
}

/// Takes a tree such as `a::{b, c as d, e::*}` apart.
fn expand(before: &[String], tree: &str, is_public: bool, out: &mut Vec<Import>) {
    let tree = tree.trim();
    if let Some((head, group)) = tree.split_once('{') {
        let prefix = [before, &segments(head)].concat();
        let group = group.trim_end().strip_suffix('}').unwrap_or(group);
        for part in at_commas(group) {
            expand(&prefix, part, is_public, out);
        }
        return;
    }
    let (path, alias) =
        tree.split_once(" as ").map_or((tree, None), |(path, alias)| (path, Some(alias.trim().to_owned())));
    let mut path = [before, &segments(path)].concat();
    // `a::{self}` is `a`.
    if path.len() > 1 && path.last().is_some_and(|last| last == "self") {
        path.pop();
    }
    if let Some(last) = path.last().cloned() {
        out.push(Import { name: alias.unwrap_or(last), path, is_public });
    }
}

fn segments(path: &str) -> Vec<String> {
    path.split("::").map(|part| part.trim().to_owned()).filter(|part| !part.is_empty()).collect()
}

/// Splits at commas outside braces.
fn at_commas(text: &str) -> Vec<&str> {
    let (mut depth, mut start, mut parts) = (0, 0, Vec::new());
    for (k, c) in text.char_indices() {
        match c {
            '{' => depth += 1,
            '}' => depth -= 1,
            ',' if depth == 0 => {
                parts.push(&text[start..k]);
                start = k + 1;
            }
            _ => {}
        }
    }
    parts.push(&text[start..]);
    parts.into_iter().filter(|part| !part.trim().is_empty()).collect()
}

/// Paths in code outside `use` that begin with `crate` or `super`.
fn inline_paths(code: &str) -> Vec<Vec<String>> {
    let words = code.split(|c: char| !(c.is_alphanumeric() || c == '_' || c == ':'));
    let is_path = |word: &&str| word.starts_with("crate::") || word.starts_with("super::");
    words.filter(is_path).map(segments).filter(|path| path.len() > 1).collect()
}

#[test]
fn no_modules_import_one_another() {
    let circles: Vec<String> =
        members().flat_map(|(_, package)| Tree::new(&Path::new(&package.folder).join("src")).circles()).collect();
    nothing_offends("modules import one another in a circle", &circles);
}

#[test]
fn imports_are_taken_apart() {
    let code = "fn f() {}\npub use a::{b, c as d, e::{self, *}};\nuse super::x;\nmod y;\n";
    let found: Vec<(String, String, bool)> =
        imports(code).into_iter().map(|import| (import.name, import.path.join("::"), import.is_public)).collect();
    let expected = [
        ("b", "a::b", true),
        ("d", "a::c", true),
        ("e", "a::e", true),
        ("*", "a::e::*", true),
        ("x", "super::x", false),
    ];
    assert_eq!(found, expected.map(|(name, path, is_public)| (name.to_owned(), path.to_owned(), is_public)));
    assert_eq!(inline_paths("let a: crate::b::C = super::d();"), [vec!["crate", "b", "C"], vec!["super", "d"]]);
}
