//! The page of a recording: its view, what the sensors showed, curves and time line.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use eframe::egui::{self, Align, Context, Layout, Ui};

use super::export::Exports;
use super::launch::{self, Run};
use super::layers_panel;
use super::plots::Plots;
use super::preferences::{Panels, Preferences};
use super::sensors::Sensors;
use super::shared::Shared;
use super::shortcuts::{Command, Panel};
use super::style::{self, colour};
use super::timeline::{SPEEDS, Timeline};
use super::view3d::View;
use crate::words;
use mvt_recording::{Recording, RecordingError, Status};

/// What is looked at.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Place {
    /// The folder of a run.
    Run(PathBuf),
    /// A raw FeelSight log.
    Log(PathBuf),
}

impl Place {
    /// The folder.
    pub fn folder(&self) -> &Path {
        match self {
            Self::Run(folder) | Self::Log(folder) => folder,
        }
    }

    /// Name of the folder.
    fn name(&self) -> String {
        let name = self.folder().file_name().map(|name| name.to_string_lossy().into_owned());
        name.unwrap_or_else(|| "run".to_owned())
    }

    /// Opens it.
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

/// A recording that is looked at.
pub struct Watch {
    place: Place,
    shared: Arc<Shared>,
    /// The process, if it was started here.
    run: Option<Run>,
    timeline: Timeline,
    view: View,
    sensors: Sensors,
    plots: Plots,
    exports: Exports,
    /// Something worth saying, and until when, in the window's seconds.
    notice: Option<(String, f64)>,
}

/// How long a notice stays, seconds.
const NOTICE_S: f64 = 8.0;
/// A step around what is looked at, by keys, radians.
const ORBIT_RAD: f64 = std::f64::consts::PI / 12.0;
/// Narrower than this there is room for one panel beside the view.
const ROOMY: f32 = 900.0;

impl Watch {
    /// Looks at a recording.
    pub fn new(ctx: &Context, place: Place, recording: Recording, run: Option<Run>) -> Self {
        let timeline = Timeline::new(&recording);
        let shared = Arc::new(Shared::new(recording));
        Self {
            timeline,
            view: View::new(ctx, Arc::clone(&shared)),
            sensors: Sensors::new(ctx, Arc::clone(&shared)),
            plots: Plots::default(),
            exports: Exports::default(),
            notice: None,
            place,
            shared,
            run,
        }
    }

    /// From where the scene is looked at.
    #[cfg(test)]
    pub fn eye(&self) -> crate::Eye {
        self.view.eye
    }

    /// Whether pictures are under way.
    #[cfg(test)]
    pub fn is_busy(&self) -> bool {
        self.view.is_busy() || self.sensors.is_busy()
    }

    /// Goes on with the run and with the time. To be called before every frame.
    pub fn update(&mut self, ctx: &Context, speed: f64) {
        if let Some(Err(said)) = self.run.as_mut().and_then(Run::poll) {
            self.run = None;
            self.say(ctx, said);
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
            self.say(ctx, news);
        }
    }

    fn say(&mut self, ctx: &Context, text: String) {
        self.notice = Some((text, ctx.input(|input| input.time) + NOTICE_S));
        ctx.request_repaint_after(Duration::from_secs_f64(NOTICE_S));
    }

