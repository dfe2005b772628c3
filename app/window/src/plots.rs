//! Plots of a run with a cursor at the shown moment.

use std::ops::RangeInclusive;

use eframe::egui::{self, Id, Ui, Vec2b};
use egui_plot::{AxisHints, GridMark, Line, Plot, PlotPoint, PlotPoints, Points, VLine};
use mvt_picture::chart;
use mvt_picture::palette::{CURVES, Theme, pad_colour};
use mvt_recording::{RecordedMoment, Recording};
use mvt_run::report::{FrameRow, StageMs};
use serde::{Deserialize, Serialize};

use super::style::{self, colour};

/// Threshold of the F-score that is plotted.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Threshold {
    /// 2 mm.
    #[serde(rename = "2 mm")]
    Two,
    /// 5 mm.
    #[default]
    #[serde(rename = "5 mm")]
    Five,
}

impl Threshold {
    /// All thresholds.
    pub const ALL: [Self; 2] = [Self::Two, Self::Five];

    /// Returns its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Two => "2 mm",
            Self::Five => "5 mm",
        }
    }
}

type Curve = Vec<PlotPoint>;

/// Curves of one run.
#[derive(Default)]
struct RunCurves {
    /// Revision of the recording that the curves belong to.
    revision: Option<u64>,
    add_s_mm: Curve,
    rotation_deg: Curve,
    confidence: Curve,
    /// Sense, track, map, mesh.
    stages_ms: [Curve; 4],
    /// Sum of the stages.
    total_ms: Curve,
    /// At 2 and 5 mm.
    f_scores: [Curve; 2],
    /// Name of each pad, and when it touches.
    contacts: Vec<(String, Curve)>,
}

/// Row of plots of one recording, or of two that are compared.
#[derive(Default)]
pub struct PlotRow {
    runs: Vec<RunCurves>,
    /// Shown span of time, seconds; `None` shows all.
    zoomed_s: Option<[f64; 2]>,
}

/// Most points of a curve. Longer curves are thinned.
const MOST_POINTS: usize = 1200;
/// Shortest span of time that is shown, seconds: a few frames.
const SHORTEST_S: f64 = 0.2;

impl RunCurves {
    fn update(&mut self, recording: &Recording) {
        let (moments, shapes) = (recording.moments(), recording.shapes());
        if self.revision == Some(recording.revision()) {
            return;
        }
        let step = moments.len().div_ceil(MOST_POINTS).max(1);
        let estimated = || moments.iter().filter(|moment| moment.estimate().is_some()).map(|moment| &moment.row);
        let error = |row: &FrameRow| Some(PlotPoint::new(row.time_s, row.add_s?.one_directional_m * 1e3));
        let turn = |row: &FrameRow| Some(PlotPoint::new(row.time_s, row.rotation_error_rad()?.to_degrees()));
        let stage = |ms: fn(&StageMs) -> f64| {
            estimated().step_by(step).map(|row| PlotPoint::new(row.time_s, ms(&row.stage_ms))).collect()
        };
        let pads = recording.about().hand.pads();
        let touches = |pad: usize| {
            let height = (pads.len() - 1 - pad) as f64;
            let is_touching = |moment: &&RecordedMoment| moment.touching.get(pad).is_some_and(Option::is_some);
            let touching = moments.iter().filter(is_touching).step_by(step);
            touching.map(|moment| PlotPoint::new(moment.row.time_s, height)).collect()
        };
        let points = || shapes.iter().filter_map(|shape| shape.point);
        *self = Self {
            revision: Some(recording.revision()),
            add_s_mm: estimated().step_by(step).filter_map(error).collect(),
            rotation_deg: estimated().step_by(step).filter_map(turn).collect(),
            confidence: estimated().step_by(step).map(|row| PlotPoint::new(row.time_s, row.confidence)).collect(),
            stages_ms: [stage(|ms| ms.sense), stage(|ms| ms.track), stage(|ms| ms.map), stage(|ms| ms.mesh)],
            total_ms: stage(|ms| ms.total()),
            f_scores: [
                points().map(|point| PlotPoint::new(point.time_s, point.f2)).collect(),
                points().map(|point| PlotPoint::new(point.time_s, point.f5)).collect(),
            ],
            contacts: pads.iter().enumerate().map(|(k, pad)| (pad.name.clone(), touches(k))).collect(),
        };
    }
}

