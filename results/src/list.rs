//! `cargo results list`: the groups, or one group in full.

use std::fmt::Write as _;

use crate::claims::{Claims, Group, Verdict};
use crate::place::Repository;
use crate::render::shown;
use crate::values::Values;

/// All groups: duration, rows that have a value, title.
pub fn groups(claims: &Claims, values: &Values) -> String {
    let mut text = format!("{:<16} {:>8} {:>9}  title", "group", "minutes", "measured");
    for group in &claims.groups {
        let measured = group.rows.iter().filter(|row| values.get(&row.id).is_some()).count();
        let share = format!("{measured} of {}", group.rows.len());
        let _ = write!(text, "\n{:<16} {:>8} {share:>9}  {}", group.name, group.minutes, group.title);
    }
    text
}

/// The commands and the rows of a group; rows without a value are shown as such.
pub fn group(group: &Group, values: &Values) -> String {
    let mut text = format!("{}: {} (about {} minutes)", group.name, group.title, group.minutes);
    if let Some(needs) = &group.needs {
        let _ = write!(text, "\nneeds {needs}");
    }
    for command in &group.commands {
        let _ = write!(text, "\n  $ {}", Repository::expanded(command, &group.name).trim());
    }
    for row in &group.rows {
        let (value, verdict) = match values.get(&row.id) {
            None => ("not measured".to_owned(), ""),
            Some(measured) => match row.verdict(measured.value) {
                Verdict::Missed => (shown(row, measured), "missed"),
                Verdict::Met => (shown(row, measured), "met"),
                Verdict::NoBar => (shown(row, measured), ""),
            },
        };
        let _ = write!(text, "\n{:<34} {:>18} {:>10} {verdict:<6}  {}", row.id, value, row.bar(), row.claim);
    }
    text
}
