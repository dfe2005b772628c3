//! The window: a start page, recordings, and messages about recordings that cannot be shown.
//!
//! It draws what [`mvt_viewer`] paints, and is a program of its own, so that no other program is built with its fonts and libraries.
//!
//! ```no_run
//! use mvt_window::mvt_viewer::WindowContents;
//!
//! mvt_window::open(&WindowContents::Start)?;
//! # Ok::<(), mvt_window::WindowError>(())
//! ```

mod backend;
mod comparison_page;
mod comparison_table;
mod export;
mod icons;
mod latest_worker;
mod launch;
mod layers_panel;
mod legend_overlay;
mod live;
mod notice;
mod plots;
mod preferences;
mod recording_page;
mod scene_view;
mod scene_widget;
mod sensors;
mod shared_recording;
mod shipped_run;
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
use mvt_recording::{Recording, RecordingError};
use mvt_viewer::{RecordingSource, WindowContents};

pub use backend::WindowError;
pub use live::open_sensor;
pub use mvt_viewer;

use comparison_page::ComparisonPage;
use launch::StartedRun;
use preferences::Preferences;
use recording_page::RecordingPage;
use shipped_run::ShippedRun;
use shortcuts::KeyCommand;
use start_page::{StartPage, StartRequest};
use style::{Appearance, colour};

/// Opens the window and returns when it is closed.
///
/// # Errors
/// [`WindowError`] if no window can be opened, or if it is lost.
pub fn open(contents: &WindowContents) -> Result<(), WindowError> {
    let viewport = ViewportBuilder::default()
        .with_title("MambaViTact")
        .with_app_id("mambavitact")
        .with_inner_size([1280.0, 800.0])
        .with_min_inner_size([480.0, 360.0]);
    backend::open(&viewport, &|ctx| Box::new(Window::new(ctx, Preferences::folder(), contents.clone())))
}

/// Page that fills the window.
enum Page {
    Start,
    /// A run that was started and has not begun to record.
    Starting(StartedRun),
    Recording(Box<RecordingPage>),
    Comparison(Box<ComparisonPage>),
    /// Contents that cannot be shown, and the reason.
    Problem(WindowContents, String),
}

/// Contents of the window.
struct Window {
    page: Page,
    /// The start page, once it was shown. It is kept, because its pictures take a while.
    start: Option<StartPage>,
    preferences: Preferences,
    saved: Preferences,
    /// When the preferences were last written.
    saved_at: Instant,
    /// Folder of the preferences, if there is one.
    folder: Option<PathBuf>,
    is_help_open: bool,
    /// Problem that is shown on the start page.
    problem: Option<String>,
    /// The recording that the program carries, once it was shown.
    shipped: Option<ShippedRun>,
}

impl Window {
    /// Returns a window with these contents. The preferences lie in `folder`.
    fn new(ctx: &Context, folder: Option<PathBuf>, contents: WindowContents) -> Self {
        style::install(ctx);
        ctx.options_mut(|options| options.zoom_with_keyboard = false);
        let (preferences, problem) = folder.as_deref().map_or_else(Default::default, Preferences::load);
        // Before the first frame, which would flicker otherwise.
        preferences.appearance.apply(ctx);
        ctx.set_zoom_factor(preferences.zoom_percent as f32 / 100.0);
        let saved = preferences.clone();
        let mut window = Self {
            page: Page::Start,
            start: None,
            preferences,
            saved,
            saved_at: Instant::now(),
            folder,
            is_help_open: false,
            problem,
            shipped: None,
        };
        match contents {
            // Who has no run yet sees the one that the program carries.
            WindowContents::Start if window.preferences.recent.is_empty() => window.show_shipped(ctx),
            other => window.show(ctx, other),
        }
        window
    }

    fn show(&mut self, ctx: &Context, contents: WindowContents) {
        self.problem = None;
        let page = match &contents {
            WindowContents::Start => {
                self.go_to_start(ctx);
                return;
            }
            WindowContents::Recording(source) => self.open_recording(source).map(|recording| {
                let page = RecordingPage::new(ctx, source.clone(), recording, None, &self.preferences);
                Page::Recording(Box::new(page))
            }),
            WindowContents::Comparison([a, b]) => {
                self.open_recording(a).and_then(|of_a| Ok((of_a, self.open_recording(b)?))).map(|(of_a, of_b)| {
                    let runs = [(a.clone(), of_a), (b.clone(), of_b)];
                    Page::Comparison(Box::new(ComparisonPage::new(ctx, runs, &self.preferences)))
                })
            }
        };
        self.page = page.unwrap_or_else(|error| Page::Problem(contents, error.to_string()));
    }

    /// Opens a recording, and remembers it if it is a run of the user.
    fn open_recording(&mut self, source: &RecordingSource) -> Result<Recording, RecordingError> {
        let recording = source.open()?;
        let is_shipped = self.shipped.as_ref().is_some_and(|run| run.source() == *source);
        if let RecordingSource::Run(folder) = source
            && !is_shipped
        {
            self.preferences.remember(folder);
        }
        Ok(recording)
    }

