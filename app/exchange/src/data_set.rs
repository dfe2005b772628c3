//! Description of a data set of LeRobot: its columns, and where the rows of an episode are.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use serde::de::{Deserialize, Deserializer, MapAccess, Visitor};
use serde_json::Value;

use crate::error::Defect;
use crate::mapping::Mapping;
use crate::table::{Cell, read_rows};

/// Greatest size of a file that describes the data, bytes.
pub(crate) const LARGEST: u64 = 256 << 20;
/// Files of a kind, at most.
const MOST_FILES: usize = 100_000;

/// Description of a data set.
pub(crate) struct DataSet {
    folder: PathBuf,
    info: Value,
    /// Names of the numbers of each column.
    names: HashMap<String, Names>,
    pub fps: f64,
}

/// Names of the numbers of a column: a list, or lists under names of their own, whose order is that of the file.
#[derive(Debug, serde::Deserialize)]
#[serde(untagged)]
enum Names {
    List(Vec<String>),
    Groups(Groups),
    None(serde::de::IgnoredAny),
}

impl Names {
    fn groups(&self) -> Vec<(String, Vec<String>)> {
        match self {
            Self::List(names) => vec![(String::new(), names.clone())],
            Self::Groups(Groups(groups)) => groups.clone(),
            Self::None(_) => Vec::new(),
        }
    }
}

/// Lists under names, in the order of the file.
#[derive(Debug)]
struct Groups(Vec<(String, Vec<String>)>);

impl<'de> Deserialize<'de> for Groups {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Entries;
        impl<'de> Visitor<'de> for Entries {
            type Value = Groups;
            fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                f.write_str("lists of names")
            }
            fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Groups, A::Error> {
                let mut groups = Vec::new();
                while let Some(entry) = map.next_entry()? {
                    groups.push(entry);
                }
                Ok(Groups(groups))
            }
        }
        deserializer.deserialize_map(Entries)
    }
}

/// The names in meta/info.json.
#[derive(Debug, serde::Deserialize)]
struct NamedColumns {
    features: HashMap<String, NamedColumn>,
}

#[derive(Debug, serde::Deserialize)]
struct NamedColumn {
    names: Option<Names>,
}

/// Where the rows of an episode are.
pub(crate) struct EpisodePlace {
    pub file: PathBuf,
    pub length: usize,
}

impl DataSet {
    pub fn open(folder: &Path) -> Result<Self, Defect> {
        let text = mvt_files::input::read_text(&folder.join("meta/info.json"), LARGEST).map_err(|error| {
            format!("meta/info.json cannot be read: {error}; give the folder of a data set of LeRobot")
        })?;
        let info: Value = serde_json::from_str(&text).map_err(|error| format!("meta/info.json is invalid: {error}"))?;
        let version = info.get("codebase_version").and_then(Value::as_str).unwrap_or("unknown");
        if !version.starts_with("v3.") {
            return Err(format!("its version is {version}; convert it to v3.0 with LeRobot first").into());
        }
        let fps = info.get("fps").and_then(Value::as_f64).filter(|fps| (1e-3..=1e5).contains(fps));
        let fps = fps.ok_or_else(|| "meta/info.json states no valid fps".to_owned())?;
        let names = serde_json::from_str::<NamedColumns>(&text).map(|named| named.features).unwrap_or_default();
        let names = names.into_iter().filter_map(|(column, named)| Some((column, named.names?))).collect();
        Ok(Self { folder: folder.to_path_buf(), info, names, fps })
    }

