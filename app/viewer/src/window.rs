//! The window: a start page, recordings, and what is said when they cannot be shown.

mod backend;
mod export;
mod icons;
pub mod launch;
mod layers_panel;
mod legend;
mod plots;
mod preferences;
mod sensors;
mod shared;
mod shortcuts;
mod start;
mod studio;
mod style;
#[cfg(test)]
mod tests;
mod thumbnails;
mod timeline;
mod view3d;
mod watch;

use std::path::PathBuf;
use std::time::{Duration, Instant};

use anyhow::Result;
use eframe::egui::{self, Context, Ui, ViewportBuilder};

pub use watch::Place;

use launch::Run;
use preferences::Preferences;
use shortcuts::Command;
use start::{Start, Wish};
use style::{Appearance, colour};
use watch::Watch;

use mvt_recording::RecordingError;

/// Opens the window and returns when it is closed.
///
/// # Errors
/// If no window can be opened; the message names the command that needs none.
pub fn open(place: Option<&Place>) -> Result<()> {
    let headless = match place {
        Some(Place::Run(folder)) => format!("`mambavitact view --run {} --record out.gif`", folder.display()),
        Some(Place::Log(folder)) => format!("`mambavitact view --log {} --record out.gif`", folder.display()),
        None => "`mambavitact view --run DIR --record out.gif`".to_owned(),
    };
    let viewport = ViewportBuilder::default()
        .with_title("MambaViTact")
        .with_app_id("mambavitact")
        .with_inner_size([1280.0, 800.0])
        .with_min_inner_size([480.0, 360.0]);
    backend::open(&viewport, &headless, &|ctx| Box::new(Window::new(ctx, Preferences::folder(), place.cloned())))
}

/// What fills the window.
enum Page {
    Start(Box<Start>),
    /// A run that was started and has not begun to record.
    Starting(Run),
    Watch(Box<Watch>),
    /// A recording that cannot be shown, and why.
    Trouble(Place, String),
}

/// The window's contents.
struct Window {
    page: Page,
    preferences: Preferences,
    saved: Preferences,
    /// When they were last written.
    saved_at: Instant,
    /// Where they are kept, if there is such a place.
    folder: Option<PathBuf>,
    is_help_open: bool,
    /// What went wrong on the way to the start page.
    problem: Option<String>,
}

impl Window {
    /// A window on something, or on the start page. What is remembered lies in `folder`.
    fn new(ctx: &Context, folder: Option<PathBuf>, place: Option<Place>) -> Self {
        style::install(ctx);
        ctx.options_mut(|options| options.zoom_with_keyboard = false);
        let (preferences, problem) = folder.as_deref().map_or_else(Default::default, Preferences::load);
        // Before the first frame, which would look otherwise.
        preferences.appearance.apply(ctx);
        ctx.set_zoom_factor(preferences.zoom_percent as f32 / 100.0);
        let page = Page::Start(Box::new(Start::new(ctx)));
        let saved = preferences.clone();
        let mut window =
            Self { page, preferences, saved, saved_at: Instant::now(), folder, is_help_open: false, problem };
        if let Some(place) = place {
            window.look_at(ctx, place);
        }
        window
    }

    fn look_at(&mut self, ctx: &Context, place: Place) {
        self.problem = None;
        self.page = match place.open() {
            Ok(recording) => {
                if let Place::Run(folder) = &place {
                    self.preferences.remember(folder);
                }
                Page::Watch(Box::new(Watch::new(ctx, place, recording, None)))
            }
            Err(error) => Page::Trouble(place, error.to_string()),
        };
    }

    fn go_to_start(&mut self, ctx: &Context) {
        self.page = Page::Start(Box::new(Start::new(ctx)));
    }

    /// Looks whether a run that was started has begun to record, or has failed.
    fn await_run(&mut self, ctx: &Context) {
        const AGAIN: Duration = Duration::from_millis(100);
        let Page::Starting(run) = &mut self.page else { return };
        let ended = run.poll();
        let place = Place::Run(run.folder.clone());
        match (place.open(), ended) {
            (Ok(recording), _) => {
                self.preferences.remember(place.folder());
                let page = std::mem::replace(&mut self.page, Page::Trouble(place.clone(), String::new()));
                if let Page::Starting(run) = page {
                    self.page = Page::Watch(Box::new(Watch::new(ctx, place, recording, Some(run))));
                }
            }
            (Err(RecordingError::NoRecording(_)), None) => ctx.request_repaint_after(AGAIN),
            (Err(_), Some(Err(said))) => {
                self.problem = Some(format!("The run did not start. {said}"));
                self.go_to_start(ctx);
            }
            (Err(error), _) => self.page = Page::Trouble(place, error.to_string()),
        }
    }

    fn command(&mut self, ctx: &Context, command: Command) {
        match command {
            Command::Help => self.is_help_open = !self.is_help_open,
            Command::Quit => ctx.send_viewport_cmd(egui::ViewportCommand::Close),
            Command::Appearance => {
                self.preferences.appearance = match ctx.theme() {
                    egui::Theme::Dark => Appearance::Light,
                    egui::Theme::Light => Appearance::Dark,
                };
            }
            other => {
                if let Page::Watch(watch) = &mut self.page {
                    watch.command(ctx, other, &mut self.preferences);
                }
            }
        }
    }

