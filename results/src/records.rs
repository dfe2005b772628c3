//! Files as records: JSON, CSV and Markdown tables.

use std::fs;
use std::path::Path;

use anyhow::{Context as _, Result, bail, ensure};
use serde_json::{Map, Value};

/// Reads the records of a file by the ending of its name.
pub fn read(path: &Path) -> Result<Vec<Value>> {
    let text = fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))?;
    let records = match path.extension().and_then(|end| end.to_str()) {
        Some("json" | "jsonl") => json(&text),
        Some("csv") => csv(&text),
        Some("md") => Ok(markdown(&text)),
        _ => bail!("{} holds no records; they are read from .json, .jsonl, .csv and .md", path.display()),
    };
    records.with_context(|| format!("cannot read records from {}", path.display()))
}

/// One or several JSON values. An array becomes its elements.
fn json(text: &str) -> Result<Vec<Value>> {
    let mut records = Vec::new();
    for value in serde_json::Deserializer::from_str(text).into_iter() {
        match value? {
            Value::Array(elements) => records.extend(elements),
            value => records.push(value),
        }
    }
    Ok(records)
}

/// A line of names, then lines of values. Lines that start with # are comments.
fn csv(text: &str) -> Result<Vec<Value>> {
    ensure!(!text.contains('"'), "quoted values are not supported");
    let mut lines = text.lines().filter(|line| !line.trim().is_empty() && !line.starts_with('#'));
    let names: Vec<&str> = lines.next().context("there is no header")?.split(',').map(str::trim).collect();
    lines.map(|line| record(&names, &line.split(',').collect::<Vec<_>>()).with_context(|| line.to_owned())).collect()
}

/// The rows of all tables. A cell that starts with a number has that number as its value.
fn markdown(text: &str) -> Vec<Value> {
    let cells = |line: &str| -> Option<Vec<String>> {
        let inner = line.trim().strip_prefix('|')?.strip_suffix('|')?;
        Some(inner.split('|').map(|cell| cell.trim().to_owned()).collect())
    };
    let is_rule = |row: &[String]| row.iter().all(|cell| cell.contains("---"));
    let (mut records, mut names): (Vec<Value>, Option<Vec<String>>) = (Vec::new(), None);
    for line in text.lines() {
        match (cells(line), &names) {
            (None, _) => names = None,
            (Some(row), None) => names = Some(row),
            (Some(row), Some(_)) if is_rule(&row) => {}
            (Some(row), Some(header)) => {
                let names: Vec<&str> = header.iter().map(String::as_str).collect();
                // A row of another length is no row of the table.
                records.extend(record(&names, &row.iter().map(String::as_str).collect::<Vec<_>>()));
            }
        }
    }
    records
}

/// A record of named cells; the first of equal names counts.
fn record(names: &[&str], cells: &[&str]) -> Result<Value> {
    ensure!(names.len() == cells.len(), "{} values for {} columns", cells.len(), names.len());
    let mut fields = Map::new();
    for (&name, &cell) in names.iter().zip(cells) {
        fields.entry(name).or_insert_with(|| scalar(cell.trim()));
    }
    Ok(Value::Object(fields))
}

/// A cell's value: null if empty, the number that it starts with, or its text.
fn scalar(cell: &str) -> Value {
    let first = cell.split_whitespace().next().unwrap_or_default();
    let number = first.trim_end_matches([',', ';']).parse::<f64>().ok().filter(|number| number.is_finite());
    match number.and_then(serde_json::Number::from_f64) {
        _ if cell.is_empty() => Value::Null,
        Some(number) => Value::Number(number),
        None => Value::String(cell.to_owned()),
    }
}

/// A field by its name, or by a JSON pointer if it starts with a slash.
pub fn field<'a>(record: &'a Value, name: &str) -> Option<&'a Value> {
    if name.starts_with('/') { record.pointer(name) } else { record.get(name) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn json_values_follow_one_another() {
        let records = json("\n{\"a\": 1}\n[{\"a\": 2}, {\"a\": 3}]").unwrap();
        assert_eq!(records.len(), 3);
        assert_eq!(field(&records[2], "a"), Some(&Value::from(3)));
        assert_eq!(field(&serde_json::json!({"a": {"5": 0.5}}), "/a/5"), Some(&Value::from(0.5)));
        assert!(json("{").is_err());
    }

    #[test]
    fn csv_has_a_header_and_comments() {
        let records = csv("# comment\ntime_s,state,error\n0.5,lost,\n1.0,tracking,2e-3\n").unwrap();
        assert_eq!(records[0], serde_json::json!({"time_s": 0.5, "state": "lost", "error": null}));
        assert_eq!(field(&records[1], "error"), Some(&Value::from(0.002)));
        assert!(csv("a,b\n1\n").is_err());
    }

    #[test]
    fn markdown_tables_have_numbers() {
        let text = "words\n| object | rad/s (q10-q90) |\n|---|---|\n| 077_cube | 0.82 (0.61-0.94) |\n| can | 5 of 7 |\n\n| b |\n|---|\n| - |\n";
        let records = markdown(text);
        assert_eq!(records.len(), 3);
        assert_eq!(records[0], serde_json::json!({"object": "077_cube", "rad/s (q10-q90)": 0.82}));
        assert_eq!(records[1]["rad/s (q10-q90)"], 5.0);
        assert_eq!(records[2]["b"], "-");
    }
}
