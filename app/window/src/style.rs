//! Appearance of the widgets.

use eframe::egui::{self, Color32, Context, Visuals};
use image::Rgb;
use mvt_picture::palette::Theme;
use serde::{Deserialize, Serialize};

/// Light or dark.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Appearance {
    /// The setting of the desktop.
    #[default]
    System,
    /// Dark on light.
    Light,
    /// Light on dark.
    Dark,
}

impl Appearance {
    /// All choices.
    pub const ALL: [Self; 3] = [Self::System, Self::Light, Self::Dark];

    /// Returns its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::System => "as the desktop",
            Self::Light => "light",
            Self::Dark => "dark",
        }
    }

    /// Applies it from the next frame on.
    pub fn apply(self, ctx: &Context) {
        ctx.set_theme(match self {
            Self::System => egui::ThemePreference::System,
            Self::Light => egui::ThemePreference::Light,
            Self::Dark => egui::ThemePreference::Dark,
        });
    }
}

/// Sets our colours in egui's two themes.
pub fn install(ctx: &Context) {
    ctx.set_visuals_of(egui::Theme::Light, visuals(Visuals::light(), &Theme::LIGHT));
    ctx.set_visuals_of(egui::Theme::Dark, visuals(Visuals::dark(), &Theme::DARK));
    ctx.all_styles_mut(|style| {
        style.spacing.item_spacing = egui::vec2(8.0, 6.0);
        style.spacing.button_padding = egui::vec2(8.0, 3.0);
        style.text_styles.insert(egui::TextStyle::Small, egui::FontId::proportional(11.0));
        // Labels are not selectable: they show numbers and states.
        style.interaction.selectable_labels = false;
    });
}

fn visuals(mut visuals: Visuals, theme: &Theme) -> Visuals {
    visuals.override_text_color = Some(colour(theme.ink));
    // The faint colour is for lines; as text it would be unreadable.
    visuals.weak_text_color = Some(colour(theme.faint).lerp_to_gamma(colour(theme.ink), 0.4));
    visuals.panel_fill = colour(theme.panel);
    visuals.window_fill = colour(theme.panel);
    visuals.extreme_bg_color = colour(theme.paper);
    visuals.selection.bg_fill = colour(theme.estimate).gamma_multiply(0.35);
    visuals.selection.stroke.color = colour(theme.ink);
    // An empty check box has no other edge.
    visuals.widgets.inactive.bg_fill = colour(theme.paper);
    visuals.widgets.inactive.bg_stroke = egui::Stroke::new(1.0, colour(theme.faint));
    visuals.hyperlink_color = colour(theme.estimate);
    visuals
}

/// Returns the theme in use.
pub fn theme(ctx: &Context) -> Theme {
    match ctx.theme() {
        egui::Theme::Light => Theme::LIGHT,
        egui::Theme::Dark => Theme::DARK,
    }
}

/// Converts a colour for egui.
pub fn colour(Rgb([r, g, b]): Rgb<u8>) -> Color32 {
    Color32::from_rgb(r, g, b)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_empty_check_box_can_be_seen() {
        for (visuals, theme) in [(Visuals::light(), Theme::LIGHT), (Visuals::dark(), Theme::DARK)] {
            let visuals = super::visuals(visuals, &theme);
            let grey = |colour: Color32| f32::from(colour.r()) + f32::from(colour.g()) + f32::from(colour.b());
            let edge = visuals.widgets.inactive.bg_stroke;
            assert!(edge.width >= 1.0 && (grey(edge.color) - grey(visuals.panel_fill)).abs() > 150.0);
        }
    }
}
