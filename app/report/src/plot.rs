//! Plots as SVG that follows the page's colours.

// Why: notes/decisions/viewing.md, "Statistics and plots of a report are made in Rust, tables and shapes in its script".

use std::fmt::Write as _;

use crate::encode::escaped;
use crate::metric::{ADD_S, Metric};
use crate::row::ReportRow;
use crate::statistics::{Estimate, quantile};

/// Width of a plot; the page scales it.
const WIDTH: f64 = 440.0;
/// Margins on the left and right of the drawn area.
const LEFT: f64 = 40.0;
const RIGHT: f64 = 12.0;
/// Height of the drawn area of plots over time and over the hidden part.
const HEIGHT: f64 = 210.0;
/// Above this ratio of largest to least value an axis is logarithmic.
const LOG_RATIO: f64 = 12.0;
/// Up to this number of runs each has a line of its own.
pub const FEW_RUNS: usize = 5;
/// Number of times at which the errors of many runs are summed up.
const MOMENTS: usize = 80;

/// Row of a plot of means: the values of the runs, and their mean with its interval.
#[derive(Debug, Clone)]
pub struct PlotRow {
    /// Name.
    pub label: String,
    /// Values with the names of their runs.
    pub values: Vec<(f64, String)>,
    /// Mean and interval.
    pub estimate: Option<Estimate>,
}

/// Axis of numbers.
#[derive(Debug, Clone, Copy)]
struct Axis {
    low: f64,
    high: f64,
    is_log: bool,
}

impl Axis {
    /// Returns an axis that holds all values.
    fn new(values: impl Iterator<Item = f64>) -> Self {
        let (low, high) = values
            .filter(|value| value.is_finite())
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)));
        if low > high {
            return Self { low: 0.0, high: 1.0, is_log: false };
        }
        if low > 0.0 && high / low > LOG_RATIO {
            return Self { low: low * 0.9, high: high * 1.1, is_log: true };
        }
        let room = if high > low { 0.05 * (high - low) } else { 0.05 * high.abs().max(1e-3) };
        Self { low: low - room, high: high + room, is_log: false }
    }

    /// Returns the axis, wide enough for differences that are shown.
    fn at_least(self, span: f64) -> Self {
        if self.is_log || self.high - self.low >= span {
            return self;
        }
        let middle = 0.5 * (self.low + self.high);
        Self { low: middle - 0.5 * span, high: middle + 0.5 * span, ..self }
    }

    /// Returns the place of a value from 0 to 1.
    fn place(&self, value: f64) -> f64 {
        let scaled = |v: f64| if self.is_log { v.max(f64::MIN_POSITIVE).ln() } else { v };
        let share = (scaled(value) - scaled(self.low)) / (scaled(self.high) - scaled(self.low));
        share.clamp(0.0, 1.0)
    }

    /// Returns round numbers on the axis.
    fn marks(&self) -> Vec<f64> {
        let is_inside = |mark: &f64| (self.low..=self.high).contains(mark);
        if self.is_log {
            let decades = self.low.log10().floor() as i32..=self.high.log10().ceil() as i32;
            let factors: &[f64] = if self.high / self.low > 1e3 { &[1.0] } else { &[1.0, 2.0, 5.0] };
            return decades.flat_map(|d| factors.iter().map(move |f| f * 10f64.powi(d))).filter(is_inside).collect();
        }
        let rough = (self.high - self.low) / 4.0;
        let decade = 10f64.powf(rough.log10().floor());
        let step = [1.0, 2.0, 5.0].map(|f| f * decade).into_iter().find(|step| *step >= rough).unwrap_or(10.0 * decade);
        let first = (self.low / step).ceil() as i64;
        (0..12).map(|k| (first + k) as f64 * step).filter(is_inside).collect()
    }
}

/// Returns a number as short as it can be.
fn number(value: f64) -> String {
    let text = if value != 0.0 && value.abs() < 1e-3 { format!("{value:.1e}") } else { format!("{value:.3}") };
    if text.contains('.') && !text.contains('e') {
        text.trim_end_matches('0').trim_end_matches('.').to_owned()
    } else {
        text
    }
}