    /// Finds an episode in the tables of episodes.
    pub fn place(&self, episode: usize) -> Result<EpisodePlace, Defect> {
        let columns = ["episode_index", "data/chunk_index", "data/file_index", "length"];
        let mut found = None;
        let mut episodes = 0;
        for path in files(&self.folder.join("meta/episodes")) {
            read_rows(&path, &columns, &mut |cells| -> Result<bool, Defect> {
                let numbers: Option<Vec<usize>> = cells.iter().map(|cell| whole(cell.as_ref())).collect();
                let Some([number, chunk, file, length]) = numbers.as_deref() else {
                    return Err(format!("{}: a row lacks one of {}", path.display(), columns.join(", ")).into());
                };
                episodes += 1;
                if *number == episode {
                    found = Some([*chunk, *file, *length]);
                }
                Ok(found.is_none())
            })?;
            if found.is_some() {
                break;
            }
        }
        let Some([chunk, file, length]) = found else {
            return Err(format!("it has {episodes} episodes, and none has the number {episode}").into());
        };
        let pattern = self.info.get("data_path").and_then(Value::as_str);
        let pattern = pattern.unwrap_or("data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet");
        let name = pattern
            .replace("{chunk_index:03d}", &format!("{chunk:03}"))
            .replace("{file_index:03d}", &format!("{file:03}"));
        if name.contains(['{', '\\']) || name.starts_with('/') || name.split('/').any(|part| part == "..") {
            return Err(format!("meta/info.json has the data_path {pattern:?}, which is not that of v3.0").into());
        }
        Ok(EpisodePlace { file: self.folder.join(name), length })
    }

    /// Returns the numbers in a row of angles, and the place of each of the mapping's joints among them.
    pub fn order(&self, mapping: &Mapping, notes: &mut Vec<String>) -> Result<(usize, Vec<usize>), String> {
        let column = &mapping.hand.joints;
        let feature = self.feature(column)?;
        let width = feature.get("shape").and_then(|shape| shape.get(0)).and_then(Value::as_u64);
        let width = width.ok_or_else(|| format!("{column} has no shape in meta/info.json"))? as usize;
        let wanted = mapping.hand.names();
        let groups = self.names.get(column).map(Names::groups).unwrap_or_default();
        if groups.is_empty() {
            let places: Option<Vec<usize>> = wanted.iter().map(|name| name.parse().ok()).collect();
            return match places.filter(|places| places.iter().all(|place| *place < width)) {
                Some(places) => Ok((width, places)),
                None if width == wanted.len() => {
                    notes.push(format!(
                        "{column} has no names: its {width} numbers are taken in the order of hand.names"
                    ));
                    Ok((width, (0..width).collect()))
                }
                None => Err(format!(
                    "{column} has {width} numbers without names; give their places in hand.names, such as \"7\""
                )),
            };
        }
        let count: usize = groups.iter().map(|(_, names)| names.len()).sum();
        let fitting: Vec<_> = groups.iter().filter(|(_, names)| names.len() == width).collect();
        // The names of an axis may stand in a group of its own beside others.
        let groups = match fitting.as_slice() {
            _ if count == width => groups.iter().collect(),
            [one] => vec![*one],
            _ => return Err(format!("{column} has {count} names for {width} numbers in meta/info.json")),
        };
        let names: Vec<(String, &str)> = groups
            .iter()
            .flat_map(|(group, names)| names.iter().map(move |name| (format!("{group}/{name}"), name.as_str())))
            .collect();
        let mut order = Vec::new();
        for name in wanted {
            let places = names.iter().enumerate().filter(|(_, (full, short))| full == name || short == name);
            let places: Vec<usize> = places.map(|(place, _)| place).collect();
            match places[..] {
                [place] => order.push(place),
                [] => {
                    let known: Vec<&str> = names.iter().map(|(_, short)| *short).take(20).collect();
                    let known = known.join(", ");
                    return Err(format!(
                        "{column} has no joint {name:?} among {known}; give hand.names in the mapping"
                    ));
                }
                _ => return Err(format!("{column} has several joints {name:?}; give hand.names as GROUP/NAME")),
            }
        }
        Ok((width, order))
    }

    pub fn feature(&self, column: &str) -> Result<&Value, String> {
        let features = self.info.get("features").and_then(Value::as_object);
        let known =
            || features.map(|all| all.keys().take(40).cloned().collect::<Vec<_>>().join(", ")).unwrap_or_default();
        let feature = features
            .and_then(|all| all.get(column))
            .ok_or_else(|| format!("it has no column {column:?}; its columns are {}", known()))?;
        if feature.get("dtype").and_then(Value::as_str) == Some("video") {
            return Err(format!(
                "{column} is a video, which cannot be imported; convert it to images with LeRobot first"
            ));
        }
        Ok(feature)
    }
}

