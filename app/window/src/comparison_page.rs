//! The page that compares two runs: one time and one camera for both, their errors in the same plots, and a table of
//! figures.

use std::sync::Arc;
use std::time::Duration;

use eframe::egui::{self, Align, Context, Layout, Ui};
use mvt_picture::palette::CURVES;
use mvt_recording::{Recording, Status};

use super::comparison_table;
use super::export::Exports;
use super::layers_panel;
use super::notice::{self, Notice};
use super::plots::{self, PlotRow};
use super::preferences::Preferences;
use super::scene_view::SceneView;
use super::scene_widget::SceneWidget;
use super::shared_recording::SharedRecording;
use super::shortcuts::KeyCommand;
use super::style::colour;
use super::timeline::{Playback, moment_at};
use mvt_viewer::RecordingSource;
use mvt_viewer::captions;

/// Least width and height with a panel of layers and with curves, points.
const ROOM_FOR_LAYERS: f32 = 600.0;
const ROOM_FOR_PLOTS: f32 = 360.0;
/// Width of the table, points.
const TABLE: f32 = 300.0;

/// One of the two runs.
struct ComparedRun {
    /// Letter and folder.
    name: String,
    source: RecordingSource,
    shared: Arc<SharedRecording>,
    scene: SceneWidget,
}

/// Page that compares two runs.
pub struct ComparisonPage {
    runs: [ComparedRun; 2],
    timeline: Playback,
    view: SceneView,
    plots: PlotRow,
    exports: Exports,
    notice: Notice,
}

impl ComparisonPage {
    /// Returns the page of two recordings.
    pub fn new(ctx: &Context, runs: [(RecordingSource, Recording); 2], preferences: &Preferences) -> Self {
        let [(_, a), (_, b)] = &runs;
        let timeline = Playback::new(longer([a, b]));
        let mut letters = ["A", "B"].into_iter();
        let runs = runs.map(|(source, recording)| {
            let name = format!("{} {}", letters.next().unwrap_or_default(), captions::folder(source.folder()));
            let shared = Arc::new(SharedRecording::new(recording));
            ComparedRun { name, source, scene: SceneWidget::new(ctx, Arc::clone(&shared)), shared }
        });
        let view = SceneView::new(preferences.colouring);
        Self { runs, timeline, view, plots: PlotRow::default(), exports: Exports::default(), notice: Notice::default() }
    }

    /// Whether pictures are being painted.
    #[cfg(test)]
    pub fn is_busy(&self) -> bool {
        self.runs.iter().any(|run| run.scene.is_busy())
    }

    /// Returns the camera of both scenes.
    #[cfg(test)]
    pub fn eye(&self) -> mvt_viewer::eye::Eye {
        self.view.eye
    }

    /// Gives the runs other names.
    #[cfg(test)]
    pub fn rename(&mut self, names: [&str; 2]) {
        self.runs.iter_mut().zip(names).for_each(|(run, name)| name.clone_into(&mut run.name));
    }

    /// Advances the time and collects messages. Call it before every frame.
    pub fn update(&mut self, ctx: &Context, speed: f64) {
        let seconds = ctx.input(|input| f64::from(input.stable_dt.min(0.1)));
        let [a, b] = &self.runs;
        let (a, b) = (a.shared.read(), b.shared.read());
        let lead = longer([&a, &b]);
        self.timeline.advance(lead.moments(), seconds, speed, lead.status() == Status::Running);
        drop((a, b));
        if self.timeline.is_playing {
            ctx.request_repaint_after(Duration::from_millis(16));
        }
        self.notice.update(ctx);
        for news in self.exports.news() {
            self.notice.show(ctx, news);
        }
    }

    /// Executes the command of a key.
    pub fn command(&mut self, ctx: &Context, command: KeyCommand, preferences: &mut Preferences) {
        match command {
            KeyCommand::Time(key, is_far) => {
                let [a, b] = &self.runs;
                let (a, b) = (a.shared.read(), b.shared.read());
                let lead = longer([&a, &b]);
                self.timeline.key(key, is_far, lead.moments(), lead.status() == Status::Running);
            }
            KeyCommand::Screenshot => self.exports.screenshot(ctx, "comparison"),
            KeyCommand::Export => self.notice.show(ctx, "open one of the runs to export its mesh".to_owned()),
            other => self.view.command(other, preferences),
        }
    }

