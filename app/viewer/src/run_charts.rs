//! Curves of a run with a cursor at a moment.

use image::{Rgb, RgbImage};
use mvt_picture::chart::{self, ChartLane, ChartLine, ChartPanel, ChartScale, round_top};
use mvt_picture::draw::Area;
use mvt_picture::palette::{Theme, pad_colour};
use mvt_recording::{RecordedMoment, Recording};
use mvt_robot::hand::TouchPad;
use mvt_run::report::FrameRow;

use crate::captions;

/// Distance between panels, pixels.
const GAP: u32 = 8;

/// Draws side by side the error of the pose and the F-score, or the stated deviation where no truth is known, the
/// confidence, the time per frame, and the contacts of the pads. A log has no estimate: only its contacts are drawn.
pub fn draw(image: &mut RgbImage, area: Area, recording: &Recording, moment: usize, theme: &Theme) {
    let panels = panels(recording, moment, theme);
    let width = (area.width + GAP) / (panels.len() as u32).max(1);
    for (k, panel) in (0..).zip(&panels) {
        let x = area.x + k * width;
        chart::draw(image, Area { x, width: width.saturating_sub(GAP), ..area }, panel, theme);
    }
}

fn panels(recording: &Recording, moment: usize, theme: &Theme) -> Vec<ChartPanel> {
    let moments = recording.moments();
    let Some((first, now)) = moments.first().zip(moments.get(moment)) else { return Vec::new() };
    let (begin_s, now_s) = (first.row.time_s, now.row.time_s);
    let end_s = moments.last().map_or(begin_s, |last| last.row.time_s).max(begin_s + 1e-3);
    let panel = |title: String| ChartPanel {
        title,
        span: begin_s..end_s,
        unit: "s".to_owned(),
        scale: ChartScale::Linear { top: 1.0 },
        lines: Vec::new(),
        lanes: Vec::new(),
        shaded: Vec::new(),
        cursor: Some(now_s),
    };
    let curve = |title: &str, points: Vec<(f64, f64)>, is_share: bool, colour: Rgb<u8>| {
        let value = points.iter().rev().find(|(time_s, _)| *time_s <= now_s + 1e-6).map(|(_, value)| *value);
        let digits = if is_share { 2 } else { 1 };
        let top = if is_share { 1.0 } else { round_top(&points) };
        ChartPanel {
            scale: ChartScale::Linear { top },
            lines: vec![ChartLine { name: String::new(), colour, points }],
            ..panel(value.map_or_else(|| title.to_owned(), |value| format!("{title}: {value:.digits$}")))
        }
    };
    let per_frame = |value: &dyn Fn(&FrameRow) -> Option<f64>| -> Vec<(f64, f64)> {
        let estimated = moments.iter().filter(|m| m.estimate().is_some());
        estimated.filter_map(|m| Some((m.row.time_s, value(&m.row)?))).collect()
    };
    let mut panels = Vec::new();
    if first.estimate().is_some() {
        let scores = recording.shapes().iter().filter_map(|shape| shape.point).map(|point| (point.time_s, point.f5));
        let errors_mm = per_frame(&|row| Some(row.add_s?.one_directional_m * 1e3));
        if errors_mm.is_empty() {
            let deviations_mm = per_frame(&|row| Some(row.deviation?.surface_m * 1e3));
            panels.push(curve("stated deviation, mm", deviations_mm, false, theme.estimate));
        } else {
            let errors = curve("ADD-S, mm", errors_mm, false, theme.estimate);
            panels.push(match captions::begins_errors(recording, moment) {
                true => ChartPanel { title: "ADD-S, mm: begins here".to_owned(), ..errors },
                false => errors,
            });
            panels.push(curve("F-score at 5 mm", scores.collect(), true, theme.truth));
        }
        panels.push(curve("confidence", per_frame(&|row| Some(row.confidence)), true, theme.keyframe));
        panels.push(curve("ms per frame", per_frame(&|row| Some(row.stage_ms.total())), false, theme.faint));
    }
    // A contact lasts until the next moment.
    let ends_s = || moments.iter().skip(1).map(|m| m.row.time_s).chain([end_s]);
    let lane = |(k, pad): (usize, &TouchPad)| {
        let touches = |(m, _): &(&RecordedMoment, f64)| m.touching.get(k).is_some_and(Option::is_some);
        let touching = moments.iter().zip(ends_s()).filter(touches);
        let spans = touching.map(|(m, end_s)| m.row.time_s..end_s).collect();
        ChartLane { name: pad.name.clone(), colour: pad_colour(k), spans }
    };
    let lanes: Vec<ChartLane> = recording.about().hand.pads().iter().enumerate().map(lane).collect();
    if !lanes.is_empty() {
        panels.push(ChartPanel { lanes, ..panel("contact".to_owned()) });
    }
    panels
}
