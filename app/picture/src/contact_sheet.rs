//! Contact sheet: one image of an episode, with a few moments and the times at which each pad touched.

use image::imageops::{self, FilterType};
use image::{Rgb, RgbImage};

use crate::palette::pad_colour;
use crate::{draw, text};

/// Contents of a contact sheet.
#[derive(Debug, Clone)]
pub struct ContactSheet {
    /// Headline.
    pub title: String,
    /// Line below the headline: seed, gait, outcome.
    pub subtitle: String,
    /// Names of the pads.
    pub pads: Vec<String>,
    /// A few moments, early to late; six fit best.
    pub moments: Vec<SheetMoment>,
    /// Times at which each pad touched.
    pub timeline: ContactTimeline,
}

/// Column of a contact sheet.
#[derive(Debug, Clone)]
pub struct SheetMoment {
    /// Seconds since the start of the episode.
    pub time_s: f64,
    /// The camera's image.
    pub camera: RgbImage,
    /// The touch image of each pad.
    pub touch: Vec<RgbImage>,
    /// Whether each pad touched.
    pub contact: Vec<bool>,
}

/// Contact of each pad, frame by frame.
#[derive(Debug, Clone, Default)]
pub struct ContactTimeline {
    /// Times of the frames, seconds, increasing.
    pub times_s: Vec<f64>,
    /// For each frame whether each pad touched; as many as times.
    pub contact: Vec<Vec<bool>>,
}

const PAPER: Rgb<u8> = Rgb([250, 250, 248]);
const INK: Rgb<u8> = Rgb([34, 38, 46]);
const FAINT: Rgb<u8> = Rgb([125, 131, 141]);
const TRACK: Rgb<u8> = Rgb([232, 233, 231]);

const MARGIN: u32 = 36;
const GAP: u32 = 14;
const COLUMN: u32 = 252;
/// A touch image has 3 : 4 of width to height, and two stand side by side.
const TOUCH: (u32, u32) = ((COLUMN - 6) / 2, (COLUMN - 6) / 2 * 4 / 3);
const CAMERA_HEIGHT: u32 = COLUMN * 3 / 4;
const HEADER: u32 = 92;
const MOMENT_LABEL: u32 = 26;
const TOUCH_LABEL: u32 = 20;
const BAR: u32 = 22;
const BAR_STEP: u32 = 30;
const NAME_WIDTH: u32 = 74;
const PERCENT_WIDTH: u32 = 62;

/// Draws a contact sheet.
pub fn contact_sheet(sheet: &ContactSheet) -> RgbImage {
    // A sheet without moments is as wide as one with four.
    let columns = if sheet.moments.is_empty() { 4 } else { sheet.moments.len() as u32 };
    let (pads, rows) = (sheet.pads.len() as u32, sheet.pads.len().div_ceil(2) as u32);
    let moment_height = MOMENT_LABEL + CAMERA_HEIGHT + 8 + rows * (TOUCH_LABEL + TOUCH.1 + 4);
    let width = 2 * MARGIN + columns * COLUMN + (columns - 1) * GAP;
    let timeline_top = MARGIN + HEADER + if sheet.moments.is_empty() { 0 } else { moment_height + 34 };
    let height = timeline_top + 40 + pads * BAR_STEP + 44 + MARGIN;
    let mut page = Page { image: RgbImage::from_pixel(width, height, PAPER) };

    page.text(MARGIN, MARGIN, 34.0, INK, &sheet.title);
    page.text(MARGIN, MARGIN + 46, 19.0, FAINT, &sheet.subtitle);
    for (i, moment) in (0..).zip(&sheet.moments) {
        page.moment(MARGIN + i * (COLUMN + GAP), MARGIN + HEADER, moment, &sheet.pads);
    }
    let marks: Vec<f64> = sheet.moments.iter().map(|moment| moment.time_s).collect();
    page.timeline(timeline_top, sheet, &marks);
    page.image
}

struct Page {
    image: RgbImage,
}

