//! Pages: their links lead somewhere, the front page stays short, the index names every page, and sources link to the decisions.

use std::collections::BTreeSet;
use std::path::{Component, Path, PathBuf};

use crate::nothing_offends;
use crate::sources::{files, read, root};

/// Most words of README.md: one look.
const WORDS: usize = 900;
/// Fewest links of README.md to other projects.
const OUTSIDE: usize = 8;
/// Decisions about the layout, which act in no single place.
const OF_THE_LAYOUT: [&str; 4] = ["crates.md", "deliberately_absent.md", "files.md", "limits_of_the_scores.md"];

fn pages() -> impl Iterator<Item = PathBuf> {
    files().into_iter().filter(|file| file.extension().is_some_and(|ending| ending == "md"))
}

/// Targets of the links on a page, outside of code.
fn links(text: &str) -> Vec<&str> {
    let prose = text.split("```").step_by(2);
    let targets = prose.flat_map(|part| part.split("](").skip(1).filter_map(|rest| rest.split_once(')')));
    targets.map(|(target, _)| target).collect()
}

/// The anchor by which GitHub knows a heading.
fn anchor(heading: &str) -> String {
    let kept = heading.trim().chars().filter(|c| c.is_alphanumeric() || matches!(c, ' ' | '-' | '_'));
    kept.map(|c| if c == ' ' { '-' } else { c.to_ascii_lowercase() }).collect()
}

fn has_anchor(page: &Path, wanted: &str) -> bool {
    read(page).lines().filter(|line| line.starts_with('#')).any(|line| anchor(line.trim_start_matches('#')) == wanted)
}

/// A path without `..`.
fn plain(path: &Path) -> PathBuf {
    let mut plain = PathBuf::new();
    for part in path.components() {
        match part {
            Component::ParentDir => drop(plain.pop()),
            part => plain.push(part),
        }
    }
    plain
}

#[test]
fn links_lead_to_files_and_headings() {
    let mut offenders = Vec::new();
    for page in pages() {
        let text = read(&page);
        for link in links(&text).into_iter().filter(|link| !link.contains("://")) {
            let (file, heading) = link.split_once('#').map_or((link, None), |(file, heading)| (file, Some(heading)));
            let target = if file.is_empty() { page.clone() } else { plain(&page.with_file_name("").join(file)) };
            let leads = root().join(&target).exists() && heading.is_none_or(|heading| has_anchor(&target, heading));
            if !leads {
                offenders.push(format!("{}: {link}", page.display()));
            }
        }
    }
    nothing_offends("these links lead nowhere", &offenders);
}

#[test]
fn the_front_page_is_short_and_leads_on() {
    let text = read(Path::new("README.md"));
    let words = text.split_whitespace().count();
    assert!(words <= WORDS, "README.md has {words} words, more than {WORDS}: move some to docs/");
    let outside = links(&text).iter().filter(|link| link.starts_with("https://")).count();
    assert!(outside >= OUTSIDE, "README.md has {outside} links to other projects");
}

#[test]
fn the_index_names_every_page() {
    let index = read(Path::new("docs/README.md"));
    let links = links(&index);
    let missing = pages().filter(|page| page.parent() == Some(Path::new("docs")) && !page.ends_with("README.md"));
    let missing: Vec<String> = missing
        .map(|page| page.file_name().unwrap().to_string_lossy().into_owned())
        .filter(|name| !links.contains(&name.as_str()))
        .collect();
    nothing_offends("docs/README.md does not lead to these pages", &missing);
}

/// A link is a comment of its own, such as `Why: notes/decisions/touch.md, "One matrix product".`
#[test]
fn decisions_are_linked_from_where_they_act() {
    let (mut known, mut unlinked) = (BTreeSet::new(), BTreeSet::new());
    for page in pages().filter(|page| page.starts_with("notes/decisions")) {
        for heading in read(&page).lines().filter_map(|line| line.strip_prefix("## ")) {
            let link = format!("{}, \"{heading}\".", page.display());
            if !OF_THE_LAYOUT.iter().any(|name| page.ends_with(name)) {
                unlinked.insert(link.clone());
            }
            known.insert(link);
        }
    }
    let mut offenders = Vec::new();
    let ends = |file: &Path| file.extension().is_some_and(|end| ["py", "rs", "sh", "toml"].iter().any(|e| end == *e));
    // The names of CI's scripts have no ending.
    for file in files().into_iter().filter(|file| ends(file) || file.starts_with(".ci")) {
        let text = read(&file);
        let reasons = text.lines().filter_map(|line| line.split_once("/ Why: ").or_else(|| line.split_once("# Why: ")));
        for (_, link) in reasons.filter(|(_, link)| link.starts_with("notes/decisions/")) {
            unlinked.remove(link);
            if !known.contains(link) {
                offenders.push(format!("{}: {link}", file.display()));
            }
        }
    }
    nothing_offends("these links lead to no decision", &offenders);
    nothing_offends("no source links to these decisions", &unlinked.into_iter().collect::<Vec<_>>());
}
