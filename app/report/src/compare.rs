//! Two sweeps side by side: runs of the same identity are pairs.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;

use crate::collect::RunCollection;
use crate::encode::escaped;
use crate::metric::{ADD_S, HEADLINES, Metric, SPEED};
use crate::plot::{self, PlotRow, run_name};
use crate::row::{ReportRow, RunIdentity, RunKind};
use crate::statistics::{Estimate, mean, wilcoxon};

/// Most pairs in the list of those that differ most.
const LISTED: usize = 20;

/// Pairs of runs of two collections.
#[derive(Debug)]
pub struct Comparison<'a> {
    /// Complete runs with the same identity, with their numbers on the page.
    pairs: Vec<Pair<'a>>,
    /// Number of complete runs of each collection that the other one lacks.
    alone: [usize; 2],
}

#[derive(Debug, Clone, Copy)]
struct Pair<'a> {
    new: Numbered<'a>,
    old: Numbered<'a>,
}

/// Run with its number on the page.
type Numbered<'a> = (usize, &'a ReportRow);

/// Difference of a figure between the runs of pairs.
#[derive(Debug, Clone, PartialEq)]
pub struct PairedDifference {
    /// Means over the pairs of the new and of the old runs.
    pub means: [f64; 2],
    /// Mean of the differences new - old over episodes, with its interval.
    pub difference: Estimate,
    /// p-value of Wilcoxon's signed-rank test over episodes; `None` if nothing differs.
    pub p: Option<f64>,
    /// Episodes in which the new value is larger, and in which it is less.
    pub larger_less: [usize; 2],
}

