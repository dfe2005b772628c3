//! Curves of a run with a cursor at a moment, as a picture.

use image::{Rgb, RgbImage};
use mvt_picture::lettering;
use mvt_robot::hand::Finger;

use super::Theme;
use super::colours::SeenBy;
use mvt_recording::{Moment, Recording};

/// A rectangle of pixels.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Area {
    /// First column.
    pub x: u32,
    /// First row.
    pub y: u32,
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
}

/// Height of a title, pixels.
const TITLE: u32 = 16;
const GAP: u32 = 8;
/// Width of the fingers' names, pixels.
const NAMES: u32 = 44;
const SIZE: f32 = 13.0;

/// Draws, side by side, the error of the pose, the shape's score, the confidence, the time per frame, and which fingers touch; of a log,
/// in which nothing is estimated, the last alone.
pub fn draw(image: &mut RgbImage, area: Area, recording: &Recording, moment: usize, theme: &Theme) {
    let moments = recording.moments();
    let Some((first, now)) = moments.first().zip(moments.get(moment)) else { return };
    let span_s = moments.last().map_or(1.0, |last| last.row.time_s - first.row.time_s).max(1e-3);
    let share = |time_s: f64| ((time_s - first.row.time_s) / span_s) as f32;
    let per_frame = |value: &dyn Fn(&mvt_run::report::FrameRow) -> Option<f64>| -> Vec<(f32, f32)> {
        let estimated = moments.iter().filter(|m| m.estimate().is_some());
        estimated.filter_map(|m| Some((share(m.row.time_s), value(&m.row)? as f32))).collect()
    };
    let scores: Vec<(f32, f32)> = recording
        .shapes()
        .iter()
        .filter_map(|shape| shape.point.map(|point| (share(point.time_s), point.f5 as f32)))
        .collect();
    let panels = vec![
        ("ADD-S, mm", per_frame(&|row| Some(row.add_s?.one_directional_m * 1e3)), 0.0, theme.estimate),
        ("F-score at 5 mm", scores, 1.0, theme.truth),
        ("confidence", per_frame(&|row| Some(row.confidence)), 1.0, theme.keyframe),
        ("ms per frame", per_frame(&|row| Some(row.stage_ms.total())), 0.0, theme.faint),
    ];
    let panels = if first.estimate().is_some() { panels } else { Vec::new() };
    let width = (area.width + GAP) / (panels.len() as u32 + 1) - GAP;
    let panel = |k: u32| Area { x: area.x + k * (width + GAP), width, ..area };
    let cursor = share(now.row.time_s);
    let last = panel(panels.len() as u32);
    for (k, (title, points, most, colour)) in (0..).zip(panels) {
        let highest = if most > 0.0 { most } else { round_up(percentile(&points)) };
        let value = points.iter().rev().find(|(x, _)| *x <= cursor + 1e-6).map(|(_, y)| *y);
        let digits = if most > 0.0 { 2 } else { 1 };
        let title = value.map_or_else(|| title.to_owned(), |value| format!("{title}: {value:.digits$}"));
        let plot = frame(image, panel(k), &title, theme);
        line(image, plot, &points, highest, colour);
        let top = if most > 0.0 { "1".to_owned() } else { format!("{highest}") };
        lettering::write(image, (plot.x + 3, plot.y), SIZE - 2.0, theme.faint, &top);
        vertical(image, plot, cursor, theme.ink);
    }
    let whole = frame(image, last, "contact", theme);
    let plot = Area { x: whole.x + NAMES, width: whole.width.saturating_sub(NAMES), ..whole };
    let row = plot.height / 4;
    let column = |m: &Moment| plot.x + (share(m.row.time_s) * plot.width.saturating_sub(1) as f32) as u32;
    // Each moment lasts until the next.
    let ends = || moments.iter().skip(1).map(column).chain([plot.x + plot.width]);
    for finger in Finger::ALL {
        let top = plot.y + finger as u32 * row;
        for (m, end) in moments.iter().zip(ends()).filter(|(m, _)| m.fingers[finger].is_some()) {
            let (x, width) = (column(m), end.saturating_sub(column(m)).max(1));
            let lane = Area { x, y: top + 2, width, height: row.saturating_sub(4) };
            fill(image, lane, SeenBy::Touch.colour());
        }
        lettering::write(image, (whole.x + 3, (top + row / 2).saturating_sub(7)), SIZE - 2.0, theme.ink, finger.name());
    }
    vertical(image, plot, cursor, theme.ink);
}