impl PlotRow {
    /// Draws the row of plots. Two recordings share the plots. Returns the time that was clicked, seconds.
    pub fn ui(&mut self, ui: &mut Ui, recordings: &[&Recording], now_s: f64, threshold: &mut Threshold) -> Option<f64> {
        self.runs.resize_with(recordings.len(), RunCurves::default);
        for (curves, recording) in self.runs.iter_mut().zip(recordings) {
            curves.update(recording);
        }
        let end_s = recordings.iter().filter_map(|recording| recording.moments().last()).map(|last| last.row.time_s);
        let end_s = end_s.fold(0.1, f64::max);
        let Self { runs, zoomed_s } = self;
        let mut frame = PlotFrame { now_s, end_s, zoomed_s, theme: style::theme(ui.ctx()) };
        let width = ui.available_width();
        // A log has contacts alone.
        let is_estimated = recordings.iter().any(|recording| recording.about().mode.is_some());
        let is_comparison = recordings.len() > 1;
        let has_contacts = !is_comparison && runs.iter().any(|run| !run.contacts.is_empty());
        let count = f32::from(5 * u8::from(is_estimated) + u8::from(has_contacts)).max(1.0);
        // A narrow window scrolls the plots instead of squeezing them.
        let each = ((width - (count - 1.0) * ui.spacing().item_spacing.x) / count).max(170.0);
        let height = ui.available_height();
        let mut clicked = None;
        let of_runs = |curve: fn(&RunCurves) -> &Curve| -> Vec<(&Curve, usize)> {
            runs.iter().enumerate().map(|(k, run)| (curve(run), k)).collect()
        };
        egui::ScrollArea::horizontal().auto_shrink(false).show(ui, |ui| {
            ui.horizontal_top(|ui| {
                let mut cell = |ui: &mut Ui, add: &mut dyn FnMut(&mut Ui) -> Option<f64>| {
                    ui.allocate_ui(egui::vec2(each, height), |ui| {
                        ui.vertical(|ui| {
                            ui.set_width(each);
                            clicked = add(ui).or(clicked);
                        });
                    });
                };
                if is_estimated {
                    cell(ui, &mut |ui| {
                        title(ui, "ADD-S, mm");
                        frame.plot(ui, "ADD-S in millimetres", &of_runs(|run| &run.add_s_mm))
                    });
                    cell(ui, &mut |ui| {
                        title(ui, "rotation error, °");
                        frame.plot(ui, "rotation error in degrees", &of_runs(|run| &run.rotation_deg))
                    });
                    cell(ui, &mut |ui| {
                        ui.horizontal(|ui| {
                            ui.strong("F-score at");
                            ui.spacing_mut().button_padding.y = 0.0;
                            for choice in Threshold::ALL {
                                ui.selectable_value(threshold, choice, choice.name());
                            }
                        });
                        let curves = match threshold {
                            Threshold::Two => of_runs(|run| &run.f_scores[0]),
                            Threshold::Five => of_runs(|run| &run.f_scores[1]),
                        };
                        frame.plot(ui, "F-score", &curves)
                    });
                    cell(ui, &mut |ui| match runs.as_slice() {
                        [run] => {
                            ui.horizontal(|ui| {
                                ui.set_min_height(ui.spacing().interact_size.y);
                                ui.spacing_mut().item_spacing.x = 5.0;
                                ui.strong("ms:");
                                for (stage, tint) in ["sense", "track", "map", "mesh"].into_iter().zip(CURVES) {
                                    chip(ui, colour(tint));
                                    ui.small(stage);
                                }
                            });
                            let curves: Vec<_> = run.stages_ms.iter().zip(0..).collect();
                            frame.plot(ui, "Milliseconds per stage", &curves)
                        }
                        _ => {
                            title(ui, "ms per frame");
                            frame.plot(ui, "Milliseconds per frame", &of_runs(|run| &run.total_ms))
                        }
                    });
                    cell(ui, &mut |ui| {
                        title(ui, "Confidence");
                        frame.plot(ui, "Confidence", &of_runs(|run| &run.confidence))
                    });
                }
                if let ([run], true) = (runs.as_slice(), has_contacts) {
                    cell(ui, &mut |ui| {
                        title(ui, "Contact by finger");
                        frame.lanes(ui, &run.contacts)
                    });
                }
            });
        });
        clicked
    }

