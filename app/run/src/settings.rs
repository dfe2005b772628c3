//! Settings: a tree of defaults, changed by a TOML file and then by `key=value`.
//!
//! The keys are those that the defaults have, with dots between levels: `tracker.icp_weight`. So every setting has a default that TOML
//! can write; an `Option` that is `None` would have no key.

use std::path::{Path, PathBuf};

use serde::Serialize;
use serde::de::DeserializeOwned;
use toml::{Table, Value};

/// Why settings could not be had. Each is one line.
#[derive(Debug, thiserror::Error)]
pub enum SettingsError {
    /// The file could not be read.
    #[error("{}: {reason}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// Its reason.
        reason: std::io::Error,
    },
    /// The file is not TOML, or says something else than it should.
    #[error("{}: line {line}: {reason}", path.display())]
    Syntax {
        /// The file.
        path: PathBuf,
        /// Line, from 1.
        line: usize,
        /// What is wrong there.
        reason: String,
    },
    /// Not of the form key=value.
    #[error("--set {0}: give a key and a value, as in --set key=value")]
    NoValue(String),
    /// There is no such setting.
    #[error("{origin}: there is no setting {key}{}", nearest.as_ref().map(|near| format!("; did you mean {near}?")).unwrap_or_default())]
    UnknownKey {
        /// The file, or `--set`.
        origin: String,
        /// The key as given.
        key: String,
        /// The key that is most like it.
        nearest: Option<String>,
    },
    /// The setting is of another kind.
    #[error("{origin}: {key} wants {wanted}, not {given}")]
    WrongKind {
        /// The file, or `--set`.
        origin: String,
        /// The key.
        key: String,
        /// What it wants.
        wanted: String,
        /// What it was given.
        given: String,
    },
    /// The defaults cannot be written as TOML, or what was written cannot be read: a fault of the program's.
    #[error("the settings do not fit TOML: {0}")]
    Unfit(String),
}

/// The defaults of `T`, changed by a TOML file if one is given, then by texts of the form `key=value` in their order. A value is TOML
/// (`0.5`, `true`, `[1, 2]`, `"text"`); a text may do without quotation marks, and a whole number serves where a number is wanted.
///
/// # Errors
/// [`SettingsError`]: an unknown key names the nearest one, and a value of the wrong kind names the key and what it wants.
pub fn load<T: Serialize + DeserializeOwned + Default>(
    file: Option<&Path>,
    set: &[String],
) -> Result<T, SettingsError> {
    let mut settings = Settings::<T>::new()?;
    if let Some(path) = file {
        settings.merge(&path.display().to_string(), &mut Vec::new(), read::<Table>(path)?)?;
    }
    for assignment in set {
        let (key, value) = assignment
            .split_once('=')
            .map(|(key, value)| (key.trim(), value.trim()))
            .filter(|(key, value)| !key.is_empty() && !value.is_empty())
            .ok_or_else(|| SettingsError::NoValue(assignment.clone()))?;
        let path: Vec<String> = key.split('.').map(|part| part.trim().to_owned()).collect();
        let wants_text = matches!(lookup(&settings.table, &path), Some(Value::String(_)));
        settings.assign("--set", &path, value_of(value, wants_text))?;
    }
    settings.table.try_into().map_err(|error| SettingsError::Unfit(error.message().to_owned()))
}

/// What a TOML file says.
///
/// # Errors
/// [`SettingsError`] with the line, if the file cannot be read or says something else.
pub fn read<T: DeserializeOwned>(path: &Path) -> Result<T, SettingsError> {
    let text = std::fs::read_to_string(path).map_err(|reason| SettingsError::Io { path: path.into(), reason })?;
    toml::from_str(&text).map_err(|error| {
        let before = error.span().and_then(|span| text.get(..span.start)).unwrap_or_default();
        let line = before.matches('\n').count() + 1;
        let reason = error.message().replace('\n', "; ");
        SettingsError::Syntax { path: path.into(), line, reason }
    })
}

