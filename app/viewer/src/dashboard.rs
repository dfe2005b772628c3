//! Scene, sensors and curves of a moment on one picture, for films and pictures without a window.

use image::imageops::{self, FilterType};
use image::{Rgb, RgbImage};
use mvt_picture::draw::{self, Area, fill};
use mvt_picture::palette::{Theme, pad_colour};
use mvt_picture::text;
use mvt_recording::{FrameImages, Recording};
use mvt_render::rays::RayMesh;

use crate::eye::Eye;
use crate::layers::Layers;
use crate::legend::{Legend, scale_bar_m};
use crate::paint::ScenePainter;
use crate::tiling::{self, GAP, TITLE, Tiling};
use crate::{captions, run_charts, sensor_pictures};

/// Contents of a dashboard.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
#[non_exhaustive]
pub enum DashboardLayout {
    /// The scene alone
    Scene,
    /// The images of the sensors alone
    Sensors,
    /// Scene, sensors and curves
    All,
}

/// Painter of dashboards.
pub struct Dashboard {
    scene: ScenePainter,
    layout: DashboardLayout,
    /// Width and height, pixels.
    size: [u32; 2],
    layers: Layers,
    theme: Theme,
    /// The newest shape, for its depth images.
    shape: Option<(usize, RayMesh)>,
}

/// Height of the head line, pixels.
const HEAD: u32 = 26;
/// Pictures of a camera and of a touch sensor: three each.
const PER_SENSOR: u32 = 3;
/// Width over height of the picture of a camera and of a touch sensor.
const CAMERA_ASPECT: f64 = 4.0 / 3.0;
const TOUCH_ASPECT: f64 = 0.75;
const LETTERS: f32 = 15.0;
const SMALL: f32 = 12.0;

impl Dashboard {
    /// Returns a painter of dashboards of this width and height in pixels.
    pub fn new(layout: DashboardLayout, size: [u32; 2], layers: Layers, theme: Theme) -> Self {
        Self { scene: ScenePainter::new(), layout, size, layers, theme, shape: None }
    }

    /// Paints the dashboard of a moment, with the scene as seen by an eye.
    pub fn paint(&mut self, recording: &Recording, moment: usize, eye: &Eye) -> RgbImage {
        let eye = &eye.at(recording, moment);
        let [width, height] = self.size;
        let mut page = RgbImage::from_pixel(width, height, self.theme.paper);
        let body =
            Area { x: GAP, y: HEAD, width: width.saturating_sub(2 * GAP), height: height.saturating_sub(HEAD + GAP) };
        match self.layout {
            DashboardLayout::Scene => self.scene(&mut page, body, recording, moment, eye),
            DashboardLayout::Sensors => self.sensors(&mut page, body, recording, moment),
            DashboardLayout::All => {
                let below = body.height / 5;
                let upper = body.height - below - GAP;
                let left = body.width * 3 / 5;
                let right = Area { x: body.x + left + GAP, width: body.width - left - GAP, height: upper, ..body };
                self.scene(&mut page, Area { width: left, height: upper, ..body }, recording, moment, eye);
                self.sensors(&mut page, right, recording, moment);
                let area = Area { y: body.y + upper + GAP, height: below, ..body };
                run_charts::draw(&mut page, area, recording, moment, &self.theme);
            }
        }
        self.head(&mut page, recording, moment);
        page
    }

    fn head(&self, page: &mut RgbImage, recording: &Recording, moment: usize) {
        let Theme { ink, faint, .. } = self.theme;
        let subject = captions::subject(recording);
        text::write(page, (GAP, 4), LETTERS, ink, &subject);
        let x = GAP + text::width(LETTERS, &subject) + 24;
        let mut end = page.width().saturating_sub(GAP);
        if let Some(now) = recording.moments().get(moment) {
            let time = format!("{:.2} s", now.row.time_s);
            end = end.saturating_sub(text::width(LETTERS, &time));
            text::write(page, (end, 4), LETTERS, ink, &time);
        }
        let happening = captions::moment(recording, moment);
        text::write(page, (x, 4), LETTERS, faint, &text::shortened(LETTERS, &happening, end.saturating_sub(x + GAP)));
    }