/// Returns the Parquet files below a folder with folders, in the order of their names.
fn files(folder: &Path) -> Vec<PathBuf> {
    let list = |folder: &Path| {
        let mut all: Vec<PathBuf> = std::fs::read_dir(folder)
            .into_iter()
            .flatten()
            .filter_map(|entry| Some(entry.ok()?.path()))
            .take(MOST_FILES)
            .collect();
        all.sort();
        all
    };
    let is_table = |path: &PathBuf| path.extension().is_some_and(|end| end == "parquet");
    list(folder).iter().flat_map(|chunk| list(chunk)).filter(is_table).collect()
}

pub(crate) fn number_of(cell: &Cell) -> Option<f64> {
    match cell {
        Cell::Number(number) => Some(*number),
        Cell::Numbers(numbers) => numbers.first().copied().filter(|_| numbers.len() == 1),
        Cell::Bytes(_) => None,
    }
}

pub(crate) fn whole(cell: Option<&Cell>) -> Option<usize> {
    number_of(cell?).filter(|number| (0.0..1e15).contains(number)).map(|number| number as usize)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the places of joints j0 to j15 by names of a column of so many numbers, and the number of notes.
    fn order(width: usize, names: &str, wanted: &str) -> Result<(Vec<usize>, usize), String> {
        let folder = tempfile::tempdir().unwrap();
        let info = format!(
            "{{\"codebase_version\": \"v3.0\", \"fps\": 30, \"features\": {{\"state\": {{\"shape\": [{width}], \"names\": {names}}}}}}}"
        );
        std::fs::create_dir(folder.path().join("meta")).unwrap();
        std::fs::write(folder.path().join("meta/info.json"), info).unwrap();
        let set = DataSet::open(folder.path()).unwrap();
        let wanted: Vec<String> = (0..16).map(|k| format!("\"{}\"", wanted.replace('K', &k.to_string()))).collect();
        let mapping = format!("[hand]\njoints = \"state\"\nnames = [{}]\n", wanted.join(", "));
        let mut notes = Vec::new();
        let (found, order) = set.order(&Mapping::parse(&mapping).unwrap(), &mut notes)?;
        assert_eq!(found, width);
        Ok((order, notes.len()))
    }

    #[test]
    fn joints_are_found_by_name_in_all_groups_or_by_place() {
        let list = |names: &mut dyn Iterator<Item = usize>| {
            let names: Vec<String> = names.map(|k| format!("\"j{k}\"")).collect();
            format!("[{}]", names.join(", "))
        };
        let (hand, reversed) = (list(&mut (0..16)), list(&mut (0..16).rev()));
        let from = |first: usize| Ok(((first..first + 16).collect::<Vec<_>>(), 0));
        assert_eq!(order(16, &hand, "jK"), from(0));
        assert_eq!(order(16, &reversed, "jK"), Ok(((0..16).rev().collect(), 0)));
        // The order of groups is that of the file and not of the alphabet.
        let groups = format!("{{\"z_arm\": [\"a\", \"b\"], \"hand\": {hand}}}");
        assert_eq!(order(18, &groups, "jK"), from(2));
        assert_eq!(order(16, &groups, "jK"), from(0), "the only group of this length");
        let two = format!("{{\"left\": {hand}, \"right\": {hand}}}");
        assert!(order(32, &two, "jK").unwrap_err().contains("several joints \"j0\""));
        assert_eq!(order(32, &two, "right/jK"), from(16));
        assert_eq!(order(16, "null", "jK"), Ok(((0..16).collect(), 1)));
        assert_eq!(order(23, "null", "K"), Ok(((0..16).collect(), 0)));
        assert!(order(23, "null", "jK").unwrap_err().contains("23 numbers without names"));
        assert!(order(18, &hand, "jK").unwrap_err().contains("16 names for 18 numbers"));
        assert!(order(16, &hand, "xK").unwrap_err().contains("no joint \"x0\" among j0, j1"));
    }
}