    /// Does what a key asks for.
    pub fn command(&mut self, ctx: &Context, command: Command, preferences: &mut Preferences) {
        match command {
            Command::Time(key, is_far) => {
                let recording = self.shared.read();
                let is_running = recording.status() == Status::Running;
                self.timeline.key(key, is_far, recording.moments(), is_running);
            }
            Command::Speed(by) => {
                let current = SPEEDS.iter().position(|&speed| speed == preferences.speed).unwrap_or(3);
                let next = current.saturating_add_signed(by as isize).min(SPEEDS.len() - 1);
                preferences.speed = SPEEDS.get(next).copied().unwrap_or(1.0);
            }
            Command::Layer(layer) => layer.toggle(&mut preferences.layers),
            Command::Look(preset) => self.view.eye.look_from(preset),
            Command::Orbit([right, up]) => self.view.eye.orbit(f64::from(right) * ORBIT_RAD, f64::from(up) * ORBIT_RAD),
            Command::Near(steps) => self.view.eye.zoom(0.9_f64.powi(steps.into())),
            Command::Reset => self.view.reset(),
            Command::Follow => preferences.follow = !preferences.follow,
            Command::Panel(panel) => {
                let panels = &mut preferences.panels;
                let flag = match panel {
                    Panel::Layers => &mut panels.layers,
                    Panel::Sensors => &mut panels.sensors,
                    Panel::Plots => &mut panels.plots,
                };
                *flag = !*flag;
            }
            Command::Screenshot => self.exports.screenshot(ctx, &self.place.name()),
            Command::Export => self.export(ctx),
            Command::Appearance | Command::Help | Command::Quit => {}
        }
    }

    fn export(&mut self, ctx: &Context) {
        let recording = self.shared.read();
        let shape = recording.shape(self.timeline.moment(recording.moments()));
        drop(recording);
        match shape {
            Ok(Some(shape)) => self.exports.mesh(&self.place.name(), &shape),
            Ok(None) => self.say(ctx, "there is no mesh yet".to_owned()),
            Err(error) => self.say(ctx, error.to_string()),
        }
    }

    /// The bar above, beside what the window puts there.
    pub fn title(&mut self, ui: &mut Ui, preferences: &mut Preferences) {
        let about = self.shared.read().about().clone();
        let side = match about.side {
            mvt_robot::hand::Side::Left => "left hand",
            mvt_robot::hand::Side::Right => "right hand",
        };
        ui.strong(&about.object).on_hover_text(self.place.folder().display().to_string());
        let mode = about.mode.map_or("log", mvt_run::pipeline::Mode::name);
        ui.label(format!("mode {mode}   sensors {}   seed {}   {side}", about.modality, about.seed));
        let ctx = ui.ctx().clone();
        ui.menu_button("File", |ui| {
            if ui.button("Screenshot (S)").clicked() {
                self.exports.screenshot(&ctx, &self.place.name());
                ui.close();
            }
            if ui.button("Export the mesh (E)").clicked() {
                self.export(&ctx);
                ui.close();
            }
        });
        ui.menu_button("Panels", |ui| {
            let panels = &mut preferences.panels;
            ui.checkbox(&mut panels.layers, "What is shown (L)");
            ui.checkbox(&mut panels.sensors, "Sensor images (I)");
            ui.checkbox(&mut panels.plots, "Curves (U)");
        });
        if self.shared.is_running()
            && ui.button("Stop the run").on_hover_text("It writes what it has and ends").clicked()
            && let Err(error) = launch::stop(about.process)
        {
            self.say(&ctx, format!("the run cannot be stopped: {error}"));
        }
    }

    /// Everything below the bar.
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
                    let has_truth = recording.truth().is_some();
                    if layers_panel::ui(ui, preferences, &mut self.view.eye, has_truth) {
                        self.view.reset();
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
            self.view.ui(ui, &recording, moment, preferences.layers, preferences.follow);
        });
    }

    /// The line that says in words what is happening.
    fn status(&self, ui: &mut Ui, recording: &Recording) {
        let theme = style::theme(ui.ctx());
        ui.horizontal(|ui| {
            let status = recording.status();
            let words = words::happening(recording, self.timeline.moment(recording.moments()));
            ui.label(words);
            ui.with_layout(Layout::right_to_left(Align::Center), |ui| {
                let run = words::whole(recording);
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

/// The panels for which there is room.
fn room_for(mut panels: Panels, available: egui::Vec2) -> Panels {
    panels.layers &= available.x >= ROOMY || !panels.sensors;
    panels.sensors &= available.x >= 480.0;
    panels.plots &= available.y >= 420.0;
    panels
}