    /// Plays the recording that the program carries.
    fn show_shipped(&mut self, ctx: &Context) {
        let opened = ShippedRun::unpack()
            .map_err(|error| error.to_string())
            .and_then(|run| Ok((run.source().open().map_err(|error| error.to_string())?, run)));
        match opened {
            Ok((recording, run)) => {
                let mut page = RecordingPage::new(ctx, run.source(), recording, None, &self.preferences);
                page.play(ctx, "An example: a simulated hand turns a cube. The start page begins and opens runs.");
                (self.page, self.shipped) = (Page::Recording(Box::new(page)), Some(run));
            }
            Err(error) => {
                self.go_to_start(ctx);
                self.problem = Some(format!("The example cannot be shown: {error}"));
            }
        }
    }

    fn go_to_start(&mut self, ctx: &Context) {
        match &mut self.start {
            // A run may have downloaded a mesh.
            Some(start) => start.look_again(ctx),
            None => self.start = Some(StartPage::new(ctx)),
        }
        self.page = Page::Start;
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
                if let Page::Starting(run) = std::mem::replace(&mut self.page, Page::Start) {
                    let page = RecordingPage::new(ctx, source, recording, Some(run), &self.preferences);
                    self.page = Page::Recording(Box::new(page));
                }
            }
            (Err(RecordingError::NoRecording(_)), None) => ctx.request_repaint_after(AGAIN),
            (Err(_), Some(Err(message))) => {
                run.clean_up();
                self.problem = Some(format!("The run did not start: {message}"));
                self.page = Page::Start;
            }
            (Err(error), _) => {
                self.page = Page::Problem(WindowContents::Recording(source), error.to_string());
            }
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
            other => match &mut self.page {
                Page::Recording(page) => page.command(ctx, other, &mut self.preferences),
                Page::Comparison(page) => page.command(ctx, other, &mut self.preferences),
                Page::Start | Page::Starting(_) | Page::Problem(..) => {}
            },
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
        match &mut self.page {
            Page::Recording(page) => page.update(&ctx, self.preferences.speed),
            Page::Comparison(page) => page.update(&ctx, self.preferences.speed),
            Page::Start | Page::Starting(_) | Page::Problem(..) => {}
        }
        self.bar(ui);
        let problem = self.problem.clone();
        match &mut self.page {
            Page::Recording(page) => page.ui(ui, &mut self.preferences),
            Page::Comparison(page) => page.ui(ui, &mut self.preferences),
            Page::Start => {
                let start = self.start.get_or_insert_with(|| StartPage::new(&ctx));
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
            Page::Problem(contents, problem) => {
                let (contents, problem) = (contents.clone(), problem.clone());
                egui::CentralPanel::default().show(ui, |ui| self.problem_page(ui, contents, &problem));
            }
        }
        if self.is_help_open {
            self.is_help_open = shortcuts::help(&ctx);
        }
        self.keep();
    }

    fn bar(&mut self, ui: &mut Ui) {
        let mut wanted = None;
        egui::Panel::top("bar").resizable(false).show(ui, |ui| {
            egui::MenuBar::new().ui(ui, |ui| {
                let is_start = matches!(self.page, Page::Start);
                if ui.add_enabled(!is_start, egui::Button::new("Start page")).clicked() {
                    self.problem = None;
                    self.go_to_start(ui.ctx());
                }
                match &mut self.page {
                    Page::Recording(page) => {
                        let other = page.menus(ui, &mut self.preferences);
                        let other = other.map(|other| [page.source().clone(), RecordingSource::Run(other)]);
                        wanted = other.map(WindowContents::Comparison);
                    }
                    Page::Comparison(page) => {
                        wanted = page.menus(ui, &mut self.preferences).map(WindowContents::Recording);
                    }
                    Page::Start | Page::Starting(_) | Page::Problem(..) => {}
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
                // Last, because it is cut where there is no room.
                match &self.page {
                    Page::Recording(page) => page.title(ui),
                    Page::Comparison(_) => drop(ui.strong("Comparison of two runs")),
                    Page::Start | Page::Starting(_) | Page::Problem(..) => drop(ui.strong("MambaViTact")),
                }
            });
        });
        if let Some(contents) = wanted {
            self.show(ui.ctx(), contents);
        }
    }

    fn grant(&mut self, ctx: &Context, request: Option<StartRequest>) {
        match request {
            None => {}
            Some(StartRequest::Show(contents)) => self.show(ctx, contents),
            Some(StartRequest::Example) => self.show_shipped(ctx),
            Some(StartRequest::Start) => match StartedRun::start(&self.preferences.choices) {
                Ok(run) => {
                    self.problem = None;
                    self.page = Page::Starting(run);
                }
                Err(error) => self.problem = Some(format!("The run cannot be started: {error}")),
            },
        }
    }

    fn problem_page(&mut self, ui: &mut Ui, contents: WindowContents, problem: &str) {
        let folders: Vec<String> = match &contents {
            WindowContents::Start => Vec::new(),
            WindowContents::Recording(source) => vec![source.folder().display().to_string()],
            WindowContents::Comparison(both) => both.iter().map(|run| run.folder().display().to_string()).collect(),
        };
        ui.vertical_centered(|ui| {
            ui.add_space(0.3 * ui.available_height());
            ui.heading("This cannot be shown");
            ui.add_space(6.0);
            ui.colored_label(colour(style::theme(ui.ctx()).lost), problem);
            ui.weak(format!("Folder: {}", folders.join(" and ")));
            ui.add_space(10.0);
            if ui.button("Try again").clicked() {
                self.show(ui.ctx(), contents);
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
