//! Panel of the layers of the scene.

use eframe::egui::{self, Ui};

use super::preferences::Preferences;
use crate::eye::{Eye, Preset};
use crate::layers::{Clouds, Colouring, Keyframes, Layers};

/// Draws a labelled choice of one of several values.
pub fn choice<T: Copy + PartialEq>(ui: &mut Ui, label: &str, value: &mut T, all: &[T], name: impl Fn(T) -> String) {
    let label_id = ui.label(label).id;
    egui::ComboBox::from_id_salt(label)
        .selected_text(name(*value))
        .width((ui.available_width() - 8.0).max(60.0))
        .show_ui(ui, |ui| {
            for &other in all {
                ui.selectable_value(value, other, name(other));
            }
        })
        .response
        .labelled_by(label_id);
}

/// Draws the panel. Returns whether the camera should be reset.
pub fn ui(ui: &mut Ui, preferences: &mut Preferences, eye: &mut Eye, has_truth: bool) -> bool {
    ui.heading("View");
    let layers = &mut preferences.layers;
    surface(ui, layers, has_truth);
    ui.separator();
    for (flag, label, meaning) in [
        (&mut layers.hand, "Hand (A)", "The Allegro hand with its gels"),
        (&mut layers.axes, "Axes (O)", "Estimated and true pose"),
        (&mut layers.trail, "Trail (T)", "Past positions of the object"),
        (&mut layers.frusta, "Cameras (R)", "Fields of view of the cameras"),
        (&mut layers.slice, "Slice (V)", "Signed distances in a plane that sweeps through the object"),
        (&mut layers.bounds, "Box (B)", "Bounding box of the estimated surface"),
    ] {
        ui.checkbox(flag, label).on_hover_text(meaning);
    }
    ui.separator();
    choice(ui, "Points (P)", &mut layers.clouds, &Clouds::ALL, |clouds| clouds.name().to_owned());
    choice(ui, "Keyframes (K)", &mut layers.keyframes, &Keyframes::ALL, |keyframes| keyframes.name().to_owned());
    ui.separator();
    ui.label("Look from");
    let mut is_reset = false;
    ui.horizontal_wrapped(|ui| {
        for preset in Preset::ALL {
            if ui.button(preset.name()).clicked() {
                eye.look_from(preset);
            }
        }
        is_reset = ui.button("reset").on_hover_text("Resets the camera (0)").clicked();
    });
    ui.checkbox(&mut preferences.follow, "Follow the object (F)");
    is_reset
}

fn surface(ui: &mut Ui, layers: &mut Layers, has_truth: bool) {
    ui.checkbox(&mut layers.mesh, "Estimated mesh (M)");
    ui.add_enabled_ui(layers.mesh, |ui| {
        choice(ui, "Colour of the mesh (C)", &mut layers.colouring, &Colouring::ALL, |c| c.name().to_owned());
        if layers.colouring == Colouring::Error && !has_truth {
            ui.weak("The true shape is unknown, so there is no error.");
        }
    });
    ui.add_enabled(has_truth, egui::Checkbox::new(&mut layers.truth, "Ground truth (G)"))
        .on_disabled_hover_text("The true shape is unknown");
}