    fn scene(&mut self, page: &mut RgbImage, area: Area, recording: &Recording, moment: usize, eye: &Eye) {
        let size = [area.width, area.height].map(|side| side as usize);
        let fine = self.scene.paint_fine(recording, moment, &self.layers, eye, &self.theme, size);
        imageops::replace(page, &fine, i64::from(area.x), i64::from(area.y));
        let mut bottom = (area.y + area.height).saturating_sub(GAP);
        for legend in Legend::of(&self.layers, recording, &self.theme) {
            let strip = strip(&legend, &self.theme);
            bottom = bottom.saturating_sub(strip.height());
            // The background of the strip is transparent.
            for (dx, dy, &pixel) in strip.enumerate_pixels().filter(|(_, _, pixel)| **pixel != self.theme.paper) {
                draw::blend(page, area.x + GAP + dx, bottom + dy, pixel, 1.0);
            }
        }
        let length_m = scale_bar_m(eye, area.height as usize);
        let pixels = (length_m / eye.metres_per_pixel(area.height as usize)).round() as u32;
        let (right, bottom) = (area.x + area.width, area.y + area.height);
        let bar =
            Area { x: right.saturating_sub(pixels + 2 * GAP), y: bottom.saturating_sub(12), width: pixels, height: 3 };
        fill(page, bar, self.theme.ink);
        let label = format!("{:.0} mm", length_m * 1e3);
        text::write(page, (bar.x, bar.y.saturating_sub(17)), SMALL, self.theme.ink, &label);
    }

    fn sensors(&mut self, page: &mut RgbImage, area: Area, recording: &Recording, moment: usize) {
        let images = match recording.images(moment) {
            Ok(Some(images)) => images,
            Ok(None) => return,
            Err(error) => {
                text::write(page, (area.x, area.y), SMALL, self.theme.ink, &error.to_string());
                return;
            }
        };
        let has_cameras = images.cameras.iter().any(Option::is_some);
        let has_touch = images.touch.iter().any(Option::is_some);
        let count = images.cameras.len() as u32;
        let cameras = |area: Area| Tiling::best(area, count, PER_SENSOR, CAMERA_ASPECT);
        let pads = recording.about().hand.pads().len() as u32;
        let touch = |area: Area| Tiling::best(area, pads, PER_SENSOR, TOUCH_ASPECT);
        let [of_cameras, of_pads] = match (has_cameras, has_touch) {
            (true, true) => tiling::share(area, cameras, touch),
            _ => [cameras(area), touch(area)],
        };
        if has_cameras {
            self.cameras(page, &of_cameras, recording, &images);
        }
        if has_touch {
            self.touch(page, &of_pads, recording, &images);
        }
    }

    /// Draws colour, measured depth and depth of the estimate of each camera.
    fn cameras(&mut self, page: &mut RgbImage, tiling: &Tiling, recording: &Recording, images: &FrameImages) {
        let index = recording.shape_at(images.frame);
        if let Some(index) = index.filter(|index| self.shape.as_ref().is_none_or(|(known, _)| known != index)) {
            self.shape = recording.shape(images.frame).ok().flatten().map(|shape| (index, RayMesh::new(&shape.mesh)));
        }
        let rendered = self.shape.as_ref().filter(|_| index.is_some()).zip(recording.pose(images.frame));
        for (k, (camera, seen)) in (0..).zip(recording.about().cameras.iter().zip(&images.cameras)) {
            let Some(seen) = seen else { continue };
            let estimate = rendered.map(|((_, mesh), pose)| sensor_pictures::rendered_depth(mesh, pose, camera, seen));
            let row = [
                (camera.name.as_str(), Some(seen.colour.clone())),
                ("depth", Some(sensor_pictures::depth(seen))),
                ("depth of the estimate", estimate),
            ];
            for (place, (title, picture)) in (0..).zip(row) {
                self.tile(page, tiling.cell(k, place), title, picture.as_ref());
            }
        }
    }

