//! The page of a recording: its scene, sensor images, curves and timeline.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use eframe::egui::{self, Align, Context, Layout, Ui};

use mvt_recording::{Recording, RecordingError, Status};

use super::export::Exports;
use super::launch::{self, StartedRun};
use super::layers_panel;
use super::plots::PlotRow;
use super::preferences::{Panels, Preferences};
use super::scene_widget::SceneWidget;
use super::sensors::SensorPanel;
use super::shared_recording::SharedRecording;
use super::shortcuts::{KeyCommand, PanelSwitch};
use super::style::{self, colour};
use super::timeline::{Playback, SPEEDS};
use crate::captions;

/// Folder that a recording is read from.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum RecordingSource {
    /// The folder of a run.
    Run(PathBuf),
    /// A raw FeelSight log.
    Log(PathBuf),
}

impl RecordingSource {
    /// Returns the folder.
    pub fn folder(&self) -> &Path {
        match self {
            Self::Run(folder) | Self::Log(folder) => folder,
        }
    }

    /// Returns the name of the folder.
    fn name(&self) -> String {
        let name = self.folder().file_name().map(|name| name.to_string_lossy().into_owned());
        name.unwrap_or_else(|| "run".to_owned())
    }

    /// Opens the recording.
    ///
    /// # Errors
    /// See [`Recording::open`].
    pub fn open(&self) -> Result<Recording, RecordingError> {
        match self {
            Self::Run(folder) => Recording::open(folder),
            Self::Log(folder) => Recording::open_log(folder),
        }
    }
}

/// Page of one recording.
pub struct RecordingPage {
    source: RecordingSource,
    shared: Arc<SharedRecording>,
    /// The run, if this window has started it.
    run: Option<StartedRun>,
    timeline: Playback,
    scene: SceneWidget,
    sensors: SensorPanel,
    plots: PlotRow,
    exports: Exports,
    /// A message, and until when it is shown, in seconds of the window.
    notice: Option<(String, f64)>,
}

/// Time for which a message is shown, seconds.
const NOTICE_S: f64 = 8.0;
/// Angle by which a key orbits, radians.
const ORBIT_RAD: f64 = std::f64::consts::PI / 12.0;
/// Least width for two panels beside the scene, points.
const ROOMY: f32 = 900.0;

impl RecordingPage {
    /// Returns the page of a recording. Threads of its own read and paint it.
    pub fn new(ctx: &Context, source: RecordingSource, recording: Recording, run: Option<StartedRun>) -> Self {
        let timeline = Playback::new(&recording);
        let shared = Arc::new(SharedRecording::new(recording));
        Self {
            timeline,
            scene: SceneWidget::new(ctx, Arc::clone(&shared)),
            sensors: SensorPanel::new(ctx, Arc::clone(&shared)),
            plots: PlotRow::default(),
            exports: Exports::default(),
            notice: None,
            source,
            shared,
            run,
        }
    }

    /// Returns the camera of the scene.
    #[cfg(test)]
    pub fn eye(&self) -> crate::eye::Eye {
        self.scene.eye
    }

    /// Whether pictures are being painted.
    #[cfg(test)]
    pub fn is_busy(&self) -> bool {
        self.scene.is_busy() || self.sensors.is_busy()
    }

    /// Advances the time and collects messages. Call it before every frame.
    pub fn update(&mut self, ctx: &Context, speed: f64) {
        if let Some(Err(message)) = self.run.as_mut().and_then(StartedRun::poll) {
            self.run = None;
            self.notify(ctx, message);
        }
        let recording = self.shared.read();
        let is_running = recording.status() == Status::Running;
        let seconds = ctx.input(|input| f64::from(input.stable_dt.min(0.1)));
        self.timeline.advance(recording.moments(), seconds, speed, is_running);
        drop(recording);
        if self.timeline.is_playing {
            ctx.request_repaint_after(Duration::from_millis(16));
        }
        let now_s = ctx.input(|input| input.time);
        self.notice.take_if(|(_, until_s)| *until_s <= now_s);
        for news in self.exports.news() {
            self.notify(ctx, news);
        }
    }

    fn notify(&mut self, ctx: &Context, text: String) {
        self.notice = Some((text, ctx.input(|input| input.time) + NOTICE_S));
        ctx.request_repaint_after(Duration::from_secs_f64(NOTICE_S));
    }

