//! The fields of a contract as text: the metadata of an ONNX file, and those of a TOML file beside it.

use std::collections::BTreeMap;

/// Fields by name. Each is a list of lists: mjlab writes `1.0,2.0;3.0` for `[[1.0], [2.0, 3.0]]`.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct Fields(BTreeMap<String, Vec<Vec<String>>>);

/// Rounding of mjlab's metadata, which has three decimals: half of the last one, and the error of a sum.
#[cfg(feature = "onnx")]
const ROUNDING: f64 = 5.1e-4;

impl Fields {
    /// Adds a field as mjlab writes it.
    ///
    /// # Errors
    /// If the field stands there twice.
    #[cfg(feature = "onnx")]
    pub(crate) fn add_metadata(&mut self, name: &str, text: &str) -> Result<(), String> {
        let entry = |entry: &str| entry.split(';').map(|part| part.trim().to_owned()).collect();
        let entries = if text.trim().is_empty() { Vec::new() } else { text.split(',').map(entry).collect() };
        match self.0.insert(name.to_owned(), entries) {
            None => Ok(()),
            Some(_) => Err(format!("{name}: the field stands there twice")),
        }
    }

    /// Reads the fields of a TOML file.
    ///
    /// # Errors
    /// If it is not TOML, or a field is neither a value nor a list of values or lists.
    pub(crate) fn of_toml(text: &str) -> Result<Self, String> {
        let table: toml::Table = text.parse().map_err(|e: toml::de::Error| e.message().replace('\n', " "))?;
        let mut fields = BTreeMap::new();
        for (name, value) in table {
            let entries = match value {
                toml::Value::Array(entries) => {
                    entries.into_iter().map(|entry| list(&name, entry)).collect::<Result<_, _>>()?
                }
                value => vec![list(&name, value)?],
            };
            fields.insert(name, entries);
        }
        Ok(Self(fields))
    }

    /// Takes the fields of a file beside the policy. Where both state a field they must agree; the file's numbers are the exact ones.
    ///
    /// # Errors
    /// The field in which they differ.
    #[cfg(feature = "onnx")]
    pub(crate) fn complete(&mut self, beside: Self) -> Result<(), String> {
        for (name, entries) in beside.0 {
            if self.0.get(&name).is_some_and(|own| !agree(own, &entries)) {
                return Err(format!("{name}: the file beside it states another value; correct or remove that one"));
            }
            self.0.insert(name, entries);
        }
        Ok(())
    }

    /// Returns whether a field is there.
    pub(crate) fn has(&self, name: &str) -> bool {
        self.0.contains_key(name)
    }

    /// Returns the first name that is not among the known ones.
    pub(crate) fn unknown(&self, known: &[&str]) -> Option<&str> {
        self.0.keys().map(String::as_str).find(|name| !known.contains(name))
    }

    /// Returns a list of words.
    ///
    /// # Errors
    /// If it is missing.
    pub(crate) fn words(&self, name: &str) -> Result<Vec<String>, String> {
        let entries = self.0.get(name).ok_or_else(|| missing(name))?;
        Ok(entries.iter().map(|entry| entry.join(";")).collect())
    }

    /// Returns a single word, or the default if the field is not there.
    ///
    /// # Errors
    /// If it is a list.
    pub(crate) fn word(&self, name: &str, default: &str) -> Result<String, String> {
        if !self.has(name) {
            return Ok(default.to_owned());
        }
        match self.words(name)?.as_slice() {
            [word] => Ok(word.clone()),
            words => Err(format!("{name}: it has {} values; write one", words.len())),
        }
    }

    /// Returns a list of lists of numbers.
    ///
    /// # Errors
    /// If it is missing, or a number cannot be read or is not a number.
    pub(crate) fn lists(&self, name: &str) -> Result<Vec<Vec<f64>>, String> {
        let number = |text: &String| match text.as_str() {
            "True" | "true" => Ok(1.0),
            "False" | "false" => Ok(0.0),
            text => text
                .parse()
                .ok()
                .filter(|number: &f64| !number.is_nan())
                .ok_or_else(|| format!("{name}: {text:?} is no number")),
        };
        let entries = self.0.get(name).ok_or_else(|| missing(name))?;
        entries.iter().map(|entry| entry.iter().map(number).collect()).collect()
    }

    /// Returns so many finite numbers; a single one stands for all.
    ///
    /// # Errors
    /// If it is missing, has another length, or a number is not finite.
    pub(crate) fn numbers(&self, name: &str, count: usize, of: &str) -> Result<Vec<f64>, String> {
        let numbers: Vec<f64> = self.lists(name)?.into_iter().flatten().collect();
        if let Some(number) = numbers.iter().find(|number| !number.is_finite()) {
            return Err(format!("{name}: {number} is not finite"));
        }
        match numbers.as_slice() {
            [one] => Ok(vec![*one; count]),
            all if all.len() == count => Ok(numbers),
            all => Err(format!("{name}: it has {} numbers for {count} {of}", all.len())),
        }
    }
}

fn missing(name: &str) -> String {
    format!("{name}: the field is missing; export it, or write it into a .toml file of the same name beside the policy")
}

/// Returns the text of a value or of a list of values.
fn list(name: &str, value: toml::Value) -> Result<Vec<String>, String> {
    let text = |value: toml::Value| match value {
        toml::Value::String(text) => Ok(text),
        toml::Value::Integer(number) => Ok(number.to_string()),
        toml::Value::Float(number) => Ok(number.to_string()),
        toml::Value::Boolean(value) => Ok(value.to_string()),
        _ => Err(format!("{name}: write values, a list of values, or a list of lists")),
    };
    match value {
        toml::Value::Array(values) => values.into_iter().map(text).collect(),
        value => Ok(vec![text(value)?]),
    }
}

/// Returns whether two fields are the same but for the rounding of metadata.
#[cfg(feature = "onnx")]
fn agree(a: &[Vec<String>], b: &[Vec<String>]) -> bool {
    let near = |(a, b): (&String, &String)| match (a.parse::<f64>(), b.parse::<f64>()) {
        (Ok(a), Ok(b)) => a == b || (a - b).abs() <= ROUNDING,
        _ => a == b,
    };
    let same = |a: &[String], b: &[String]| a.len() == b.len() && a.iter().zip(b).all(near);
    a.len() == b.len() && a.iter().zip(b).all(|(a, b)| same(a, b))
}
