//! Files whose names differ in one part.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use crate::error::RgbdError;

/// The part in which names differ. Numbers come in their order, other texts after them.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct FrameName {
    /// 0 before 1: whether it is a number.
    rank: u8,
    number: u128,
    pub text: String,
}

impl FrameName {
    pub fn new(text: &str) -> Self {
        // The last run of digits: `frame-000190` and `000190` are one.
        let end = text.rfind(|c: char| c.is_ascii_digit()).map_or(0, |at| at + 1);
        let begin = text[..end].rfind(|c: char| !c.is_ascii_digit()).map_or(0, |at| at + 1);
        let number = text[begin..end].parse().ok();
        Self { rank: u8::from(number.is_none()), number: number.unwrap_or(0), text: text.to_owned() }
    }

    /// Returns the number, if it is one.
    pub fn number(&self) -> Option<u128> {
        (self.rank == 0).then_some(self.number)
    }
}

/// Files by the part in which their names differ.
pub(crate) type NamedFiles = BTreeMap<FrameName, PathBuf>;

/// Returns the files below `root` that fit a pattern with one `*` in its last part, such as `data/*-color.png`.
pub(crate) fn matching(root: &Path, pattern: &str) -> Result<NamedFiles, RgbdError> {
    let (folder, name) = pattern.rsplit_once('/').unwrap_or(("", pattern));
    let parts: Vec<&str> = name.split('*').collect();
    let [before, after] = parts[..] else {
        return Err(RgbdError::fault(
            root,
            format!("the pattern {pattern:?} must have one * in the name of its files"),
        ));
    };
    let part = |name: &str| Some(name.strip_prefix(before)?.strip_suffix(after)?.to_owned());
    collect(&root.join(folder), part)
}

/// Returns the files of a folder with one of these endings, by their names without it; none if there is no such folder.
pub(crate) fn in_folder(folder: &Path, endings: &[&str]) -> Result<NamedFiles, RgbdError> {
    let part = |name: &str| {
        let (stem, ending) = name.rsplit_once('.')?;
        endings.iter().any(|known| known.eq_ignore_ascii_case(ending)).then(|| stem.to_owned())
    };
    if folder.is_dir() { collect(folder, part) } else { Ok(NamedFiles::new()) }
}

fn collect(folder: &Path, part: impl Fn(&str) -> Option<String>) -> Result<NamedFiles, RgbdError> {
    let mut files = NamedFiles::new();
    for entry in fs::read_dir(folder).map_err(RgbdError::io(folder))? {
        let name = entry.map_err(RgbdError::io(folder))?.file_name();
        if mvt_files::input::is_litter(&name) {
            continue;
        }
        if let Some(part) = name.to_str().and_then(&part) {
            files.insert(FrameName::new(&part), folder.join(&name));
        }
    }
    Ok(files)
}

/// Pairs files of two kinds: by their names, or by their order if no name is common and there are as many of both.
pub(crate) fn paired<'a>(names: &[FrameName], files: &'a NamedFiles) -> Vec<Option<&'a PathBuf>> {
    let by_name: Vec<Option<&PathBuf>> = names
        .iter()
        .map(|name| {
            files.get(name).or_else(|| files.iter().find(|(other, _)| alike(name, other)).map(|(_, path)| path))
        })
        .collect();
    if by_name.iter().all(Option::is_none) && names.len() == files.len() {
        return files.values().map(Some).collect();
    }
    by_name
}

fn alike(a: &FrameName, b: &FrameName) -> bool {
    a.number().is_some() && a.number() == b.number()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_ordered_by_their_numbers() {
        let mut names = ["10", "9", "frame-000008", "b", "1581120424100262102"].map(FrameName::new);
        names.sort();
        assert_eq!(names.map(|name| name.text), ["frame-000008", "9", "10", "1581120424100262102", "b"]);
    }

    #[test]
    fn patterns_have_one_star() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["000001-color.png", "000001-depth.png", "000002-color.png", ".DS_Store", "._000001-color.png"] {
            fs::write(folder.path().join(name), "").unwrap();
        }
        let found = matching(folder.path(), "*-color.png").unwrap();
        assert_eq!(found.keys().map(FrameName::number).collect::<Vec<_>>(), [Some(1), Some(2)]);
        for wrong in ["*-*.png", "color.png"] {
            assert!(matching(folder.path(), wrong).unwrap_err().to_string().contains("one *"));
        }
        assert!(matching(folder.path(), "no/*.png").unwrap_err().to_string().contains("no"));
    }

    #[test]
    fn files_are_paired_by_name_or_number_or_order() {
        let names = ["000001", "000002"].map(FrameName::new);
        let files = |names: &[&str]| names.iter().map(|name| (FrameName::new(name), PathBuf::from(name))).collect();
        let found =
            |files: &NamedFiles| paired(&names, files).into_iter().map(Option::<&PathBuf>::cloned).collect::<Vec<_>>();
        assert_eq!(found(&files(&["1", "2"])), [Some("1".into()), Some("2".into())]);
        assert_eq!(found(&files(&["000002"])), [None, Some("000002".into())]);
        assert_eq!(found(&files(&["7", "8"])), [Some("7".into()), Some("8".into())]);
        assert_eq!(found(&files(&["7"])), [None, None]);
    }
}
