//! The page of a recording: its scene, sensor images, curves and timeline.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use eframe::egui::{self, Align, Context, Layout, Ui};

use mvt_recording::{Recording, Status};
use mvt_viewer::RecordingSource;

use super::export::Exports;
use super::launch::{self, StartedRun};
use super::layers_panel;
use super::notice::{self, Notice};
use super::plots::PlotRow;
use super::preferences::{Panels, Preferences};
use super::scene_view::SceneView;
use super::scene_widget::SceneWidget;
use super::sensors::SensorPanel;
use super::shared_recording::SharedRecording;
use super::shortcuts::KeyCommand;
use super::style::{self, colour};
use super::timeline::Playback;
use mvt_viewer::captions;

/// Page of one recording.
pub struct RecordingPage {
    source: RecordingSource,
    shared: Arc<SharedRecording>,
    /// The run, if this window has started it.
    run: Option<StartedRun>,
    timeline: Playback,
    scene: SceneWidget,
    view: SceneView,
    sensors: SensorPanel,
    plots: PlotRow,
    exports: Exports,
    notice: Notice,
}

/// Least width for two panels beside the scene, points.
const ROOMY: f32 = 900.0;
/// Width of the panel of layers, points.
const LAYERS: f32 = 196.0;
/// Least width of the panel of sensors, points, and its share of the window.
const LEAST_SENSORS: f32 = 200.0;
const SENSORS_SHARE: f32 = 0.27;
/// Change of the width of the window after which the panel of sensors has its share again, points.
const WINDOW_STEP: f32 = 160.0;

impl RecordingPage {
    /// Returns the page of a recording. Threads of its own read and paint it.
    pub fn new(
        ctx: &Context,
        source: RecordingSource,
        recording: Recording,
        run: Option<StartedRun>,
        preferences: &Preferences,
    ) -> Self {
        let timeline = Playback::new(&recording);
        let shared = Arc::new(SharedRecording::new(recording));
        Self {
            timeline,
            scene: SceneWidget::new(ctx, Arc::clone(&shared)),
            sensors: SensorPanel::new(ctx, Arc::clone(&shared)),
            plots: PlotRow::default(),
            exports: Exports::default(),
            notice: Notice::default(),
            view: SceneView::new(preferences.colouring),
            source,
            shared,
            run,
        }
    }

    /// Returns the camera of the scene.
    #[cfg(test)]
    pub fn eye(&self) -> mvt_viewer::eye::Eye {
        self.view.eye
    }

    /// Returns the span of time that the curves show, if it is not all.
    #[cfg(test)]
    pub fn zoomed_s(&self) -> Option<[f64; 2]> {
        self.plots.zoomed_s()
    }

    /// Whether pictures are being painted.
    #[cfg(test)]
    pub fn is_busy(&self) -> bool {
        self.scene.is_busy() || self.sensors.is_busy()
    }

    /// Plays the recording from its beginning, under a notice.
    pub fn play(&mut self, ctx: &Context, words: &str) {
        let recording = self.shared.read();
        self.timeline.show(recording.moments(), 0, false);
        self.timeline.toggle(recording.moments());
        self.notice.show(ctx, words.to_owned());
    }