    /// Shown span of time, seconds.
    #[cfg(test)]
    pub fn zoomed_s(&self) -> Option<[f64; 2]> {
        self.zoomed_s
    }
}

/// Draws a square in the colour of a curve.
pub fn chip(ui: &mut Ui, tint: egui::Color32) {
    let (rect, _) = ui.allocate_exact_size(egui::vec2(8.0, 8.0), egui::Sense::hover());
    ui.painter().rect_filled(rect, 1.0, tint);
}

/// Cursor, axis and colours that all plots share.
struct PlotFrame<'a> {
    now_s: f64,
    end_s: f64,
    zoomed_s: &'a mut Option<[f64; 2]>,
    theme: Theme,
}

impl PlotFrame<'_> {
    fn empty<'p>(&self, name: &str, room: egui::Vec2) -> Plot<'p> {
        Plot::new(name)
            .allow_drag(false)
            .allow_zoom(false)
            .allow_axis_zoom_drag(false)
            .allow_scroll(false)
            .allow_boxed_zoom(false)
            .allow_double_click_reset(false)
            .link_cursor(Id::unique("time"), Vec2b::new(true, false))
            .set_margin_fraction(egui::vec2(0.0, 0.08))
            .show_crosshair(false)
            .label_formatter(|hover| match hover {
                egui_plot::HoverPosition::NearDataPoint { position, .. } => {
                    Some(format!("{:.2} s\n{}", position.x, three_digits(position.y)))
                }
                egui_plot::HoverPosition::Elsewhere { .. } => None,
            })
            .grid_spacing(LABELS)
            .x_grid_spacer(move |input| thinned(round_marks(input.bounds), input.bounds, room.x, MARK.x))
            .y_grid_spacer(move |input| thinned(round_marks(input.bounds), input.bounds, room.y, MARK.y))
            .grid_color(colour(self.theme.faint).gamma_multiply(0.4))
            .custom_x_axes(vec![AxisHints::new_x().label_spacing(LABELS).formatter(time_label)])
            .custom_y_axes(vec![AxisHints::new_y().label_spacing(LABELS).formatter(label).min_thickness(26.0)])
    }

    /// Plots lines over time, from 0 up.
    fn plot(&mut self, ui: &mut Ui, name: &str, curves: &[(&Curve, usize)]) -> Option<f64> {
        let [from_s, to_s] = self.zoomed_s.unwrap_or([0.0, self.end_s]);
        let top = top(curves, from_s..=to_s);
        let response = self.empty(name, ui.available_size()).show(ui, |plot| {
            plot.set_plot_bounds_y(0.0..=top);
            for &(curve, k) in curves {
                let line = Line::new("", PlotPoints::Borrowed(curve)).color(colour(CURVES[k % CURVES.len()]));
                plot.line(line.width(1.5).allow_band(false));
            }
            self.time(plot)
        });
        named(&response.response, name);
        response.inner
    }

    /// Shows the span of time with a line at the shown moment. The wheel zooms, a drag moves the span, and a double click
    /// shows all. Returns the time that was clicked, seconds.
    fn time(&mut self, plot: &mut egui_plot::PlotUi<'_>) -> Option<f64> {
        plot.vline(VLine::new("", self.now_s).color(colour(self.theme.ink)).width(1.5).allow_hover(false));
        let whole = [0.0, self.end_s];
        let span = self.zoomed_s.unwrap_or(whole);
        plot.set_plot_bounds_x(span[0]..=span[1]);
        let response = plot.response().clone();
        if response.double_clicked() {
            *self.zoomed_s = None;
            return None;
        }
        let wheel = plot.ctx().input(|input| f64::from(input.smooth_scroll_delta().y));
        if let Some(at) = plot.pointer_coordinate().filter(|_| response.hovered() && wheel != 0.0) {
            *self.zoomed_s = zoom_about(span, at.x, wheel, self.end_s);
            plot.ctx().request_repaint();
        } else if response.dragged() && self.zoomed_s.is_some() {
            *self.zoomed_s = moved(span, -f64::from(plot.pointer_coordinate_drag_delta().x), self.end_s);
        }
        response.clicked().then(|| plot.pointer_coordinate()).flatten().map(|point| point.x)
    }

    /// Plots a lane per pad, filled where it touches.
    fn lanes(&mut self, ui: &mut Ui, contacts: &[(String, Curve)]) -> Option<f64> {
        let name = "Contact by finger";
        let count = contacts.len() as u32;
        // The first lane is the uppermost.
        let names: Vec<String> = contacts.iter().rev().map(|(name, _)| name.clone()).collect();
        let name_at = move |value: f64| {
            (0..)
                .zip(&names)
                .find(|(k, _)| (f64::from(*k) - value).abs() < 0.1)
                .map_or_else(String::new, |(_, name)| name.clone())
        };
        let plot = self
            .empty(name, ui.available_size())
            .y_grid_spacer(move |_| (0..count).map(|k| GridMark { value: f64::from(k), step_size: 1.0 }).collect())
            .y_axis_formatter(move |mark, _| name_at(mark.value));
        let response = plot.y_axis_min_width(44.0).show(ui, |plot| {
            plot.set_plot_bounds_y(-0.5..=f64::from(count) - 0.5);
            for (k, (_, curve)) in contacts.iter().enumerate() {
                let points = Points::new("", PlotPoints::Borrowed(curve)).radius(2.0);
                plot.points(points.color(colour(pad_colour(k))).allow_hover(false));
            }
            self.time(plot)
        });
        named(&response.response, name);
        response.inner
    }
}