/// Settings as TOML that [`load`] reads as the same.
///
/// # Errors
/// [`SettingsError::Unfit`] if they cannot be written so.
pub fn to_toml<T: Serialize>(settings: &T) -> Result<String, SettingsError> {
    toml::to_string_pretty(settings).map_err(|error| SettingsError::Unfit(error.to_string()))
}

/// A value on the command line.
fn value_of(text: &str, wants_text: bool) -> Value {
    let parsed = format!("value = {text}").parse::<Table>().ok().filter(|table| table.len() == 1);
    match parsed.and_then(|mut table| table.remove("value")) {
        Some(value) if value.is_str() || !wants_text => value,
        _ => Value::String(text.to_owned()),
    }
}

/// The table that becomes a `T`.
struct Settings<T> {
    table: Table,
    target: std::marker::PhantomData<T>,
}

impl<T: Serialize + DeserializeOwned + Default> Settings<T> {
    fn new() -> Result<Self, SettingsError> {
        let table = Table::try_from(T::default()).map_err(|error| SettingsError::Unfit(error.to_string()))?;
        Ok(Self { table, target: std::marker::PhantomData })
    }

    /// Takes over every value of a table that lies at `path`.
    fn merge(&mut self, origin: &str, path: &mut Vec<String>, table: Table) -> Result<(), SettingsError> {
        for (key, value) in table {
            path.push(key);
            match value {
                Value::Table(inner) if matches!(lookup(&self.table, path), Some(Value::Table(_))) => {
                    self.merge(origin, path, inner)?;
                }
                value => self.assign(origin, path, value)?,
            }
            path.pop();
        }
        Ok(())
    }

    fn assign(&mut self, origin: &str, path: &[String], value: Value) -> Result<(), SettingsError> {
        let key = path.join(".");
        let Some(current) = lookup(&self.table, path) else {
            let nearest = nearest(&self.table, &key);
            return Err(SettingsError::UnknownKey { origin: origin.to_owned(), key, nearest });
        };
        let given = shortened(&value);
        let wrong = |wanted: String| SettingsError::WrongKind {
            origin: origin.to_owned(),
            key: key.clone(),
            wanted,
            given: given.clone(),
        };
        let value = fitted(current, value).ok_or_else(|| wrong(kind(current)))?;
        let mut changed = self.table.clone();
        if let Some(place) = lookup_mut(&mut changed, path) {
            *place = value;
        }
        // What the kind does not tell, such as the name of a variant or a sign, `T` knows. Tried value by value, its complaint can be
        // given the key.
        if let Err(error) = T::deserialize(changed.clone()) {
            return Err(wrong(error.message().replace('\n', "; ")));
        }
        self.table = changed;
        Ok(())
    }
}

fn lookup<'a>(table: &'a Table, path: &[String]) -> Option<&'a Value> {
    let (last, tables) = path.split_last()?;
    tables.iter().try_fold(table, |table, key| table.get(key)?.as_table())?.get(last)
}

fn lookup_mut<'a>(table: &'a mut Table, path: &[String]) -> Option<&'a mut Value> {
    let (last, tables) = path.split_last()?;
    tables.iter().try_fold(table, |table, key| table.get_mut(key)?.as_table_mut())?.get_mut(last)
}

/// The value, if it is of the kind of the current one.
fn fitted(current: &Value, value: Value) -> Option<Value> {
    match (current, value) {
        (Value::Float(_), Value::Integer(x)) => Some(Value::Float(x as f64)),
        (Value::Float(_), Value::Float(x)) => x.is_finite().then_some(Value::Float(x)),
        (Value::Array(list), Value::Array(values)) => match list.first() {
            Some(first) => {
                values.into_iter().map(|value| fitted(first, value)).collect::<Option<_>>().map(Value::Array)
            }
            None => Some(Value::Array(values)),
        },
        // Only whole tables of defaults are known; their values are set one by one.
        (Value::Table(_), _) => None,
        (current, value) => current.same_type(&value).then_some(value),
    }
}