impl Page {
    fn moment(&mut self, x: u32, y: u32, moment: &SheetMoment, names: &[String]) {
        self.text(x, y, 18.0, INK, &format!("{:.1} s", moment.time_s));
        let mut top = y + MOMENT_LABEL;
        self.picture(x, top, (COLUMN, CAMERA_HEIGHT), &moment.camera);
        top += CAMERA_HEIGHT + 8;
        for (pad, (image, name)) in moment.touch.iter().zip(names).enumerate() {
            let (row, column) = (pad as u32 / 2, pad as u32 % 2);
            let (x, y) = (x + column * (TOUCH.0 + 6), top + row * (TOUCH_LABEL + TOUCH.1 + 4));
            let touches = moment.contact.get(pad).is_some_and(|touches| *touches);
            let color = pad_colour(pad);
            // A pad that touches is marked in the colour of its bar.
            self.disc(x + 6, y + 9, 5.0, if touches { color } else { TRACK });
            self.text(x + 16, y, 15.0, if touches { INK } else { FAINT }, name);
            self.picture(x, y + TOUCH_LABEL, TOUCH, image);
        }
    }

    fn timeline(&mut self, top: u32, ContactSheet { pads, timeline, .. }: &ContactSheet, marks: &[f64]) {
        self.text(MARGIN, top, 20.0, INK, "Contact");
        let left = MARGIN + NAME_WIDTH;
        let right = self.image.width() - MARGIN - PERCENT_WIDTH;
        let bars = top + 40;
        let frames = timeline.contact.len().min(timeline.times_s.len());
        let start = timeline.times_s.first().copied().unwrap_or(0.0);
        // The last frame gets the mean duration of the others.
        let last = if frames > 0 { timeline.times_s[frames - 1] } else { 1.0 };
        let span = (last - start) * frames as f64 / (frames.max(2) - 1) as f64;
        let span = if span > 0.0 { span } else { 1.0 };
        let at = |time: f64| {
            left + ((time - start) / span * f64::from(right - left)).round().clamp(0.0, f64::from(right - left)) as u32
        };
        let touches = |contact: &Vec<bool>, pad: usize| contact.get(pad).is_some_and(|touches| *touches);
        for (pad, name) in pads.iter().enumerate() {
            let y = bars + pad as u32 * BAR_STEP;
            let color = pad_colour(pad);
            self.text(MARGIN, y + 2, 17.0, INK, name);
            self.fill(left, y, right - left, BAR, TRACK);
            for i in (0..frames).filter(|&i| touches(&timeline.contact[i], pad)) {
                let from = at(timeline.times_s[i]);
                let to = if i + 1 < frames { at(timeline.times_s[i + 1]) } else { right };
                self.fill(from, y, to.saturating_sub(from).max(1), BAR, color);
            }
            let touched = timeline.contact[..frames].iter().filter(|contact| touches(contact, pad)).count();
            let percent = 100.0 * touched as f64 / frames.max(1) as f64;
            self.text(right + 12, y + 2, 17.0, INK, &format!("{percent:.0} %"));
        }
        let bottom = bars + (pads.len() as u32 * BAR_STEP).saturating_sub(BAR_STEP - BAR);
        for &mark in marks {
            let x = at(mark);
            self.fill(x, bars - 6, 1, bottom - bars + 6, INK);
            self.disc(x, bars - 8, 3.0, INK);
        }
        let step = tick_step(span);
        let mut tick = (start / step).ceil() * step;
        while tick <= start + span + 1e-9 {
            let x = at(tick);
            self.fill(x, bottom + 4, 1, 6, FAINT);
            let label = format!("{tick:.0}");
            let half = text::width(15.0, &label) / 2;
            self.text(x.saturating_sub(half), bottom + 12, 15.0, FAINT, &label);
            tick += step;
        }
        self.text(right + 12, bottom + 12, 15.0, FAINT, "s");
    }

    fn picture(&mut self, x: u32, y: u32, (width, height): (u32, u32), picture: &RgbImage) {
        if picture.width() == 0 || picture.height() == 0 {
            return self.fill(x, y, width, height, TRACK);
        }
        let scaled = imageops::resize(picture, width, height, FilterType::Triangle);
        imageops::replace(&mut self.image, &scaled, i64::from(x), i64::from(y));
    }

    fn fill(&mut self, x: u32, y: u32, width: u32, height: u32, color: Rgb<u8>) {
        for (x, y) in (y..y + height).flat_map(|y| (x..x + width).map(move |x| (x, y))) {
            self.blend(x, y, color, 1.0);
        }
    }

