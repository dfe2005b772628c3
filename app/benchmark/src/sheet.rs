//! Picture of an RGB-D sequence: some frames with their masks, and how the object's size and motion change.

use image::imageops::{FilterType, resize};
use image::{Rgb, RgbImage, imageops};
use mvt_picture::draw::{Area, blend, fill, line};
use mvt_picture::palette::Theme;
use mvt_picture::text;
use mvt_rgbd::RgbdFrame;

use crate::facts::{Glance, SequenceFacts};

/// Number of frames on the picture, and of columns.
pub(crate) const SHOWN: usize = 12;
const COLUMNS: u32 = 4;
const MARGIN: u32 = 32;
const GAP: u32 = 12;
/// Width of a frame, pixels.
const WIDTH: u32 = 320;
const LABEL: u32 = 24;
const HEADER: u32 = 84;
/// Height of a curve with its label.
const CURVE: u32 = 96;
const NAME: u32 = 150;
/// Motions are drawn up to so many of those that 95 % stay below.
const LEAP: f64 = 2.0;
/// The mask and its outline.
const MASK: Rgb<u8> = Rgb([0, 200, 120]);
const OUTLINE: Rgb<u8> = Rgb([255, 40, 160]);

/// A frame on the picture.
pub(crate) struct SheetFrame {
    pub label: String,
    pub picture: RgbImage,
}

impl SheetFrame {
    /// Paints the mask over the colours.
    pub fn new(frame: &RgbdFrame, glance: &Glance) -> Self {
        let mut picture = frame.color.clone();
        if let Some(mask) = &frame.mask {
            let inside = |v: usize, u: usize| mask.get((v, u)).copied().unwrap_or(false);
            // As wide as a pixel of the picture.
            let step = (mask.ncols() / WIDTH as usize).max(1);
            for ((v, u), _) in mask.indexed_iter().filter(|(_, inside)| **inside) {
                let is_edge = !(inside(v + step, u)
                    && inside(v, u + step)
                    && v.checked_sub(step).is_some_and(|v| inside(v, u))
                    && u.checked_sub(step).is_some_and(|u| inside(v, u)));
                let (colour, coverage) = if is_edge { (OUTLINE, 1.0) } else { (MASK, 0.25) };
                blend(&mut picture, u as u32, v as u32, colour, coverage);
            }
        }
        let seen = match (frame.mask.is_some(), glance.distance_m) {
            (false, _) => "no mask".to_owned(),
            (true, None) => "hidden".to_owned(),
            (true, Some(distance_m)) => format!("{} pixels, {distance_m:.2} m", glance.pixels),
        };
        let height = (WIDTH * picture.height() / picture.width().max(1)).max(1);
        let picture = resize(&picture, WIDTH, height, FilterType::Triangle);
        Self { label: format!("{:.1} s  {seen}", glance.time_s), picture }
    }
}

/// Draws the picture.
pub(crate) fn sheet(facts: &SequenceFacts, frames: &[SheetFrame], glances: &[Glance]) -> RgbImage {
    let Theme { paper, ink, faint, panel, .. } = Theme::LIGHT;
    let rows = (frames.len() as u32).div_ceil(COLUMNS);
    let frame_height = frames.first().map_or(0, |frame| frame.picture.height());
    let width = 2 * MARGIN + COLUMNS * WIDTH + (COLUMNS - 1) * GAP;
    let curves_top = MARGIN + HEADER + rows * (LABEL + frame_height + GAP) + GAP;
    let sentences_top = curves_top + 2 * CURVE + 8;
    let height = sentences_top + 26 * facts.difficulties.len() as u32 + MARGIN;
    let mut page = RgbImage::from_pixel(width, height, paper);
    text::write(&mut page, (MARGIN, MARGIN), 30.0, ink, &facts.path);
    let rate = facts.frames_per_second.map_or(String::new(), |rate| format!(", {rate:.1} a second"));
    let subtitle =
        format!("{}, {} frames of {} x {} pixels{rate}", facts.layout, facts.frames, facts.size[0], facts.size[1]);
    text::write(&mut page, (MARGIN, MARGIN + 42), 19.0, faint, &subtitle);
    for (k, frame) in (0..).zip(frames) {
        let x = MARGIN + k % COLUMNS * (WIDTH + GAP);
        let y = MARGIN + HEADER + k / COLUMNS * (LABEL + frame_height + GAP);
        text::write(&mut page, (x, y), 16.0, ink, &frame.label);
        imageops::replace(&mut page, &frame.picture, i64::from(x), i64::from(y + LABEL));
    }
    let pixels = glances.iter().map(|glance| glance.has_mask.then_some(glance.pixels as f64)).collect::<Vec<_>>();
    let motion = glances.windows(2).map(|pair| {
        let (a, b) = pair.first().zip(pair.last())?;
        Some(1e3 * (b.middle?.coords() - a.middle?.coords()).norm())
    });
    let motion: Vec<Option<f64>> = motion.collect();
    // A leap behind something that hides the object would flatten all else.
    let usual_mm = facts.motion_p95_mm.map_or(f64::INFINITY, |motion_mm| LEAP * motion_mm);
    let curves = [("object", "pixels", pixels, f64::INFINITY), ("motion", "mm a frame", motion, usual_mm)];
    for (k, (name, unit, values, highest)) in (0..).zip(curves) {
        let most = values.iter().flatten().copied().fold(0.0, f64::max).min(highest);
        let top = curves_top + k * CURVE;
        text::write(&mut page, (MARGIN, top), 17.0, ink, name);
        text::write(&mut page, (MARGIN, top + 24), 15.0, faint, &format!("0 to {most:.0} {unit}"));
        let area = Area { x: MARGIN + NAME, y: top, width: width - 2 * MARGIN - NAME, height: CURVE - 16 };
        curve(&mut page, area, &values, most, panel);
    }
    for (k, sentence) in (0..).zip(&facts.difficulties) {
        let place = (MARGIN, sentences_top + 26 * k);
        text::write(
            &mut page,
            place,
            17.0,
            ink,
            &text::shortened(17.0, &format!("hard: {sentence}"), width - 2 * MARGIN),
        );
    }
    page
}

/// Draws values over the frames, from 0 to `most`.
fn curve(page: &mut RgbImage, area: Area, values: &[Option<f64>], most: f64, ground: Rgb<u8>) {
    let Area { x: left, y: top, width, height } = area;
    fill(page, area, ground);
    let place = |k: usize, value: f64| {
        let x = left as f32 + k as f32 / (values.len().max(2) - 1) as f32 * (width - 1) as f32;
        [x, (top + height - 1) as f32 - (value / most.max(1e-9)) as f32 * (height - 4) as f32]
    };
    let points = values.iter().enumerate().map(|(k, value)| value.map(|value| place(k, value.min(most))));
    let points: Vec<Option<[f32; 2]>> = points.collect();
    for pair in points.windows(2) {
        if let [Some(a), Some(b)] = pair {
            line(page, *a, *b, 1.5, mvt_picture::palette::CURVES[0]);
        }
    }
}
