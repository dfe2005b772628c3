//! Panel of the sensors' images at a moment.

use std::sync::Arc;

use eframe::egui::{self, ColorImage, Context, TextureHandle, TextureOptions, Ui};
use image::RgbImage;
use mvt_picture::palette;
use mvt_recording::{Recording, Touching};
use mvt_render::rays::RayMesh;
use mvt_robot::hand::Finger;

use super::icons;
use super::latest_worker::{LatestWorker, Work};
use super::shared_recording::SharedRecording;
use super::style::{self, colour};
use crate::sensor_pictures;

/// Request for the pictures of a moment at a revision of the recording.
#[derive(Debug, Clone, PartialEq)]
struct ImagesRequest {
    moment: usize,
    revision: u64,
}

/// Sensor of a picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Sensor {
    Camera(usize),
    Finger(Finger),
}

/// Picture with its caption.
type Captioned<T> = (&'static str, T);

/// Painter of the sensors' pictures.
struct SensorPainter {
    shared: Arc<SharedRecording>,
    /// The newest shape, for its depth images.
    shape: Option<(usize, RayMesh)>,
}

/// Pictures by sensor, or the reason why they cannot be read.
type Painted = Result<Vec<(Sensor, Vec<Captioned<ColorImage>>)>, String>;

impl Work for SensorPainter {
    type Request = ImagesRequest;
    type Output = Painted;

    fn run(&mut self, request: ImagesRequest) -> Painted {
        let shared = Arc::clone(&self.shared);
        let recording = shared.read();
        let Some(images) = recording.images(request.moment).map_err(|error| error.to_string())? else {
            return Ok(Vec::new());
        };
        let index = recording.shape_at(images.frame);
        if let Some(index) = index.filter(|index| self.shape.as_ref().is_none_or(|(known, _)| known != index)) {
            let shape = recording.shape(images.frame).map_err(|error| error.to_string())?;
            self.shape = shape.map(|shape| (index, RayMesh::new(&shape.mesh)));
        }
        let estimate = self.shape.as_ref().filter(|_| index.is_some()).zip(recording.pose(images.frame));
        let mut made = Vec::new();
        for (k, (camera, seen)) in recording.about().cameras.iter().zip(&images.cameras).enumerate() {
            let Some(seen) = seen else { continue };
            let mut shown = vec![("colour", seen.colour.clone()), ("depth", sensor_pictures::depth(seen))];
            shown.push(("labels", sensor_pictures::segmentation(seen)));
            if let Some(((_, mesh), pose)) = estimate {
                shown.push(("depth of the estimate", sensor_pictures::rendered_depth(mesh, pose, camera, seen)));
            }
            made.push((Sensor::Camera(k), for_egui(&shown)));
        }
        for (finger, touch) in images.touch.iter() {
            let Some(touch) = touch else { continue };
            let mut shown = vec![("image", touch.image.clone()), ("indentation", sensor_pictures::indentation(touch))];
            shown.push(("contact", sensor_pictures::contact(touch)));
            shown.extend(sensor_pictures::true_indentation(touch).map(|truth| ("true indentation", truth)));
            made.push((Sensor::Finger(finger), for_egui(&shown)));
        }
        Ok(made)
    }
}

fn for_egui(pictures: &[Captioned<RgbImage>]) -> Vec<Captioned<ColorImage>> {
    let there = pictures.iter().filter(|(_, picture)| !picture.is_empty());
    let same =
        |picture: &RgbImage| ColorImage::from_rgb([picture.width() as usize, picture.height() as usize], picture);
    there.map(|(caption, picture)| (*caption, same(picture))).collect()
}

/// Panel of sensor images.
pub struct SensorPanel {
    worker: LatestWorker<SensorPainter>,
    shown: Vec<(Sensor, Vec<Captioned<TextureHandle>>)>,
    problem: Option<String>,
}

impl SensorPanel {
    /// Returns a panel for a recording.
    pub fn new(ctx: &Context, shared: Arc<SharedRecording>) -> Self {
        let worker = LatestWorker::new(ctx.clone(), || SensorPainter { shared, shape: None });
        Self { worker, shown: Vec::new(), problem: None }
    }

    /// Whether pictures are being painted.
    #[cfg(test)]
    pub fn is_busy(&self) -> bool {
        self.worker.is_busy()
    }

    /// Draws the panel at a moment.
    pub fn ui(&mut self, ui: &mut Ui, recording: &Recording, moment: usize) {
        let theme = style::theme(ui.ctx());
        self.worker.request(ImagesRequest { moment, revision: recording.revision() });
        match self.worker.take() {
            Some(Ok(pictures)) => {
                self.problem = None;
                self.upload(ui.ctx(), pictures);
            }
            Some(Err(problem)) => self.problem = Some(problem),
            None => {}
        }
        ui.heading("Sensors");
        if let Some(problem) = &self.problem {
            ui.colored_label(colour(theme.lost), problem);
        }
        let now = recording.moments().get(moment);
        ui.horizontal_wrapped(|ui| {
            for finger in Finger::ALL {
                let touching = now.and_then(|moment| moment.fingers[finger]);
                contact(ui, finger, touching);
            }
        });
        if self.shown.is_empty() && !self.worker.is_busy() {
            ui.weak("There are no pictures of this moment.");
        }
        for (sensor, pictures) in &self.shown {
            ui.separator();
            match *sensor {
                Sensor::Camera(k) => {
                    let name = recording.about().cameras.get(k).map_or("camera", |camera| camera.name.as_str());
                    ui.strong(format!("Camera {name}"));
                    grid(ui, pictures, 2, name);
                }
                Sensor::Finger(finger) => {
                    let touching = now.and_then(|moment| moment.fingers[finger]);
                    ui.horizontal(|ui| {
                        ui.strong(finger.name());
                        let nothing = if recording.is_read(moment) { "touches nothing" } else { "is being read" };
                        ui.weak(touching.map_or_else(|| nothing.to_owned(), touch_text));
                    });
                    grid(ui, pictures, 4, finger.name());
                }
            }
        }
    }

    /// Loads pictures into textures.
    fn upload(&mut self, ctx: &Context, pictures: Vec<(Sensor, Vec<Captioned<ColorImage>>)>) {
        let mut before = std::mem::take(&mut self.shown).into_iter();
        for (sensor, images) in pictures {
            // Pictures at the same place reuse their texture.
            let mut textures = before.next().map(|(_, textures)| textures).unwrap_or_default().into_iter();
            let uploaded = images.into_iter().map(|(caption, image)| {
                let texture = match textures.next() {
                    Some((_, mut texture)) => {
                        texture.set(image, TextureOptions::LINEAR);
                        texture
                    }
                    None => ctx.load_texture(caption, image, TextureOptions::LINEAR),
                };
                (caption, texture)
            });
            self.shown.push((sensor, uploaded.collect()));
        }
    }
}

/// Draws a lamp with the finger's name and its force.
fn contact(ui: &mut Ui, finger: Finger, touching: Option<Touching>) {
    ui.horizontal(|ui| {
        ui.spacing_mut().item_spacing.x = 3.0;
        let name = finger.name();
        let words = if touching.is_some() { format!("{name} touches") } else { format!("{name} touches nothing") };
        icons::lamp(ui, touching.is_some(), colour(palette::TOUCH), &words);
        match touching.and_then(|touching| touching.force_n) {
            Some(force_n) => ui.label(format!("{name} {force_n:.1} N")),
            None => ui.label(name),
        };
    });
}

fn touch_text(touching: Touching) -> String {
    let mut words = format!("{:.0} mm2, {:.2} mm deep", touching.area_mm2, touching.deepest_mm);
    if let Some(force_n) = touching.force_n {
        words += &format!(", {force_n:.1} N");
    }
    words
}

/// Draws pictures side by side with captions below.
fn grid(ui: &mut Ui, pictures: &[Captioned<TextureHandle>], columns: usize, sensor: &str) {
    const GAP: f32 = 4.0;
    let width = (ui.available_width() - GAP * (columns - 1) as f32) / columns as f32;
    for row in pictures.chunks(columns) {
        ui.horizontal_top(|ui| {
            ui.spacing_mut().item_spacing.x = GAP;
            for (caption, texture) in row {
                ui.vertical(|ui| {
                    ui.set_width(width);
                    ui.spacing_mut().item_spacing.y = 1.0;
                    let alt = format!("{sensor}: {caption}");
                    ui.add(egui::Image::new(texture).fit_to_exact_size(fitted(texture, width)).alt_text(alt));
                    ui.small(*caption);
                });
            }
        });
    }
}

fn fitted(texture: &TextureHandle, width: f32) -> egui::Vec2 {
    let [w, h] = texture.size().map(|side| side.max(1) as f32);
    egui::vec2(width, width * h / w)
}
