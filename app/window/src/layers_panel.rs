//! Panel of the layers of the scene.

use eframe::egui::{self, Ui};
use mvt_recording::Recording;

use super::preferences::Preferences;
use super::scene_view::SceneView;
use mvt_viewer::eye::Preset;
use mvt_viewer::layers::{Clouds, Colouring, Keyframes, Layers};

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

/// Draws the panel for the recordings of a page.
pub fn ui(ui: &mut Ui, preferences: &mut Preferences, view: &mut SceneView, recordings: &[&Recording]) {
    let has_truth = recordings.iter().any(|recording| recording.true_mesh().is_some());
    // Nothing is estimated in a log.
    let has_estimate = recordings.iter().any(|recording| recording.about().mode.is_some());
    ui.heading("View");
    let layers = &mut view.layers;
    surface(ui, layers, has_truth, has_estimate);
    preferences.colouring = layers.colouring;
    ui.separator();
    for (flag, label, meaning) in [
        (&mut layers.hand, "Hand (A)", "The Allegro hand with its gels"),
        (&mut layers.axes, "Axes (O)", "Estimated and true pose"),
        (&mut layers.trail, "Trail (T)", "Past positions of the object"),
        (&mut layers.frusta, "Cameras (R)", "Fields of view of the cameras"),
    ] {
        ui.checkbox(flag, label).on_hover_text(meaning);
    }
    let slice =
        "Cuts the estimated surface with a plane that sweeps through it with time, and shows the signed distances";
    estimated(ui, &mut layers.slice, "Slice (V)", slice, has_estimate);
    estimated(ui, &mut layers.bounds, "Box (B)", "Bounding box of the estimated surface", has_estimate);
    ui.separator();
    choice(ui, "Points (P)", &mut layers.clouds, &Clouds::ALL, |clouds| clouds.name().to_owned());
    ui.add_enabled_ui(has_estimate, |ui| {
        choice(ui, "Keyframes (K)", &mut layers.keyframes, &Keyframes::ALL, |keyframes| keyframes.name().to_owned());
    });
    ui.separator();
    ui.label("Look from");
    ui.horizontal_wrapped(|ui| {
        for preset in Preset::ALL {
            if ui.button(preset.name()).clicked() {
                view.eye.look_from(preset);
            }
        }
        if ui.button("reset").on_hover_text("Resets the camera (0)").clicked() {
            view.reset();
        }
    });
    ui.checkbox(&mut preferences.follow, "Follow the object (F)");
}

fn surface(ui: &mut Ui, layers: &mut Layers, has_truth: bool, has_estimate: bool) {
    estimated(ui, &mut layers.mesh, "Estimated mesh (M)", "The estimated surface", has_estimate);
    ui.add_enabled_ui(layers.mesh && has_estimate, |ui| {
        choice(ui, "Colour of the mesh (C)", &mut layers.colouring, &Colouring::ALL, |c| c.name().to_owned());
        if layers.colouring == Colouring::Error && has_estimate && !has_truth {
            ui.weak("The true shape is unknown, so there is no error.");
        }
    });
    if has_estimate {
        ui.add_enabled(has_truth, egui::Checkbox::new(&mut layers.truth, "Ground truth (G)"))
            .on_disabled_hover_text("The true shape is unknown");
    } else {
        let mut is_shown = has_truth;
        ui.add_enabled(false, egui::Checkbox::new(&mut is_shown, "Ground truth (G)"))
            .on_disabled_hover_text("A log always shows the true shape, if it is known");
    }
}

/// Draws a check box of a layer that belongs to the estimate; without an estimate it is not ticked.
fn estimated(ui: &mut Ui, flag: &mut bool, label: &str, meaning: &str, has_estimate: bool) {
    let mut is_off = false;
    let shown = if has_estimate { flag } else { &mut is_off };
    ui.add_enabled(has_estimate, egui::Checkbox::new(shown, label))
        .on_hover_text(meaning)
        .on_disabled_hover_text("A log has no estimate");
}
