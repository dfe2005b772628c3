//! The window: a start page, recordings, and messages about recordings that cannot be shown.

mod backend;
mod export;
mod icons;
mod latest_worker;
pub mod launch;
mod layers_panel;
mod legend_overlay;
mod plots;
mod preferences;
mod recording_page;
mod scene_widget;
mod sensors;
mod shared_recording;
mod shortcuts;
mod start_page;
mod style;
#[cfg(test)]
mod tests;
mod thumbnails;
mod timeline;

use std::path::PathBuf;
use std::time::{Duration, Instant};

use eframe::egui::{self, Context, Ui, ViewportBuilder};
use mvt_recording::RecordingError;

pub use backend::WindowError;
pub use recording_page::RecordingSource;

use launch::StartedRun;
use preferences::Preferences;
use recording_page::RecordingPage;
use shortcuts::KeyCommand;
use start_page::{StartPage, StartRequest};
use style::{Appearance, colour};

/// Opens the window on a recording, or on the start page, and returns when it is closed.
///
/// # Errors
/// [`WindowError`] if no window can be opened, or if it is lost.
pub fn open(source: Option<&RecordingSource>) -> Result<(), WindowError> {
    let viewport = ViewportBuilder::default()
        .with_title("MambaViTact")
        .with_app_id("mambavitact")
        .with_inner_size([1280.0, 800.0])
        .with_min_inner_size([480.0, 360.0]);
    backend::open(&viewport, &|ctx| Box::new(Window::new(ctx, Preferences::folder(), source.cloned())))
}

/// Page that fills the window.
enum Page {
    Start(Box<StartPage>),
    /// A run that was started and has not begun to record.
    Starting(StartedRun),
    Recording(Box<RecordingPage>),
    /// A recording that cannot be shown, and the reason.
    Problem(RecordingSource, String),
}

/// Contents of the window.
struct Window {
    page: Page,
    preferences: Preferences,
    saved: Preferences,
    /// When the preferences were last written.
    saved_at: Instant,
    /// Folder of the preferences, if there is one.
    folder: Option<PathBuf>,
    is_help_open: bool,
    /// Problem that is shown on the start page.
    problem: Option<String>,
}

impl Window {
    /// Returns a window on a recording, or on the start page. The preferences lie in `folder`.
    fn new(ctx: &Context, folder: Option<PathBuf>, source: Option<RecordingSource>) -> Self {
        style::install(ctx);
        ctx.options_mut(|options| options.zoom_with_keyboard = false);
        let (preferences, problem) = folder.as_deref().map_or_else(Default::default, Preferences::load);
        // Before the first frame, which would flicker otherwise.
        preferences.appearance.apply(ctx);
        ctx.set_zoom_factor(preferences.zoom_percent as f32 / 100.0);
        let page = Page::Start(Box::new(StartPage::new(ctx)));
        let saved = preferences.clone();
        let mut window =
            Self { page, preferences, saved, saved_at: Instant::now(), folder, is_help_open: false, problem };
        if let Some(source) = source {
            window.show(ctx, source);
        }
        window
    }

    fn show(&mut self, ctx: &Context, source: RecordingSource) {
        self.problem = None;
        self.page = match source.open() {
            Ok(recording) => {
                if let RecordingSource::Run(folder) = &source {
                    self.preferences.remember(folder);
                }
                Page::Recording(Box::new(RecordingPage::new(ctx, source, recording, None)))
            }
            Err(error) => Page::Problem(source, error.to_string()),
        };
    }

    fn go_to_start(&mut self, ctx: &Context) {
        self.page = Page::Start(Box::new(StartPage::new(ctx)));
    }

    /// Checks whether a started run has begun to record or has failed.
    fn await_run(&mut self, ctx: &Context) {
        const AGAIN: Duration = Duration::from_millis(100);
        let Page::Starting(run) = &mut self.page else { return };
        let ended = run.poll();
        let source = RecordingSource::Run(run.folder.clone());
        match (source.open(), ended) {
            (Ok(recording), _) => {
                self.preferences.remember(source.folder());
                let page = std::mem::replace(&mut self.page, Page::Problem(source.clone(), String::new()));
                if let Page::Starting(run) = page {
                    self.page = Page::Recording(Box::new(RecordingPage::new(ctx, source, recording, Some(run))));
                }
            }
            (Err(RecordingError::NoRecording(_)), None) => ctx.request_repaint_after(AGAIN),
            (Err(_), Some(Err(message))) => {
                self.problem = Some(format!("The run did not start. {message}"));
                self.go_to_start(ctx);
            }
            (Err(error), _) => self.page = Page::Problem(source, error.to_string()),
        }
    }