fn frame(title: &str, height: f64, body: &str) -> String {
    let title = escaped(title);
    format!(
        "<figure class=\"plot\"><figcaption>{title}</figcaption>\
         <svg viewBox=\"0 0 {WIDTH} {height:.0}\" role=\"img\" aria-label=\"{title}\">{body}</svg></figure>"
    )
}

/// Plots the values of each row as dots with their mean and its interval.
pub fn rows(title: &str, metric: &Metric, rows: &[PlotRow]) -> String {
    const ROW: f64 = 36.0;
    let ends = rows.iter().filter_map(|row| row.estimate).flat_map(|e| e.interval.unwrap_or([e.mean; 2]));
    let axis = Axis::new(rows.iter().flat_map(|row| row.values.iter().map(|(v, _)| *v)).chain(ends));
    let axis = axis.at_least(4.0 * 10f64.powi(-(metric.digits as i32)));
    let (left, right) = (8.0, WIDTH - RIGHT);
    let x = |value: f64| left + (right - left) * axis.place(value);
    let bottom = ROW * rows.len() as f64;
    let mut body = String::new();
    for mark in axis.marks() {
        let at = x(mark);
        let class = if mark == 0.0 { "grid zero" } else { "grid" };
        let anchor = if at < 24.0 { "start" } else { "middle" };
        let _ = write!(
            body,
            "<path class=\"{class}\" d=\"M{at:.1} 0V{bottom:.0}\"/><text class=\"mark\" x=\"{at:.1}\" y=\"{:.0}\" text-anchor=\"{anchor}\">{}</text>",
            bottom + 14.0,
            number(mark)
        );
    }
    for (k, row) in rows.iter().enumerate() {
        let (top, middle) = (ROW * k as f64 + 12.0, ROW * k as f64 + 24.0);
        let _ = write!(body, "<text class=\"label\" x=\"{left}\" y=\"{top:.0}\">{}</text>", escaped(&row.label));
        for (j, (value, name)) in row.values.iter().enumerate() {
            // Apart from one another, in an order that looks random and is always the same.
            let y = middle + ((j * 7) % 11) as f64 - 5.0;
            let shown = metric.shown(*value);
            let _ = write!(
                body,
                "<circle class=\"dot\" cx=\"{:.1}\" cy=\"{y:.1}\" r=\"2.4\"><title>{}: {shown} {}</title></circle>",
                x(*value),
                escaped(name),
                metric.unit
            );
        }
        let Some(Estimate { mean, interval, .. }) = row.estimate else { continue };
        if let Some([low, high]) = interval {
            let _ = write!(body, "<path class=\"interval\" d=\"M{:.1} {middle}H{:.1}\"/>", x(low), x(high));
        }
        let _ = write!(body, "<circle class=\"mean\" cx=\"{:.1}\" cy=\"{middle}\" r=\"4.5\"/>", x(mean));
        let _ = write!(
            body,
            "<text class=\"value\" x=\"{right}\" y=\"{top:.0}\" text-anchor=\"end\">{}</text>",
            metric.shown(mean)
        );
    }
    frame(title, bottom + 20.0, &body)
}

/// Axes of a plot over `x`, and the functions that place values.
struct Area {
    x: Axis,
    y: Axis,
    body: String,
}

impl Area {
    fn new(x: Axis, y: Axis, x_title: &str) -> Self {
        let mut area = Self { x, y, body: String::new() };
        for mark in y.marks() {
            let at = area.at_y(mark);
            let _ = write!(
                area.body,
                "<path class=\"grid\" d=\"M{LEFT} {at:.1}H{:.0}\"/><text class=\"mark\" x=\"{:.0}\" y=\"{:.1}\" text-anchor=\"end\">{}</text>",
                WIDTH - RIGHT,
                LEFT - 6.0,
                at + 4.0,
                number(mark)
            );
        }
        for mark in x.marks() {
            let _ = write!(
                area.body,
                "<text class=\"mark\" x=\"{:.1}\" y=\"{:.0}\" text-anchor=\"middle\">{}</text>",
                area.at_x(mark),
                HEIGHT + 16.0,
                number(mark)
            );
        }
        let _ = write!(
            area.body,
            "<text class=\"mark\" x=\"{:.0}\" y=\"{:.0}\" text-anchor=\"end\">{}</text>",
            WIDTH - RIGHT,
            HEIGHT + 32.0,
            escaped(x_title)
        );
        area
    }

