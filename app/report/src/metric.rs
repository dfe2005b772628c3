//! Figures of a run that a report shows.

use crate::row::ReportRow;

/// Figure of a run.
#[derive(Debug, Clone, Copy)]
pub struct Metric {
    /// Name, short enough for the head of a column.
    pub name: &'static str,
    /// Unit; empty for none.
    pub unit: &'static str,
    /// Digits behind the point.
    pub digits: usize,
    /// Whether a larger value is better; `None` if neither is.
    pub larger_is_better: Option<bool>,
    /// Returns the value of a run.
    pub of: fn(&ReportRow) -> Option<f64>,
}

/// F-score at 5 mm.
pub const F5: Metric = Metric {
    name: "F@5 mm",
    unit: "",
    digits: 3,
    larger_is_better: Some(true),
    of: |row| row.f_score.get(&5).copied(),
};

/// Mean ADD-S.
pub const ADD_S: Metric =
    Metric { name: "ADD-S mean", unit: "mm", digits: 2, larger_is_better: Some(false), of: |row| row.add_s };

/// Speed of tracking and mapping.
pub const SPEED: Metric =
    Metric { name: "frames/s", unit: "", digits: 1, larger_is_better: Some(true), of: |row| row.frames_per_second };

/// Figures that have means with intervals.
pub const HEADLINES: [Metric; 8] = [
    F5,
    Metric { name: "F@2 mm", of: |row| row.f_score.get(&2).copied(), ..F5 },
    ADD_S,
    Metric { name: "ADD-S p95", of: |row| row.add_s_p95, ..ADD_S },
    Metric { name: "ADD mean", of: |row| row.add, ..ADD_S },
    Metric { name: "rotation mean", unit: "degrees", digits: 1, of: |row| row.rotation_deg, ..ADD_S },
    Metric {
        name: "frames lost",
        unit: "%",
        digits: 1,
        larger_is_better: Some(false),
        of: |row| row.lost_share().map(|share| 100.0 * share),
    },
    SPEED,
];

/// Columns of the table of all runs, beside those that name the run.
pub const COLUMNS: [Metric; 11] = [
    Metric {
        name: "hidden",
        unit: "%",
        digits: 0,
        larger_is_better: None,
        of: |row| row.hidden.map(|share| 100.0 * share),
    },
    HEADLINES[0],
    HEADLINES[1],
    Metric { name: "F@1 mm fine", of: |row| row.f_score_fine.get(&1).copied(), ..F5 },
    HEADLINES[2],
    HEADLINES[3],
    Metric { name: "ADD-S final", of: |row| row.add_s_final, ..ADD_S },
    HEADLINES[4],
    HEADLINES[5],
    HEADLINES[6],
    HEADLINES[7],
];

impl Metric {
    /// Returns the name with its unit.
    pub fn title(&self) -> String {
        if self.unit.is_empty() { self.name.to_owned() } else { format!("{}, {}", self.name, self.unit) }
    }

    /// Returns a value as text.
    pub fn shown(&self, value: f64) -> String {
        format!("{value:.0$}", self.digits)
    }

    /// Returns the mean of each episode (object and seed), so that runs on the same frames count once, in order of the
    /// episodes; runs without a value are left out.
    pub fn by_episode(&self, rows: &[&ReportRow]) -> Vec<f64> {
        let mut episodes = std::collections::BTreeMap::<(&str, u64), Vec<f64>>::new();
        for row in rows {
            if let Some(value) = (self.of)(row).filter(|value| value.is_finite()) {
                episodes.entry((&row.id.object, row.id.seed)).or_default().push(value);
            }
        }
        episodes.values().map(|values| crate::statistics::mean(values)).collect()
    }
}
