//! The claims of RESULTS.md, read from `results/claims.toml`.

use std::collections::BTreeMap;
use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

use anyhow::{Context as _, Result, bail, ensure};
use serde::Deserialize;
use serde_json::Value;

/// Everything that RESULTS.md can say.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Claims {
    /// Paragraphs under the title of the page.
    pub introduction: Vec<String>,
    /// Things that were never measured.
    #[serde(default)]
    pub unmeasured: Vec<String>,
    /// Groups in the order of the page.
    #[serde(rename = "group")]
    pub groups: Vec<Group>,
}

/// Claims that the same commands measure.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Group {
    /// Name on the command line.
    pub name: String,
    /// Title on the page.
    pub title: String,
    /// Whether the data come from our own simulator.
    pub simulated: bool,
    /// Estimated duration of the commands in minutes.
    pub minutes: f64,
    /// Needs of the commands beyond the repository.
    pub needs: Option<String>,
    /// Whether the rows are shown on RESULTS.md. Those of other groups are shown on results/more.md.
    #[serde(default = "yes")]
    pub page: bool,
    /// A sentence under the title.
    pub note: Option<String>,
    /// Bash commands, run in order from the root. `$OUT` is the group's scratch folder.
    pub commands: Vec<String>,
    /// Files that are kept.
    #[serde(default, rename = "table")]
    pub tables: Vec<Table>,
    /// Claims in the order of the page.
    #[serde(default, rename = "row")]
    pub rows: Vec<Row>,
}

/// A file that is copied from the scratch folder to `results/`.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Table {
    /// Path in the scratch folder.
    pub from: String,
    /// Name in `results/`, which ends in .md or .csv.
    pub to: String,
    /// Text of the link and, after the group's title, title of the copy.
    pub title: String,
    /// If given, records are read from the file and these fields become the columns.
    #[serde(default)]
    pub columns: Vec<String>,
}

/// One figure.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Row {
    /// Unique name, which starts with the name of the group.
    pub id: String,
    /// Statement on the page.
    pub claim: String,
    /// Unit behind the value.
    #[serde(default)]
    pub unit: String,
    /// Digits behind the point.
    #[serde(default = "two")]
    pub digits: usize,
    /// The value must reach this.
    pub at_least: Option<f64>,
    /// The value must not exceed this.
    pub at_most: Option<f64>,
    /// Why the bar is missed. A row that misses its bar must have a reason, any other row must have none.
    pub missed: Option<String>,
    /// Where the value is.
    pub value: Source,
    /// A second value that the first is compared with.
    pub against: Option<Source>,
    /// How the two values are compared.
    pub compare: Option<Comparison>,
    /// Fields by which the records of both sources are paired; the pairs' differences are then reduced as `value` says.
    #[serde(default)]
    pub pair_by: Vec<String>,
}

/// Where a figure is in the files that the commands write.
///
/// JSON (also several values or lines in a file), CSV and Markdown tables are read as records; other files as text.
#[derive(Debug, Clone, Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Source {
    /// Path in the scratch folder.
    pub file: String,
    /// Of records: a field's name, or a JSON pointer.
    pub field: Option<String>,
    /// Of records: only those whose fields meet all conditions.
    #[serde(rename = "where")]
    pub conditions: BTreeMap<String, Condition>,
    /// Of text: only lines that contain this.
    pub line: Option<String>,
    /// Of text: only the part of the line after this.
    pub after: Option<String>,
    /// Of text: which number on the rest of the line counts, from 1.
    pub number: Option<usize>,
    /// How many values become one.
    pub reduce: Reduction,
    /// Whether the standard error of a mean is stored, too.
    pub error: bool,
    /// Factor of the value.
    pub scale: Option<f64>,
}

/// A condition on a field.
#[derive(Debug, Clone, Deserialize)]
#[serde(untagged)]
pub enum Condition {
    /// One of several values. It stands before the bounds, because serde also reads a struct from an array.
    AnyOf(Vec<Value>),
    /// A number within bounds.
    Bounds(Bounds),
    /// This value.
    Equals(Value),
}

/// Bounds of a number; either may be missing.
#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Bounds {
    /// Lower bound.
    pub at_least: Option<f64>,
    /// Upper bound.
    pub at_most: Option<f64>,
}

