//! Settings files and `--set`: defaults, changed by a TOML file and then by texts of the form `key=value`.
//!
//! Valid keys are those of [`SettingGroup::listing`], with dots between levels: `slam.tracker.icp_weight`. Keys of version 0.1.0 that have
//! new names are still read.

use std::path::{Path, PathBuf};

use mvt_files::input;
use mvt_settings::{SettingError, SettingGroup, SettingInfo};
use serde::Serialize;
use serde::de::DeserializeOwned;
use toml::{Table, Value};

/// Largest settings file that is read, bytes.
const LARGEST_FILE: u64 = 1 << 20;
/// Keys of version 0.1.0, each with the keys that hold its numbers now and how the numbers become theirs. Frames came at 30 Hz then.
const RENAMED: [(&str, &[(&str, Conversion)]); 10] = [
    ("slam.tracker.velocity_kept", &[("slam.tracker.velocity_memory_s", Some(|kept| -PERIOD_S / kept.ln()))]),
    (
        "slam.tracker.velocity_sigma",
        &[
            ("slam.tracker.velocity_sigma_m_s", Some(velocity_of_change)),
            ("slam.tracker.velocity_sigma_rad_s", Some(velocity_of_change)),
        ],
    ),
    (
        "slam.tracker.slip_sigma_m",
        &[
            ("slam.tracker.slip_still_1s_sigma_m", Some(|slip_m| slip_m / PERIOD_S.sqrt())),
            ("slam.tracker.slip_changing_sigma_m", None),
        ],
    ),
    ("slam.map.steps", &[("slam.map.steps_per_s", Some(per_second))]),
    ("slam.map.refined", &[("slam.map.refined_per_s", Some(per_second))]),
    ("slam.map.refine_sigma", &[("slam.map.refine_sigma_m", None), ("slam.map.refine_sigma_rad", None)]),
    (
        "slam.trust.surprise",
        &[("slam.trust.surprise_m_s", Some(per_second)), ("slam.trust.surprise_rad_s", Some(per_second))],
    ),
    ("slam.trust.lost_after", &[("slam.trust.lost_after_s", Some(|frames| 0.03 * (frames - 1.0)))]),
    ("slam.trust.search_every", &[("slam.trust.search_interval_s", Some(|frames| 0.03 * frames))]),
    ("supervisor.drift_m", &[("supervisor.drift_begin_m", None), ("supervisor.drift_end_m", None)]),
];

/// How a number of version 0.1.0 becomes one of now; `None` if it stays.
type Conversion = Option<fn(f64) -> f64>;

/// Time between two frames of version 0.1.0, seconds.
const PERIOD_S: f64 = 1.0 / 30.0;

fn per_second(per_frame: f64) -> f64 {
    per_frame / PERIOD_S
}

/// The velocity of which a change per frame is that of version 0.1.0, which kept 0.6 of it.
fn velocity_of_change(per_frame: f64) -> f64 {
    per_second(per_frame) / 0.8
}

/// Rounds to four digits: what a conversion gives is not exact.
fn converted(value: Value, conversion: Conversion) -> Value {
    let number = value.as_float().or_else(|| value.as_integer().map(|whole| whole as f64));
    match (number, conversion) {
        (Some(number), Some(convert)) => Value::Float(format!("{:.3e}", convert(number)).parse().unwrap_or(number)),
        _ => value,
    }
}

/// Settings that cannot be read. Each message is one line.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum LoadSettingsError {
    /// The file cannot be read.
    #[error("{}: {reason}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The reason.
        reason: std::io::Error,
    },
    /// The file is not valid TOML.
    #[error("{}: line {line}: {reason}", path.display())]
    Syntax {
        /// The file.
        path: PathBuf,
        /// Line, from 1.
        line: usize,
        /// The reason.
        reason: String,
    },
    /// A text is not of the form key=value.
    #[error("--set {0}: give a key and a value, as in --set key=value")]
    NoValue(String),
    /// There is no such setting.
    #[error("{origin}: there is no setting {key}{}", nearest.as_ref().map(|near| format!("; did you mean {near}?")).unwrap_or_default())]
    UnknownKey {
        /// The file, or `--set`.
        origin: String,
        /// The given key.
        key: String,
        /// The most similar key.
        nearest: Option<String>,
    },
    /// The value is of another kind than the setting.
    #[error("{origin}: {key} must be {wanted}, not {given}")]
    WrongKind {
        /// The file, or `--set`.
        origin: String,
        /// The key.
        key: String,
        /// Kind and range of the setting.
        wanted: String,
        /// The given value.
        given: String,
    },
    /// A setting is out of range.
    #[error("settings: {0}")]
    Range(#[from] SettingError),
    /// The defaults cannot be written as TOML, which is a bug.
    #[error("the settings do not fit TOML: {0}")]
    Unfit(String),
}

