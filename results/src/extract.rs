//! Finds the value of a row in the files that the commands wrote.

use std::fs;
use std::path::Path;

use anyhow::{Context as _, Result, bail, ensure};
use serde_json::Value;

use crate::claims::{Comparison, Condition, Reduction, Row, Source};
use crate::records;

/// A value and, of a mean, its standard error.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Figure {
    /// The value.
    pub value: f64,
    /// Standard error of the mean.
    pub error: Option<f64>,
}

/// A number and the record that it comes from; text has no record.
#[derive(Debug, Clone)]
struct Found {
    number: f64,
    record: Value,
}

/// The value of a row, from the group's scratch folder.
pub fn figure(row: &Row, folder: &Path) -> Result<Figure> {
    let figure = match (&row.against, row.compare) {
        (Some(against), Some(Comparison::Difference)) if !row.pair_by.is_empty() => {
            let (a, b) = (find(&row.value, folder)?, find(against, folder)?);
            reduce(&row.value, &differences(&a, &b, &row.pair_by)?)?
        }
        (Some(against), Some(compare)) => {
            let (a, b) = (single(&row.value, folder)?.value, single(against, folder)?.value);
            let value = match compare {
                Comparison::Difference => a - b,
                Comparison::Ratio => a / b,
                Comparison::Percent => 100.0 * a / b,
                Comparison::PercentLower => 100.0 * (1.0 - a / b),
            };
            Figure { value, error: None }
        }
        _ => single(&row.value, folder)?,
    };
    ensure!(figure.value.is_finite(), "the value is not a finite number");
    Ok(figure)
}

/// The value of one source.
fn single(source: &Source, folder: &Path) -> Result<Figure> {
    reduce(source, &find(source, folder)?).with_context(|| source.file.clone())
}

/// All numbers of a source.
fn find(source: &Source, folder: &Path) -> Result<Vec<Found>> {
    let path = folder.join(&source.file);
    let mut found = if source.is_text() {
        let text = fs::read_to_string(&path).with_context(|| format!("cannot read {}", path.display()))?;
        in_text(source, &text)
    } else {
        in_records(source, &records::read(&path)?)
    };
    for number in found.iter_mut().flatten() {
        number.number *= source.scale.unwrap_or(1.0);
    }
    found.with_context(|| path.display().to_string())
}

fn in_records(source: &Source, records: &[Value]) -> Result<Vec<Found>> {
    ensure!(!records.is_empty(), "there are no records");
    // A misspelt name must not pass for a condition that no record meets.
    for name in source.conditions.keys() {
        ensure!(records.iter().any(|record| records::field(record, name).is_some()), "no record has a field {name:?}");
    }
    let kept = records.iter().filter(|record| {
        source.conditions.iter().all(|(name, condition)| is_met(condition, records::field(record, name)))
    });
    kept.map(|record| {
        let number = match &source.field {
            // Only a count has no field.
            None => 1.0,
            Some(name) => {
                let value = records::field(record, name).with_context(|| format!("a record has no field {name:?}"))?;
                number(value).with_context(|| format!("field {name:?} is {value}, not a number"))?
            }
        };
        Ok(Found { number, record: record.clone() })
    })
    .collect()
}

/// A number; true is 1, false is 0.
fn number(value: &Value) -> Option<f64> {
    value.as_f64().or_else(|| value.as_bool().map(|truth| f64::from(u8::from(truth))))
}

/// Whether a field meets a condition. A missing one meets none.
fn is_met(condition: &Condition, value: Option<&Value>) -> bool {
    let Some(value) = value else { return false };
    // 30 and 30.0 are the same number.
    let equals =
        |wanted: &Value| value == wanted || value.as_f64().is_some_and(|number| wanted.as_f64() == Some(number));
    match condition {
        Condition::Equals(wanted) => equals(wanted),
        Condition::AnyOf(several) => several.iter().any(equals),
        Condition::Bounds(bounds) => value.as_f64().is_some_and(|number| {
            bounds.at_least.is_none_or(|least| number >= least) && bounds.at_most.is_none_or(|most| number <= most)
        }),
    }
}

fn in_text(source: &Source, text: &str) -> Result<Vec<Found>> {
    let mut found = Vec::new();
    for line in text.lines().filter(|line| source.line.as_ref().is_none_or(|part| line.contains(part))) {
        let rest = match &source.after {
            None => line,
            Some(marker) => match line.split_once(marker.as_str()) {
                Some((_, rest)) => rest,
                None => continue,
            },
        };
        let which = source.number.unwrap_or(1);
        let number = match source.reduce {
            Reduction::Count => 1.0,
            _ => nth_number(rest, which).with_context(|| format!("there is no number {which} on the line {line:?}"))?,
        };
        ensure!(number.is_finite(), "number {which} on the line {line:?} is not finite");
        found.push(Found { number, record: Value::Null });
    }
    Ok(found)
}

