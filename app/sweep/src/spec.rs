//! SPEC.toml: the variations of a sweep, and the tasks that follow from them.

use std::collections::{BTreeMap, HashSet};

use anyhow::{Result, bail, ensure};
use rand::seq::SliceRandom as _;
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use serde_json::Value;

/// Settings of a task, by their keys.
pub type TaskSettings = BTreeMap<String, Value>;

/// The command that a task does.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum TaskCommand {
    /// Each task writes a log.
    Generate,
    /// Each task is a run of an estimator.
    Evaluate,
}

impl TaskCommand {
    /// Returns its name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Generate => "generate",
            Self::Evaluate => "evaluate",
        }
    }
}

/// SPEC.toml as it is written.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct SpecFile {
    command: TaskCommand,
    /// Points of the Latin hypercube.
    #[serde(default)]
    points: Option<usize>,
    /// Seed of the Latin hypercube.
    #[serde(default)]
    points_seed: u64,
    /// Settings that all tasks share.
    #[serde(default)]
    fixed: toml::Table,
    axes: toml::Table,
}

/// The variations of a sweep.
#[derive(Debug, Clone, PartialEq)]
pub struct SweepSpec {
    /// The command of each task.
    pub command: TaskCommand,
    fixed: TaskSettings,
    /// Axes of the grid, in the order of their keys.
    grid: Vec<(String, Vec<Value>)>,
    /// Keys of the hypercube, and its points.
    sampled: Vec<String>,
    points: Vec<Vec<Value>>,
}

/// Axis whose values are not listed.
#[derive(Debug, Deserialize)]
#[serde(untagged)]
enum Range {
    Count(Count),
    Steps(Steps),
    Sampled(Sampled),
}

/// `count` whole numbers from `from` on, with a prefix as texts.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Count {
    from: u64,
    count: u64,
    prefix: Option<String>,
}

/// Evenly spaced numbers.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Steps {
    min: toml::Value,
    max: toml::Value,
    steps: u64,
}

/// Numbers of the hypercube.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Sampled {
    min: toml::Value,
    max: toml::Value,
}

/// Keys that tell an axis from a table of settings.
const RANGE_KEYS: [&str; 6] = ["from", "count", "prefix", "min", "max", "steps"];

impl SweepSpec {
    /// Reads a specification that leads to at most `limit` tasks.
    ///
    /// # Errors
    /// If a key is unknown, an axis is empty or names a value twice, or there are more tasks; the message names the key or the number.
    pub fn parse(text: &str, limit: u64) -> Result<Self> {
        let file: SpecFile = toml::from_str(text).map_err(|error| anyhow::anyhow!("{}", in_one_line(&error)))?;
        let mut fixed = Vec::new();
        flatten("", &file.fixed, &mut fixed);
        let fixed = fixed.into_iter().map(|(key, value)| Ok((key, json(value)?))).collect::<Result<_>>()?;
        let mut axes = Vec::new();
        flatten("", &file.axes, &mut axes);
        let mut spec = Self { command: file.command, fixed, grid: Vec::new(), sampled: Vec::new(), points: Vec::new() };
        let mut ranges = Vec::new();
        // Values are made only when their number is known to be sane.
        let mut tasks = 1u64;
        for (key, axis) in &axes {
            ensure!(!spec.fixed.contains_key(key), "{key} stands in [fixed] and in [axes]; remove one of them");
            let length = match (axis, range(key, axis)?) {
                (_, Some(Range::Count(Count { count, .. }))) => count,
                (_, Some(Range::Steps(Steps { steps, .. }))) => steps,
                (_, Some(Range::Sampled(sampled))) => {
                    ranges.push((key.clone(), sampled));
                    continue;
                }
                (toml::Value::Array(list), None) => list.len() as u64,
                _ => bail!("axis {key} is neither a list nor a range such as {{ min = 0.5, max = 2.0 }}"),
            };
            ensure!(length > 0, "axis {key} is empty; give it a value or remove it");
            tasks = tasks.saturating_mul(length);
        }
        match (file.points, ranges.is_empty()) {
            (None, false) => {
                bail!("axis {} has neither steps nor points: add steps to it, or points = N to the file", ranges[0].0)
            }
            (Some(_), true) => bail!("points is for axes with min and max alone, and there is none"),
            (Some(0), false) => bail!("points must be at least 1"),
            (points, _) => tasks = tasks.saturating_mul(points.unwrap_or(1) as u64),
        }
        ensure!(
            tasks <= limit,
            "the axes lead to {tasks} tasks, more than {limit}; shorten an axis, or allow them with --limit {tasks}"
        );
        for (key, axis) in axes {
            let values = match range(&key, &axis)? {
                Some(Range::Sampled(_)) => continue,
                Some(Range::Count(count)) => count.values(),
                Some(Range::Steps(steps)) => steps.values(&key)?,
                None => axis.as_array().into_iter().flatten().cloned().map(json).collect::<Result<_>>()?,
            };
            let mut seen = HashSet::new();
            if let Some(value) = values.iter().find(|value| !seen.insert(value.to_string())) {
                bail!("axis {key} names {value} twice");
            }
            spec.grid.push((key, values));
        }
        spec.points = hypercube(&ranges, file.points.unwrap_or(1), file.points_seed)?;
        spec.sampled = ranges.into_iter().map(|(key, _)| key).collect();
        Ok(spec)
    }

