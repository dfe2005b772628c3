//! Curves, described once and drawn by the same code into an image or as SVG.
//!
//! An image gets the compact form, which fits a strip of a film: the title and the upper end of the axis. SVG gets axes
//! with marks, and a legend of the lines that have names.

mod canvas;

use std::ops::Range;

use image::{Rgb, RgbImage};

use crate::draw::Area;
use crate::palette::{LOST_SPAN, Theme};
use canvas::{Anchor, Canvas, SvgCanvas};

/// Curve of one quantity.
#[derive(Debug, Clone, PartialEq)]
pub struct ChartLine {
    /// Name in the legend; empty for none.
    pub name: String,
    /// Colour.
    pub colour: Rgb<u8>,
    /// Points in the order in which they are joined. Points that are not finite are left out.
    pub points: Vec<(f64, f64)>,
}

/// Row of bars that mark spans of the horizontal axis.
#[derive(Debug, Clone, PartialEq)]
pub struct ChartLane {
    /// Name on the left.
    pub name: String,
    /// Colour.
    pub colour: Rgb<u8>,
    /// Marked spans.
    pub spans: Vec<Range<f64>>,
}

/// Vertical axis. Values outside of it are drawn at its ends.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ChartScale {
    /// From 0 to `top`.
    Linear {
        /// Upper end.
        top: f64,
    },
    /// Logarithmic from `bottom` to `top`, both greater than 0.
    Log {
        /// Lower end.
        bottom: f64,
        /// Upper end.
        top: f64,
    },
}

/// Plot of lines or of lanes over a common horizontal axis.
#[derive(Debug, Clone, PartialEq)]
pub struct ChartPanel {
    /// Quantity and unit.
    pub title: String,
    /// Ends of the horizontal axis.
    pub span: Range<f64>,
    /// Unit of the horizontal axis.
    pub unit: String,
    /// Vertical axis of the lines.
    pub scale: ChartScale,
    /// Lines; later ones are drawn over earlier ones.
    pub lines: Vec<ChartLine>,
    /// Lanes, from top to bottom.
    pub lanes: Vec<ChartLane>,
    /// Spans of the horizontal axis with a shaded background.
    pub shaded: Vec<Range<f64>>,
    /// Position of a vertical line.
    pub cursor: Option<f64>,
}

/// Height of a title, of its letters and of small letters, pixels.
const TITLE: f32 = 16.0;
/// More room below the title of an SVG, for the uppermost mark, pixels.
const ABOVE: f32 = 6.0;
const LETTERS: f32 = 13.0;
const SMALL: f32 = 11.0;
/// Width of the names of lanes, pixels.
const NAMES: f32 = 44.0;
/// Room for the marks of the axes of an SVG, pixels.
const LEFT: f32 = 56.0;
const BOTTOM: f32 = 20.0;
/// Width of an SVG, height of its title and of each panel, and margin, pixels.
const SVG_WIDTH: f32 = 960.0;
const SVG_TITLE: f32 = 40.0;
const SVG_PANEL: f32 = 250.0;
const SVG_MARGIN: f32 = 14.0;

impl ChartScale {
    /// Position of a value between the lower end (0) and the upper end (1).
    fn share(self, value: f64) -> f32 {
        let share = match self {
            Self::Linear { top } => value / top,
            Self::Log { bottom, top } => (value / bottom).ln() / (top / bottom).ln(),
        };
        // An axis without length gives NaN.
        if share.is_nan() { 0.0 } else { share.clamp(0.0, 1.0) as f32 }
    }

    /// Marks with their labels.
    fn marks(self) -> Vec<(f64, String)> {
        match self {
            Self::Linear { top } => labelled_marks(0.0, top),
            Self::Log { bottom, top } => {
                let decades = bottom.log10().floor() as i32..=top.log10().ceil() as i32;
                let values = decades.take(40).flat_map(|k| [1.0, 2.0, 5.0].map(|step| step * 10f64.powi(k)));
                values.filter(|v| (bottom..=top).contains(v)).map(|v| (v, format!("{v}"))).collect()
            }
        }
    }
}

/// Returns three to six marks at round numbers between two numbers, and the distance between marks.
pub fn round_marks(low: f64, high: f64) -> (Vec<f64>, f64) {
    let span = (high - low).max(1e-9);
    let decade = 10f64.powf((span / 3.0).log10().floor());
    let step = [5.0, 2.0].into_iter().map(|k| k * decade).find(|step| 3.0 * step <= span).unwrap_or(decade);
    let marks = (low / step).ceil() as i64..=(high / step).floor() as i64;
    (marks.take(16).map(|k| k as f64 * step).filter(|mark| mark.is_finite()).collect(), step)
}

/// Returns a mark as text, with enough decimals to differ from the next mark at a distance of `step`.
pub fn mark_label(mark: f64, step: f64) -> String {
    let decimals = (-step.log10() - 1e-9).ceil().clamp(0.0, 6.0) as usize;
    format!("{mark:.decimals$}")
}

