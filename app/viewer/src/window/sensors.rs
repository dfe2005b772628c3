//! What the sensors showed at a moment, and what became of it.

use std::sync::Arc;

use eframe::egui::{self, ColorImage, Context, TextureHandle, TextureOptions, Ui};
use image::RgbImage;
use mvt_render::rays::RayMesh;
use mvt_robot::hand::Finger;

use super::icons;
use super::shared::Shared;
use super::studio::{Craft, Studio};
use super::style::{self, colour};
use crate::colours::SeenBy;
use crate::pictures;
use mvt_recording::{Recording, Touching};

/// Pictures that are wanted: of a moment, at a revision of the recording.
#[derive(Debug, Clone, PartialEq)]
struct Order {
    moment: usize,
    revision: u64,
}

/// Whose pictures.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Sensor {
    Camera(usize),
    Finger(Finger),
}

/// A picture and what it shows.
type Captioned<T> = (&'static str, T);

struct Gallery {
    shared: Arc<Shared>,
    /// The newest shape, for images of it.
    shape: Option<(usize, RayMesh)>,
}

/// What came of an order: pictures by sensor, or why there are none.
type Made = Result<Vec<(Sensor, Vec<Captioned<ColorImage>>)>, String>;

impl Craft for Gallery {
    type Order = Order;
    type Product = Made;

    fn make(&mut self, order: Order) -> Made {
        let shared = Arc::clone(&self.shared);
        let recording = shared.read();
        let Some(images) = recording.images(order.moment).map_err(|error| error.to_string())? else {
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
            let mut shown = vec![("colour", seen.colour.clone()), ("depth", pictures::depth(seen))];
            shown.push(("taken for object and hand", pictures::segmentation(seen)));
            if let Some(((_, mesh), pose)) = estimate {
                shown.push(("depth of the estimate", pictures::rendered_depth(mesh, pose, camera, seen)));
            }
            made.push((Sensor::Camera(k), for_egui(&shown)));
        }
        for (finger, touch) in images.touch.iter() {
            let Some(touch) = touch else { continue };
            let mut shown = vec![("image", touch.image.clone()), ("pressed in", pictures::indentation(touch))];
            shown.push(("contact", pictures::contact(touch)));
            shown.extend(pictures::true_indentation(touch).map(|truth| ("in truth", truth)));
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

/// The panel.
pub struct Sensors {
    studio: Studio<Gallery>,
    shown: Vec<(Sensor, Vec<Captioned<TextureHandle>>)>,
    problem: Option<String>,
}

impl Sensors {
    /// Pictures of a recording.
    pub fn new(ctx: &Context, shared: Arc<Shared>) -> Self {
        let studio = Studio::new(ctx.clone(), || Gallery { shared, shape: None });
        Self { studio, shown: Vec::new(), problem: None }
    }

    /// Whether pictures are under way.
    #[cfg(test)]
    pub fn is_busy(&self) -> bool {
        self.studio.is_busy()
    }

    /// The panel's contents at a moment.
    pub fn ui(&mut self, ui: &mut Ui, recording: &Recording, moment: usize) {
        let theme = style::theme(ui.ctx());
        self.studio.order(Order { moment, revision: recording.revision() });
        match self.studio.take() {
            Some(Ok(pictures)) => {
                self.problem = None;
                self.hang(ui.ctx(), pictures);
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
        if self.shown.is_empty() && !self.studio.is_busy() {
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
                        ui.weak(touching.map_or_else(|| "touches nothing".to_owned(), in_words));
                    });
                    grid(ui, pictures, 4, finger.name());
                }
            }
        }
    }

    fn hang(&mut self, ctx: &Context, pictures: Vec<(Sensor, Vec<Captioned<ColorImage>>)>) {
        let mut before = std::mem::take(&mut self.shown).into_iter();
        for (sensor, images) in pictures {
            // Pictures of the same place go on the same texture.
            let mut textures = before.next().map(|(_, textures)| textures).unwrap_or_default().into_iter();
            let hung = images.into_iter().map(|(caption, image)| {
                let texture = match textures.next() {
                    Some((_, mut texture)) => {
                        texture.set(image, TextureOptions::LINEAR);
                        texture
                    }
                    None => ctx.load_texture(caption, image, TextureOptions::LINEAR),
                };
                (caption, texture)
            });
            self.shown.push((sensor, hung.collect()));
        }
    }
}

/// A lamp with the finger's name and its force.
fn contact(ui: &mut Ui, finger: Finger, touching: Option<Touching>) {
    ui.horizontal(|ui| {
        ui.spacing_mut().item_spacing.x = 3.0;
        let name = finger.name();
        let words = if touching.is_some() { format!("{name} touches") } else { format!("{name} touches nothing") };
        icons::lamp(ui, touching.is_some(), colour(SeenBy::Touch.colour()), &words);
        match touching.and_then(|touching| touching.force_n) {
            Some(force_n) => ui.label(format!("{name} {force_n:.1} N")),
            None => ui.label(name),
        };
    });
}

fn in_words(touching: Touching) -> String {
    let mut words = format!("{:.0} mm2, {:.2} mm deep", touching.area_mm2, touching.deepest_mm);
    if let Some(force_n) = touching.force_n {
        words += &format!(", {force_n:.1} N");
    }
    words
}

/// Pictures side by side with captions below.
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