    /// Returns the number of tasks.
    pub fn len(&self) -> usize {
        self.grid.iter().map(|(_, values)| values.len()).product::<usize>() * self.points.len()
    }

    /// Returns whether there are no tasks; a specification has at least one.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Returns the settings of a task; the last axis changes first, the points of the hypercube before it.
    pub fn task(&self, number: usize) -> TaskSettings {
        let mut settings = self.fixed.clone();
        let mut rest = number;
        let point = self.points.get(rest % self.points.len().max(1)).into_iter().flatten();
        settings.extend(self.sampled.iter().cloned().zip(point.cloned()));
        rest /= self.points.len().max(1);
        for (key, values) in self.grid.iter().rev() {
            if let Some(value) = values.get(rest % values.len().max(1)) {
                settings.insert(key.clone(), value.clone());
            }
            rest /= values.len().max(1);
        }
        settings
    }

    /// Returns, for each axis, its key and the values that must be checked: all of a list, the ends of a range.
    pub fn axis_values(&self) -> Vec<(String, Vec<Value>)> {
        let mut axes = self.grid.clone();
        for (column, key) in self.sampled.iter().enumerate() {
            axes.push((key.clone(), self.points.iter().filter_map(|point| point.get(column).cloned()).collect()));
        }
        axes
    }
}

/// Returns the first line of a TOML error and its place.
fn in_one_line(error: &toml::de::Error) -> String {
    error.to_string().split_whitespace().collect::<Vec<_>>().join(" ")
}

/// Lists the values of a table by their keys with dots between levels. A range is a value.
fn flatten(prefix: &str, table: &toml::Table, into: &mut Vec<(String, toml::Value)>) {
    for (key, value) in table {
        let key = if prefix.is_empty() { key.clone() } else { format!("{prefix}.{key}") };
        match value {
            toml::Value::Table(inner) if !inner.keys().any(|key| RANGE_KEYS.contains(&key.as_str())) => {
                flatten(&key, inner, into);
            }
            value => into.push((key, value.clone())),
        }
    }
}

fn range(key: &str, axis: &toml::Value) -> Result<Option<Range>> {
    let toml::Value::Table(table) = axis else { return Ok(None) };
    match table.clone().try_into() {
        Ok(range) => Ok(Some(range)),
        Err(_) => bail!("axis {key} must be a list, {{ from, count }}, {{ min, max, steps }} or {{ min, max }}"),
    }
}

fn json(value: toml::Value) -> Result<Value> {
    Ok(match value {
        toml::Value::Float(number) if !number.is_finite() => bail!("{number} is not a number that a setting can have"),
        value => serde_json::to_value(value)?,
    })
}

impl Count {
    fn values(&self) -> Vec<Value> {
        let numbers = (0..self.count).map(|k| self.from.saturating_add(k));
        match &self.prefix {
            Some(prefix) => numbers.map(|number| format!("{prefix}{number}").into()).collect(),
            None => numbers.map(Value::from).collect(),
        }
    }
}

impl Steps {
    fn values(&self, key: &str) -> Result<Vec<Value>> {
        let scale = Scale::new(key, &self.min, &self.max)?;
        let last = (self.steps - 1).max(1) as f64;
        Ok((0..self.steps).map(|step| scale.between(step as f64 / last)).collect())
    }
}

/// Numbers between two ends; whole ones if both ends are whole.
enum Scale {
    Whole(i64, i64),
    Real(f64, f64),
}

impl Scale {
    fn new(key: &str, min: &toml::Value, max: &toml::Value) -> Result<Self> {
        let number = |value: &toml::Value| value.as_float().or(value.as_integer().map(|whole| whole as f64));
        let scale = match (min.as_integer(), max.as_integer()) {
            (Some(min), Some(max)) if min < max => Self::Whole(min, max),
            _ => match (number(min), number(max)) {
                (Some(min), Some(max)) if min < max && (max - min).is_finite() => Self::Real(min, max),
                _ => bail!("axis {key}: min and max must be numbers, and min the smaller one"),
            },
        };
        Ok(scale)
    }

    /// Returns the number at a share of the way, 0 to 1.
    fn between(&self, share: f64) -> Value {
        match *self {
            Self::Whole(min, max) => (min + ((max as f64 - min as f64) * share).round() as i64).into(),
            Self::Real(min, max) => (min + (max - min) * share).into(),
        }
    }
}

