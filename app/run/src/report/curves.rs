//! `curves.svg`: a run over time.

use std::ops::Range;

use anyhow::{Result, anyhow};
use plotters::coord::Shift;
use plotters::prelude::*;

use mvt_metrics::AddS;

use super::{FrameRow, RunRecord, ShapePoint, TrackState};

const SIZE: (u32, u32) = (960, 1040);
/// Told apart also by people who see red and green alike (Okabe and Ito).
const BLUE: RGBColor = RGBColor(0, 114, 178);
const VERMILION: RGBColor = RGBColor(213, 94, 0);
const PURPLE: RGBColor = RGBColor(204, 121, 167);
const GREEN: RGBColor = RGBColor(0, 158, 115);
const INK: RGBColor = RGBColor(34, 38, 46);
const LOST: RGBColor = RGBColor(230, 159, 0);

/// Errors above this are drawn at it, mm: an object that is lost is astray by more than the rest of the curve would bear.
const CUT_MM: f64 = 20.0;
/// Times above this are drawn at it, for the sake of the rest: the first frame trains the field.
const CUT_MS: f64 = 100.0;

/// A line in a panel: its name, its colour, and its points (time in seconds, value).
type Line = (&'static str, RGBColor, Vec<(f64, f64)>);

/// A quantity over time.
struct Panel {
    name: String,
    /// The axis reaches at least to here.
    least: f64,
    /// Where the curves leave room.
    legend: SeriesLabelPosition,
    lines: Vec<Line>,
}

/// Pose error, shape scores, confidence and time per frame as SVG, one above the other. Spans in which the tracker had lost the object
/// are shaded.
///
/// # Errors
/// If the drawing library fails, which it has no reason to.
pub fn curves(run: &RunRecord) -> Result<String> {
    let mut svg = String::new();
    // The library's errors borrow the drawing area, so they are made into words here.
    draw(run, &SVGBackend::with_string(&mut svg, SIZE).into_drawing_area())
        .map_err(|error| anyhow!("cannot draw the curves: {error}"))?;
    Ok(svg)
}

fn draw<B: DrawingBackend>(
    run: &RunRecord,
    area: &DrawingArea<B, Shift>,
) -> Result<(), DrawingAreaErrorKind<B::ErrorType>> {
    area.fill(&WHITE)?;
    let state = if run.complete { "" } else { ", interrupted" };
    let title = format!("{}, seed {}, {} {}{state}", run.object, run.seed, run.mode, run.modality);
    let area = area.titled(&title, ("sans-serif", 24).into_font().color(&INK))?;
    let of_frames = |value: fn(&FrameRow) -> f64| run.frames.iter().map(|row| (row.time_s, value(row))).collect();
    let of_shape = |value: fn(&ShapePoint) -> f64| run.shape.iter().map(|p| (p.time_s, value(p))).collect();
    let error = |of: fn(&AddS) -> f64| {
        let rows = run.frames.iter().filter_map(|row| Some((row.time_s, of(row.add_s.as_ref()?))));
        rows.map(|(time_s, error_m)| (time_s, (error_m * 1e3).min(CUT_MM))).collect::<Vec<_>>()
    };
    let panels = [
        Panel {
            name: format!("ADD-S, mm (cut at {CUT_MM})"),
            least: 1.0,
            legend: SeriesLabelPosition::UpperLeft,
            lines: vec![
                ("symmetric", VERMILION, error(|e| e.symmetric_m)),
                ("as NeuralFeels", BLUE, error(|e| e.one_directional_m)),
            ],
        },
        Panel {
            name: "shape score".to_owned(),
            least: 1.0,
            legend: SeriesLabelPosition::LowerRight,
            lines: vec![
                ("F at 5 mm", BLUE, of_shape(|p| p.f5)),
                ("F at 2 mm", VERMILION, of_shape(|p| p.f2)),
                ("precision at 5 mm", PURPLE, of_shape(|p| p.precision5)),
                ("recall at 5 mm", GREEN, of_shape(|p| p.recall5)),
            ],
        },
        Panel {
            name: "confidence".to_owned(),
            least: 1.0,
            legend: SeriesLabelPosition::LowerRight,
            lines: vec![("", BLUE, of_frames(|row| row.confidence))],
        },
        Panel {
            name: format!("ms per frame (cut at {CUT_MS})"),
            least: 1.0,
            legend: SeriesLabelPosition::UpperLeft,
            lines: vec![
                ("all stages", INK, of_frames(|row| row.stage_ms.total().min(CUT_MS))),
                ("track", BLUE, of_frames(|row| row.stage_ms.track.min(CUT_MS))),
                ("map", VERMILION, of_frames(|row| row.stage_ms.map.min(CUT_MS))),
            ],
        },
    ];
    let end = run.frames.last().map_or(1.0, |row| row.time_s).max(1e-3);
    let begin = run.frames.first().map_or(0.0, |row| row.time_s).min(end - 1e-3);
    let spans = lost_spans(run);
    for (area, panel) in area.split_evenly((4, 1)).iter().zip(panels) {
        panel.draw(area, begin..end, &spans)?;
    }
    area.present()
}

impl Panel {
    fn draw<B: DrawingBackend>(
        self,
        area: &DrawingArea<B, Shift>,
        times: Range<f64>,
        lost: &[Range<f64>],
    ) -> Result<(), DrawingAreaErrorKind<B::ErrorType>> {
        let values = self.lines.iter().flat_map(|(_, _, points)| points).map(|p| p.1).filter(|v| v.is_finite());
        let top = values.fold(self.least, f64::max) * 1.05;
        let mut chart = ChartBuilder::on(area)
            .margin(8)
            .margin_right(20)
            .x_label_area_size(34)
            .y_label_area_size(64)
            .build_cartesian_2d(times, 0.0..top)?;
        chart.draw_series(
            lost.iter().map(|span| Rectangle::new([(span.start, 0.0), (span.end, top)], LOST.mix(0.25).filled())),
        )?;
        chart
            .configure_mesh()
            .light_line_style(TRANSPARENT)
            .bold_line_style(INK.mix(0.12))
            .axis_style(INK.mix(0.5))
            .label_style(("sans-serif", 14).into_font().color(&INK))
            .x_desc("s")
            .y_desc(&self.name)
            .y_labels(6)
            .draw()?;
        let has_names = self.lines.iter().any(|(label, ..)| !label.is_empty());
        for (label, color, points) in self.lines {
            let finite = points.into_iter().filter(|p| p.1.is_finite());
            let line = chart.draw_series(LineSeries::new(finite, color.stroke_width(2)))?;
            if !label.is_empty() {
                line.label(label).legend(move |(x, y)| PathElement::new([(x, y), (x + 16, y)], color.stroke_width(2)));
            }
        }
        if has_names {
            chart
                .configure_series_labels()
                .position(self.legend)
                .background_style(WHITE.mix(0.8))
                .label_font(("sans-serif", 14).into_font().color(&INK))
                .draw()?;
        }
        Ok(())
    }
}

/// The spans of time from a frame at which the object was lost to the next at which it was not.
pub(super) fn lost_spans(run: &RunRecord) -> Vec<Range<f64>> {
    let mut spans: Vec<Range<f64>> = Vec::new();
    let mut was_lost = false;
    for row in &run.frames {
        let is_lost = row.state == TrackState::Lost;
        match spans.last_mut() {
            Some(span) if was_lost => span.end = row.time_s,
            _ if is_lost => spans.push(row.time_s..row.time_s),
            _ => {}
        }
        was_lost = is_lost;
    }
    spans
}