/// How many values become one.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Reduction {
    /// There must be exactly one.
    #[default]
    Only,
    /// The first.
    First,
    /// The last.
    Last,
    /// The mean.
    Mean,
    /// The median.
    Median,
    /// The smallest.
    Min,
    /// The largest.
    Max,
    /// The sum.
    Sum,
    /// The number of records or lines.
    Count,
}

/// How a value is compared with a second one.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Comparison {
    /// The first minus the second.
    Difference,
    /// The first over the second.
    Ratio,
    /// The first in percent of the second.
    Percent,
    /// By how many percent the first is lower than the second.
    PercentLower,
}

/// Whether a value meets its bar.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Verdict {
    /// There is no bar.
    NoBar,
    /// The bar is met.
    Met,
    /// The bar is missed.
    Missed,
}

/// Default of [`Group::page`].
fn yes() -> bool {
    true
}

/// Default of [`Row::digits`].
fn two() -> usize {
    2
}

impl Row {
    /// Whether a value meets the bar. It is rounded as shown first, so that the page cannot contradict itself.
    pub fn verdict(&self, value: f64) -> Verdict {
        let scale = 10_f64.powi(self.digits as i32);
        let shown = (value * scale).round() / scale;
        let is_met = match (self.at_least, self.at_most) {
            (None, None) => return Verdict::NoBar,
            (Some(bar), _) => shown >= bar,
            (None, Some(bar)) => shown <= bar,
        };
        if is_met { Verdict::Met } else { Verdict::Missed }
    }

    /// The bar as shown; empty without a bar.
    pub fn bar(&self) -> String {
        match (self.at_least, self.at_most) {
            (None, None) => String::new(),
            (Some(bar), _) => format!(">= {bar}"),
            (None, Some(bar)) => format!("<= {bar}"),
        }
    }
}

impl Claims {
    /// Reads and validates the file.
    pub fn load(path: &Path) -> Result<Self> {
        let text = fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))?;
        Self::parse(&text).with_context(|| path.display().to_string())
    }

    /// Reads and validates the text of the file.
    pub fn parse(text: &str) -> Result<Self> {
        let claims: Self = toml::from_str(text)?;
        claims.validate()?;
        Ok(claims)
    }

    /// The group of this name.
    pub fn group(&self, name: &str) -> Result<&Group> {
        let names = || self.groups.iter().map(|group| group.name.as_str()).collect::<Vec<_>>().join(", ");
        let group = self.groups.iter().find(|group| group.name == name);
        group.with_context(|| format!("there is no group {name:?}; choose from {}", names()))
    }

    /// All rows with their groups, in the order of the page.
    pub fn rows(&self) -> impl Iterator<Item = (&Group, &Row)> {
        self.groups.iter().flat_map(|group| group.rows.iter().map(move |row| (group, row)))
    }

    fn validate(&self) -> Result<()> {
        let mut names = BTreeSet::new();
        let mut ids = BTreeSet::new();
        let mut files = BTreeSet::new();
        for group in &self.groups {
            ensure!(names.insert(&group.name), "two groups have the name {:?}", group.name);
            ensure!(
                group.commands.iter().any(|command| !command.trim().is_empty()),
                "group {:?} has no command; a figure that no command makes does not belong on the page",
                group.name
            );
            for table in &group.tables {
                ensure!(files.insert(&table.to), "two tables are copied to {:?}", table.to);
                let is_name =
                    !table.to.contains(['/', '\\']) && [".md", ".csv"].iter().any(|end| table.to.ends_with(end));
                ensure!(is_name, "the table {:?} must be a file name that ends in .md or .csv", table.to);
            }
            for row in &group.rows {
                ensure!(ids.insert(&row.id), "two rows have the id {:?}", row.id);
                row.validate(&group.name).with_context(|| format!("row {:?}", row.id))?;
            }
        }
        Ok(())
    }
}

impl Row {
    fn validate(&self, group: &str) -> Result<()> {
        let starts_well = self.id.strip_prefix(group).is_some_and(|rest| rest.starts_with('.'));
        ensure!(starts_well, "an id starts with the name of its group and a dot: \"{group}.\"");
        ensure!(!self.claim.is_empty() && !self.claim.contains(['|', '\n']), "a claim is one line without \"|\"");
        ensure!(!(self.at_least.is_some() && self.at_most.is_some()), "give at_least or at_most, not both");
        if self.missed.is_some() && self.bar().is_empty() {
            bail!("a row without a bar cannot miss it; remove `missed`");
        }
        match (&self.against, self.compare) {
            (None, None) => ensure!(self.pair_by.is_empty(), "pair_by needs `against`"),
            (Some(_), Some(compare)) => {
                ensure!(
                    self.pair_by.is_empty() || compare == Comparison::Difference,
                    "pair_by needs compare = \"difference\""
                );
            }
            _ => bail!("give `against` and `compare`, or neither"),
        }
        [Some(&self.value), self.against.as_ref()].into_iter().flatten().try_for_each(Source::validate)
    }
}

