//! Icons of buttons. They are painted, because the fonts have no such signs.

use eframe::egui::{self, Color32, Painter, Pos2, Rect, Response, Role, Sense, Shape, Stroke, Ui, WidgetInfo};

/// Icon of a button.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Icon {
    /// Begin to play.
    Play,
    /// Stop playing.
    Pause,
    /// One frame back.
    Back,
    /// One frame on.
    On,
    /// To the first frame.
    First,
    /// To the last frame.
    Last,
}

const SIDE: f32 = 26.0;

/// Draws a button with an icon, and a text for hints and screen readers.
pub fn button(ui: &mut Ui, icon: Icon, words: &str) -> Response {
    let (rect, response) = ui.allocate_exact_size(egui::Vec2::splat(SIDE), Sense::click());
    let visuals = ui.style().interact(&response);
    ui.painter().rect(rect, visuals.corner_radius, visuals.weak_bg_fill, visuals.bg_stroke, egui::StrokeKind::Inside);
    let colour = ui.visuals().override_text_color.unwrap_or(visuals.fg_stroke.color);
    icon.paint(ui.painter(), rect.shrink(0.28 * SIDE), colour);
    response.widget_info(|| WidgetInfo::labeled(Role::Button, ui.is_enabled(), words));
    response.on_hover_text(words)
}

/// Draws a lamp, filled when lit and hollow otherwise, so that it is readable without its colour.
pub fn lamp(ui: &mut Ui, is_lit: bool, colour: Color32, words: &str) -> Response {
    let (rect, response) = ui.allocate_exact_size(egui::Vec2::splat(12.0), Sense::hover());
    let faint = ui.visuals().weak_text_color();
    if is_lit {
        ui.painter().circle(rect.center(), 5.0, colour, Stroke::new(1.0, colour));
    } else {
        ui.painter().circle(rect.center(), 4.5, Color32::TRANSPARENT, Stroke::new(1.0, faint));
    }
    response.widget_info(|| WidgetInfo::labeled(Role::Label, true, words));
    response.on_hover_text(words)
}

impl Icon {
    fn paint(self, painter: &Painter, rect: Rect, colour: Color32) {
        let triangle = |rect: Rect, right: bool| {
            let (base, tip) = if right { (rect.left(), rect.right()) } else { (rect.right(), rect.left()) };
            let points = [(base, rect.top()), (tip, rect.center().y), (base, rect.bottom())];
            let points = points.into_iter().map(|(x, y)| Pos2::new(x, y)).collect();
            painter.add(Shape::convex_polygon(points, colour, Stroke::NONE));
        };
        let bar = |from: f32, to: f32| {
            let x = |share: f32| rect.left() + share * rect.width();
            painter.rect_filled(Rect::from_x_y_ranges(x(from)..=x(to), rect.y_range()), 0.0, colour);
        };
        let part = |from: f32, to: f32| {
            let x = |share: f32| rect.left() + share * rect.width();
            Rect::from_x_y_ranges(x(from)..=x(to), rect.y_range())
        };
        match self {
            Self::Play => triangle(rect, true),
            Self::Pause => {
                bar(0.08, 0.38);
                bar(0.62, 0.92);
            }
            Self::On => {
                bar(0.0, 0.2);
                triangle(part(0.35, 1.0), true);
            }
            Self::Back => {
                triangle(part(0.0, 0.65), false);
                bar(0.8, 1.0);
            }
            Self::First => {
                bar(0.0, 0.14);
                triangle(part(0.18, 0.58), false);
                triangle(part(0.58, 1.0), false);
            }
            Self::Last => {
                triangle(part(0.0, 0.42), true);
                triangle(part(0.42, 0.82), true);
                bar(0.86, 1.0);
            }
        }
    }
}