impl<'a> Comparison<'a> {
    /// Pairs the complete runs of two collections. The rows of `old` follow those of `new` on the page.
    pub fn new(new: &'a RunCollection, old: &'a RunCollection) -> Self {
        let complete = |collection: &'a RunCollection, first: usize| {
            let rows = collection.rows.iter().enumerate().filter(|(_, row)| row.is_complete);
            rows.map(|(k, row)| (first + k, row)).collect::<Vec<Numbered<'a>>>()
        };
        let (news, olds) = (complete(new, 0), complete(old, new.rows.len()));
        let by_identity = |rows: &[Numbered<'a>]| {
            let mut runs = BTreeMap::<RunIdentity, Vec<Numbered<'a>>>::new();
            for row in rows {
                runs.entry(row.1.id.without_settings()).or_default().push(*row);
            }
            runs
        };
        let others = by_identity(&olds);
        let partner = |row: &ReportRow, rivals: usize| match others.get(&row.id.without_settings())?.as_slice() {
            // Sweeps are compared because their settings differ.
            [only] if rivals == 1 => Some(*only),
            several => several.iter().find(|(_, other)| other.settings == row.settings).copied(),
        };
        let pairs: Vec<Pair<'_>> = by_identity(&news)
            .values()
            .flat_map(|rows| rows.iter().map(|new| (new, rows.len())))
            .filter_map(|(new, rivals)| Some(Pair { new: *new, old: partner(new.1, rivals)? }))
            .collect();
        let alone = [news.len() - pairs.len(), olds.len() - pairs.len()];
        Self { pairs, alone }
    }

    /// Returns the numbers on the page of the runs that differ most in ADD-S.
    pub fn notable(&self) -> Vec<usize> {
        self.by_loss().iter().flat_map(|pair| [pair.new.0, pair.old.0]).collect()
    }

    /// The pairs from the greatest loss to the greatest gain in ADD-S; runs without a value are the worst.
    fn by_loss(&self) -> Vec<Pair<'a>> {
        let loss = |pair: &Pair<'_>| {
            let [new, old] = [pair.new.1.badness(), pair.old.1.badness()];
            if new == old { 0.0 } else { new - old }
        };
        let mut pairs = self.pairs.clone();
        pairs.sort_by(|a, b| loss(b).total_cmp(&loss(a)));
        pairs
    }

    fn by_kind(&self) -> BTreeMap<&'a RunKind, Vec<Pair<'a>>> {
        let mut kinds = BTreeMap::<_, Vec<Pair<'_>>>::new();
        for pair in &self.pairs {
            kinds.entry(&pair.new.1.id.kind).or_default().push(*pair);
        }
        kinds
    }

    /// Writes the section of the page.
    pub fn html(&self) -> String {
        let [of_new, of_old] = self.alone;
        let mut html = format!(
            "<section id=\"comparison\"><h2>A against B</h2><p>{} pairs of runs with the same object, seed and sensors. A has {of_new} runs \
             without a partner, B {of_old}; they are not compared. A difference is A - B; green is better.</p>",
            self.pairs.len()
        );
        if self.pairs.is_empty() {
            return html + "</section>";
        }
        html += "<div class=\"scroll\"><table class=\"sortable\" id=\"differences\"><thead><tr><th>kind of run</th><th>figure</th>\
                 <th class=\"n\">A</th><th class=\"n\">B</th><th class=\"n\">A - B</th><th class=\"n\">95 % interval</th>\
                 <th class=\"n\">p (Wilcoxon)</th><th class=\"n\">episodes</th><th class=\"n\">A better</th><th class=\"n\">B better</th>\
                 </tr></thead><tbody>";
        for (kind, pairs) in self.by_kind() {
            // Speeds depend on the machine, and on what else it did.
            for metric in HEADLINES.iter().filter(|metric| metric.name != SPEED.name) {
                if let Some(difference) = PairedDifference::new(metric, &pairs) {
                    html += &difference.row(&kind.name(), metric);
                }
            }
        }
        html += "</tbody></table></div><div class=\"plots\">";
        for metric in [&HEADLINES[0], &ADD_S] {
            html += &self.plot(metric);
        }
        html += "</div><h3>Pairs that differ most in ADD-S</h3>";
        html + &self.listed() + "</section>"
    }

    /// The differences of each object.
    fn plot(&self, metric: &Metric) -> String {
        let objects: BTreeSet<&str> = self.pairs.iter().map(|pair| pair.new.1.id.object.as_str()).collect();
        let row = |object: &str| {
            let pairs: Vec<Pair<'_>> =
                self.pairs.iter().filter(|pair| pair.new.1.id.object == object).copied().collect();
            let values = pairs.iter().filter_map(|pair| {
                let [new, old] = [(metric.of)(pair.new.1)?, (metric.of)(pair.old.1)?];
                Some((new - old, format!("{}, {}", run_name(pair.new.1), pair.new.1.id.kind.name())))
            });
            let values: Vec<(f64, String)> = values.collect();
            let estimate = Estimate::new(&values.iter().map(|(value, _)| *value).collect::<Vec<_>>());
            PlotRow { label: object.to_owned(), values, estimate }
        };
        let rows: Vec<PlotRow> = objects.into_iter().map(row).filter(|row| !row.values.is_empty()).collect();
        if rows.is_empty() {
            return String::new();
        }
        plot::rows(&format!("{}: difference A - B by object", metric.title()), metric, &rows)
    }

    fn listed(&self) -> String {
        let mut html = String::from(
            "<div class=\"scroll\"><table class=\"sortable\"><thead><tr><th>run</th><th>kind</th><th class=\"n\">ADD-S A, mm</th>\
             <th class=\"n\">ADD-S B, mm</th><th class=\"n\">A - B</th><th></th></tr></thead><tbody>",
        );
        let by_loss = self.by_loss();
        let last = by_loss.len().saturating_sub(LISTED / 2).max(LISTED / 2);
        let listed = by_loss.iter().take(LISTED / 2).chain(by_loss.iter().skip(last));
        for Pair { new: (number, new), old: (other, old) } in listed {
            let mm = |value: Option<f64>| value.map_or_else(|| "-".to_owned(), |mm| ADD_S.shown(mm));
            let difference = new.add_s.zip(old.add_s).map(|(new, old)| new - old);
            let _ = write!(
                html,
                "<tr><td>{}</td><td>{}</td><td class=\"n\">{}</td><td class=\"n\">{}</td><td class=\"n {}\">{}</td>\
                 <td><button data-shapes=\"{number},{other}\" hidden>3-D</button></td></tr>",
                escaped(&run_name(new)),
                escaped(&new.id.kind.name()),
                mm(new.add_s),
                mm(old.add_s),
                verdict(&ADD_S, difference.unwrap_or(0.0)),
                difference.map_or_else(|| "-".to_owned(), |mm| format!("{mm:+.2}")),
            );
        }
        html + "</tbody></table></div>"
    }
}

