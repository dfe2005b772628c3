//! Scene, sensors and curves of a moment on one picture, with lettering: what a film shows, without any window.

use image::imageops::{self, FilterType};
use image::{Rgb, RgbImage};
use mvt_picture::lettering;
use mvt_render::rays::RayMesh;
use mvt_robot::hand::Finger;

use super::colours::SeenBy;
use super::curves::{self, Area, fill};
use super::key::{Key, scale_bar_m};
use super::{Eye, Layers, Scene, Theme, pictures, words};
use mvt_recording::{Images, Recording};

/// What is on a page.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Layout {
    /// The scene alone
    Scene,
    /// The sensors' images alone
    Sensors,
    /// Scene, sensors and curves
    All,
}

/// Makes pages.
pub struct Page {
    scene: Scene,
    layout: Layout,
    /// Width and height, pixels.
    size: [u32; 2],
    layers: Layers,
    theme: Theme,
    /// The newest shape, for images of it.
    shape: Option<(usize, RayMesh)>,
}

/// Height of the line on top, pixels, and distance between pictures.
const HEAD: u32 = 26;
const GAP: u32 = 6;
/// Height of a title, pixels.
const TITLE: u32 = 15;
const LETTERS: f32 = 15.0;
const SMALL: f32 = 12.0;
/// The scene is painted with so many pixels along either side of one.
const FINENESS: usize = 2;

impl Page {
    /// Pages of this size.
    pub fn new(layout: Layout, size: [u32; 2], layers: Layers, theme: Theme) -> Self {
        Self { scene: Scene::new(), layout, size, layers, theme, shape: None }
    }

    /// The page of a moment, as seen by an eye.
    pub fn paint(&mut self, recording: &Recording, moment: usize, eye: &Eye) -> RgbImage {
        let [width, height] = self.size;
        let mut page = RgbImage::from_pixel(width, height, self.theme.paper);
        let body =
            Area { x: GAP, y: HEAD, width: width.saturating_sub(2 * GAP), height: height.saturating_sub(HEAD + GAP) };
        match self.layout {
            Layout::Scene => self.scene(&mut page, body, recording, moment, eye),
            Layout::Sensors => self.sensors(&mut page, body, recording, moment),
            Layout::All => {
                let below = body.height / 5;
                let upper = body.height - below - GAP;
                let left = body.width * 3 / 5;
                let right = Area { x: body.x + left + GAP, width: body.width - left - GAP, height: upper, ..body };
                self.scene(&mut page, Area { width: left, height: upper, ..body }, recording, moment, eye);
                self.sensors(&mut page, right, recording, moment);
                let area = Area { y: body.y + upper + GAP, height: below, ..body };
                curves::draw(&mut page, area, recording, moment, &self.theme);
            }
        }
        self.head(&mut page, recording, moment);
        page
    }

    fn head(&self, page: &mut RgbImage, recording: &Recording, moment: usize) {
        let Theme { ink, faint, .. } = self.theme;
        let subject = words::subject(recording);
        lettering::write(page, (GAP, 4), LETTERS, ink, &subject);
        let happening = words::happening(recording, moment);
        let x = GAP + lettering::width(LETTERS, &subject) + 24;
        lettering::write(page, (x, 4), LETTERS, faint, &happening);
        if let Some(now) = recording.moments().get(moment) {
            let time = format!("{:.2} s", now.row.time_s);
            let x = page.width().saturating_sub(GAP + lettering::width(LETTERS, &time));
            lettering::write(page, (x, 4), LETTERS, ink, &time);
        }
    }