/// Returns the settings `base`, changed by a TOML file if one is given, then by texts of the form `key=value` in their order.
///
/// A value is TOML (`0.5`, `true`, `[1, 2]`, `"text"`). Texts need no quotation marks, and a whole number is accepted as any number.
pub(crate) fn load<T>(base: T, file: Option<&Path>, set: &[String]) -> Result<T, LoadSettingsError>
where
    T: SettingGroup + Serialize + DeserializeOwned,
{
    let unfit = |error: String| LoadSettingsError::Unfit(error);
    let mut table = Table::try_from(base).map_err(|error| unfit(error.to_string()))?;
    let listing = T::listing();
    if let Some(path) = file {
        let origin = path.display().to_string();
        for (key, value) in leaves("", read::<Table>(path)?, &listing) {
            table = assigned::<T>(table, &listing, &origin, &key, value)?;
        }
    }
    for assignment in set {
        let (key, value) = assignment
            .split_once('=')
            .map(|(key, value)| (key.split('.').map(str::trim).collect::<Vec<_>>().join("."), value.trim()))
            .filter(|(key, value)| !key.is_empty() && !value.is_empty())
            .ok_or_else(|| LoadSettingsError::NoValue(assignment.clone()))?;
        let wants_text = matches!(lookup(&mut table, &key), Some(Value::String(_)));
        table = assigned::<T>(table, &listing, "--set", &key, value_of(value, wants_text))?;
    }
    let settings: T = table.try_into().map_err(|error: toml::de::Error| unfit(error.message().to_owned()))?;
    settings.validate()?;
    Ok(settings)
}

/// Reads a TOML file.
///
/// # Errors
/// [`LoadSettingsError`] with the line if the file cannot be read or is invalid.
pub fn read<T: DeserializeOwned>(path: &Path) -> Result<T, LoadSettingsError> {
    let text =
        input::read_text(path, LARGEST_FILE).map_err(|reason| LoadSettingsError::Io { path: path.into(), reason })?;
    toml::from_str(&text).map_err(|error| {
        let before = error.span().and_then(|span| text.get(..span.start)).unwrap_or_default();
        let line = before.matches('\n').count() + 1;
        let reason = error.message().replace('\n', "; ");
        LoadSettingsError::Syntax { path: path.into(), line, reason }
    })
}

/// Returns settings as TOML that [`load`] reads back, with documentation, range and default of each as comments.
pub(crate) fn to_toml<T: SettingGroup + Serialize>(settings: &T) -> Result<String, LoadSettingsError> {
    let listing = T::listing();
    let plain = toml::to_string_pretty(settings).map_err(|error| LoadSettingsError::Unfit(error.to_string()))?;
    let (mut text, mut table) = (String::new(), String::new());
    for line in plain.lines() {
        if let Some(name) = line.strip_prefix('[').and_then(|line| line.strip_suffix(']')) {
            table = format!("{name}.");
        }
        let key = line.split_once(" = ").map(|(name, _)| format!("{table}{name}"));
        if let Some(SettingInfo { doc, range, default, .. }) = key.and_then(|key| listing.iter().find(|s| s.key == key))
        {
            let range = if range.is_empty() { String::new() } else { format!("Range: {range}. ") };
            let lines = doc.lines().map(str::to_owned).chain([format!("{range}Default: {default}.")]);
            text += &lines.fold("\n".to_owned(), |comment, line| comment + "# " + &line + "\n");
        }
        text = text + line + "\n";
    }
    Ok(text)
}

/// Parses a value of the command line.
fn value_of(text: &str, wants_text: bool) -> Value {
    let parsed = format!("value = {text}").parse::<Table>().ok().filter(|table| table.len() == 1);
    match parsed.and_then(|mut table| table.remove("value")) {
        Some(value) if value.is_str() || !wants_text => value,
        _ => Value::String(text.to_owned()),
    }
}

/// All values of a table with their keys. A table in place of a setting is returned whole, as a value of the wrong kind.
fn leaves(prefix: &str, table: Table, listing: &[SettingInfo]) -> Vec<(String, Value)> {
    let values = table.into_iter().flat_map(|(name, value)| {
        let key = format!("{prefix}{name}");
        match value {
            Value::Table(inner) if listing.iter().all(|setting| setting.key != key) => {
                leaves(&format!("{key}."), inner, listing)
            }
            value => vec![(key, value)],
        }
    });
    values.collect()
}

