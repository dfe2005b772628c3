//! Copies long tables from the scratch folder to `results/`, under a line that says where they come from.

use std::fmt::Write as _;
use std::fs;
use std::path::Path;

use anyhow::{Context as _, Result};
use serde_json::Value;

use crate::claims::{Group, Table};
use crate::records;

/// Where a table was measured.
#[derive(Debug, Clone, Copy)]
pub struct Origin<'a> {
    /// The commit.
    pub commit: &'a str,
    /// The machine.
    pub machine: &'a str,
    /// The date.
    pub date: &'a str,
}

/// The copy of a table.
pub fn copy(group: &Group, table: &Table, folder: &Path, origin: Origin<'_>) -> Result<String> {
    let path = folder.join(&table.from);
    let is_csv = table.to.ends_with(".csv");
    let body = if table.columns.is_empty() {
        let text = fs::read_to_string(&path).with_context(|| format!("cannot read {}", path.display()))?;
        let is_plain = !is_csv && !table.from.ends_with(".md");
        if is_plain { format!("```text\n{}\n```\n", text.trim_end()) } else { format!("{}\n", text.trim_end()) }
    } else {
        let records = records::read(&path)?;
        if is_csv { csv(&records, &table.columns) } else { markdown(&records, &table.columns) }
    };
    let Origin { commit, machine, date } = origin;
    let name = &group.name;
    Ok(if is_csv {
        format!(
            "# {}: {}. Commit {commit}; {machine}; {date}; cargo results measure {name}\n{body}",
            group.title, table.title
        )
    } else {
        format!(
            "# {}: {}\n\nCommit {commit}; {machine}; {date}; `cargo results measure {name}`.\n\n{body}",
            group.title, table.title
        )
    })
}

fn csv(records: &[Value], columns: &[String]) -> String {
    let names: Vec<&str> = columns.iter().map(|column| name(column)).collect();
    let mut text = names.join(",") + "\n";
    for record in records {
        // A comma in a value would become two values.
        let cells: Vec<String> = columns.iter().map(|column| cell(record, column).replace(',', " ")).collect();
        text += &(cells.join(",") + "\n");
    }
    text
}

fn markdown(records: &[Value], columns: &[String]) -> String {
    let names: Vec<&str> = columns.iter().map(|column| name(column)).collect();
    let mut text = format!("| {} |\n{}|\n", names.join(" | "), "|---".repeat(columns.len()));
    for record in records {
        let cells: Vec<String> = columns.iter().map(|column| cell(record, column)).collect();
        let _ = writeln!(text, "| {} |", cells.join(" | "));
    }
    text
}

/// The name of a column without the slash of a pointer.
fn name(column: &str) -> &str {
    column.strip_prefix('/').unwrap_or(column)
}

/// A field as text: numbers with at most four digits behind the point, nothing for null.
fn cell(record: &Value, column: &str) -> String {
    match records::field(record, column) {
        None | Some(Value::Null) => String::new(),
        Some(Value::String(text)) => text.clone(),
        Some(Value::Number(number)) if number.is_f64() => {
            let text = format!("{:.4}", number.as_f64().unwrap_or(f64::NAN));
            text.trim_end_matches('0').trim_end_matches('.').to_owned()
        }
        Some(value) => value.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const GROUP: &str = "name = \"g\"\ntitle = \"G\"\nsimulated = true\nminutes = 1\ncommands = [\"true\"]\n";
    const ORIGIN: Origin<'_> = Origin { commit: "abc1234", machine: "M, 2 cores", date: "2026-11-22" };

    fn copied(table: &str) -> String {
        let folder = tempfile::tempdir().unwrap();
        fs::write(
            folder.path().join("a.jsonl"),
            "{\"n\": 1, \"x\": {\"y\": 0.123456}}\n{\"n\": 2, \"x\": {\"y\": null}}",
        )
        .unwrap();
        fs::write(folder.path().join("a.txt"), "words\n").unwrap();
        let group: Group = toml::from_str(&format!("{GROUP}[[table]]\ntitle = \"T\"\n{table}")).unwrap();
        copy(&group, &group.tables[0], folder.path(), ORIGIN).unwrap()
    }

    #[test]
    fn copies_name_their_origin() {
        let origin = "Commit abc1234; M, 2 cores; 2026-11-22; `cargo results measure g`.";
        let records = copied("from = \"a.jsonl\"\nto = \"a.md\"\ncolumns = [\"n\", \"/x/y\"]");
        assert_eq!(records, format!("# G: T\n\n{origin}\n\n| n | x/y |\n|---|---|\n| 1 | 0.1235 |\n| 2 |  |\n"));
        let csv = copied("from = \"a.jsonl\"\nto = \"a.csv\"\ncolumns = [\"n\", \"/x/y\"]");
        assert_eq!(
            csv,
            "# G: T. Commit abc1234; M, 2 cores; 2026-11-22; cargo results measure g\nn,x/y\n1,0.1235\n2,\n"
        );
        assert!(copied("from = \"a.txt\"\nto = \"b.md\"").ends_with("```text\nwords\n```\n"));
    }
}