    fn command(&mut self, ctx: &Context, command: KeyCommand) {
        match command {
            KeyCommand::Help => self.is_help_open = !self.is_help_open,
            KeyCommand::Quit => ctx.send_viewport_cmd(egui::ViewportCommand::Close),
            KeyCommand::Appearance => {
                self.preferences.appearance = match ctx.theme() {
                    egui::Theme::Dark => Appearance::Light,
                    egui::Theme::Light => Appearance::Dark,
                };
            }
            other => {
                if let Page::Recording(page) = &mut self.page {
                    page.command(ctx, other, &mut self.preferences);
                }
            }
        }
    }

    /// Draws a frame.
    fn ui(&mut self, ui: &mut Ui) {
        let ctx = ui.ctx().clone();
        for command in shortcuts::pressed(&ctx) {
            self.command(&ctx, command);
        }
        self.preferences.zoom(shortcuts::zoom(&ctx));
        ctx.set_zoom_factor(self.preferences.zoom_percent as f32 / 100.0);
        self.preferences.appearance.apply(&ctx);
        self.await_run(&ctx);
        if let Page::Recording(page) = &mut self.page {
            page.update(&ctx, self.preferences.speed);
        }
        self.bar(ui);
        let problem = self.problem.clone();
        match &mut self.page {
            Page::Recording(page) => page.ui(ui, &mut self.preferences),
            Page::Start(start) => {
                let request = egui::CentralPanel::default()
                    .show(ui, |ui| start.ui(ui, &mut self.preferences, problem.as_deref()))
                    .inner;
                self.grant(&ctx, request);
            }
            Page::Starting(run) => {
                let folder = run.folder.display().to_string();
                egui::CentralPanel::default().show(ui, |ui| {
                    ui.vertical_centered(|ui| {
                        ui.add_space(0.35 * ui.available_height());
                        ui.spinner();
                        ui.heading("The run is starting");
                        ui.weak(format!("A missing mesh is downloaded first. Results go to {folder}."));
                    });
                });
            }
            Page::Problem(source, problem) => {
                let (source, problem) = (source.clone(), problem.clone());
                egui::CentralPanel::default().show(ui, |ui| self.problem_page(ui, source, &problem));
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
                    Page::Recording(page) => page.title(ui, &mut self.preferences),
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

    fn grant(&mut self, ctx: &Context, request: Option<StartRequest>) {
        match request {
            None => {}
            Some(StartRequest::Open(folder)) => self.show(ctx, RecordingSource::Run(folder)),
            Some(StartRequest::OpenLog(folder)) => self.show(ctx, RecordingSource::Log(folder)),
            Some(StartRequest::Start) => match StartedRun::start(&self.preferences.choices) {
                Ok(run) => {
                    self.problem = None;
                    self.page = Page::Starting(run);
                }
                Err(error) => self.problem = Some(format!("The run cannot be started: {error}")),
            },
        }
    }

    fn problem_page(&mut self, ui: &mut Ui, source: RecordingSource, problem: &str) {
        ui.vertical_centered(|ui| {
            ui.add_space(0.3 * ui.available_height());
            ui.heading("This cannot be shown");
            ui.add_space(6.0);
            ui.colored_label(colour(style::theme(ui.ctx()).lost), problem);
            ui.weak(format!("Folder: {}", source.folder().display()));
            ui.add_space(10.0);
            if ui.button("Try again").clicked() {
                self.show(ui.ctx(), source);
            }
            if ui.button("Go to the start page").clicked() {
                self.go_to_start(ui.ctx());
            }
        });
    }

    /// Writes changed preferences, at most every two seconds.
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
            tracing::warn!("cannot save the viewer's settings: {error:#}");
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