/// Points of a Latin hypercube: each axis is cut into as many equal parts as there are points, and each part has one of them.
fn hypercube(ranges: &[(String, Sampled)], points: usize, seed: u64) -> Result<Vec<Vec<Value>>> {
    let mut rows = vec![Vec::new(); points];
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    for (key, Sampled { min, max }) in ranges {
        let scale = Scale::new(key, min, max)?;
        let mut parts: Vec<usize> = (0..points).collect();
        parts.shuffle(&mut random);
        for (row, part) in rows.iter_mut().zip(parts) {
            let within: f64 = random.random();
            row.push(scale.between((part as f64 + within) / points as f64));
        }
    }
    Ok(rows)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const GRID: &str = "command = \"generate\"\n[fixed]\nduration = 2.0\n[axes]\nobject = [\"a\", \"b\"]\nseed = { from = 5, count = 3 }\n\
                        cameras = [\"side\"]\n";

    fn refusal(text: &str) -> String {
        SweepSpec::parse(text, 1000).unwrap_err().to_string()
    }

    #[test]
    fn a_grid_is_the_product_of_its_axes() {
        let spec = SweepSpec::parse(GRID, 1000).unwrap();
        let tasks: Vec<_> = (0..spec.len()).map(|k| spec.task(k)).collect();
        let shown: Vec<String> = tasks.iter().map(|task| format!("{}{}", task["object"], task["seed"])).collect();
        assert_eq!(shown, ["\"a\"5", "\"a\"6", "\"a\"7", "\"b\"5", "\"b\"6", "\"b\"7"]);
        assert!(tasks.iter().all(|task| task["duration"] == 2.0 && task["cameras"] == "side" && task.len() == 4));
    }

    #[test]
    fn ranges_and_dotted_keys_are_read() {
        let text = "command = \"evaluate\"\npoints = 4\n[axes]\nobject = { from = 0, count = 2, prefix = \"random:\" }\n\
                    slam.tracker.touch_weight = { min = 0.5, max = 1.5, steps = 3 }\ncamera_noise = { min = 0.0, max = 8.0 }\n";
        let spec = SweepSpec::parse(text, 1000).unwrap();
        assert_eq!(spec.len(), 2 * 3 * 4);
        let first = spec.task(0);
        assert_eq!((&first["object"], &first["slam.tracker.touch_weight"]), (&"random:0".into(), &0.5.into()));
        let noise = |k: usize| spec.task(k)["camera_noise"].as_f64().unwrap();
        // Each quarter of the range has one of four points.
        let mut quarters: Vec<usize> = (0..4).map(|k| (noise(k) / 2.0) as usize).collect();
        quarters.sort_unstable();
        assert_eq!(quarters, [0, 1, 2, 3]);
    }

    #[test]
    fn mistakes_are_named() {
        let said = refusal(&GRID.replace("cameras = [\"side\"]", "cameras = []"));
        assert!(said.contains("cameras is empty"), "{said}");
        let said = refusal(&GRID.replace("count = 3", "count = 500000"));
        assert!(said.contains("1000000 tasks") && said.contains("--limit 1000000"), "{said}");
        let said = refusal(&GRID.replace("count = 3", "count = 9223372036854775807"));
        assert!(said.contains("tasks, more than 1000"), "{said}");
        let said = refusal(&GRID.replace("[\"a\", \"b\"]", "[\"a\", \"a\"]"));
        assert!(said.contains("object names \"a\" twice"), "{said}");
        let said = refusal(&GRID.replace("[fixed]", "[fixd]"));
        assert!(said.contains("fixd") && said.contains("fixed"), "{said}");
        let said = refusal(&GRID.replace("[fixed]", "[fixed]\nseed = 1"));
        assert!(said.contains("seed stands in [fixed] and in [axes]"), "{said}");
        let said = refusal(&(GRID.to_owned() + "camera_noise = { min = 0, max = 1 }\n"));
        assert!(said.contains("camera_noise has neither steps nor points"), "{said}");
        let said = refusal(&(GRID.to_owned() + "camera_noise = { min = 2, max = 1, steps = 3 }\n"));
        assert!(said.contains("camera_noise: min and max"), "{said}");
        let said = refusal(&(GRID.to_owned() + "camera_noise = { min = 2, stepps = 3 }\n"));
        assert!(said.contains("camera_noise must be a list"), "{said}");
    }

    proptest! {
        #[test]
        fn every_part_of_a_hypercube_has_one_point(points in 1usize..60, seed: u64) {
            let range = || Sampled { min: toml::Value::Float(0.0), max: toml::Value::Float(1.0) };
            let rows = hypercube(&[("a".into(), range()), ("b".into(), range())], points, seed).unwrap();
            for axis in 0..2 {
                let mut parts: Vec<usize> = rows.iter().map(|row| (row[axis].as_f64().unwrap() * points as f64) as usize).collect();
                parts.sort_unstable();
                prop_assert_eq!(parts, (0..points).collect::<Vec<_>>());
            }
        }

        #[test]
        fn any_text_is_taken_without_a_panic(text in "\\PC{0,200}", number: i64) {
            let _ = SweepSpec::parse(&text, 100);
            let _ = SweepSpec::parse(&format!("command = \"generate\"\npoints = {number}\n[axes]\nseed = {{ min = {number}, max = 3 }}"), 100);
        }
    }
}