/// Returns a span of time zoomed around a point by the points that the wheel turned; `None` for the whole time.
fn zoom_about([from_s, to_s]: [f64; 2], at_s: f64, wheel: f64, end_s: f64) -> Option<[f64; 2]> {
    /// Points of the wheel that zoom by a factor of e.
    const POINTS: f64 = 200.0;
    let factor = (-wheel / POINTS).exp();
    let length_s = ((to_s - from_s) * factor).max(SHORTEST_S);
    if !length_s.is_finite() || length_s >= end_s {
        return None;
    }
    let share = ((at_s - from_s) / (to_s - from_s)).clamp(0.0, 1.0);
    let from_s = (at_s - share * length_s).clamp(0.0, end_s - length_s);
    Some([from_s, from_s + length_s])
}

/// Returns a span of time moved by seconds within the whole time.
fn moved([from_s, to_s]: [f64; 2], by_s: f64, end_s: f64) -> Option<[f64; 2]> {
    let length_s = to_s - from_s;
    let from_s = (from_s + by_s).clamp(0.0, (end_s - length_s).max(0.0));
    Some([from_s, from_s + length_s])
}

/// Distances at which labels fade and appear, points. There are few marks, so that labels are never too dense.
const LABELS: egui::Rangef = egui::Rangef { min: 4.0, max: 8.0 };

fn round_marks((low, high): (f64, f64)) -> Vec<GridMark> {
    let (marks, step_size) = chart::round_marks(low, high);
    marks.into_iter().map(|value| GridMark { value, step_size }).collect()
}

/// Room that a mark with its label takes on both axes, points.
const MARK: egui::Vec2 = egui::vec2(46.0, 17.0);

/// Keeps as many marks as there is room for, at multiples of a larger step.
fn thinned(marks: Vec<GridMark>, (low, high): (f64, f64), length: f32, each: f32) -> Vec<GridMark> {
    let step = marks.first().map_or(1.0, |mark| mark.step_size);
    let points = f64::from(length) * step / (high - low).max(1e-9);
    let every = [1.0, 2.0, 5.0, 10.0].into_iter().find(|every| every * points >= f64::from(each)).unwrap_or(10.0);
    let is_kept = |mark: &GridMark| ((mark.value / step).round() % every).abs() < 0.5;
    marks.into_iter().filter(is_kept).map(|mark| GridMark { step_size: every * step, ..mark }).collect()
}

/// Label of a time. None stands at 0, where the label of the other axis stands.
fn time_label(mark: GridMark, range: &RangeInclusive<f64>) -> String {
    if mark.value == 0.0 { String::new() } else { label(mark, range) + " s" }
}

/// Writes a number with about three digits.
fn three_digits(value: f64) -> String {
    match value.abs() {
        0.0..10.0 => format!("{value:.2}"),
        10.0..100.0 => format!("{value:.1}"),
        _ => format!("{value:.0}"),
    }
}

fn label(mark: GridMark, _: &RangeInclusive<f64>) -> String {
    chart::mark_label(mark.value, mark.step_size)
}