    /// Executes the command of a key.
    pub fn command(&mut self, ctx: &Context, command: KeyCommand, preferences: &mut Preferences) {
        match command {
            KeyCommand::Time(key, is_far) => {
                let recording = self.shared.read();
                let is_running = recording.status() == Status::Running;
                self.timeline.key(key, is_far, recording.moments(), is_running);
            }
            KeyCommand::Speed(by) => {
                let current = SPEEDS.iter().position(|&speed| speed == preferences.speed).unwrap_or(3);
                let next = current.saturating_add_signed(by as isize).min(SPEEDS.len() - 1);
                preferences.speed = SPEEDS.get(next).copied().unwrap_or(1.0);
            }
            KeyCommand::Layer(layer) => layer.toggle(&mut preferences.layers),
            KeyCommand::Look(preset) => self.scene.eye.look_from(preset),
            KeyCommand::Orbit([right, up]) => {
                self.scene.eye.orbit(f64::from(right) * ORBIT_RAD, f64::from(up) * ORBIT_RAD);
            }
            KeyCommand::Near(steps) => self.scene.eye.zoom(0.9_f64.powi(steps.into())),
            KeyCommand::Reset => self.scene.reset(),
            KeyCommand::Follow => preferences.follow = !preferences.follow,
            KeyCommand::Panel(panel) => {
                let panels = &mut preferences.panels;
                let flag = match panel {
                    PanelSwitch::Layers => &mut panels.layers,
                    PanelSwitch::Sensors => &mut panels.sensors,
                    PanelSwitch::Plots => &mut panels.plots,
                };
                *flag = !*flag;
            }
            KeyCommand::Screenshot => self.exports.screenshot(ctx, &self.source.name()),
            KeyCommand::Export => self.export(ctx),
            KeyCommand::Appearance | KeyCommand::Help | KeyCommand::Quit => {}
        }
    }

    fn export(&mut self, ctx: &Context) {
        let recording = self.shared.read();
        let shape = recording.shape(self.timeline.moment(recording.moments()));
        drop(recording);
        match shape {
            Ok(Some(shape)) => self.exports.mesh(&self.source.name(), &shape),
            Ok(None) => self.notify(ctx, "there is no mesh yet".to_owned()),
            Err(error) => self.notify(ctx, error.to_string()),
        }
    }

    /// Adds the recording's part of the bar at the top.
    pub fn title(&mut self, ui: &mut Ui, preferences: &mut Preferences) {
        let about = self.shared.read().about().clone();
        let side = match about.side {
            mvt_robot::hand::Side::Left => "left hand",
            mvt_robot::hand::Side::Right => "right hand",
        };
        ui.strong(&about.object).on_hover_text(self.source.folder().display().to_string());
        let mode = about.mode.map_or("log", mvt_run::estimator::Mode::name);
        ui.label(format!("mode {mode}   sensors {}   seed {}   {side}", about.modality, about.seed));
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
        if self.shared.is_running()
            && ui.button("Stop the run").on_hover_text("The run writes its results and ends").clicked()
            && let Err(error) = launch::interrupt(about.process)
        {
            self.notify(&ctx, format!("cannot stop the run: {error}"));
        }
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
            egui::Panel::bottom("plots").resizable(true).default_size(150.0).size_range(80.0..=most).show(ui, |ui| {
                let clicked = self.plots.ui(ui, &recording, now_s, &mut preferences.threshold);
                if let Some(time_s) = clicked {
                    self.timeline.seek(recording.moments(), time_s);
                }
            });
        }
        if panels.layers {
            egui::Panel::left("layers").resizable(false).exact_size(196.0).show(ui, |ui| {
                egui::ScrollArea::vertical().auto_shrink(false).show(ui, |ui| {
                    let has_truth = recording.true_mesh().is_some();
                    if layers_panel::ui(ui, preferences, &mut self.scene.eye, has_truth) {
                        self.scene.reset();
                    }
                });
            });
        }
        if panels.sensors {
            egui::Panel::right("sensors").resizable(true).default_size(300.0).size_range(200.0..=620.0).show(
                ui,
                |ui| {
                    egui::ScrollArea::vertical().auto_shrink(false).show(ui, |ui| {
                        self.sensors.ui(ui, &recording, moment);
                    });
                },
            );
        }
        egui::CentralPanel::no_frame().show(ui, |ui| {
            self.scene.ui(ui, &recording, moment, preferences.layers, preferences.follow);
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
                if let Some(problem) = self.shared.problem() {
                    ui.colored_label(colour(theme.lost), problem);
                } else if let Some(warning) = recording.warnings().last() {
                    let all = recording.warnings().join("\n");
                    ui.colored_label(colour(theme.lost), warning).on_hover_text(all);
                }
                if let Some((notice, _)) = &self.notice {
                    ui.strong(notice);
                }
            });
        });
    }
}

/// Closes the panels for which there is no room.
fn room_for(mut panels: Panels, available: egui::Vec2) -> Panels {
    panels.layers &= available.x >= ROOMY || !panels.sensors;
    panels.sensors &= available.x >= 480.0;
    panels.plots &= available.y >= 420.0;
    panels
}