/// The nth number in a text, from 1. Digits within words such as `avx512` are no numbers.
fn nth_number(text: &str, which: usize) -> Option<f64> {
    let is_word = |c: char| c.is_alphanumeric() || "_.".contains(c);
    let mut rest = text;
    let mut before = ' ';
    let mut left = which;
    while let Some(c) = rest.chars().next() {
        let length = number_length(rest);
        if length > 0 && !is_word(before) {
            left -= 1;
            if left == 0 {
                return rest[..length].parse().ok();
            }
            before = '0';
            rest = &rest[length..];
        } else {
            before = c;
            rest = &rest[c.len_utf8()..];
        }
    }
    None
}

/// Length of the number that a text starts with; 0 if it starts with none.
fn number_length(text: &str) -> usize {
    for word in ["NaN", "inf"] {
        // They count as numbers, so that they are reported rather than passed over.
        if text.strip_prefix(word).is_some_and(|rest| !rest.starts_with(char::is_alphanumeric)) {
            return word.len();
        }
    }
    let bytes = text.as_bytes();
    let digits =
        |from: usize| bytes.get(from..).unwrap_or_default().iter().take_while(|byte| byte.is_ascii_digit()).count();
    let sign = usize::from(bytes.first() == Some(&b'-'));
    let whole = digits(sign);
    if whole == 0 {
        return 0;
    }
    let mut end = sign + whole;
    if bytes.get(end) == Some(&b'.') && digits(end + 1) > 0 {
        end += 1 + digits(end + 1);
    }
    if matches!(bytes.get(end), Some(b'e' | b'E')) {
        let sign = usize::from(matches!(bytes.get(end + 1), Some(b'-' | b'+')));
        let exponent = digits(end + 1 + sign);
        if exponent > 0 {
            end += 1 + sign + exponent;
        }
    }
    end
}

/// The difference of each pair of records whose named fields are equal. Every record must have exactly one partner.
fn differences(a: &[Found], b: &[Found], pair_by: &[String]) -> Result<Vec<Found>> {
    ensure!(a.len() == b.len(), "{} records cannot be paired with {}", a.len(), b.len());
    let key =
        |found: &Found| pair_by.iter().map(|name| records::field(&found.record, name).cloned()).collect::<Vec<_>>();
    a.iter()
        .map(|first| {
            let partners: Vec<&Found> = b.iter().filter(|second| key(second) == key(first)).collect();
            match partners.as_slice() {
                [second] => Ok(Found { number: first.number - second.number, record: first.record.clone() }),
                several => bail!("a record has {} partners by {}", several.len(), pair_by.join(", ")),
            }
        })
        .collect()
}

fn reduce(source: &Source, found: &[Found]) -> Result<Figure> {
    let numbers: Vec<f64> = found.iter().map(|found| found.number).collect();
    let count = numbers.len();
    let sum: f64 = numbers.iter().sum();
    if source.reduce == Reduction::Count {
        return Ok(Figure { value: count as f64, error: None });
    }
    if source.reduce == Reduction::Only {
        ensure!(count == 1, "{count} values where there should be one; narrow the source or give `reduce`");
    }
    let (Some(&first), Some(&last)) = (numbers.first(), numbers.last()) else {
        bail!("nothing matches");
    };
    let mean = sum / count as f64;
    let value = match source.reduce {
        Reduction::Only | Reduction::First => first,
        Reduction::Last => last,
        Reduction::Mean => mean,
        Reduction::Median => median(numbers.clone()),
        Reduction::Min => numbers.iter().copied().fold(f64::INFINITY, f64::min),
        Reduction::Max => numbers.iter().copied().fold(f64::NEG_INFINITY, f64::max),
        Reduction::Sum => sum,
        Reduction::Count => count as f64,
    };
    let error = (source.error && count > 1).then(|| {
        let squares: f64 = numbers.iter().map(|number| (number - mean).powi(2)).sum();
        (squares / (count * (count - 1)) as f64).sqrt()
    });
    Ok(Figure { value, error })
}

/// The middle value, or the mean of the two in the middle.
fn median(mut numbers: Vec<f64>) -> f64 {
    numbers.sort_by(f64::total_cmp);
    let half = numbers.len() / 2;
    let upper = numbers.get(half).copied().unwrap_or(f64::NAN);
    let lower = if numbers.len().is_multiple_of(2) { half.checked_sub(1) } else { Some(half) };
    0.5 * (upper + lower.and_then(|k| numbers.get(k).copied()).unwrap_or(upper))
}

#[cfg(test)]
mod tests {
    use super::*;

    const RUNS: &str = r#"
{"object": "cube", "seed": 0, "modality": "vitac", "f_score": {"5": 0.9}, "error_mm": 1.0, "failed": false, "after": null}
{"object": "cube", "seed": 1, "modality": "vitac", "f_score": {"5": 1.0}, "error_mm": 2.0, "failed": true, "after": 3}
{"object": "cube", "seed": 1, "modality": "vi", "f_score": {"5": 0.8}, "error_mm": 4.0, "failed": true, "after": 7}
{"object": "cube", "seed": 0, "modality": "vi", "f_score": {"5": 0.7}, "error_mm": 2.0, "failed": false, "after": null}"#;
    const TEXT: &str = "avx512   6.8  17.7\nscalar   2.7  5.8\nratio 14.5 (14.4 to 15.0); met: at least 6\nworst -1.5e-3 mm.\nin contact NaN um, 99.9 %\n";