    fn at_x(&self, value: f64) -> f64 {
        LEFT + (WIDTH - LEFT - RIGHT) * self.x.place(value)
    }

    fn at_y(&self, value: f64) -> f64 {
        6.0 + (HEIGHT - 6.0) * (1.0 - self.y.place(value))
    }

    fn line(&mut self, class: &str, points: impl Iterator<Item = (f64, f64)>) {
        let path: Vec<String> = points.map(|(x, y)| format!("{:.1} {:.1}", self.at_x(x), self.at_y(y))).collect();
        if path.len() > 1 {
            let _ = write!(self.body, "<path class=\"{class}\" d=\"M{}\"/>", path.join("L"));
        }
    }
}

/// Plots a figure against the hidden part of the object, with the medians of quarters of the runs; `None` if too few
/// runs know their hidden part.
pub fn against_hidden(metric: &Metric, rows: &[&ReportRow]) -> Option<String> {
    let mut points: Vec<(f64, f64, &ReportRow)> =
        rows.iter().filter_map(|row| Some((100.0 * row.hidden?, (metric.of)(row)?, *row))).collect();
    if points.len() < FEW_RUNS {
        return None;
    }
    points.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)));
    let (x, y) = (Axis::new(points.iter().map(|p| p.0)), Axis::new(points.iter().map(|p| p.1)));
    let mut area = Area::new(x, y, "hidden from the first camera, %");
    for (hidden, value, row) in &points {
        let (cx, cy) = (area.at_x(*hidden), area.at_y(*value));
        let _ = write!(
            area.body,
            "<circle class=\"dot\" cx=\"{cx:.1}\" cy=\"{cy:.1}\" r=\"2.6\"><title>{}: {} {}</title></circle>",
            escaped(&run_name(row)),
            metric.shown(*value),
            metric.unit
        );
    }
    let median = |values: &mut Vec<f64>| {
        values.sort_by(f64::total_cmp);
        quantile(values, 0.5)
    };
    let quarters: Vec<(f64, f64)> = points
        .chunks(points.len().div_ceil(4))
        .map(|quarter| {
            (median(&mut quarter.iter().map(|p| p.0).collect()), median(&mut quarter.iter().map(|p| p.1).collect()))
        })
        .collect();
    area.line("line", quarters.iter().copied());
    for (hidden, value) in quarters {
        let (cx, cy) = (area.at_x(hidden), area.at_y(value));
        let _ = write!(area.body, "<circle class=\"mean\" cx=\"{cx:.1}\" cy=\"{cy:.1}\" r=\"4.5\"/>");
    }
    Some(frame(&format!("{} against the hidden part, with medians", metric.title()), HEIGHT + 38.0, &area.body))
}

/// Returns object and seed of a run.
pub fn run_name(row: &ReportRow) -> String {
    match row.id.estimator_seed {
        0 => format!("{}, seed {}", row.id.object, row.id.seed),
        other => format!("{}, seed {} + {other}", row.id.object, row.id.seed),
    }
}