/// Returns the table of a `T` with one more setting changed.
fn assigned<T: DeserializeOwned>(
    mut table: Table,
    listing: &[SettingInfo],
    origin: &str,
    key: &str,
    value: Value,
) -> Result<Table, LoadSettingsError> {
    let given = shortened(&value);
    let wrong = |wanted: String| {
        Err(LoadSettingsError::WrongKind { origin: origin.to_owned(), key: key.to_owned(), wanted, given })
    };
    if let Some((_, parts)) = RENAMED.iter().find(|(old, _)| *old == key) {
        let values = match (parts.len(), value) {
            (1, value) => vec![value],
            (_, Value::Array(values)) => values,
            _ => Vec::new(),
        };
        if values.len() != parts.len() {
            return wrong(format!("a list of {} numbers", parts.len()));
        }
        let names: Vec<&str> = parts.iter().map(|(name, _)| *name).collect();
        tracing::warn!("{origin}: {key} is replaced by {}", names.join(" and "));
        let mut pairs = parts.iter().zip(values);
        return pairs.try_fold(table, |table, ((name, conversion), value)| {
            assigned::<T>(table, listing, origin, name, converted(value, *conversion))
        });
    }
    let range = listing.iter().find(|setting| setting.key == key).map(|setting| setting.range.as_str());
    let (Some(place), Some(range)) = (lookup(&mut table, key), range) else {
        let inner = listing.iter().filter_map(|s| s.key.strip_prefix(key)?.strip_prefix('.'));
        let mut names: Vec<&str> = inner.filter_map(|rest| rest.split('.').next()).collect();
        names.dedup();
        if !names.is_empty() {
            return wrong(format!("one of its own keys ({})", names.join(", ")));
        }
        let nearest = nearest(listing, key);
        return Err(LoadSettingsError::UnknownKey { origin: origin.to_owned(), key: key.to_owned(), nearest });
    };
    let wanted = [kind(place).as_str(), range].join(if range.is_empty() { "" } else { ", " });
    match fitted(place, value) {
        Some(value) => *place = value,
        None => return wrong(wanted),
    }
    // The kind does not show everything, such as the sign or the name of a choice. `T` checks it value by value, so that its message can
    // name the key.
    match T::deserialize(table.clone()) {
        Ok(_) => Ok(table),
        Err(_) if !range.is_empty() => wrong(wanted),
        Err(error) => {
            let message = error.message().replace('\n', "; ");
            wrong(message.split_once("expected ").map_or(message.as_str(), |(_, names)| names).to_owned())
        }
    }
}

fn lookup<'a>(table: &'a mut Table, key: &str) -> Option<&'a mut Value> {
    let (first, rest) = key.split_once('.').map_or((key, None), |(first, rest)| (first, Some(rest)));
    let value = table.get_mut(first)?;
    match rest {
        Some(rest) => lookup(value.as_table_mut()?, rest),
        None => Some(value),
    }
}

/// Returns the value in the type of the current one if it is of the same kind.
fn fitted(current: &Value, value: Value) -> Option<Value> {
    match (current, value) {
        (Value::Float(_), Value::Integer(x)) => Some(Value::Float(x as f64)),
        (Value::Array(list), Value::Array(values)) => match list.first() {
            Some(first) => {
                values.into_iter().map(|value| fitted(first, value)).collect::<Option<_>>().map(Value::Array)
            }
            None => Some(Value::Array(values)),
        },
        (current, value) => current.same_type(&value).then_some(value),
    }
}

/// Kind of a setting in words.
fn kind(current: &Value) -> String {
    match current {
        Value::String(_) => "a text".to_owned(),
        Value::Integer(_) => "a whole number".to_owned(),
        Value::Float(_) => "a number".to_owned(),
        Value::Boolean(_) => "true or false".to_owned(),
        Value::Datetime(_) => "a date".to_owned(),
        Value::Array(_) | Value::Table(_) => format!("a list such as {current}"),
    }
}

fn shortened(value: &Value) -> String {
    let text = value.to_string().replace('\n', " ");
    if text.chars().count() > 60 { text.chars().take(57).chain("...".chars()).collect() } else { text }
}

/// Returns the most similar key, compared as a whole or by its last name.
fn nearest(listing: &[SettingInfo], key: &str) -> Option<String> {
    let distance = |known: &str| {
        let last = known.rsplit('.').next().unwrap_or(known);
        strsim::damerau_levenshtein(known, key).min(strsim::damerau_levenshtein(last, key))
    };
    // A wholly different key does not help.
    let distances = listing.iter().map(|setting| (distance(&setting.key), &setting.key));
    distances.filter(|(distance, _)| 2 * distance <= key.len()).min().map(|(_, key)| key.clone())
}

#[cfg(test)]
mod tests;
