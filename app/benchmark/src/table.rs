//! Table of the results beside published figures.

use std::fmt::Write as _;

use mvt_metrics::SequenceScore;

use crate::published::PublishedSet;
use crate::results::{Outcome, ResultLine};

/// Columns with their titles.
const TITLES: [&str; 8] = ["frames/s", "ADD AUC", "ADD-S AUC", "CD mm", "F@5", "wrong %", "abstained %", "frames"];

/// Width of the names: that of the longest published method with its source.
const NAME: usize = 42;

/// Returns the width of a column: numbers such as 0.123 have five characters.
fn width(title: &str) -> usize {
    title.len().max(5)
}

/// Numbers of a row; missing ones are unknown.
type Row = [Option<f64>; TITLES.len()];

fn row(frames: usize, frames_per_second: f64, score: &SequenceScore) -> Row {
    let SequenceScore { add_auc, add_s_auc, chamfer_mm, f5, wrong, abstained, .. } = *score;
    [
        Some(frames_per_second),
        Some(add_auc),
        Some(add_s_auc),
        chamfer_mm,
        f5,
        Some(wrong),
        Some(abstained),
        Some(frames as f64),
    ]
}

/// Returns the median of the numbers that are known.
fn median(rows: &[Row], column: usize) -> Option<f64> {
    let mut values: Vec<f64> = rows.iter().filter_map(|row| *row.get(column)?).collect();
    values.sort_unstable_by(f64::total_cmp);
    let (low, high) = (values.get(values.len().saturating_sub(1) / 2)?, values.get(values.len() / 2)?);
    Some(0.5 * (low + high))
}

fn mean(rows: &[Row], column: usize) -> Option<f64> {
    let values: Vec<f64> = rows.iter().filter_map(|row| *row.get(column)?).collect();
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

fn line(name: &str, row: &Row) -> String {
    let mut text = format!("| {name:NAME$} |");
    for (column, (title, value)) in TITLES.iter().zip(row).enumerate() {
        // F-scores have three digits, numbers of frames none.
        let digits = match column {
            4 => 3,
            7 => 0,
            _ => 2,
        };
        let cell = value.map_or_else(|| "-".to_owned(), |value| format!("{value:.digits$}"));
        let _ = write!(text, " {cell:>width$} |", width = width(title));
    }
    text + "\n"
}

/// Returns the table as Markdown.
pub(crate) fn table(lines: &[ResultLine]) -> String {
    let mut text = format!("| {:NAME$} |", "sequence");
    TITLES.iter().for_each(|title| {
        let _ = write!(text, " {title:>width$} |", width = width(title));
    });
    text += &format!("\n|{}|", "-".repeat(NAME + 2));
    TITLES.iter().for_each(|title| text += &format!("{}:|", "-".repeat(width(title) + 1)));
    text.push('\n');
    let (mut rows, mut failures, mut sets) = (Vec::new(), Vec::new(), Vec::new());
    for result in lines {
        match &result.outcome {
            Outcome::Scored { frames, frames_per_second, score } => {
                let row = row(*frames, *frames_per_second, score);
                text += &line(&result.sequence, &row);
                rows.push(row);
                let set = PublishedSet::of(&result.sequence, &result.layout);
                sets.extend(set.filter(|set| !sets.contains(set)));
            }
            Outcome::Failed { error } => failures.push(format!("{}: {error}", result.sequence)),
        }
    }
    let over = |of: fn(&[Row], usize) -> Option<f64>| std::array::from_fn(|column| of(&rows, column));
    if rows.len() > 1 {
        text += &line("**median**", &over(median));
        text += &line("**mean**", &over(mean));
    }
    for set in sets {
        for published in set.rows() {
            let frames_per_second = published.s_per_frame.map(f64::recip);
            let (add, add_s) = (published.add_auc, Some(published.add_s_auc));
            let name = format!("{}, {} ({})", published.method, set.name(), published.source);
            text += &line(&name, &[frames_per_second, add, add_s, published.chamfer_mm, None, None, None, None]);
        }
    }
    if !failures.is_empty() {
        text += &format!("\nfailed:\n{}\n", failures.join("\n"));
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn medians_leave_out_what_is_unknown() {
        let row = |value: Option<f64>| [value; TITLES.len()];
        let rows = [row(Some(3.0)), row(None), row(Some(1.0)), row(Some(2.0))];
        assert_eq!((median(&rows, 2), mean(&rows, 2), median(&[row(None)], 0)), (Some(2.0), Some(2.0), None));
        assert_eq!(median(&rows[..3], 2), Some(2.0));
    }
}