/// Plots errors over time: the lines of a few runs, or the median, the middle half and the worst of many. `None` if no
/// run knows its errors over time.
pub fn over_time(rows: &[&ReportRow]) -> Option<String> {
    let known: Vec<&ReportRow> = rows.iter().filter(|row| row.curve.points.len() > 1).copied().collect();
    let points = || known.iter().flat_map(|row| row.curve.points.iter().copied());
    let end_s = points().map(|[time_s, _]| time_s).fold(0.0, f64::max);
    if known.is_empty() || end_s <= 0.0 {
        return None;
    }
    let x = Axis { low: 0.0, high: end_s, is_log: false };
    let mut area = Area::new(x, Axis::new(points().map(|[_, mm]| mm)), "time, s");
    let mut legend = String::new();
    if known.len() <= FEW_RUNS {
        if let [row] = known.as_slice() {
            for [from, to] in &row.curve.lost {
                let (from, to) = (area.at_x(*from), area.at_x(*to));
                let _ = write!(
                    area.body,
                    "<rect class=\"lost\" x=\"{from:.1}\" y=\"6\" width=\"{:.1}\" height=\"{:.0}\"><title>lost</title></rect>",
                    (to - from).max(1.0),
                    HEIGHT - 6.0
                );
            }
        }
        for (k, row) in known.iter().enumerate() {
            area.line(&format!("line c{k}"), row.curve.points.iter().map(|[t, mm]| (*t, *mm)));
            let _ = write!(legend, "<span class=\"key c{k}\">{}</span>", escaped(&run_name(row)));
        }
    } else {
        let times = (0..MOMENTS).map(|k| end_s * (k as f64 + 0.5) / MOMENTS as f64);
        let bands: Vec<(f64, [f64; 3])> = times
            .filter_map(|time_s| {
                let mut errors: Vec<f64> = known.iter().filter_map(|row| error_at(row, time_s)).collect();
                errors.sort_by(f64::total_cmp);
                (!errors.is_empty()).then(|| (time_s, [0.25, 0.5, 0.75].map(|share| quantile(&errors, share))))
            })
            .collect();
        let upper = bands.iter().map(|(t, [.., high])| (*t, *high));
        area.line("band", upper.chain(bands.iter().rev().map(|(t, [low, ..])| (*t, *low))));
        if let Some(worst) = known.iter().max_by(|a, b| a.badness().total_cmp(&b.badness())) {
            area.line("line c1 thin", worst.curve.points.iter().map(|[t, mm]| (*t, *mm)));
            let _ = write!(legend, "<span class=\"key c1\">worst: {}</span>", escaped(&run_name(worst)));
        }
        area.line("line", bands.iter().map(|(t, [_, median, _])| (*t, *median)));
        legend = format!("<span class=\"key c0\">median and middle half of {} runs</span>{legend}", known.len());
    }
    let plot = frame(&format!("{} over time", ADD_S.title().replace(" mean", "")), HEIGHT + 38.0, &area.body);
    Some(plot.replace("</figure>", &format!("<p class=\"legend\">{legend}</p></figure>")))
}

/// Returns the error of a run at a time, interpolated; `None` before its first and after its last point.
fn error_at(row: &ReportRow, time_s: f64) -> Option<f64> {
    let points = &row.curve.points;
    let after = points.partition_point(|[t, _]| *t < time_s);
    let (&[t0, e0], &[t1, e1]) = (points.get(after.checked_sub(1)?)?, points.get(after)?);
    Some(e0 + (e1 - e0) * (time_s - t0) / (t1 - t0))
}

/// Plots the errors of a run over time without axes, for a list.
pub fn sparkline(row: &ReportRow) -> String {
    let points = &row.curve.points;
    let top = points.iter().map(|[_, mm]| *mm).fold(0.0, f64::max);
    let end_s = points.last().map_or(0.0, |[time_s, _]| *time_s);
    if points.len() < 2 || top <= 0.0 || end_s <= 0.0 {
        return String::new();
    }
    let path: Vec<String> =
        points.iter().map(|[t, mm]| format!("{:.1} {:.1}", 200.0 * t / end_s, 38.0 - 36.0 * mm / top)).collect();
    format!(
        "<svg class=\"spark\" viewBox=\"0 0 200 40\" preserveAspectRatio=\"none\" role=\"img\" aria-label=\"ADD-S over time, up to {top:.1} mm\">\
         <path class=\"line\" d=\"M{}\"/></svg><p class=\"faint\">ADD-S over {end_s:.0} s, up to {top:.1} mm</p>",
        path.join("L")
    )
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn marks_are_round_numbers() {
        let of = |values: &[f64]| Axis::new(values.iter().copied()).marks().into_iter().map(number).collect::<Vec<_>>();
        assert_eq!(of(&[0.9, 1.0]), ["0.9", "0.95", "1"]);
        assert_eq!(of(&[0.5, 40.0]), ["0.5", "1", "2", "5", "10", "20"]);
        assert_eq!(of(&[0.0, 100.0]), ["0", "50", "100"]);
        assert_eq!(of(&[]), ["0", "0.5", "1"]);
    }

    proptest! {
        #[test]
        fn any_values_have_places_and_some_marks(values in prop::collection::vec(any::<f64>(), 0..20)) {
            let axis = Axis::new(values.iter().copied());
            prop_assert!(axis.marks().len() <= 700);
            for value in values {
                prop_assert!(value.is_nan() || (0.0..=1.0).contains(&axis.place(value)) || axis.place(value).is_nan());
            }
        }
    }
}