    fn scene(&mut self, page: &mut RgbImage, area: Area, recording: &Recording, moment: usize, eye: &Eye) {
        let size = [area.width, area.height].map(|side| side as usize * FINENESS);
        let fine = self.scene.paint(recording, moment, &self.layers, eye, &self.theme, size);
        imageops::replace(page, &shrink(fine), i64::from(area.x), i64::from(area.y));
        if let Some(key) = Key::of(&self.layers, recording) {
            let key = strip(&key, &self.theme);
            let (x, y) = (area.x + GAP, (area.y + area.height).saturating_sub(key.height() + GAP));
            // What is paper lets through what is behind.
            for (dx, dy, &pixel) in key.enumerate_pixels().filter(|(_, _, pixel)| **pixel != self.theme.paper) {
                lettering::blend(page, x + dx, y + dy, pixel, 1.0);
            }
        }
        let length_m = scale_bar_m(eye, area.height as usize);
        let pixels = (length_m / eye.metres_per_pixel(area.height as usize)).round() as u32;
        let (right, bottom) = (area.x + area.width, area.y + area.height);
        let bar =
            Area { x: right.saturating_sub(pixels + 2 * GAP), y: bottom.saturating_sub(12), width: pixels, height: 3 };
        fill(page, bar, self.theme.ink);
        let label = format!("{:.0} mm", length_m * 1e3);
        lettering::write(page, (bar.x, bar.y.saturating_sub(17)), SMALL, self.theme.ink, &label);
    }

    fn sensors(&mut self, page: &mut RgbImage, area: Area, recording: &Recording, moment: usize) {
        let images = match recording.images(moment) {
            Ok(Some(images)) => images,
            Ok(None) => return,
            Err(error) => {
                lettering::write(page, (area.x, area.y), SMALL, self.theme.ink, &error.to_string());
                return;
            }
        };
        let has_cameras = images.cameras.iter().any(Option::is_some);
        let has_touch = images.touch.iter().any(|(_, finger)| finger.is_some());
        let rows = images.cameras.len() as u32;
        // As high as rows of three pictures 4 wide and 3 high.
        let of_cameras = rows * (area.width / 3 * 3 / 4 + TITLE);
        let above = match (has_cameras, has_touch) {
            (true, true) => of_cameras.min(area.height / 2),
            (true, false) => area.height,
            (false, _) => 0,
        };
        if has_cameras {
            self.cameras(page, Area { height: above.saturating_sub(GAP), ..area }, recording, &images);
        }
        if has_touch {
            let below = Area { y: area.y + above, height: area.height - above, ..area };
            self.fingers(page, below, recording, moment, &images);
        }
    }

    /// Colour, measured depth and depth of the estimate, a row per camera.
    fn cameras(&mut self, page: &mut RgbImage, area: Area, recording: &Recording, images: &Images) {
        let index = recording.shape_at(images.frame);
        if let Some(index) = index.filter(|index| self.shape.as_ref().is_none_or(|(known, _)| known != index)) {
            self.shape = recording.shape(images.frame).ok().flatten().map(|shape| (index, RayMesh::new(&shape.mesh)));
        }
        let rendered = self.shape.as_ref().filter(|_| index.is_some()).zip(recording.pose(images.frame));
        let cameras: Vec<_> = recording.about().cameras.iter().zip(&images.cameras).collect();
        let rows = cameras.len() as u32;
        for (k, (camera, seen)) in (0..).zip(cameras) {
            let Some(seen) = seen else { continue };
            let estimate = rendered.map(|((_, mesh), pose)| pictures::rendered_depth(mesh, pose, camera, seen));
            let row = [
                (camera.name.as_str(), Some(seen.colour.clone())),
                ("depth", Some(pictures::depth(seen))),
                ("depth of the estimate", estimate),
            ];
            for (column, (title, picture)) in (0..).zip(row) {
                self.tile(page, cell(area, [column, k], [3, rows]), title, picture.as_ref());
            }
        }
    }

