//! A window that shows the present images of a sensor.
//!
//! Another process reads the sensor and writes its newest frames to this one's standard input.

use std::io::{self, BufReader};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use eframe::egui::{self, ColorImage, Context, Key, TextureHandle, TextureOptions, Ui, ViewportBuilder};
use image::RgbImage;
use mvt_viewer::live::{LiveEnd, LiveFrame, LiveMessage};

use super::backend::{self, WindowError};
use super::style::{self, colour};

/// What was read and not yet shown.
#[derive(Debug, Clone, Default)]
struct Inbox(Arc<Mutex<News>>);

#[derive(Debug, Default)]
struct News {
    frame: Option<LiveFrame>,
    end: Option<LiveEnd>,
}

impl Inbox {
    fn news(&self) -> MutexGuard<'_, News> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Takes a message. A frame replaces one that was not shown.
    fn receive(&self, message: LiveMessage) {
        match message {
            LiveMessage::Frame(frame) => self.news().frame = Some(frame),
            LiveMessage::End(end) => self.news().end = Some(end),
        }
    }

    /// Reads messages until the last one, on a thread of its own.
    fn read(&self, ctx: &Context) {
        let (inbox, ctx) = (self.clone(), ctx.clone());
        std::thread::spawn(move || {
            let mut input = BufReader::new(io::stdin());
            while let Ok(Some(message)) = LiveMessage::read(&mut input) {
                let is_last = matches!(message, LiveMessage::End(_));
                inbox.receive(message);
                ctx.request_repaint();
                if is_last {
                    return;
                }
            }
            inbox.receive(LiveMessage::End(LiveEnd::Trouble("the program that reads the sensor has ended".to_owned())));
            ctx.request_repaint();
        });
    }
}

/// Opens a window on a sensor, and returns when it is closed. Standard input delivers [`LiveMessage`]s.
///
/// # Errors
/// [`WindowError`] if no window can be opened, or if it is lost.
pub fn open_sensor(title: &str) -> Result<(), WindowError> {
    let viewport = ViewportBuilder::default()
        .with_title(format!("MambaViTact: {title}"))
        .with_app_id("mambavitact")
        .with_inner_size([900.0, 620.0])
        .with_min_inner_size([360.0, 300.0]);
    backend::open(&viewport, &|ctx| {
        let inbox = Inbox::default();
        inbox.read(ctx);
        Box::new(LiveWindow::new(ctx, title, inbox))
    })
}

/// The window.
struct LiveWindow {
    title: String,
    inbox: Inbox,
    pictures: Vec<(String, TextureHandle)>,
    figures: Vec<(String, String)>,
    end: Option<LiveEnd>,
}

/// Distance between pictures, points.
const GAP: f32 = 8.0;
/// Height of a caption, points.
const CAPTION: f32 = 24.0;
/// Width of a figure with its name, points.
const FIGURE: f32 = 132.0;

impl LiveWindow {
    fn new(ctx: &Context, title: &str, inbox: Inbox) -> Self {
        style::install(ctx);
        Self { title: title.to_owned(), inbox, pictures: Vec::new(), figures: Vec::new(), end: None }
    }

    /// Takes the newest frame.
    fn update(&mut self, ctx: &Context) {
        let (frame, end) = {
            let mut news = self.inbox.news();
            (news.frame.take(), news.end.take())
        };
        if let Some(frame) = frame {
            let upload = |(caption, picture): (String, RgbImage)| {
                let size = [picture.width() as usize, picture.height() as usize];
                let image = ColorImage::from_rgb(size, &picture);
                let known = self.pictures.iter().find(|(known, _)| *known == caption);
                let texture = match known.cloned() {
                    Some((_, mut texture)) => {
                        texture.set(image, TextureOptions::LINEAR);
                        texture
                    }
                    None => ctx.load_texture(&caption, image, TextureOptions::LINEAR),
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
    fn ui(&mut self, ui: &mut Ui) {
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
                            ui.weak(name);
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
                    ui.weak(caption);
                    let picture = egui::Image::from_texture((texture.id(), size)).fit_to_exact_size(size);
                    ui.add(picture.alt_text(caption));
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
        let pictures =
            ["image", "indentation"].map(|caption| (caption.to_owned(), RgbImage::from_pixel(24, 32, Rgb([level; 3]))));
        LiveFrame { pictures: pictures.into(), figures: vec![("area".to_owned(), area.to_owned())] }
    }

    /// A window without a display, and its inbox.
    fn bench() -> (Harness<'static, Option<LiveWindow>>, Inbox) {
        let inbox = Inbox::default();
        let of_window = inbox.clone();
        let app = move |ui: &mut Ui, window: &mut Option<LiveWindow>| {
            window.get_or_insert_with(|| LiveWindow::new(ui.ctx(), "/dev/video0", of_window.clone())).ui(ui);
        };
        (Harness::builder().with_size([700.0, 500.0]).build_ui_state(app, None), inbox)
    }

    fn shows(harness: &Harness<'_, Option<LiveWindow>>, text: &str) -> bool {
        harness.query_all_by_label_contains(text).next().is_some()
    }

    #[test]
    fn the_newest_frame_is_shown_and_none_waits() {
        let (mut harness, inbox) = bench();
        harness.run();
        assert!(shows(&harness, "Waiting for /dev/video0"));
        // The window does not take the first two.
        for (level, area) in [(10, "1.0 mm²"), (20, "2.0 mm²"), (30, "3.0 mm²")] {
            inbox.receive(LiveMessage::Frame(frame(level, area)));
        }
        harness.run();
        assert!(shows(&harness, "3.0 mm²") && !shows(&harness, "1.0 mm²"));
        assert!(shows(&harness, "indentation") && shows(&harness, "Live from /dev/video0"));
        let textures = |harness: &Harness<'_, Option<LiveWindow>>| {
            harness.state().as_ref().unwrap().pictures.iter().map(|(_, texture)| texture.id()).collect::<Vec<_>>()
        };
        let before = textures(&harness);
        inbox.receive(LiveMessage::Frame(frame(40, "4.0 mm²")));
        harness.run();
        assert_eq!(textures(&harness), before, "pictures are replaced, not piled up");
    }

    #[test]
    fn a_lost_camera_is_said_and_its_last_frame_stays() {
        let (mut harness, inbox) = bench();
        inbox.receive(LiveMessage::Frame(frame(10, "1.0 mm²")));
        let words = "the camera /dev/video0 was lost: No such device";
        inbox.receive(LiveMessage::End(LiveEnd::Trouble(words.to_owned())));
        harness.run();
        assert!(shows(&harness, "was lost: No such device") && shows(&harness, "1.0 mm²"));
        assert!(!shows(&harness, "Live from"));
        harness.run();
        assert!(shows(&harness, "was lost"), "the message stays");
    }
}
