//! A window that shows the present images of a sensor.
//!
//! The sensor's thread leaves its newest frame in a [`LiveView`] and goes on; the window takes it when it paints. A frame that comes sooner
//! replaces the one that was not taken.

use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};

use eframe::egui::{self, ColorImage, Context, Key, TextureHandle, TextureOptions, Ui, ViewportBuilder};
use image::RgbImage;

use super::backend::{self, WindowError};
use super::style::{self, colour};

/// Pictures and figures of one instant.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct LiveFrame {
    /// Pictures with their captions, from left to right.
    pub pictures: Vec<(&'static str, RgbImage)>,
    /// Names, values and units of figures.
    pub figures: Vec<(&'static str, String)>,
}

/// A message from a sensor's thread to the window.
#[derive(Debug, Clone, Default)]
pub struct LiveView {
    shared: Arc<Shared>,
}

#[derive(Debug, Default)]
struct Shared {
    news: Mutex<News>,
    /// The window, once it is open.
    window: OnceLock<Context>,
}

#[derive(Debug, Default)]
struct News {
    frame: Option<LiveFrame>,
    end: Option<LiveEnd>,
}

/// Why no more frames come.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum LiveEnd {
    /// All were shown, in words.
    Complete(String),
    /// The sensor was lost, in words.
    Trouble(String),
    /// The program is asked to end, and the window closes.
    Closing,
}

impl LiveView {
    /// Shows a frame as soon as the window paints. Never waits for the window.
    pub fn show(&self, frame: LiveFrame) {
        self.news().frame = Some(frame);
        self.wake();
    }

    /// Tells the window that no more frames come.
    pub fn end(&self, end: LiveEnd) {
        self.news().end = Some(end);
        self.wake();
    }

    fn news(&self) -> MutexGuard<'_, News> {
        self.shared.news.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn wake(&self) {
        if let Some(window) = self.shared.window.get() {
            window.request_repaint();
        }
    }
}

/// Opens a window on a sensor, and returns when it is closed.
///
/// # Errors
/// [`WindowError`] if no window can be opened, or if it is lost.
pub fn open_live(title: &str, view: &LiveView) -> Result<(), WindowError> {
    let viewport = ViewportBuilder::default()
        .with_title(format!("MambaViTact: {title}"))
        .with_app_id("mambavitact")
        .with_inner_size([900.0, 620.0])
        .with_min_inner_size([360.0, 300.0]);
    backend::open(&viewport, &|ctx| Box::new(LiveWindow::new(ctx, title, view.clone())))
}

