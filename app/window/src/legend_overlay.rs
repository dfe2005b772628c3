//! Paints the legends of the colours and the scale bar over the scene.

use eframe::egui::{Align2, FontId, Painter, Pos2, Rect, Shape, TextStyle, Ui};
use mvt_picture::palette::Theme;
use mvt_recording::Recording;

use super::style::{self, colour};
use mvt_viewer::eye::Eye;
use mvt_viewer::layers::Layers;
use mvt_viewer::legend::{Legend, scale_bar_m};

/// Distance from the edges of the scene, points.
const MARGIN: f32 = 10.0;

/// Paints the legends, one above the other, and the scale bar into the lower corners of the scene.
pub fn paint(ui: &Ui, view: Rect, recording: &Recording, layers: &Layers, eye: &Eye) {
    let theme = style::theme(ui.ctx());
    let font = TextStyle::Small.resolve(ui.style());
    let painter = ui.painter().with_clip_rect(view);
    on_paper(&painter, &theme, |painter| {
        let height = view.height() as usize;
        let length_m = scale_bar_m(eye, height);
        let length = (length_m / eye.metres_per_pixel(height)) as f32;
        let end = Pos2::new(view.right() - MARGIN, view.bottom() - MARGIN);
        let bar = Rect::from_min_max(Pos2::new(end.x - length, end.y - 3.0), end);
        painter.rect_filled(bar, 0.0, colour(theme.ink));
        let words = format!("{:.0} mm", length_m * 1e3);
        let above = Pos2::new(end.x, end.y - 5.0);
        bar.union(painter.text(above, Align2::RIGHT_BOTTOM, words, font.clone(), colour(theme.ink)))
    });
    // A narrow view has room for a short colour map.
    let length = (0.4 * view.width()).clamp(60.0, 150.0);
    let mut corner = view.left_bottom();
    for legend in Legend::of(layers, recording, &theme) {
        let used = on_paper(&painter, &theme, |painter| paint_legend(painter, corner, length, &legend, &theme, &font));
        corner.y = used.top();
    }
}

/// Calls `add`, which paints and returns the rectangle that it used, on translucent paper, so that it is readable over
/// any scene. Returns the rectangle of the paper.
fn on_paper(painter: &Painter, theme: &Theme, add: impl FnOnce(&Painter) -> Rect) -> Rect {
    let paper = painter.add(Shape::Noop);
    let used = add(painter).expand(4.0);
    painter.set(paper, Shape::rect_filled(used, 3.0, colour(theme.paper).gamma_multiply(0.75)));
    used
}

/// Paints a legend above `corner`, with a colour map of this length in points. Returns the rectangle that it used.
fn paint_legend(painter: &Painter, corner: Pos2, length: f32, legend: &Legend, theme: &Theme, font: &FontId) -> Rect {
    let ink = colour(theme.ink);
    let write = |at: Pos2, align: Align2, text: &str| painter.text(at, align, text, font.clone(), ink);
    let bottom = corner.y - MARGIN;
    let left = corner.x + MARGIN;
    match legend {
        Legend::Ramp { title, labels, colour: of_share } => {
            let title = write(Pos2::new(left, bottom - 16.0), Align2::LEFT_BOTTOM, title);
            let left = title.right() + MARGIN;
            let bar = Rect::from_x_y_ranges(left..=left + length, bottom - 26.0..=bottom - 16.0);
            for x in 0..length as u32 {
                // Columns overlap, because at some sizes of text a point is no whole number of pixels.
                let right = (left + x as f32 + 2.0).min(bar.right());
                let column = Rect::from_x_y_ranges(left + x as f32..=right, bar.y_range());
                painter.rect_filled(column, 0.0, colour(of_share(x as f32 / (length - 1.0))));
            }
            (0u8..).zip(labels).fold(title.union(bar), |used, (k, label)| {
                let x = left + 0.5 * f32::from(k) * length;
                used.union(write(Pos2::new(x, bottom), Align2::CENTER_BOTTOM, label))
            })
        }
        Legend::Names { title, names } => {
            let mut used = write(Pos2::new(left, bottom), Align2::LEFT_BOTTOM, title);
            for (of_name, name) in names {
                let x = if title.is_empty() && used.width() < 1.0 { left } else { used.right() + MARGIN };
                let square = Rect::from_x_y_ranges(x..=x + 10.0, bottom - 12.0..=bottom - 2.0);
                painter.rect_filled(square, 2.0, colour(*of_name));
                used = used.union(square).union(write(Pos2::new(x + 14.0, bottom), Align2::LEFT_BOTTOM, name));
            }
            used
        }
    }
}