/// A title over an empty plot, whose area is returned.
fn frame(image: &mut RgbImage, area: Area, title: &str, theme: &Theme) -> Area {
    lettering::write(image, (area.x, area.y), SIZE, theme.ink, title);
    let plot = Area { y: area.y + TITLE, height: area.height.saturating_sub(TITLE), ..area };
    fill(image, plot, theme.panel);
    plot
}

/// Fills a rectangle.
pub fn fill(image: &mut RgbImage, area: Area, colour: Rgb<u8>) {
    for y in area.y..(area.y + area.height).min(image.height()) {
        for x in area.x..(area.x + area.width).min(image.width()) {
            image.put_pixel(x, y, colour);
        }
    }
}

fn vertical(image: &mut RgbImage, plot: Area, share: f32, colour: Rgb<u8>) {
    let x = plot.x + (share.clamp(0.0, 1.0) * plot.width.saturating_sub(1) as f32).round() as u32;
    for y in plot.y..plot.y + plot.height {
        lettering::blend(image, x, y, colour, 0.8);
    }
}

/// A line through points whose x is a share of the width, the later ones over the earlier.
fn line(image: &mut RgbImage, plot: Area, points: &[(f32, f32)], highest: f32, colour: Rgb<u8>) {
    let (right, bottom) = (plot.width.saturating_sub(1) as f32, plot.height.saturating_sub(2) as f32);
    let place = |&(x, y): &(f32, f32)| (x * right, bottom * (1.0 - (y / highest).clamp(0.0, 1.0)));
    for pair in points.windows(2) {
        let ((x0, y0), (x1, y1)) = (place(&pair[0]), place(&pair[1]));
        // Written so that NaN fails.
        let steps = (x1 - x0).abs().max((y1 - y0).abs()).ceil().max(1.0) as u32;
        for k in 0..=steps.min(4096) {
            let along = k as f32 / steps as f32;
            let (x, y) = (x0 + (x1 - x0) * along, y0 + (y1 - y0) * along);
            let (column, row) = (plot.x + x as u32, plot.y + y as u32);
            lettering::blend(image, column, row, colour, 1.0 - y.fract());
            lettering::blend(image, column, row + 1, colour, 1.0);
            lettering::blend(image, column, row + 2, colour, y.fract());
        }
    }
}

/// What 98 of 100 values are below: one outlier should not flatten a curve.
fn percentile(points: &[(f32, f32)]) -> f32 {
    let mut values: Vec<f32> = points.iter().map(|(_, y)| *y).filter(|y| y.is_finite()).collect();
    values.sort_by(f32::total_cmp);
    values.get(values.len() * 98 / 100).copied().unwrap_or(1.0)
}

/// The next of 1, 2 or 5 times a power of ten.
fn round_up(value: f32) -> f32 {
    if value.is_nan() || value < 1e-6 {
        return 1.0;
    }
    let power = 10f32.powf(value.log10().floor());
    [1.0, 2.0, 5.0, 10.0].map(|step| step * power).into_iter().find(|step| *step >= value).unwrap_or(value)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scales_end_at_round_numbers() {
        for (value, expected) in [(0.3, 0.5), (1.0, 1.0), (1.1, 2.0), (37.0, 50.0), (99.0, 100.0), (0.0, 1.0)] {
            assert!((round_up(value) - expected).abs() < 1e-5 * expected, "{value}");
        }
        assert_eq!(round_up(f32::NAN), 1.0);
    }

    #[test]
    fn a_line_rises_from_left_to_right() {
        let plot = Area { x: 2, y: 3, width: 40, height: 30 };
        let mut image = RgbImage::new(50, 40);
        line(&mut image, plot, &[(0.0, 0.0), (1.0, 1.0)], 1.0, Rgb([255; 3]));
        let brightest = |x: u32| (0..40).max_by_key(|y| image.get_pixel(x, *y).0[0]).unwrap();
        assert!(brightest(3) > 28 && brightest(40) < 6, "{} {}", brightest(3), brightest(40));
        line(&mut image, plot, &[(0.0, f32::NAN), (f32::NAN, 1.0), (9.0, 1e30)], 1.0, Rgb([255; 3]));
    }
}