impl Source {
    fn validate(&self) -> Result<()> {
        ensure!(!self.file.is_empty(), "a source needs a `file`");
        ensure!(!(self.error && self.reduce != Reduction::Mean), "only a mean has a standard error");
        if self.is_text() {
            ensure!(self.field.is_none() && self.conditions.is_empty(), "{} is text: it has no fields", self.file);
            ensure!(self.line.is_some() || self.after.is_some(), "text needs `line` or `after`");
            ensure!(self.number != Some(0), "numbers on a line count from 1");
        } else {
            ensure!(
                self.line.is_none() && self.after.is_none() && self.number.is_none(),
                "{} holds records: give `field` and `where`",
                self.file
            );
            ensure!(self.field.is_some() || self.reduce == Reduction::Count, "give a `field`, or reduce = \"count\"");
        }
        Ok(())
    }

    /// Whether the file is read as text rather than as records.
    pub fn is_text(&self) -> bool {
        ![".json", ".jsonl", ".csv", ".md"].iter().any(|end| self.file.ends_with(end))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(group: &str) -> Result<Claims> {
        Claims::parse(&format!(
            "introduction = []\n[[group]]\nname = \"g\"\ntitle = \"G\"\nsimulated = false\nminutes = 1\n{group}"
        ))
    }

    fn refusal(group: &str) -> String {
        format!("{:#}", parse(group).unwrap_err())
    }

    #[test]
    fn what_does_not_fit_is_refused() {
        assert!(refusal("commands = []").contains("no command"));
        let row = |rest: &str| format!("commands = [\"true\"]\n[[group.row]]\nclaim = \"c\"\n{rest}");
        assert!(parse(&row("id = \"g.a\"\nvalue = { file = \"a.json\", field = \"x\" }")).is_ok());
        assert!(refusal(&row("id = \"a\"\nvalue = { file = \"a.json\", field = \"x\" }")).contains("starts with"));
        assert!(refusal(&row("id = \"g.a\"\nvalue = { file = \"a.json\" }")).contains("field"));
        assert!(refusal(&row("id = \"g.a\"\nvalue = { file = \"a.txt\", field = \"x\" }")).contains("is text"));
        assert!(refusal(&row("id = \"g.a\"\nvalue = { file = \"a.txt\" }")).contains("line"));
        assert!(
            refusal(&row("id = \"g.a\"\nmissed = \"m\"\nvalue = { file = \"a.txt\", line = \"x\" }")).contains("bar")
        );
        assert!(refusal(&row("id = \"g.a\"\nvalu = 1")).contains("valu"));
        let twice = row(
            "id = \"g.a\"\nvalue = { file = \"a.json\", field = \"x\" }\n[[group.row]]\nclaim = \"c\"\nid = \"g.a\"\nvalue = { file = \"a.json\", field = \"x\" }",
        );
        assert!(refusal(&twice).contains("two rows"));
    }

    #[test]
    fn verdicts_follow_the_digits_that_are_shown() {
        let row = |bar: &str| {
            let rest = format!("id = \"g.a\"\n{bar}\nvalue = {{ file = \"a.json\", field = \"x\" }}");
            let claims = parse(&format!("commands = [\"true\"]\n[[group.row]]\nclaim = \"c\"\n{rest}")).unwrap();
            claims.groups[0].rows[0].clone()
        };
        assert_eq!(row("").verdict(1.0), Verdict::NoBar);
        assert_eq!(row("at_least = 0.9").verdict(0.896), Verdict::Met);
        assert_eq!(row("at_least = 0.9").verdict(0.894), Verdict::Missed);
        assert_eq!(row("at_most = 2.5").verdict(2.504), Verdict::Met);
        assert_eq!(row("at_most = 2.5").verdict(2.51), Verdict::Missed);
    }
}