    /// Advances the time and collects messages. Call it before every frame.
    pub fn update(&mut self, ctx: &Context, speed: f64) {
        if let Some(Err(message)) = self.run.as_mut().and_then(StartedRun::poll) {
            self.run = None;
            self.notice.show(ctx, message);
        }
        let recording = self.shared.read();
        let is_running = recording.status() == Status::Running;
        let seconds = ctx.input(|input| f64::from(input.stable_dt.min(0.1)));
        self.timeline.advance(recording.moments(), seconds, speed, is_running);
        drop(recording);
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
                let recording = self.shared.read();
                let is_running = recording.status() == Status::Running;
                self.timeline.key(key, is_far, recording.moments(), is_running);
            }
            KeyCommand::Screenshot => self.exports.screenshot(ctx, &self.source.name()),
            KeyCommand::Export => self.export(ctx),
            other => self.view.command(other, preferences),
        }
    }

    fn export(&mut self, ctx: &Context) {
        let recording = self.shared.read();
        let shape = recording.shape(self.timeline.moment(recording.moments()));
        drop(recording);
        match shape {
            Ok(Some(shape)) => self.exports.mesh(&self.source.name(), &shape),
            Ok(None) => self.notice.show(ctx, "there is no mesh yet".to_owned()),
            Err(error) => self.notice.show(ctx, error.to_string()),
        }
    }

    /// Adds the name and the settings of the run to the bar at the top.
    pub fn title(&self, ui: &mut Ui) {
        let recording = self.shared.read();
        let about = recording.about();
        let side = if about.hand.is_none() { "no" } else { about.hand.side().name() };
        ui.strong(&about.object).on_hover_text(self.source.folder().display().to_string());
        let mode = about.mode.map_or("log", mvt_run::estimator::Mode::name);
        let words = format!("mode {mode}   sensors {}   seed {}   {side} hand", about.modality, about.seed);
        let more = format!("{words} ({})", about.hand.name());
        ui.add(egui::Label::new(words).truncate()).on_hover_text(more);
    }

    /// Adds the page's menus to the bar at the top. Returns the run with which this one should be compared.
    pub fn menus(&mut self, ui: &mut Ui, preferences: &mut Preferences) -> Option<PathBuf> {
        let mut other = None;
        let ctx = ui.ctx().clone();
        ui.menu_button("File", |ui| {
            if ui.button("Screenshot (S)").clicked() {
                self.exports.screenshot(&ctx, &self.source.name());
                ui.close();
            }
            if ui.button("Export the mesh (E)").clicked() {
                self.export(&ctx);
                ui.close();
            }
        });
        ui.menu_button("Panels", |ui| {
            let panels = &mut preferences.panels;
            ui.checkbox(&mut panels.layers, "Layers (L)");
            ui.checkbox(&mut panels.sensors, "Sensor images (I)");
            ui.checkbox(&mut panels.plots, "Curves (U)");
        });
        if matches!(self.source, RecordingSource::Run(_)) {
            ui.menu_button("Compare", |ui| {
                let own = std::path::absolute(self.source.folder()).ok();
                let others: Vec<&PathBuf> =
                    preferences.recent.iter().filter(|run| Some(run.as_path()) != own.as_deref()).collect();
                if others.is_empty() {
                    ui.weak("Runs that you open appear here.");
                }
                for run in others {
                    if ui.button(format!("with {}", captions::folder(run))).clicked() {
                        other = Some(run.clone());
                        ui.close();
                    }
                }
            });
        }
        if self.shared.is_running()
            && ui.button("Stop the run").on_hover_text("The run writes its results and ends").clicked()
            && let Err(error) = launch::interrupt(self.shared.read().about().process)
        {
            self.notice.show(&ctx, format!("cannot stop the run: {error}"));
        }
        other
    }

    /// Returns the folder that the recording is read from.
    pub fn source(&self) -> &RecordingSource {
        &self.source
    }

    /// Draws everything below the bar.
    pub fn ui(&mut self, ui: &mut Ui, preferences: &mut Preferences) {
        let panels = room_for(preferences.panels, ui.available_size());
        let shared = Arc::clone(&self.shared);
        let recording = shared.read();
        egui::Panel::bottom("time").resizable(false).show(ui, |ui| {
            ui.add_space(2.0);
            self.timeline.ui(ui, &recording, &mut preferences.speed);
            self.status(ui, &recording);
        });
        let moments = recording.moments();
        let moment = self.timeline.moment(moments);
        let now_s = moments.get(moment).map_or(0.0, |moment| moment.row.time_s);
        if panels.plots {
            let most = (0.5 * ui.available_height()).max(80.0);
            let panel = egui::Panel::bottom("plots").resizable(true).default_size(most.min(150.0));
            panel.size_range(80.0..=most).show(ui, |ui| {
                let clicked = self.plots.ui(ui, &[&recording], now_s, &mut preferences.threshold);
                if let Some(time_s) = clicked {
                    self.timeline.seek(recording.moments(), time_s);
                }
            });
        }
        // A narrow window puts the layers above the sensors.
        let is_narrow = ui.available_width() < ROOMY;
        if panels.layers && !(is_narrow && panels.sensors) {
            egui::Panel::left("layers").resizable(false).exact_size(LAYERS).show(ui, |ui| {
                egui::ScrollArea::vertical().auto_shrink(false).show(ui, |ui| {
                    layers_panel::ui(ui, preferences, &mut self.view, &[&recording]);
                });
            });
        }
        if panels.sensors {
            let width = ui.ctx().content_rect().width();
            // The panel is a share of the window. A dragged width holds for windows of about the same size.
            let panel = egui::Panel::right(("sensors", (width / WINDOW_STEP) as u32)).resizable(true);
            let most = (0.6 * width).max(LEAST_SENSORS);
            let default = (SENSORS_SHARE * width).max(LEAST_SENSORS);
            panel.default_size(default).size_range(LEAST_SENSORS..=most).show(ui, |ui| {
                let height = ui.available_height();
                egui::ScrollArea::vertical().auto_shrink(false).show(ui, |ui| {
                    if is_narrow && panels.layers {
                        layers_panel::ui(ui, preferences, &mut self.view, &[&recording]);
                        ui.separator();
                    }
                    self.sensors.ui(ui, &recording, moment, height);
                });
            });
        }
        egui::CentralPanel::no_frame().show(ui, |ui| {
            self.scene.ui(ui, &recording, moment, &mut self.view, preferences.follow);
        });
    }

    /// Draws the line that describes the moment and the run in words.
    fn status(&self, ui: &mut Ui, recording: &Recording) {
        let theme = style::theme(ui.ctx());
        ui.horizontal(|ui| {
            let status = recording.status();
            let words = captions::moment(recording, self.timeline.moment(recording.moments()));
            ui.label(words);
            ui.with_layout(Layout::right_to_left(Align::Center), |ui| {
                let run = captions::status(recording);
                match status {
                    Status::Running | Status::Finished => ui.weak(run),
                    Status::Interrupted | Status::Crashed => ui.colored_label(colour(theme.lost), run),
                };
                notice::problem(ui, &self.shared, recording);
                self.notice.ui(ui);
            });
        });
    }
}

/// Closes the panels for which there is no room.
fn room_for(mut panels: Panels, available: egui::Vec2) -> Panels {
    panels.sensors &= available.x >= 480.0;
    panels.plots &= available.y >= 340.0;
    panels
}