/// What a setting wants, in words.
fn kind(current: &Value) -> String {
    match current {
        Value::String(_) => "a text".to_owned(),
        Value::Integer(_) => "a whole number".to_owned(),
        Value::Float(_) => "a finite number".to_owned(),
        Value::Boolean(_) => "true or false".to_owned(),
        Value::Datetime(_) => "a date".to_owned(),
        Value::Array(_) => format!("a list such as {current}"),
        Value::Table(table) => {
            format!("one of its own keys ({})", table.keys().cloned().collect::<Vec<_>>().join(", "))
        }
    }
}

fn shortened(value: &Value) -> String {
    let text = value.to_string().replace('\n', " ");
    if text.chars().count() > 60 { text.chars().take(57).chain("...".chars()).collect() } else { text }
}

/// The key that is most like another, whole or without the names before it.
fn nearest(table: &Table, key: &str) -> Option<String> {
    let distance = |known: &str| {
        let last = known.rsplit('.').next().unwrap_or(known);
        strsim::damerau_levenshtein(known, key).min(strsim::damerau_levenshtein(last, key))
    };
    let mut keys = Vec::new();
    collect(table, "", &mut keys);
    // Something wholly different is no help.
    keys.into_iter()
        .map(|known| (distance(&known), known))
        .filter(|(d, _)| 2 * d <= key.len())
        .min()
        .map(|(_, key)| key)
}

fn collect(table: &Table, prefix: &str, keys: &mut Vec<String>) {
    for (name, value) in table {
        let key = format!("{prefix}{name}");
        match value {
            Value::Table(inner) => collect(inner, &format!("{key}."), keys),
            _ => keys.push(key),
        }
    }
}

#[cfg(test)]
mod tests {
    use serde::Deserialize;

    use super::*;

    #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
    #[serde(default)]
    struct Run {
        name: String,
        threads: u32,
        tracker: Tracker,
    }

    #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
    #[serde(default)]
    struct Tracker {
        icp_weight: f64,
        sdf_weight: f32,
        factors: Vec<f64>,
        enabled: bool,
        start: Start,
    }

    #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
    #[serde(rename_all = "lowercase")]
    enum Start {
        Truth,
        Disturbed,
    }

    impl Default for Run {
        fn default() -> Self {
            Self { name: "run".into(), threads: 2, tracker: Tracker::default() }
        }
    }

    impl Default for Tracker {
        fn default() -> Self {
            let factors = vec![1.0, 2.0];
            Self { icp_weight: 1.0, sdf_weight: 0.1, factors, enabled: true, start: Start::Disturbed }
        }
    }

    fn set(assignments: &[&str]) -> Result<Run, SettingsError> {
        load(None, &assignments.iter().map(|&s| s.to_owned()).collect::<Vec<_>>())
    }