    /// Image, indentation and contact, or true indentation where it is known, a column per finger.
    fn fingers(&self, page: &mut RgbImage, area: Area, recording: &Recording, moment: usize, images: &Images) {
        let touching = recording.moments().get(moment).map(|moment| moment.fingers);
        for finger in Finger::ALL {
            let Some(seen) = &images.touch[finger] else { continue };
            let column = finger as u32;
            let truth = pictures::true_indentation(seen);
            let third = match truth {
                Some(truth) => ("true", truth),
                None => ("contact", pictures::contact(seen)),
            };
            let rows = [(finger.name(), seen.image.clone()), ("pressed in", pictures::indentation(seen)), third];
            for (row, (title, picture)) in (0..).zip(rows) {
                let tile = cell(area, [column, row], [4, 3]);
                let title = match touching.and_then(|touching| touching[finger]) {
                    Some(touch) if row == 0 => match touch.force_n {
                        Some(force_n) => format!("{title}  {force_n:.1} N"),
                        None => format!("{title}  {:.1} mm", touch.deepest_mm),
                    },
                    _ => title.to_owned(),
                };
                self.tile(page, tile, &title, Some(&picture));
                if row == 0 && touching.is_some_and(|touching| touching[finger].is_some()) {
                    let lamp =
                        Area { x: tile.x + lettering::width(SMALL, &title) + 6, y: tile.y + 3, width: 8, height: 8 };
                    fill(page, lamp, SeenBy::Touch.colour());
                }
            }
        }
    }

    /// A picture under its title, as large as fits; nothing where there is no picture.
    fn tile(&self, page: &mut RgbImage, area: Area, title: &str, picture: Option<&RgbImage>) {
        let Some(picture) = picture.filter(|picture| !picture.is_empty()) else { return };
        lettering::write(page, (area.x, area.y), SMALL, self.theme.ink, title);
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

fn cell(area: Area, [column, row]: [u32; 2], [columns, rows]: [u32; 2]) -> Area {
    let (width, height) = (area.width / columns.max(1), area.height / rows.max(1));
    Area {
        x: area.x + column * width,
        y: area.y + row * height,
        width: width.saturating_sub(GAP),
        height: height.saturating_sub(GAP),
    }
}

/// The mean of squares of pixels.
fn shrink(fine: &RgbImage) -> RgbImage {
    let by = FINENESS as u32;
    RgbImage::from_fn(fine.width() / by, fine.height() / by, |x, y| {
        let mut sum = [0u32; 3];
        for (dx, dy) in (0..by).flat_map(|dx| (0..by).map(move |dy| (dx, dy))) {
            let pixel = fine.get_pixel(x * by + dx, y * by + dy).0;
            sum.iter_mut().zip(pixel).for_each(|(sum, c)| *sum += u32::from(c));
        }
        Rgb(sum.map(|c| (c / (by * by)) as u8))
    })
}

/// What the colours stand for, as a strip.
fn strip(key: &Key, theme: &Theme) -> RgbImage {
    const BAR: u32 = 150;
    const HEIGHT: u32 = 34;
    match key {
        Key::Ramp { title, labels, colour } => bar(BAR, HEIGHT, theme, title, *labels, colour),
        Key::Names(names) => {
            let mut image = RgbImage::from_pixel(230, 18, theme.paper);
            let mut x = 0;
            for (by, name) in names {
                fill(&mut image, Area { x, y: 4, width: 10, height: 10 }, by.colour());
                lettering::write(&mut image, (x + 14, 1), SMALL + 1.0, theme.ink, name);
                x += 28 + lettering::width(SMALL + 1.0, name);
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
    let left = lettering::width(SMALL + 1.0, title) + 10;
    let mut image = RgbImage::from_pixel(left + width + 24, height, theme.paper);
    lettering::write(&mut image, (0, 1), SMALL + 1.0, theme.ink, title);
    for x in 0..width {
        fill(&mut image, Area { x: left + x, y: 2, width: 1, height: 11 }, colour(x as f32 / (width - 1) as f32));
    }
    for (k, label) in (0..).zip(labels) {
        let half = lettering::width(SMALL, label) / 2;
        let x = (left + k * (width - 1) / 2).saturating_sub(half);
        lettering::write(&mut image, (x, 15), SMALL, theme.ink, label);
    }
    image
}