fn labelled_marks(low: f64, high: f64) -> Vec<(f64, String)> {
    let (marks, step) = round_marks(low, high);
    marks.into_iter().map(|mark| (mark, mark_label(mark, step))).collect()
}

/// Returns a round upper end for an axis from 0: the next of 1, 2 or 5 times a power of ten above 98 % of the values. A
/// few outliers do not flatten the curve.
pub fn round_top(points: &[(f64, f64)]) -> f64 {
    let mut values: Vec<f64> = points.iter().map(|(_, y)| *y).filter(|y| y.is_finite()).collect();
    values.sort_by(f64::total_cmp);
    round_up(values.get(values.len() * 98 / 100).copied().unwrap_or(1.0))
}

fn round_up(value: f64) -> f64 {
    if value.is_nan() || value < 1e-6 {
        return 1.0;
    }
    let power = 10f64.powf(value.log10().floor());
    [1.0, 2.0, 5.0, 10.0]
        .map(|step| step * power)
        .into_iter()
        .find(|step| *step >= value * (1.0 - 1e-9))
        .unwrap_or(value)
}

/// Draws a panel in compact form into a rectangle of an image.
pub fn draw(image: &mut RgbImage, area: Area, panel: &ChartPanel, theme: &Theme) {
    let [x, y, width, height] = [area.x, area.y, area.width, area.height].map(|n| n as f32);
    panel.draw(image, [x, y, x + width, y + height], theme, false);
}

/// Returns panels below a title as an SVG document, 960 pixels wide.
pub fn svg(title: &str, panels: &[ChartPanel], theme: &Theme) -> String {
    let height = SVG_TITLE + SVG_PANEL * panels.len() as f32;
    let mut canvas = SvgCanvas::new(SVG_WIDTH, height);
    canvas.rectangle([0.0, 0.0, SVG_WIDTH, height], theme.paper, 1.0);
    canvas.text((0.5 * SVG_WIDTH, 10.0), Anchor::Middle, 22.0, theme.ink, title);
    for (k, panel) in panels.iter().enumerate() {
        let top = SVG_TITLE + SVG_PANEL * k as f32;
        let area = [SVG_MARGIN, top, SVG_WIDTH - SVG_MARGIN, top + SVG_PANEL - SVG_MARGIN];
        panel.draw(&mut canvas, area, theme, true);
    }
    canvas.finish()
}

impl ChartPanel {
    fn draw(&self, canvas: &mut impl Canvas, [left, top, right, bottom]: [f32; 4], theme: &Theme, has_axes: bool) {
        canvas.text((left, top), Anchor::Start, LETTERS, theme.ink, &self.title);
        let axis = match (has_axes, self.lanes.is_empty()) {
            (true, true) => LEFT,
            (false, true) => 0.0,
            (_, false) => NAMES,
        };
        let upper = (top + TITLE + if has_axes { ABOVE } else { 0.0 }).min(bottom);
        let lower = if has_axes { (bottom - BOTTOM).max(upper) } else { bottom };
        let from = if has_axes { left + axis } else { left };
        canvas.rectangle([from, upper, right, lower], theme.panel, 1.0);
        let start = (left + axis).min(right);
        let length = self.span.end - self.span.start;
        let column = |x: f64| {
            let share = (x - self.span.start) / length;
            start + if share.is_nan() { 0.0 } else { share.clamp(0.0, 1.0) as f32 } * (right - start - 1.0).max(0.0)
        };
        let row = |y: f64| lower - 2.0 - self.scale.share(y) * (lower - upper - 2.0).max(0.0);
        for shaded in &self.shaded {
            canvas.rectangle([column(shaded.start), upper, column(shaded.end), lower], LOST_SPAN, 0.25);
        }
        if has_axes {
            let mut marks = labelled_marks(self.span.start, self.span.end);
            if let Some((_, last)) = marks.last_mut() {
                *last = format!("{last} {}", self.unit);
            }
            for (x, label) in marks {
                canvas.rectangle([column(x), upper, column(x) + 1.0, lower], theme.ink, 0.12);
                canvas.text((column(x), lower + 4.0), Anchor::Middle, LETTERS, theme.ink, &label);
            }
            for (y, label) in if self.lines.is_empty() { Vec::new() } else { self.scale.marks() } {
                canvas.rectangle([start, row(y), right, row(y) + 1.0], theme.ink, 0.12);
                canvas.text((start - 6.0, row(y) - 0.5 * LETTERS), Anchor::End, LETTERS, theme.ink, &label);
            }
            self.legend(canvas, right, top, theme);
        }
        for line in &self.lines {
            let finite = line.points.iter().filter(|(x, y)| x.is_finite() && y.is_finite());
            let points: Vec<(f32, f32)> = finite.map(|&(x, y)| (column(x), row(y))).collect();
            canvas.polyline(&points, line.colour);
        }
        if let (false, false, ChartScale::Linear { top }) = (has_axes, self.lines.is_empty(), self.scale) {
            canvas.text((start + 3.0, upper), Anchor::Start, SMALL, theme.faint, &format!("{top}"));
        }
        let height = (lower - upper) / self.lanes.len().max(1) as f32;
        for (k, lane) in self.lanes.iter().enumerate() {
            let top = upper + k as f32 * height;
            for span in &lane.spans {
                let (from, to) = (column(span.start), column(span.end));
                canvas.rectangle([from, top + 2.0, to.max(from + 1.0), top + height - 2.0], lane.colour, 1.0);
            }
            canvas.text((left + 3.0, top + 0.5 * height - 7.0), Anchor::Start, SMALL, theme.ink, &lane.name);
        }
        if let Some(cursor) = self.cursor {
            canvas.rectangle([column(cursor), upper, column(cursor) + 1.0, lower], theme.ink, 0.8);
        }
    }