    fn file(text: &str) -> Result<Run, SettingsError> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("config.toml");
        std::fs::write(&path, text).unwrap();
        load(Some(&path), &["threads=7".to_owned()])
    }

    #[test]
    fn defaults_file_and_assignments_in_this_order() {
        assert_eq!(set(&[]).unwrap(), Run::default());
        let run = file("threads = 3\n[tracker]\nicp_weight = 4\nfactors = [3]\n").unwrap();
        assert_eq!((run.threads, run.tracker.icp_weight, run.tracker.factors), (7, 4.0, vec![3.0]));
        let run = set(&[
            "tracker.icp_weight=0.25",
            " tracker.factors = [1, 2.5] ",
            "name=12",
            "tracker.start=truth",
            "tracker.enabled=false",
            "threads=1",
            "threads=4",
        ])
        .unwrap();
        let tracker = Tracker {
            icp_weight: 0.25,
            factors: vec![1.0, 2.5],
            enabled: false,
            start: Start::Truth,
            ..Tracker::default()
        };
        assert_eq!(run, Run { name: "12".into(), threads: 4, tracker });
        assert_eq!(set(&["name=\"a = b\""]).unwrap().name, "a = b");
    }

    #[test]
    fn what_is_written_is_read_as_the_same() {
        let run = set(&["tracker.icp_weight=0.1", "name=a \"b\" = [c]", "tracker.sdf_weight=0.3"]).unwrap();
        let text = to_toml(&run).unwrap();
        let again: Run = {
            let folder = tempfile::tempdir().unwrap();
            let path = folder.path().join("config.toml");
            std::fs::write(&path, &text).unwrap();
            load(Some(&path), &[]).unwrap()
        };
        assert_eq!(again, run, "{text}");
        assert!(text.contains("sdf_weight = 0.3\n"), "{text}");
    }

    #[test]
    fn mistakes_are_named_in_one_line() {
        for (assignment, expected) in [
            ("threads", "--set threads: give a key and a value"),
            ("=3", "--set =3: give a key and a value"),
            ("thraeds=3", "there is no setting thraeds; did you mean threads?"),
            ("icp_wieght=3", "there is no setting icp_wieght; did you mean tracker.icp_weight?"),
            ("traker.icp_weight=3", "did you mean tracker.icp_weight?"),
            ("threads.x=3", "there is no setting threads.x"),
            ("zzzzzzzzzzzz=3", "there is no setting zzzzzzzzzzzz"),
            ("tracker=3", "tracker wants one of its own keys (enabled, factors, icp_weight, sdf_weight, start), not 3"),
            ("tracker.icp_weight=heavy", "tracker.icp_weight wants a finite number, not \"heavy\""),
            ("tracker.icp_weight=nan", "tracker.icp_weight wants a finite number, not nan"),
            ("tracker.enabled=1", "tracker.enabled wants true or false, not 1"),
            ("threads=1.5", "threads wants a whole number, not 1.5"),
            ("threads=-1", "--set: threads wants"),
            ("tracker.factors=[\"a\"]", "tracker.factors wants a list such as [1.0, 2.0], not [\"a\"]"),
            ("tracker.start=midway", "tracker.start wants"),
            ("threads=3\nname=\"x\"", "threads wants a whole number"),
        ] {
            let error = set(&[assignment]).unwrap_err().to_string();
            assert!(error.contains(expected) && !error.contains('\n'), "{error}");
        }
        assert!(!set(&["zzzzzzzzzzzz=3"]).unwrap_err().to_string().contains("did you mean"));
        let variant = set(&["tracker.start=midway"]).unwrap_err().to_string();
        assert!(variant.contains("truth") && variant.contains("disturbed"), "{variant}");

        for (text, expected) in [
            ("threads = 3\nx = = 4\n", "config.toml: line 2: "),
            (
                "threads = 3\n[tracker]\nicp_weigth = 4\n",
                "there is no setting tracker.icp_weigth; did you mean tracker.icp_weight?",
            ),
            ("tracker = 4\n", "tracker wants one of its own keys"),
            ("[threads]\nx = 1\n", "threads wants a whole number"),
        ] {
            let error = file(text).unwrap_err().to_string();
            assert!(error.contains(expected) && error.contains("config.toml") && !error.contains('\n'), "{error}");
        }
        let missing = load::<Run>(Some(Path::new("nowhere.toml")), &[]).unwrap_err().to_string();
        assert!(missing.starts_with("nowhere.toml: "), "{missing}");
    }

    proptest::proptest! {
        #[test]
        fn no_assignment_panics(text in "[a-z.=\\[\\]\"0-9\n-]{0,24}") {
            let _ = set(&[&text, &format!("name={text}"), &format!("tracker.factors={text}")]);
            let _ = file(&text);
        }
    }
}
