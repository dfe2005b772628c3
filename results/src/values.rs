//! The measured values, kept in `results/values.jsonl`: a line per row.

use std::collections::BTreeMap;
use std::fs;
use std::io::ErrorKind;
use std::path::Path;

use anyhow::{Context as _, Result, ensure};
use serde::{Deserialize, Serialize};

use crate::claims::Claims;

/// The value of a row and where it was measured.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Measured {
    /// The row.
    pub id: String,
    /// The value.
    pub value: f64,
    /// Standard error of a mean.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub error: Option<f64>,
    /// Short hash of the commit, with `+changes` if files differed from it.
    pub commit: String,
    /// Processor and number of cores.
    pub machine: String,
    /// Date in UTC.
    pub date: String,
}

/// All values by row.
#[derive(Debug, Clone, Default)]
pub struct Values {
    by_id: BTreeMap<String, Measured>,
}

impl Values {
    /// Reads the file; a missing file holds no values.
    pub fn load(path: &Path) -> Result<Self> {
        match fs::read_to_string(path) {
            Ok(text) => Self::parse(&text).with_context(|| path.display().to_string()),
            Err(error) if error.kind() == ErrorKind::NotFound => Ok(Self::default()),
            Err(error) => Err(error).with_context(|| format!("cannot read {}", path.display())),
        }
    }

    /// Reads the text of the file.
    pub fn parse(text: &str) -> Result<Self> {
        let mut values = Self::default();
        for (number, line) in (1..).zip(text.lines()).filter(|(_, line)| !line.trim().is_empty()) {
            let measured: Measured = serde_json::from_str(line).with_context(|| format!("line {number}"))?;
            ensure!(values.get(&measured.id).is_none(), "line {number}: {:?} has two values", measured.id);
            values.set(measured);
        }
        Ok(values)
    }

    /// The value of a row.
    pub fn get(&self, id: &str) -> Option<&Measured> {
        self.by_id.get(id)
    }

    /// Stores a value in place of the row's old one.
    pub fn set(&mut self, measured: Measured) {
        self.by_id.insert(measured.id.clone(), measured);
    }

    /// All values, by id.
    pub fn iter(&self) -> impl Iterator<Item = &Measured> {
        self.by_id.values()
    }

    /// Writes the file, in the order of the claims; values without a claim come last.
    pub fn save(&self, path: &Path, claims: &Claims) -> Result<()> {
        let known: Vec<&str> = claims.rows().map(|(_, row)| row.id.as_str()).collect();
        let in_order = known.iter().filter_map(|id| self.get(id));
        let unknown = self.iter().filter(|measured| !known.contains(&measured.id.as_str()));
        let mut text = String::new();
        for measured in in_order.chain(unknown) {
            text += &serde_json::to_string(measured)?;
            text.push('\n');
        }
        fs::write(path, text).with_context(|| format!("cannot write {}", path.display()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_row_has_one_value() {
        let line = r#"{"id": "g.a", "value": 1.5, "commit": "abc1234", "machine": "m", "date": "2026-11-22"}"#;
        assert_eq!(Values::parse(line).unwrap().get("g.a").unwrap().value, 1.5);
        assert!(Values::parse(&format!("{line}\n{line}")).unwrap_err().to_string().contains("two values"));
        assert!(Values::parse("{}").is_err());
    }
}