    fn disc(&mut self, x: u32, y: u32, radius: f32, color: Rgb<u8>) {
        let reach = radius.ceil() as i64 + 1;
        for (dx, dy) in (-reach..=reach).flat_map(|dy| (-reach..=reach).map(move |dx| (dx, dy))) {
            let (px, py) = (i64::from(x) + dx, i64::from(y) + dy);
            if let (Ok(px), Ok(py)) = (u32::try_from(px), u32::try_from(py)) {
                let coverage = radius + 0.5 - (dx as f32).hypot(dy as f32);
                self.blend(px, py, color, coverage);
            }
        }
    }

    /// Writes text whose line begins at `y`.
    fn text(&mut self, x: u32, y: u32, size: f32, color: Rgb<u8>, text: &str) {
        text::write(&mut self.image, (x, y), size, color, text);
    }

    fn blend(&mut self, x: u32, y: u32, color: Rgb<u8>, coverage: f32) {
        draw::blend(&mut self.image, x, y, color, coverage);
    }
}

/// Returns the seconds between ticks: 1, 2 or 5 times a power of ten, for at most some twelve ticks.
fn tick_step(span_s: f64) -> f64 {
    let decade = 10f64.powf((span_s / 12.0).log10().floor()).max(1.0);
    [1.0, 2.0, 5.0, 10.0].map(|m| m * decade).into_iter().find(|step| span_s / step <= 12.0).unwrap_or(10.0 * decade)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sheet(frames: usize, moments: usize) -> ContactSheet {
        let touch = vec![RgbImage::from_pixel(240, 320, Rgb([100, 120, 140])); 4];
        let moment = |i: usize| SheetMoment {
            time_s: i as f64,
            camera: RgbImage::from_pixel(640, 480, Rgb([60, 80, 70])),
            touch: touch.clone(),
            contact: vec![true, false, true, false],
        };
        ContactSheet {
            title: "077_rubiks_cube".into(),
            subtitle: "seed 0".into(),
            pads: ["index", "middle", "ring", "thumb"].map(str::to_owned).to_vec(),
            moments: (0..moments).map(moment).collect(),
            timeline: ContactTimeline {
                times_s: (0..frames).map(|i| i as f64 / 30.0).collect(),
                contact: (0..frames).map(|i| vec![true, false, i % 2 == 0, i > frames / 2]).collect(),
            },
        }
    }

    /// Fraction of the timeline's middle row of a pad that has its colour.
    fn colored(image: &RgbImage, pad: usize) -> f64 {
        let color = pad_colour(pad);
        let bar = image.width() - 2 * MARGIN - NAME_WIDTH - PERCENT_WIDTH;
        let bottom = image.height() - MARGIN - 44;
        let y = bottom - (4 - pad as u32) * BAR_STEP + BAR / 2;
        (0..image.width()).filter(|&x| image.get_pixel(x, y) == &color).count() as f64 / f64::from(bar)
    }

    #[test]
    fn bars_are_as_long_as_contacts() {
        let image = contact_sheet(&sheet(600, 0));
        for (pad, fraction) in [1.0, 0.0, 0.5, 0.5].into_iter().enumerate() {
            assert!((colored(&image, pad) - fraction).abs() < 0.01, "{pad} {}", colored(&image, pad));
        }
    }

    #[test]
    fn odd_sheets_are_drawn() {
        for (frames, moments) in [(0, 0), (1, 1), (2, 7), (20_000, 1)] {
            contact_sheet(&sheet(frames, moments));
        }
        let mut empty = sheet(3, 1);
        empty.moments[0].camera = RgbImage::new(0, 0);
        empty.timeline.contact.truncate(2);
        contact_sheet(&empty);
        for pads in [0, 2, 8] {
            let mut other = sheet(3, 2);
            other.pads = (0..pads).map(|k| format!("pad {k}")).collect();
            contact_sheet(&other);
        }
    }

    #[test]
    fn ticks_are_round_numbers() {
        assert_eq!([0.5, 10.0, 20.0, 30.0, 100.0, 130.0].map(tick_step), [1.0, 1.0, 2.0, 5.0, 10.0, 20.0]);
    }
}
