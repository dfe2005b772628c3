//! Panel of the sensors' images at a moment.

use std::sync::Arc;

use eframe::egui::{self, ColorImage, Context, TextureHandle, TextureOptions, Ui};
use image::RgbImage;
use mvt_picture::palette;
use mvt_recording::{Recording, Touching};
use mvt_render::rays::RayMesh;
use mvt_robot::hand::PerPad;

use super::icons;
use super::latest_worker::{LatestWorker, Work};
use super::shared_recording::SharedRecording;
use super::style::{self, colour};
use mvt_viewer::sensor_pictures;

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
    /// By the index of the pad.
    Touch(usize),
}

/// Picture with its caption.
type Captioned<T> = (&'static str, T);

/// Painter of the sensors' pictures.
struct SensorPainter {
    shared: Arc<SharedRecording>,
    /// The newest shape, for its depth images.
    shape: Option<(usize, RayMesh)>,
}

/// Pictures of a frame by sensor.
struct SensorPictures<T> {
    /// Index of the moment at which they were taken.
    moment: usize,
    by_sensor: Vec<(Sensor, Vec<Captioned<T>>)>,
}

/// The pictures, or the reason why they cannot be read. There are none before the first images.
type Painted = Result<Option<SensorPictures<ColorImage>>, String>;

impl Work for SensorPainter {
    type Request = ImagesRequest;
    type Output = Painted;

    fn run(&mut self, request: ImagesRequest) -> Painted {
        let shared = Arc::clone(&self.shared);
        let recording = shared.read();
        let Some(images) = recording.images(request.moment).map_err(|error| error.to_string())? else {
            return Ok(None);
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
        for (pad, touch) in images.touch.iter().enumerate() {
            let Some(touch) = touch else { continue };
            let mut shown = vec![("image", touch.image.clone()), ("indentation", sensor_pictures::indentation(touch))];
            shown.push(("contact", sensor_pictures::contact(touch)));
            shown.extend(sensor_pictures::true_indentation(touch).map(|truth| ("true indentation", truth)));
            made.push((Sensor::Touch(pad), for_egui(&shown)));
        }
        Ok(Some(SensorPictures { moment: images.frame, by_sensor: made }))
    }
}

fn for_egui(pictures: &[Captioned<RgbImage>]) -> Vec<Captioned<ColorImage>> {
    let there = pictures.iter().filter(|(_, picture)| !picture.is_empty());
    let same =
        |picture: &RgbImage| ColorImage::from_rgb([picture.width() as usize, picture.height() as usize], picture);
    there.map(|(caption, picture)| (*caption, same(picture))).collect()
}

/// Least and largest width of the picture of a touch sensor, points.
const TOUCH: egui::Rangef = egui::Rangef { min: 40.0, max: 240.0 };
/// Distance between pictures, points.
const GAP: f32 = 4.0;
/// Height over width of the picture of a camera and of a touch sensor, with which the room is shared out.
const CAMERA_ASPECT: f32 = 0.75;
const TOUCH_ASPECT: f32 = 4.0 / 3.0;

/// Panel of sensor images.
pub struct SensorPanel {
    worker: LatestWorker<SensorPainter>,
    shown: Option<SensorPictures<TextureHandle>>,
    problem: Option<String>,
    /// Picture that is shown large.
    enlarged: Option<(Sensor, &'static str)>,
}

impl SensorPanel {
    /// Returns a panel for a recording.
    pub fn new(ctx: &Context, shared: Arc<SharedRecording>) -> Self {
        let worker = LatestWorker::new(ctx.clone(), || SensorPainter { shared, shape: None });
        Self { worker, shown: None, problem: None, enlarged: None }
    }

    /// Whether pictures are being painted.
    #[cfg(test)]
    pub fn is_busy(&self) -> bool {
        self.worker.is_busy()
    }

    /// Draws the panel at a moment, if possible within a height in points. A click on a picture shows it large.
    pub fn ui(&mut self, ui: &mut Ui, recording: &Recording, moment: usize, height: f32) {
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
        let Some(shown) = &self.shown else {
            ui.weak(if self.worker.is_busy() { "The images are being read." } else { "No image of this frame." });
            return;
        };
        ui.weak(self.age(recording, moment, shown.moment));
        // Figures and pictures belong to the same frame.
        let touching = recording.moments().get(shown.moment).map(|moment| moment.touching.clone()).unwrap_or_default();
        let is_read = recording.is_read(shown.moment);
        let mut clicked = None;
        let widths = self.widths(ui, height);
        for (sensor, pictures) in &shown.by_sensor {
            if let Sensor::Camera(k) = *sensor {
                let name = recording.about().cameras.get(k).map_or("camera", |camera| camera.name.as_str());
                ui.strong(format!("Camera {name}"));
                if let Some(caption) = grid(ui, pictures, widths.camera, name) {
                    clicked = Some((*sensor, caption));
                }
            }
        }
        ui.horizontal_top(|ui| {
            ui.spacing_mut().item_spacing.x = GAP;
            for (sensor, pictures) in &shown.by_sensor {
                let Sensor::Touch(pad) = *sensor else { continue };
                let name = pad_name(recording, pad);
                ui.vertical(|ui| {
                    ui.set_width(widths.column);
                    pad_head(ui, (pad, name), touching.get(pad).copied().flatten(), is_read);
                    for (caption, texture) in pictures {
                        if picture(ui, texture, caption, widths.touch, name) {
                            clicked = Some((*sensor, *caption));
                        }
                    }
                });
            }
        });
        self.enlarged = clicked.or(self.enlarged);
        self.large(ui.ctx(), recording, &touching);
    }

    /// Describes the age of the shown pictures.
    fn age(&self, recording: &Recording, moment: usize, of: usize) -> String {
        let time_s = |moment: usize| recording.moments().get(moment).map_or(0.0, |moment| moment.row.time_s);
        match recording.images_at(moment) {
            Some(newest) if newest != of => "The images of this frame are being read.".to_owned(),
            None => "No image of this frame.".to_owned(),
            Some(_) if of == moment => "Images of this frame. Click to enlarge.".to_owned(),
            Some(_) => format!("Images from {:.2} s before. Click to enlarge.", time_s(moment) - time_s(of)),
        }
    }

    /// Returns the sizes with which everything fits into the height, if that is possible.
    fn widths(&self, ui: &Ui, height: f32) -> PictureWidths {
        let rows = |sensor: fn(&Sensor) -> bool| {
            let of = self.shown.iter().flat_map(|shown| &shown.by_sensor).filter(|(other, _)| sensor(other));
            of.map(|(_, pictures)| pictures.len()).collect::<Vec<_>>()
        };
        let cameras = rows(|sensor| matches!(sensor, Sensor::Camera(_)));
        let pads = rows(|sensor| matches!(sensor, Sensor::Touch(_)));
        let line = ui.text_style_height(&egui::TextStyle::Body) + ui.spacing().item_spacing.y;
        let caption = ui.text_style_height(&egui::TextStyle::Small) + 2.0 + ui.spacing().item_spacing.y;
        let share = |count: f32| (ui.available_width() - GAP * (count - 1.0)) / count;
        // Heading, age of the pictures, names and figures of the pads.
        let room = height - 5.0 * line;
        let of_cameras = |columns: f32| {
            let rows: f32 = cameras.iter().map(|&count| (count as f32 / columns).ceil()).sum();
            cameras.len() as f32 * line + rows * (share(columns) * CAMERA_ASPECT + caption)
        };
        let column = share(pads.len().max(1) as f32);
        let most = pads.iter().copied().max().unwrap_or(0).max(1) as f32;
        let of_pads = |columns: f32| (((room - of_cameras(columns)) / most) - caption) / TOUCH_ASPECT;
        let columns = if pads.is_empty() || of_pads(2.0) >= column.min(1.5 * TOUCH.min) { 2.0 } else { 4.0 };
        PictureWidths { camera: share(columns), column, touch: TOUCH.clamp(of_pads(columns)).min(column) }
    }

    /// Shows a picture over everything else, until it is clicked or Esc is pressed.
    fn large(&mut self, ctx: &Context, recording: &Recording, touching: &PerPad<Option<Touching>>) {
        let Some((sensor, caption)) = self.enlarged else { return };
        let pictures = self.shown.iter().flat_map(|shown| &shown.by_sensor).find(|(other, _)| *other == sensor);
        let texture = pictures.and_then(|(_, pictures)| pictures.iter().find(|(other, _)| *other == caption));
        let (name, figures) = match sensor {
            Sensor::Camera(k) => {
                let name = recording.about().cameras.get(k).map_or("camera", |camera| camera.name.as_str());
                (format!("Camera {name}"), String::new())
            }
            Sensor::Touch(pad) => {
                let touching = touching.get(pad).copied().flatten();
                let figures = touching.map_or_else(|| "touches nothing".to_owned(), touch_text);
                (pad_name(recording, pad).to_owned(), figures)
            }
        };
        let modal = egui::Modal::new(egui::Id::unique("enlarged")).show(ctx, |ui| {
            let words = format!("{name}: {caption}");
            ui.horizontal(|ui| {
                ui.strong(&words);
                ui.weak(figures);
            });
            let room = ctx.content_rect().size() - egui::vec2(80.0, 140.0);
            let is_clicked = match texture {
                Some((_, texture)) => {
                    let [width, height] = texture.size().map(|side| side.max(1) as f32);
                    let scale = (room.x / width).min(room.y / height).max(0.1);
                    let image = egui::Image::new(texture).fit_to_exact_size(egui::vec2(width, height) * scale);
                    ui.add(image.alt_text(format!("{words}, enlarged")).sense(egui::Sense::click())).clicked()
                }
                None => ui.weak("No image of this frame.").clicked(),
            };
            ui.weak("A click or Esc closes it.");
            is_clicked
        });
        if modal.inner || modal.should_close() {
            self.enlarged = None;
        }
    }

    /// Loads pictures into textures.
    fn upload(&mut self, ctx: &Context, pictures: Option<SensorPictures<ColorImage>>) {
        let before = self.shown.take().map(|shown| shown.by_sensor).unwrap_or_default();
        let Some(SensorPictures { moment, by_sensor }) = pictures else { return };
        let mut before = before.into_iter();
        let mut loaded = Vec::new();
        for (sensor, images) in by_sensor {
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
            loaded.push((sensor, uploaded.collect()));
        }
        self.shown = Some(SensorPictures { moment, by_sensor: loaded });
    }
}

/// Widths of a camera's picture, of the column of a pad and of its pictures, points.
#[derive(Debug, Clone, Copy)]
struct PictureWidths {
    camera: f32,
    column: f32,
    touch: f32,
}

fn pad_name(recording: &Recording, pad: usize) -> &str {
    recording.about().hand.pads().get(pad).map_or("pad", |pad| pad.name.as_str())
}

/// Draws a pad's name with a lamp, and its contact in figures.
fn pad_head(ui: &mut Ui, (pad, name): (usize, &str), touching: Option<Touching>, is_read: bool) {
    let words = match touching {
        Some(touching) => format!("{name}: {}", touch_text(touching)),
        None if is_read => format!("{name} touches nothing"),
        None => format!("{name} is being read"),
    };
    ui.horizontal(|ui| {
        ui.spacing_mut().item_spacing.x = 3.0;
        icons::lamp(ui, touching.is_some(), colour(palette::pad_colour(pad)), &words);
        ui.strong(name);
    });
    let figure = match touching {
        Some(Touching { force_n: Some(force_n), .. }) => format!("{force_n:.1} N"),
        Some(touching) => format!("{:.2} mm", touching.deepest_mm),
        None if is_read => "no contact".to_owned(),
        None => "is being read".to_owned(),
    };
    ui.add(egui::Label::new(egui::RichText::new(figure).small()).truncate()).on_hover_text(words);
}

fn touch_text(touching: Touching) -> String {
    let mut words = format!("{:.0} mm2, {:.2} mm deep", touching.area_mm2, touching.deepest_mm);
    if let Some(force_n) = touching.force_n {
        words += &format!(", {force_n:.1} N");
    }
    words
}

/// Draws pictures of this width side by side. Returns the caption of the one that was clicked.
fn grid(ui: &mut Ui, pictures: &[Captioned<TextureHandle>], width: f32, sensor: &str) -> Option<&'static str> {
    let mut clicked = None;
    let columns = ((ui.available_width() + GAP + 1.0) / (width + GAP)).floor().max(1.0) as usize;
    for row in pictures.chunks(columns) {
        ui.horizontal_top(|ui| {
            ui.spacing_mut().item_spacing.x = GAP;
            for (caption, texture) in row {
                ui.vertical(|ui| {
                    ui.set_width(width);
                    if picture(ui, texture, caption, width, sensor) {
                        clicked = Some(*caption);
                    }
                });
            }
        });
    }
    clicked
}

/// Draws a picture with its caption below. Returns whether it was clicked.
fn picture(ui: &mut Ui, texture: &TextureHandle, caption: &str, width: f32, sensor: &str) -> bool {
    let image = egui::Image::new(texture).fit_to_exact_size(fitted(texture, width));
    let image = image.alt_text(format!("{sensor}: {caption}")).sense(egui::Sense::click());
    let spacing = std::mem::replace(&mut ui.spacing_mut().item_spacing.y, 1.0);
    let response = ui.add(image).on_hover_cursor(egui::CursorIcon::ZoomIn);
    ui.spacing_mut().item_spacing.y = spacing;
    ui.add(egui::Label::new(egui::RichText::new(caption).small()).truncate()).on_hover_text(caption);
    response.clicked()
}

fn fitted(texture: &TextureHandle, width: f32) -> egui::Vec2 {
    let [w, h] = texture.size().map(|side| side.max(1) as f32);
    egui::vec2(width, width * h / w)
}