    /// Adds the page's menus to the bar at the top. Returns the run that should be opened alone.
    pub fn menus(&mut self, ui: &mut Ui, preferences: &mut Preferences) -> Option<RecordingSource> {
        let mut opened = None;
        ui.menu_button("Open one", |ui| {
            for run in &self.runs {
                if ui.button(format!("open {}", run.name)).clicked() {
                    opened = Some(run.source.clone());
                    ui.close();
                }
            }
        });
        if ui.button("Screenshot (S)").clicked() {
            self.exports.screenshot(ui.ctx(), "comparison");
        }
        ui.menu_button("Panels", |ui| {
            ui.checkbox(&mut preferences.panels.layers, "Layers (L)");
            ui.checkbox(&mut preferences.panels.plots, "Figures and curves (U)");
        });
        opened
    }

    /// Draws everything below the bar.
    pub fn ui(&mut self, ui: &mut Ui, preferences: &mut Preferences) {
        let Self { runs: [a, b], timeline, view, plots, notice, .. } = self;
        let (shared_a, shared_b) = (Arc::clone(&a.shared), Arc::clone(&b.shared));
        let (of_a, of_b) = (shared_a.read(), shared_b.read());
        let lead = longer([&of_a, &of_b]);
        let room = ui.available_size();
        egui::Panel::bottom("time").resizable(false).show(ui, |ui| {
            ui.add_space(2.0);
            timeline.ui(ui, lead, &mut preferences.speed);
            ui.with_layout(Layout::right_to_left(Align::Center), |ui| {
                notice::problem(ui, &shared_a, &of_a);
                notice::problem(ui, &shared_b, &of_b);
                notice.ui(ui);
            });
        });
        let now_s = lead.moments().get(timeline.moment(lead.moments())).map_or(0.0, |moment| moment.row.time_s);
        let tints = [CURVES[0], CURVES[1]].map(colour);
        let names = [a.name.as_str(), b.name.as_str()];
        if preferences.panels.plots && room.y >= ROOM_FOR_PLOTS {
            let most = (0.5 * ui.available_height()).max(80.0);
            egui::Panel::bottom("plots").resizable(true).default_size(190.0).size_range(80.0..=most).show(ui, |ui| {
                egui::Panel::left("figures").resizable(true).default_size(TABLE).show(ui, |ui| {
                    egui::ScrollArea::both().auto_shrink(false).show(ui, |ui| {
                        comparison_table::ui(ui, tints, [&of_a, &of_b], now_s);
                    });
                });
                let clicked = plots.ui(ui, &[&of_a, &of_b], now_s, &mut preferences.threshold);
                if let Some(time_s) = clicked {
                    timeline.seek(lead.moments(), time_s);
                }
            });
        }
        if preferences.panels.layers && room.x >= ROOM_FOR_LAYERS {
            egui::Panel::left("layers").resizable(false).exact_size(196.0).show(ui, |ui| {
                egui::ScrollArea::vertical().auto_shrink(false).show(ui, |ui| {
                    layers_panel::ui(ui, preferences, view, &[&of_a, &of_b]);
                });
            });
        }
        let eye = view.eye;
        egui::Panel::left("run A")
            .resizable(false)
            .exact_size(0.5 * ui.available_width())
            .frame(egui::Frame::NONE)
            .show(ui, |ui| {
                ui.spacing_mut().item_spacing.y = 0.0;
                heading(ui, names[0], tints[0], &of_a);
                a.scene.ui(ui, &of_a, moment_at(of_a.moments(), now_s), view, preferences.follow);
            });
        egui::CentralPanel::no_frame().show(ui, |ui| {
            ui.spacing_mut().item_spacing.y = 0.0;
            heading(ui, names[1], tints[1], &of_b);
            // Only the first run moves the camera with its object.
            b.scene.ui(ui, &of_b, moment_at(of_b.moments(), now_s), view, false);
        });
        if view.eye != eye {
            // The first scene was drawn before the second one turned the camera.
            ui.ctx().request_repaint();
        }
    }
}

/// Returns the recording that ends later. Its frames are those of the timeline.
fn longer([a, b]: [&Recording; 2]) -> &Recording {
    let end_s = |recording: &Recording| recording.moments().last().map_or(0.0, |last| last.row.time_s);
    if end_s(b) > end_s(a) { b } else { a }
}

/// Draws the name of a run over its scene.
fn heading(ui: &mut Ui, name: &str, tint: egui::Color32, recording: &Recording) {
    egui::Frame::NONE.fill(ui.visuals().panel_fill).inner_margin(egui::Margin::symmetric(8, 2)).show(ui, |ui| {
        ui.horizontal(|ui| {
            plots::chip(ui, tint);
            ui.strong(name);
            ui.add(egui::Label::new(egui::RichText::new(captions::subject(recording)).weak()).truncate());
            // The frame is as wide as the scene.
            ui.allocate_space(egui::vec2(ui.available_width(), 1.0));
        });
    });
}