/// Upper end of the vertical axis for the shown span of time: at least 1, and above nearly all values, so that a few
/// outliers do not flatten the curves.
fn top(curves: &[(&Curve, usize)], shown_s: RangeInclusive<f64>) -> f64 {
    const MARGIN: f64 = 1.08;
    let points = curves.iter().flat_map(|(curve, _)| curve.iter());
    let mut values: Vec<f64> = points.filter(|point| shown_s.contains(&point.x)).map(|point| point.y).collect();
    values.sort_by(f64::total_cmp);
    let nearly_all = values.get(values.len() * 98 / 100).or(values.last()).copied().unwrap_or(1.0);
    let highest = values.last().copied().unwrap_or(1.0);
    MARGIN * highest.min(1.5 * nearly_all).max(1.0)
}

/// Draws a title as high as one with buttons, so that all plots have the same height.
fn title(ui: &mut Ui, text: &str) {
    ui.horizontal(|ui| {
        ui.set_min_height(ui.spacing().interact_size.y);
        ui.strong(text);
    });
}

fn named(response: &egui::Response, name: &str) {
    response.widget_info(|| egui::WidgetInfo::labeled(egui::Role::Figure, true, name));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn axes_have_a_few_round_marks_that_differ() {
        for (low, high) in [(0.0, 1.08), (0.0, 2.2), (0.0, 700.0), (-0.5, 3.5), (0.0, 29.97), (3.0, 3.0), (0.0, 1e-3)] {
            let marks = round_marks((low, high));
            let labels: Vec<String> = marks.iter().map(|&mark| label(mark, &(low..=high))).collect();
            assert!(high <= low || (3..=7).contains(&marks.len()), "{labels:?}");
            assert!(labels.windows(2).all(|pair| pair[0] != pair[1]), "{labels:?}");
        }
        for strange in [(f64::NAN, 1.0), (0.0, f64::INFINITY), (1.0, 0.0)] {
            assert!(round_marks(strange).len() <= 16);
        }
    }

    #[test]
    fn a_few_outliers_do_not_flatten_the_other_values() {
        let curve = |values: &[f64]| -> Curve { values.iter().map(|&y| PlotPoint::new(0.0, y)).collect() };
        assert_eq!(top(&[], 0.0..=1.0), 1.08);
        assert_eq!(top(&[(&curve(&[0.2, 0.3]), 0)], 0.0..=1.0), 1.08);
        let mut values = vec![10.0; 100];
        values.push(5000.0);
        assert!((10.0..20.0).contains(&top(&[(&curve(&values), 0)], 0.0..=1.0)));
    }
    #[test]
    fn a_small_plot_has_fewer_marks() {
        let values = |length: f32| -> Vec<f64> {
            thinned(round_marks((0.0, 12.0)), (0.0, 12.0), length, 20.0).iter().map(|mark| mark.value).collect()
        };
        assert_eq!(values(400.0), [0.0, 2.0, 4.0, 6.0, 8.0, 10.0, 12.0]);
        assert_eq!(values(100.0), [0.0, 4.0, 8.0, 12.0]);
        assert_eq!(values(0.0), [0.0]);
    }

    #[test]
    fn a_zoom_stays_within_the_run() {
        let zoomed = zoom_about([0.0, 10.0], 2.0, 200.0, 10.0).unwrap();
        assert!(zoomed[0] > 0.0 && zoomed[1] < 10.0 && (zoomed[0]..=zoomed[1]).contains(&2.0), "{zoomed:?}");
        // The point under the pointer stays.
        assert!(((2.0 - zoomed[0]) / (zoomed[1] - zoomed[0]) - 0.2).abs() < 1e-9);
        assert_eq!(zoom_about(zoomed, 2.0, -1000.0, 10.0), None);
        let nearest = zoom_about([0.0, 10.0], 9.9, 1e6, 10.0).unwrap();
        assert!((nearest[1] - nearest[0] - SHORTEST_S).abs() < 1e-9 && nearest[1] <= 10.0);
        assert_eq!(moved([1.0, 3.0], 100.0, 10.0), Some([8.0, 10.0]));
        assert_eq!(moved([1.0, 3.0], -100.0, 10.0), Some([0.0, 2.0]));
        assert_eq!(zoom_about([0.0, 10.0], f64::NAN, f64::NEG_INFINITY, 10.0), None);
    }
}