    /// One frame.
    fn ui(&mut self, ui: &mut Ui) {
        let ctx = ui.ctx().clone();
        for command in shortcuts::pressed(&ctx) {
            self.command(&ctx, command);
        }
        self.preferences.zoom(shortcuts::zoom(&ctx));
        ctx.set_zoom_factor(self.preferences.zoom_percent as f32 / 100.0);
        self.preferences.appearance.apply(&ctx);
        self.await_run(&ctx);
        if let Page::Watch(watch) = &mut self.page {
            watch.update(&ctx, self.preferences.speed);
        }
        self.bar(ui);
        let problem = self.problem.clone();
        match &mut self.page {
            Page::Watch(watch) => watch.ui(ui, &mut self.preferences),
            Page::Start(start) => {
                let wish = egui::CentralPanel::default()
                    .show(ui, |ui| start.ui(ui, &mut self.preferences, problem.as_deref()))
                    .inner;
                self.grant(&ctx, wish);
            }
            Page::Starting(run) => {
                let folder = run.folder.display().to_string();
                egui::CentralPanel::default().show(ui, |ui| {
                    ui.vertical_centered(|ui| {
                        ui.add_space(0.35 * ui.available_height());
                        ui.spinner();
                        ui.heading("The run is starting");
                        ui.weak(format!(
                            "An object that is not on this machine is fetched first. Results go to {folder}."
                        ));
                    });
                });
            }
            Page::Trouble(place, words) => {
                let (place, words) = (place.clone(), words.clone());
                egui::CentralPanel::default().show(ui, |ui| self.trouble(ui, place, &words));
            }
        }
        if self.is_help_open {
            self.is_help_open = shortcuts::help(&ctx);
        }
        self.keep();
    }

    fn bar(&mut self, ui: &mut Ui) {
        egui::Panel::top("bar").resizable(false).show(ui, |ui| {
            egui::MenuBar::new().ui(ui, |ui| {
                let is_start = matches!(self.page, Page::Start(_));
                if ui.add_enabled(!is_start, egui::Button::new("Start page")).clicked() {
                    self.problem = None;
                    self.go_to_start(ui.ctx());
                }
                match &mut self.page {
                    Page::Watch(watch) => watch.title(ui, &mut self.preferences),
                    _ => drop(ui.strong("MambaViTact")),
                }
                ui.menu_button("Settings", |ui| {
                    ui.label("Appearance");
                    for appearance in Appearance::ALL {
                        ui.radio_value(&mut self.preferences.appearance, appearance, appearance.name());
                    }
                    ui.separator();
                    ui.label("Size of text");
                    let [least, most] = Preferences::ZOOM_PERCENT;
                    for percent in (least..=most).step_by(25) {
                        ui.radio_value(&mut self.preferences.zoom_percent, percent, format!("{percent} %"));
                    }
                });
                if ui.button("Keys (H)").clicked() {
                    self.is_help_open = true;
                }
            });
        });
    }

    fn grant(&mut self, ctx: &Context, wish: Option<Wish>) {
        match wish {
            None => {}
            Some(Wish::Open(folder)) => self.look_at(ctx, Place::Run(folder)),
            Some(Wish::OpenLog(folder)) => self.look_at(ctx, Place::Log(folder)),
            Some(Wish::Start) => match Run::start(&self.preferences.choices) {
                Ok(run) => {
                    self.problem = None;
                    self.page = Page::Starting(run);
                }
                Err(error) => self.problem = Some(format!("The run cannot be started: {error}")),
            },
        }
    }

    fn trouble(&mut self, ui: &mut Ui, place: Place, words: &str) {
        ui.vertical_centered(|ui| {
            ui.add_space(0.3 * ui.available_height());
            ui.heading("This cannot be shown");
            ui.add_space(6.0);
            ui.colored_label(colour(style::theme(ui.ctx()).lost), words);
            ui.weak(format!("Folder: {}", place.folder().display()));
            ui.add_space(10.0);
            if ui.button("Try again").clicked() {
                self.look_at(ui.ctx(), place);
            }
            if ui.button("Go to the start page").clicked() {
                self.go_to_start(ui.ctx());
            }
        });
    }

    /// Writes what is to be remembered, not too often.
    fn keep(&mut self) {
        const PAUSE: Duration = Duration::from_secs(2);
        if self.preferences != self.saved && self.saved_at.elapsed() > PAUSE {
            self.save();
        }
    }

    fn save(&mut self) {
        if let Some(folder) = self.folder.as_deref().filter(|_| self.preferences != self.saved)
            && let Err(error) = self.preferences.save(folder)
        {
            tracing::warn!("the viewer's settings cannot be kept: {error:#}");
        }
        self.saved = self.preferences.clone();
        self.saved_at = Instant::now();
    }
}

impl eframe::App for Window {
    fn ui(&mut self, ui: &mut Ui, _: &mut eframe::Frame) {
        self.ui(ui);
    }

    fn on_exit(&mut self, _: Option<&eframe::glow::Context>) {
        self.save();
    }
}
