//! Tables of numbers as text, in the dialects of spreadsheets and of other programs for poses.

use mvt_files::cells;

/// A table: its names and its lines.
pub(super) struct TextTable {
    /// Names of the columns in lower case.
    pub names: Vec<String>,
    /// Line of the names, from 1.
    pub line: usize,
    /// Cells of the other lines, each with its line. Decimal commas are points.
    pub rows: Vec<(usize, Vec<String>)>,
}

/// Names of the columns of TUM's files, which may lack a header.
const TUM: &str = "timestamp tx ty tz qx qy qz qw";

/// What separates the cells of a line.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Separator {
    Sign(char),
    Spaces,
}

impl Separator {
    /// Returns the separator of a line of names or numbers: a semicolon or a tab, since commas may then be decimal; else a comma, else spaces.
    fn of(line: &str) -> Self {
        let found = [';', '\t', ','].into_iter().find(|separator| line.contains(*separator));
        found.map_or(Self::Spaces, Self::Sign)
    }

    fn cells(self, line: &str) -> Vec<String> {
        match self {
            Self::Spaces => line.split_whitespace().map(|cell| cell.trim_matches('"').to_owned()).collect(),
            Self::Sign(sign) => cells::split(line, sign),
        }
    }
}

impl TextTable {
    /// Reads a table. Lines that begin with # are comments, and the last of them holds the names if no other line does. Returns the line where
    /// names are missing.
    pub fn read(text: &str) -> Result<Self, usize> {
        let text = text.trim_start_matches('\u{feff}').replace("\r\n", "\n");
        let mut lines = (1..).zip(text.split(['\n', '\r'])).filter(|(_, line)| !line.trim().is_empty()).peekable();
        let mut comment = None;
        while let Some((number, line)) = lines.next_if(|(_, line)| line.trim_start().starts_with('#')) {
            comment = Some((number, line.trim_start().trim_start_matches('#')));
        }
        let (number, first) = lines.peek().copied().or(comment).ok_or(1_usize)?;
        let is_numbers = |line: &str| {
            let cells = Separator::of(line).cells(line);
            cells.iter().all(|cell| cell.is_empty() || is_number(cell) || is_number(&cell.replace(',', ".")))
        };
        let (line, header) = if !is_numbers(first) {
            lines.next();
            (number, first)
        } else if let Some(comment) = comment {
            comment
        } else if Separator::of(first) == Separator::Spaces && first.split_whitespace().count() == 8 {
            (number, TUM)
        } else {
            return Err(number);
        };
        let mut names = Separator::of(header).cells(header);
        let is_unnamed = |names: &[String]| names.last().is_some_and(String::is_empty);
        while is_unnamed(&names) {
            names.pop();
        }
        names.iter_mut().for_each(|name| *name = name.to_ascii_lowercase());
        let mut rows = Vec::new();
        // Names that stand in a comment may be separated in another way.
        let separator = Separator::of(if line == number { header } else { first });
        for (line, text) in lines.filter(|(_, line)| !line.trim_start().starts_with('#')) {
            let mut cells = separator.cells(text);
            // A separator at the end begins no cell.
            while cells.len() > names.len() && is_unnamed(&cells) {
                cells.pop();
            }
            // Spreadsheets leave lines without content.
            if cells.iter().all(String::is_empty) {
                continue;
            }
            if separator != Separator::Sign(',') {
                cells.iter_mut().for_each(|cell| *cell = cell.replace(',', "."));
            }
            rows.push((line, cells));
        }
        Ok(Self { names, line, rows })
    }
}

fn is_number(cell: &str) -> bool {
    number(cell).is_some()
}

/// Returns the number in a cell, also with the exponent D of Fortran.
pub(super) fn number(cell: &str) -> Option<f64> {
    cell.parse().ok().or_else(|| cell.replace(['d', 'D'], "e").parse().ok())
}

/// Returns our name of a column with another name, and by what its numbers are multiplied. Units stand at the name's end, as `x_mm` or
/// `x [m]`; numbers without a unit are metres. Times without one are [`None`]: their unit shows in the numbers.
pub(super) fn known_as(name: &str) -> Option<(&'static str, Option<f64>)> {
    let (stem, unit) = match name.split_once('[') {
        Some((stem, unit)) => (stem.trim(), unit.trim_end_matches(']').trim()),
        None => (name, ""),
    };
    let (stem, unit) = match stem.rsplit_once('_') {
        Some((rest, last)) if ["s", "ms", "us", "ns", "m", "mm", "sec", "nsec"].contains(&last) => (rest, last),
        _ => (stem, unit),
    };
    let factor = match unit {
        "" => None,
        "s" | "sec" | "m" => Some(1.0),
        "ms" | "mm" => Some(1e-3),
        "us" => Some(1e-6),
        "ns" | "nsec" => Some(1e-9),
        _ => return None,
    };
    let words: Vec<&str> = stem.split(['_', '.', ' ']).collect();
    if let ["time" | "timestamp" | "t" | "stamp"] = words[..] {
        return Some(("time_s", factor));
    }
    let (last, of) = words.split_last()?;
    let is_of = |names: &[&str]| of.is_empty() || of.iter().any(|word| names.contains(word));
    let (place, turn) =
        (is_of(&["p", "pos", "position", "t", "translation"]), is_of(&["q", "quat", "orientation", "rotation"]));
    let name = match *last {
        "x" | "tx" | "px" if place => "x_m",
        "y" | "ty" | "py" if place => "y_m",
        "z" | "tz" | "pz" if place => "z_m",
        "qw" if of.is_empty() => "qw",
        "qx" if of.is_empty() => "qx",
        "qy" if of.is_empty() => "qy",
        "qz" if of.is_empty() => "qz",
        "w" if turn => "qw",
        "x" if turn => "qx",
        "y" if turn => "qy",
        "z" if turn => "qz",
        _ => return None,
    };
    Some((name, Some(factor.unwrap_or(1.0))))
}