impl PairedDifference {
    /// Compares a figure; `None` if no pair has it.
    fn new(metric: &Metric, pairs: &[Pair<'_>]) -> Option<Self> {
        let mut episodes = BTreeMap::<(&str, u64), Vec<[f64; 2]>>::new();
        for Pair { new: (_, new), old: (_, old) } in pairs {
            if let (Some(a), Some(b)) = ((metric.of)(new), (metric.of)(old)) {
                episodes.entry((&new.id.object, new.id.seed)).or_default().push([a, b]);
            }
        }
        let means: Vec<[f64; 2]> = episodes
            .values()
            .map(|values| [0, 1].map(|k| mean(&values.iter().map(|pair| pair[k]).collect::<Vec<_>>())))
            .collect();
        let differences: Vec<f64> = means.iter().map(|[new, old]| new - old).collect();
        Some(Self {
            means: [0, 1].map(|k| mean(&means.iter().map(|pair| pair[k]).collect::<Vec<_>>())),
            difference: Estimate::new(&differences)?,
            p: wilcoxon(&differences),
            larger_less: [
                differences.iter().filter(|d| **d > 0.0).count(),
                differences.iter().filter(|d| **d < 0.0).count(),
            ],
        })
    }

    fn row(&self, kind: &str, metric: &Metric) -> String {
        let Self { means: [new, old], difference, p, larger_less: [larger, less] } = self;
        let digits = metric.digits + 1;
        let interval = difference
            .interval
            .map_or_else(|| "-".to_owned(), |[low, high]| format!("{low:+.digits$} to {high:+.digits$}"));
        // A colour only where the interval excludes 0.
        let is_clear = difference.interval.is_some_and(|[low, high]| low > 0.0 || high < 0.0);
        let class = if is_clear { verdict(metric, difference.mean) } else { "" };
        let [better, worse] = if metric.larger_is_better == Some(true) { [larger, less] } else { [less, larger] };
        format!(
            "<tr><td>{}</td><td>{}</td><td class=\"n\">{}</td><td class=\"n\">{}</td><td class=\"n {class}\">{:+.digits$}</td>\
             <td class=\"n {class}\">{interval}</td><td class=\"n\" data-value=\"{}\">{}</td><td class=\"n\">{}</td><td class=\"n\">{better}</td><td class=\"n\">{worse}</td></tr>",
            escaped(kind),
            metric.title(),
            metric.shown(*new),
            metric.shown(*old),
            difference.mean,
            p.unwrap_or(1.0),
            p.map_or_else(|| "-".to_owned(), |p| if p < 1e-4 { "< 0.0001".to_owned() } else { format!("{p:.4}") }),
            difference.count,
        )
    }
}

/// Returns the class of the colour of a difference.
fn verdict(metric: &Metric, difference: f64) -> &'static str {
    match metric.larger_is_better {
        Some(larger) if difference != 0.0 => {
            if (difference > 0.0) == larger {
                "better"
            } else {
                "worse"
            }
        }
        _ => "",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(object: &str, seed: u64, mm: f64) -> ReportRow {
        let line = format!(
            r#"{{"object":"{object}","seed":{seed},"cameras":"side","mode":"slam","modality":"vitac","variant":"full","frames":9,
            "f_score":{{}},"add_s_mm":{{"mean":{mm},"median":1,"p95":2,"final":1}},"lost_frames":0}}"#
        );
        ReportRow::of_line(&line).unwrap()
    }

    fn collection(rows: Vec<ReportRow>) -> RunCollection {
        RunCollection { rows, ..RunCollection::default() }
    }

    #[test]
    fn runs_are_paired_by_identity() {
        let new = collection((0..6).map(|k| row("can", k, 1.0 + 0.1 * k as f64)).chain([row("mug", 9, 5.0)]).collect());
        let old = collection((0..6).map(|k| row("can", k, 1.5 + 0.2 * k as f64)).collect());
        let comparison = Comparison::new(&new, &old);
        assert_eq!((comparison.pairs.len(), comparison.alone), (6, [1, 0]));
        let difference = PairedDifference::new(&ADD_S, &comparison.pairs).unwrap();
        // All six are better: -0.5 to -1.0.
        assert!((difference.difference.mean + 0.75).abs() < 1e-12);
        assert_eq!(difference.larger_less, [0, 6]);
        assert!((difference.p.unwrap() - 2.0 / 64.0).abs() < 1e-12);
        // The least gain first; old rows are numbered behind the new ones.
        assert_eq!(comparison.notable()[..2], [0, 7]);
        let html = comparison.html();
        assert!(html.contains("better") && !html.contains("worse\""), "{html}");
        // Twice the same sweep differs nowhere.
        let same = Comparison::new(&new, &new);
        let difference = PairedDifference::new(&ADD_S, &same.pairs).unwrap();
        assert_eq!((difference.difference.mean, difference.p), (0.0, None));
    }

    #[test]
    fn settings_decide_only_between_several_runs() {
        let with = |settings: &str, mm: f64| ReportRow { settings: settings.to_owned(), ..row("can", 0, mm) };
        let tagged = |settings: &str, mm: f64| {
            let mut row = with(settings, mm);
            row.id.kind.variant = format!("full #{settings}");
            row
        };
        let pairs = |new: Vec<ReportRow>, old: Vec<ReportRow>| {
            let (new, old) = (collection(new), collection(old));
            Comparison::new(&new, &old).pairs.iter().map(|pair| (pair.new.0, pair.old.0)).collect::<Vec<_>>()
        };
        assert_eq!(pairs(vec![with("a", 1.0)], vec![with("b", 2.0)]), [(0, 1)]);
        assert_eq!(pairs(vec![tagged("a", 1.0)], vec![with("b", 2.0)]), [(0, 1)]);
        assert_eq!(pairs(vec![tagged("a", 1.0), tagged("b", 1.0)], vec![with("b", 2.0)]), [(1, 2)]);
        assert_eq!(pairs(vec![with("c", 1.0)], vec![tagged("a", 2.0), tagged("b", 2.0)]), []);
    }

    #[test]
    fn sweeps_without_common_runs_are_no_pairs() {
        let (new, old) = (collection(vec![row("can", 0, 1.0)]), collection(vec![row("can", 1, 1.0)]));
        let comparison = Comparison::new(&new, &old);
        assert_eq!((comparison.pairs.len(), comparison.alone), (0, [1, 1]));
        assert!(comparison.html().contains("0 pairs"));
    }
}