    /// Draws image, indentation and contact, or true indentation where it is known, of each touch sensor.
    fn touch(&self, page: &mut RgbImage, tiling: &Tiling, recording: &Recording, images: &FrameImages) {
        // Figures and pictures belong to the same frame.
        let touching = recording.moments().get(images.frame).map(|moment| &moment.touching);
        for (k, (pad, seen)) in (0..).zip(recording.about().hand.pads().iter().zip(&images.touch)) {
            let Some(seen) = seen else { continue };
            let touching = touching.and_then(|touching| *touching.get(k as usize)?);
            let truth = sensor_pictures::true_indentation(seen);
            let third = match truth {
                Some(truth) => ("true", truth),
                None => ("contact", sensor_pictures::contact(seen)),
            };
            let rows =
                [(pad.name.as_str(), seen.image.clone()), ("indentation", sensor_pictures::indentation(seen)), third];
            for (row, (title, picture)) in (0..).zip(rows) {
                let tile = tiling.cell(k, row);
                let title = match touching {
                    Some(touch) if row == 0 => match touch.force_n {
                        Some(force_n) => format!("{title}  {force_n:.1} N"),
                        None => format!("{title}  {:.1} mm", touch.deepest_mm),
                    },
                    _ => title.to_owned(),
                };
                self.tile(page, tile, &title, Some(&picture));
                if row == 0 && touching.is_some() {
                    let lamp = Area { x: tile.x + text::width(SMALL, &title) + 6, y: tile.y + 3, width: 8, height: 8 };
                    // A lamp that would stand in the next column is left out; the figure says the same.
                    if lamp.x + lamp.width <= tile.x + tile.width {
                        fill(page, lamp, pad_colour(k as usize));
                    }
                }
            }
        }
    }

    /// Draws a picture under its title, as large as fits. An empty picture is skipped.
    fn tile(&self, page: &mut RgbImage, area: Area, title: &str, picture: Option<&RgbImage>) {
        let Some(picture) = picture.filter(|picture| !picture.is_empty()) else { return };
        text::write(page, (area.x, area.y), SMALL, self.theme.ink, title);
        let room = [area.width, area.height.saturating_sub(TITLE)];
        let scale =
            (f64::from(room[0]) / f64::from(picture.width())).min(f64::from(room[1]) / f64::from(picture.height()));
        let [width, height] = [picture.width(), picture.height()].map(|side| (f64::from(side) * scale).floor() as u32);
        if width > 0 && height > 0 {
            let picture = imageops::resize(picture, width, height, FilterType::Triangle);
            imageops::replace(page, &picture, i64::from(area.x), i64::from(area.y + TITLE));
        }
    }
}

/// Paints a legend as a strip.
fn strip(legend: &Legend, theme: &Theme) -> RgbImage {
    const BAR: u32 = 150;
    const HEIGHT: u32 = 34;
    match legend {
        Legend::Ramp { title, labels, colour } => bar(BAR, HEIGHT, theme, title, *labels, colour),
        Legend::Names { title, names } => {
            const LETTERS: f32 = SMALL + 1.0;
            let begin = if title.is_empty() { 0 } else { text::width(LETTERS, title) + 10 };
            let width = names.iter().map(|(_, name)| 28 + text::width(LETTERS, name)).sum::<u32>();
            let mut image = RgbImage::from_pixel(begin + width, 18, theme.paper);
            text::write(&mut image, (0, 1), LETTERS, theme.ink, title);
            let mut x = begin;
            for (of_name, name) in names {
                fill(&mut image, Area { x, y: 4, width: 10, height: 10 }, *of_name);
                text::write(&mut image, (x + 14, 1), LETTERS, theme.ink, name);
                x += 28 + text::width(LETTERS, name);
            }
            image
        }
    }
}

fn bar(
    width: u32,
    height: u32,
    theme: &Theme,
    title: &str,
    labels: [&str; 3],
    colour: impl Fn(f32) -> Rgb<u8>,
) -> RgbImage {
    let left = text::width(SMALL + 1.0, title) + 10;
    let mut image = RgbImage::from_pixel(left + width + 24, height, theme.paper);
    text::write(&mut image, (0, 1), SMALL + 1.0, theme.ink, title);
    for x in 0..width {
        fill(&mut image, Area { x: left + x, y: 2, width: 1, height: 11 }, colour(x as f32 / (width - 1) as f32));
    }
    for (k, label) in (0..).zip(labels) {
        let half = text::width(SMALL, label) / 2;
        let x = (left + k * (width - 1) / 2).saturating_sub(half);
        text::write(&mut image, (x, 15), SMALL, theme.ink, label);
    }
    image
}
