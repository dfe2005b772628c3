//! `curves.svg`: a run over time.

use std::ops::Range;

use image::Rgb;
use mvt_picture::chart::{self, ChartLine, ChartPanel, ChartScale};
use mvt_picture::palette::{CURVES, Theme};

use super::{FrameRow, RunRecord, ShapePoint, TrackState};

/// Larger errors are drawn at this value, mm, because the error of a lost object would flatten the rest of the curve.
const CUT_MM: f64 = 20.0;
/// Larger rotation errors are drawn at this value, degrees.
const CUT_DEG: f64 = 30.0;
/// Longer times are drawn at this value, ms, because the first frame, which trains the field, would flatten the rest.
const CUT_MS: f64 = 100.0;

/// Points of a line: time in seconds, and value.
type Points = Vec<(f64, f64)>;

/// Draws pose and rotation error, shape scores, confidence and time per frame as SVG, one above the other. Spans in which the
/// tracker has lost the object are shaded.
pub fn curves(run: &RunRecord) -> String {
    let state = if run.complete { "" } else { ", interrupted" };
    let title = format!("{}, seed {}, {} {}{state}", run.object, run.seed, run.mode, run.modality);
    let of_frames = |value: fn(&FrameRow) -> f64| run.frames.iter().map(|row| (row.time_s, value(row))).collect();
    let of_shape = |value: fn(&ShapePoint) -> f64| run.shape.iter().map(|p| (p.time_s, value(p))).collect();
    let of_some = |value: fn(&FrameRow) -> Option<f64>, factor: f64, cut: f64| -> Points {
        run.frames.iter().filter_map(|row| Some((row.time_s, (value(row)? * factor).min(cut)))).collect()
    };
    let error = |of: fn(&FrameRow) -> Option<f64>| of_some(of, 1e3, CUT_MM);
    let degrees = |of: fn(&FrameRow) -> Option<f64>, count: f64| of_some(of, count.to_degrees(), CUT_DEG);
    let end = run.frames.last().map_or(1.0, |row| row.time_s).max(1e-3);
    let begin = run.frames.first().map_or(0.0, |row| row.time_s).min(end - 1e-3);
    let spans = lost_spans(run);
    let panel = |title: String, lines: Vec<(&str, Rgb<u8>, Points)>| {
        let values = lines.iter().flat_map(|(_, _, points)| points).map(|p| p.1).filter(|v| v.is_finite());
        ChartPanel {
            title,
            span: begin..end,
            unit: "s".to_owned(),
            scale: ChartScale::Linear { top: values.fold(1.0, f64::max) * 1.05 },
            lines: lines
                .into_iter()
                .map(|(name, colour, points)| ChartLine { name: name.to_owned(), colour, points })
                .collect(),
            lanes: Vec::new(),
            shaded: spans.clone(),
            cursor: None,
        }
    };
    let [blue, vermilion, green, purple] = CURVES;
    let panels = [
        panel(
            format!("ADD-S, mm (cut at {CUT_MM})"),
            vec![
                ("symmetric", vermilion, error(|row| Some(row.add_s?.symmetric_m))),
                ("as NeuralFeels", blue, error(|row| Some(row.add_s?.one_directional_m))),
                ("two stated deviations", green, error(|row| Some(2.0 * row.deviation?.surface_m))),
            ],
        ),
        panel(
            format!("rotation error, degrees (cut at {CUT_DEG})"),
            vec![
                ("error", blue, degrees(FrameRow::rotation_error_rad, 1.0)),
                ("two stated deviations", green, degrees(|row| Some(row.deviation?.angle_rad), 2.0)),
            ],
        ),
        panel(
            "shape score".to_owned(),
            vec![
                ("F at 5 mm", blue, of_shape(|p| p.f5)),
                ("F at 2 mm", vermilion, of_shape(|p| p.f2)),
                ("precision at 5 mm", purple, of_shape(|p| p.precision5)),
                ("recall at 5 mm", green, of_shape(|p| p.recall5)),
            ],
        ),
        panel("confidence".to_owned(), vec![("", blue, of_frames(|row| row.confidence))]),
        panel(
            format!("ms per frame (cut at {CUT_MS})"),
            vec![
                ("all stages", Theme::LIGHT.ink, of_frames(|row| row.stage_ms.total().min(CUT_MS))),
                ("track", blue, of_frames(|row| row.stage_ms.track.min(CUT_MS))),
                ("map", vermilion, of_frames(|row| row.stage_ms.map.min(CUT_MS))),
            ],
        ),
    ];
    chart::svg(&title, &panels, &Theme::LIGHT)
}

/// Returns the spans of time from a frame at which the object was lost to the next at which it was not.
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