/// The window.
pub(super) struct LiveWindow {
    title: String,
    view: LiveView,
    pictures: Vec<(&'static str, TextureHandle)>,
    figures: Vec<(&'static str, String)>,
    end: Option<LiveEnd>,
}

/// Distance between pictures, points.
const GAP: f32 = 8.0;
/// Height of a caption, points.
const CAPTION: f32 = 24.0;
/// Width of a figure with its name, points.
const FIGURE: f32 = 132.0;

impl LiveWindow {
    pub fn new(ctx: &Context, title: &str, view: LiveView) -> Self {
        style::install(ctx);
        // A second window on the same view is never woken, which only a test could open.
        let _ = view.shared.window.set(ctx.clone());
        Self { title: title.to_owned(), view, pictures: Vec::new(), figures: Vec::new(), end: None }
    }

    /// Takes the newest frame.
    fn update(&mut self, ctx: &Context) {
        let (frame, end) = {
            let mut news = self.view.news();
            (news.frame.take(), news.end.take())
        };
        if let Some(frame) = frame {
            let upload = |(caption, picture): (&'static str, RgbImage)| {
                let size = [picture.width() as usize, picture.height() as usize];
                let image = ColorImage::from_rgb(size, &picture);
                let known = self.pictures.iter().find(|(known, _)| *known == caption);
                let texture = match known.cloned() {
                    Some((_, mut texture)) => {
                        texture.set(image, TextureOptions::LINEAR);
                        texture
                    }
                    None => ctx.load_texture(caption, image, TextureOptions::LINEAR),
                };
                (caption, texture)
            };
            let pictures = frame.pictures.into_iter().map(upload).collect();
            if self.figures.len() != frame.figures.len() {
                // The panel has its new height from the next frame on.
                ctx.request_repaint();
            }
            self.pictures = pictures;
            self.figures = frame.figures;
        }
        if end == Some(LiveEnd::Closing) {
            ctx.send_viewport_cmd(egui::ViewportCommand::Close);
        }
        self.end = end.or(self.end.take());
    }

    /// Draws a frame.
    pub fn ui(&mut self, ui: &mut Ui) {
        let ctx = ui.ctx().clone();
        self.update(&ctx);
        if ctx.input(|input| input.key_pressed(Key::Q) || input.key_pressed(Key::Escape)) {
            ctx.send_viewport_cmd(egui::ViewportCommand::Close);
        }
        egui::Panel::bottom("figures").resizable(false).show(ui, |ui| {
            ui.add_space(4.0);
            ui.horizontal_wrapped(|ui| {
                for (name, value) in &self.figures {
                    ui.allocate_ui(egui::vec2(FIGURE, 44.0), |ui| {
                        ui.vertical(|ui| {
                            ui.set_width(FIGURE);
                            ui.weak(*name);
                            ui.heading(value);
                        });
                    });
                }
            });
            let theme = style::theme(&ctx);
            match &self.end {
                Some(LiveEnd::Trouble(reason)) => drop(ui.colored_label(colour(theme.lost), reason)),
                Some(LiveEnd::Complete(words)) => drop(ui.strong(words)),
                Some(LiveEnd::Closing) => drop(ui.weak("The window closes.")),
                None if self.pictures.is_empty() => drop(ui.weak(format!("Waiting for {}.", self.title))),
                None => drop(ui.weak(format!("Live from {}. Q closes the window.", self.title))),
            }
            ui.add_space(4.0);
        });
        egui::CentralPanel::default().show(ui, |ui| self.draw_pictures(ui));
    }

    /// Draws the pictures beside one another, as large as they fit.
    fn draw_pictures(&self, ui: &mut Ui) {
        let room = ui.available_size();
        let aspect: f32 = self.pictures.iter().map(|(_, texture)| texture.aspect_ratio()).sum();
        let gaps = GAP * self.pictures.len().saturating_sub(1) as f32;
        let height = ((room.x - gaps) / aspect.max(0.1)).min(room.y - CAPTION).max(1.0);
        ui.horizontal_top(|ui| {
            ui.spacing_mut().item_spacing.x = GAP;
            for (caption, texture) in &self.pictures {
                ui.vertical(|ui| {
                    let size = egui::vec2(height * texture.aspect_ratio(), height);
                    ui.weak(*caption);
                    let picture = egui::Image::from_texture((texture.id(), size)).fit_to_exact_size(size);
                    ui.add(picture.alt_text(*caption));
                });
            }
        });
    }
}

impl eframe::App for LiveWindow {
    fn ui(&mut self, ui: &mut Ui, _: &mut eframe::Frame) {
        self.ui(ui);
    }
}

#[cfg(test)]
mod tests {
    use egui_kittest::Harness;
    use egui_kittest::kittest::Queryable as _;
    use image::Rgb;

    use super::*;

    fn frame(level: u8, area: &str) -> LiveFrame {
        let pictures = ["image", "indentation"].map(|caption| (caption, RgbImage::from_pixel(24, 32, Rgb([level; 3]))));
        LiveFrame { pictures: pictures.into(), figures: vec![("area", area.to_owned())] }
    }

    /// A window without a display, and the view of its sensor.
    fn bench() -> (Harness<'static, Option<LiveWindow>>, LiveView) {
        let view = LiveView::default();
        let of_window = view.clone();
        let app = move |ui: &mut Ui, window: &mut Option<LiveWindow>| {
            window.get_or_insert_with(|| LiveWindow::new(ui.ctx(), "/dev/video0", of_window.clone())).ui(ui);
        };
        (Harness::builder().with_size([700.0, 500.0]).build_ui_state(app, None), view)
    }

    fn shows(harness: &Harness<'_, Option<LiveWindow>>, text: &str) -> bool {
        harness.query_all_by_label_contains(text).next().is_some()
    }

    #[test]
    fn the_newest_frame_is_shown_and_none_waits() {
        let (mut harness, view) = bench();
        harness.run();
        assert!(shows(&harness, "Waiting for /dev/video0"));
        // The window does not take the first two.
        for (level, area) in [(10, "1.0 mm²"), (20, "2.0 mm²"), (30, "3.0 mm²")] {
            view.show(frame(level, area));
        }
        harness.run();
        assert!(shows(&harness, "3.0 mm²") && !shows(&harness, "1.0 mm²"));
        assert!(shows(&harness, "indentation") && shows(&harness, "Live from /dev/video0"));
        let textures = |harness: &Harness<'_, Option<LiveWindow>>| {
            harness.state().as_ref().unwrap().pictures.iter().map(|(_, texture)| texture.id()).collect::<Vec<_>>()
        };
        let before = textures(&harness);
        view.show(frame(40, "4.0 mm²"));
        harness.run();
        assert_eq!(textures(&harness), before, "pictures are replaced, not piled up");
    }

    #[test]
    fn a_lost_camera_is_said_and_its_last_frame_stays() {
        let (mut harness, view) = bench();
        view.show(frame(10, "1.0 mm²"));
        view.end(LiveEnd::Trouble("the camera /dev/video0 was lost: No such device".to_owned()));
        harness.run();
        assert!(shows(&harness, "was lost: No such device") && shows(&harness, "1.0 mm²"));
        assert!(!shows(&harness, "Live from"));
        harness.run();
        assert!(shows(&harness, "was lost"), "the message stays");
    }
}