    /// Names of the lines with their colours, at the right of the title.
    fn legend(&self, canvas: &mut impl Canvas, right: f32, top: f32, theme: &Theme) {
        let mut end = right;
        for line in self.lines.iter().rev().filter(|line| !line.name.is_empty()) {
            canvas.text((end, top), Anchor::End, LETTERS, theme.ink, &line.name);
            // Fonts of viewers differ in width.
            let width = 1.25 * crate::text::width(LETTERS, &line.name) as f32;
            canvas.rectangle([end - width - 22.0, top + 7.0, end - width - 4.0, top + 10.0], line.colour, 1.0);
            end -= width + 40.0;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn panel(points: Vec<(f64, f64)>) -> ChartPanel {
        ChartPanel {
            title: "loss & <error>".into(),
            span: 0.0..1.0,
            unit: "s".into(),
            scale: ChartScale::Linear { top: 1.0 },
            lines: vec![ChartLine { name: "loss".into(), colour: Rgb([255; 3]), points }],
            lanes: Vec::new(),
            shaded: vec![0.25..0.5, f64::NAN..2.0],
            cursor: Some(f64::INFINITY),
        }
    }

    #[test]
    fn scales_end_at_round_numbers() {
        for (value, expected) in [(0.3, 0.5), (1.0, 1.0), (1.1, 2.0), (37.0, 50.0), (99.0, 100.0), (0.0, 1.0)] {
            assert!((round_up(value) - expected).abs() < 1e-5 * expected, "{value}");
        }
        assert_eq!(round_up(f64::NAN), 1.0);
        assert_eq!(round_top(&[]), 1.0);
    }

    #[test]
    fn axes_have_a_few_round_marks_that_differ() {
        for (low, high) in [(0.0, 1.08), (0.0, 2.2), (0.0, 700.0), (-0.5, 3.5), (0.0, 29.97), (3.0, 3.0), (0.0, 1e-3)] {
            let labels: Vec<String> = labelled_marks(low, high).into_iter().map(|(_, label)| label).collect();
            assert!(high <= low || (3..=7).contains(&labels.len()), "{labels:?}");
            assert!(labels.windows(2).all(|pair| pair[0] != pair[1]), "{labels:?}");
        }
        for (low, high) in [(f64::NAN, 1.0), (0.0, f64::INFINITY), (1.0, 0.0)] {
            assert!(round_marks(low, high).0.len() <= 16);
        }
        let log = ChartScale::Log { bottom: 0.03, top: 3.0 }.marks();
        let labels: Vec<&str> = log.iter().map(|(_, label)| label.as_str()).collect();
        assert_eq!(labels, ["0.05", "0.1", "0.2", "0.5", "1", "2"]);
    }

    #[test]
    fn a_line_rises_from_left_to_right() {
        let area = Area { x: 2, y: 3, width: 40, height: 46 };
        let mut image = RgbImage::new(50, 60);
        let blank = ChartPanel { title: String::new(), shaded: Vec::new(), cursor: None, ..panel(Vec::new()) };
        let rising = ChartPanel { lines: panel(vec![(0.0, 0.0), (1.0, 1.0)]).lines, ..blank };
        draw(&mut image, area, &rising, &Theme::DARK);
        // The upper end of the axis is labelled on the left.
        let brightest = |x: u32| (30..60).chain(3..30).max_by_key(|y| image.get_pixel(x, *y).0[0]);
        assert!(brightest(3) > Some(40) && brightest(40) < Some(26), "{:?} {:?}", brightest(3), brightest(40));
    }

    #[test]
    fn numbers_that_are_not_finite_do_no_harm() {
        for wrong in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 0.0, 1e300] {
            for scale in [ChartScale::Linear { top: wrong }, ChartScale::Log { bottom: wrong, top: 1.0 }] {
                let points = vec![(0.0, wrong), (wrong, 1.0), (9.0, 1e30), (1.0, 0.5)];
                let panel = ChartPanel { scale, span: 0.0..wrong, ..panel(points) };
                draw(&mut RgbImage::new(50, 40), Area { x: 2, y: 3, width: 40, height: 30 }, &panel, &Theme::LIGHT);
                let text = svg("run", std::slice::from_ref(&panel), &Theme::LIGHT);
                assert!(!text.contains("NaN") && !text.contains("inf"), "{text}");
                assert!(text.contains("loss &amp; &lt;error&gt;"));
            }
        }
    }
}