    fn value_of(row: &str) -> Result<Figure> {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join("runs.jsonl"), RUNS).unwrap();
        fs::write(folder.path().join("log.txt"), TEXT).unwrap();
        let row: Row = toml::from_str(&format!("id = \"g.a\"\nclaim = \"c\"\n{row}")).unwrap();
        figure(&row, folder.path())
    }

    fn value(source: &str) -> f64 {
        value_of(&format!("value = {{ {source} }}")).unwrap().value
    }

    #[test]
    fn pointers_filters_and_reductions() {
        let vitac = "file = \"runs.jsonl\", where = { modality = \"vitac\" }";
        assert!((value(&format!("{vitac}, field = \"/f_score/5\", reduce = \"mean\"")) - 0.95).abs() < 1e-12);
        for (reduction, expected) in
            [("min", 1.0), ("max", 2.0), ("sum", 3.0), ("first", 1.0), ("last", 2.0), ("median", 1.5)]
        {
            assert_eq!(
                value(&format!("{vitac}, field = \"error_mm\", reduce = \"{reduction}\"")),
                expected,
                "{reduction}"
            );
        }
        let figure =
            value_of(&format!("value = {{ {vitac}, field = \"error_mm\", reduce = \"mean\", error = true }}")).unwrap();
        assert_eq!(figure, Figure { value: 1.5, error: Some(0.5) });
        assert_eq!(
            value("file = \"runs.jsonl\", where = { failed = true, modality = \"vi\" }, field = \"error_mm\""),
            4.0
        );
        assert_eq!(value("file = \"runs.jsonl\", where = { after = { at_most = 5 } }, reduce = \"count\""), 1.0);
        assert_eq!(value("file = \"runs.jsonl\", where = { object = \"can\" }, reduce = \"count\""), 0.0);
        assert_eq!(
            value(
                "file = \"runs.jsonl\", where = { seed = [0, 2] }, field = \"error_mm\", reduce = \"sum\", scale = 10.0"
            ),
            30.0
        );
    }

    #[test]
    fn what_is_not_there_is_an_error() {
        let refusal = |source: &str| format!("{:#}", value_of(&format!("value = {{ {source} }}")).unwrap_err());
        assert!(refusal("file = \"runs.jsonl\", field = \"error_mm\"").contains("4 values"));
        assert!(refusal("file = \"runs.jsonl\", where = { sed = 0 }, reduce = \"count\"").contains("\"sed\""));
        assert!(refusal("file = \"runs.jsonl\", field = \"after\", reduce = \"mean\"").contains("null"));
        assert!(
            refusal("file = \"runs.jsonl\", where = { seed = 9 }, field = \"seed\", reduce = \"mean\"")
                .contains("nothing matches")
        );
        assert!(refusal("file = \"none.json\", field = \"a\"").contains("cannot read"));
        assert!(refusal("file = \"log.txt\", line = \"scalar\", number = 3").contains("no number 3"));
        assert!(refusal("file = \"log.txt\", after = \"contact\"").contains("not finite"));
    }

    #[test]
    fn numbers_in_text() {
        assert_eq!(value("file = \"log.txt\", line = \"avx512\", number = 2"), 17.7);
        assert_eq!(value("file = \"log.txt\", after = \"scalar\""), 2.7);
        assert_eq!(value("file = \"log.txt\", line = \"ratio\", after = \"at least\""), 6.0);
        assert_eq!(value("file = \"log.txt\", after = \"worst\""), -1.5e-3);
        assert_eq!(value("file = \"log.txt\", line = \" \", reduce = \"count\""), 5.0);
        assert_eq!(nth_number("F@5 v2.1 0.5.", 1), Some(5.0));
        assert_eq!(nth_number("µ7 at -3e", 1), Some(-3.0));
        assert_eq!(nth_number("none", 1), None);
    }

    #[test]
    fn values_are_compared() {
        let of = |modality: &str| {
            format!(
                "{{ file = \"runs.jsonl\", where = {{ modality = \"{modality}\" }}, field = \"error_mm\", reduce = \"mean\", error = true }}"
            )
        };
        let compared =
            |rest: &str| value_of(&format!("value = {}\nagainst = {}\n{rest}", of("vitac"), of("vi"))).unwrap();
        assert_eq!(compared("compare = \"percent_lower\"").value, 50.0);
        assert_eq!(compared("compare = \"percent\"").value, 50.0);
        assert_eq!(compared("compare = \"ratio\"").value, 0.5);
        assert_eq!(compared("compare = \"difference\"").value, -1.5);
        let paired = compared("compare = \"difference\"\npair_by = [\"object\", \"seed\"]");
        assert_eq!(paired, Figure { value: -1.5, error: Some(0.5) });
    }
}
