//! Points of the surface with one of their colours, which are compared pixel by pixel.
//!
//! Light changes as an object turns. So a colour is taken less its mean around a pixel, and only where the object shows.

use glam::Vec3;
use image::RgbImage;
use mvt_frames::depth::{CameraDepth, Label};

use super::Lens;
use super::picture::{self, CHANNELS, LEVELS, Level};

/// Half the side of the square over which the mean of the brightness is taken, pixels of the level.
const MEAN_PX: usize = 4;
/// Texels are this far within the pixels of the object, as masks err by a pixel or two.
const RIM_PX: usize = 2;
/// So many places are looked at per texel that is kept.
const TRIED: usize = 4;
/// A surface that is seen at a cosine below this is too foreshortened.
const LEAST_COSINE: f32 = 0.3;
/// Changes of a colour count for this part of those of the brightness, which is the mean of three and has less noise.
const COLOUR_PART: f32 = 0.5;
/// A change below this from pixel to pixel is noise, grey levels of the second level.
const LEAST_SLOPE: f32 = 1.0;

/// A colour less its mean around each pixel at one resolution; NaN where the object does not show.
#[derive(Debug, Clone)]
pub(crate) struct Contrast {
    width: usize,
    /// By rows.
    values: Vec<f32>,
}

impl PartialEq for Contrast {
    fn eq(&self, other: &Self) -> bool {
        // NaN equals NaN here.
        self.width == other.width
            && self.values.iter().map(|value| value.to_bits()).eq(other.values.iter().map(|value| value.to_bits()))
    }
}

impl Contrast {
    /// Of all channels of one resolution; `shows` tells which pixels show the object.
    fn of(channels: &[Level; CHANNELS], shows: impl Fn(usize, usize) -> bool) -> [Self; CHANNELS] {
        let (width, height) = (channels[0].width, channels[0].height);
        // Sums of each channel, and the number of the object's pixels, above and left of each.
        let columns = width + 1;
        let mut sums = vec![[0.0_f64; CHANNELS + 1]; columns * (height + 1)];
        for v in 0..height {
            let mut row = [0.0; CHANNELS + 1];
            for u in 0..width {
                if shows(u, v) {
                    for (sum, level) in row.iter_mut().zip(channels) {
                        *sum += f64::from(level.at(u, v));
                    }
                    row[CHANNELS] += 1.0;
                }
                let above = sums[v * columns + u + 1];
                sums[(v + 1) * columns + u + 1] = std::array::from_fn(|k| above[k] + row[k]);
            }
        }
        let mut contrasts = [(); CHANNELS].map(|()| Self { width, values: vec![f32::NAN; width * height] });
        for (v, u) in (0..height).flat_map(|v| (0..width).map(move |u| (v, u))).filter(|&(v, u)| shows(u, v)) {
            let (left, top) = (u.saturating_sub(MEAN_PX), v.saturating_sub(MEAN_PX));
            let (right, bottom) = ((u + MEAN_PX + 1).min(width), (v + MEAN_PX + 1).min(height));
            let corner = |u: usize, v: usize| &sums[v * columns + u];
            let [first, second, third, fourth] =
                [corner(right, bottom), corner(left, bottom), corner(right, top), corner(left, top)];
            let sum = |k: usize| first[k] - second[k] - third[k] + fourth[k];
            for (k, (contrast, level)) in contrasts.iter_mut().zip(channels).enumerate() {
                contrast.values[v * width + u] = level.at(u, v) - (sum(k) / sum(CHANNELS)) as f32;
            }
        }
        contrasts
    }

    /// The value at a place and its slopes by column and row; `None` where the object does not show.
    pub fn sample(&self, [u, v]: [f32; 2]) -> Option<(f32, [f32; 2])> {
        if !(u >= 0.0 && v >= 0.0 && u < (self.width - 1) as f32) {
            return None;
        }
        let (column, row) = (u as i32, v as i32);
        let (a, b) = (u - column as f32, v - row as f32);
        let first = row as usize * self.width + column as usize;
        let &[p, q] = self.values.get(first..first + 2)?.first_chunk()?;
        let second = first + self.width;
        let &[r, s] = self.values.get(second..second + 2)?.first_chunk()?;
        let (top, bottom) = (p + a * (q - p), r + a * (s - r));
        let value = top + b * (bottom - top);
        let slopes = [(q - p) + b * ((s - r) - (q - p)), bottom - top];
        value.is_finite().then_some((value, slopes))
    }
}

/// A point of the surface with a colour.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Texel {
    /// The brightness, or the colour that changes clearly more here: paints of one brightness differ in a colour.
    pub channel: usize,
    /// Where it is, world frame, metres.
    pub point: Vec3,
    /// Its outward normal, world frame.
    pub normal: Vec3,
    /// The colour less its mean around the point at each level; `None` where the level does not show it.
    pub values: [Option<f32>; LEVELS],
}

/// The part of a picture that is compared pixel by pixel.
#[derive(Debug, Clone, PartialEq)]
pub struct Texels {
    pub(crate) lens: Lens,
    corner: [usize; 2],
    /// Finest first. Only the frame that is compared with earlier ones needs them: an [`earlier`](super::Scan::earlier) scan has none.
    pub(crate) levels: Vec<[Contrast; CHANNELS]>,
    /// Those with the greatest changes of a colour.
    pub(crate) texels: Vec<Texel>,
}

impl Texels {
    /// At most `most` texels of an image; `None` without a colour image of the size of the depth image, and where the object is not seen.
    pub(crate) fn new(image: &CameraDepth, most: usize) -> Option<Self> {
        let colour = image.colour.as_ref().filter(|_| most > 0)?;
        let (rows, columns) = image.depth_m.dim();
        let fits = (colour.width() as usize, colour.height() as usize) == (columns, rows);
        let [left, top, right, bottom] =
            picture::bounds(image).filter(|_| fits && image.labels.dim() == (rows, columns))?;
        // A whole number of pixels at each resolution.
        let whole = |length: usize| length >> (LEVELS - 1) << (LEVELS - 1);
        let corner = [whole(left), whole(top)];
        let size = [whole((right + 1 - corner[0]) + (1 << LEVELS)), whole((bottom + 1 - corner[1]) + (1 << LEVELS))];
        let size = [size[0].min(whole(columns - corner[0])), size[1].min(whole(rows - corner[1]))];
        let mut texels = Self {
            lens: Lens::new(&image.intrinsics, image.world_from_camera, [0.0; 2]),
            corner,
            levels: contrasts(image, colour, corner, size),
            texels: Vec::new(),
        };
        texels.choose(image, [left, top, right, bottom], most);
        Some(texels)
    }

    /// A place of the image at a resolution.
    pub(crate) fn to_level(&self, place: [f32; 2], level: usize) -> [f32; 2] {
        picture::to_level(place, self.corner, level)
    }

    fn choose(&mut self, image: &CameraDepth, [left, top, right, bottom]: [usize; 4], most: usize) {
        let (rows, columns) = image.labels.dim();
        let shows = |u: usize, v: usize| image.labels.get((v, u)) == Some(&Label::Object);
        let is_deep = |u: usize, v: usize| {
            u >= RIM_PX
                && v >= RIM_PX
                && [(u - RIM_PX, v), (u + RIM_PX, v), (u, v - RIM_PX), (u, v + RIM_PX)]
                    .iter()
                    .all(|&(u, v)| shows(u, v))
        };
        let area = (right + 1 - left) * (bottom + 1 - top);
        let stride = ((area as f64 / (TRIED * most) as f64).sqrt() as usize).max(1);
        let mut found = Vec::new();
        for v in (top..=bottom.min(rows - 1)).step_by(stride) {
            for u in (left..=right.min(columns - 1)).step_by(stride) {
                let z = image.depth_m[(v, u)];
                if !(shows(u, v) && is_deep(u, v) && z > 0.0 && z.is_finite()) {
                    continue;
                }
                let at = |level: usize| self.to_level([u as f32, v as f32], level);
                let sample = |channel: usize, level: usize| self.levels.get(level)?[channel].sample(at(level));
                let part = |channel: usize| if channel == 0 { 1.0 } else { COLOUR_PART };
                let strength =
                    |channel: usize| sample(channel, 1).map_or(0.0, |(_, [x, y])| part(channel) * x.hypot(y));
                let Some(channel) = (0..CHANNELS).max_by(|&a, &b| strength(a).total_cmp(&strength(b))) else {
                    continue;
                };
                if strength(channel) < LEAST_SLOPE {
                    continue;
                }
                let values = std::array::from_fn(|level| sample(channel, level).map(|(value, _)| value));
                found.push((strength(channel), channel, [u, v], values));
            }
        }
        found.sort_by(|a, b| b.0.total_cmp(&a.0));
        let texel = |(_, channel, [u, v], values): (f32, usize, [usize; 2], [Option<f32>; LEVELS])| {
            let normal = self.lens.fitted_normal(&image.depth_m, u, v);
            let (direction, length) = self.lens.ray(u as f32, v as f32);
            let point = self.lens.origin + direction * (image.depth_m[(v, u)] * length);
            (-normal.dot(direction) > LEAST_COSINE).then_some(Texel { channel, point, normal, values })
        };
        self.texels = found.into_iter().filter_map(texel).take(most).collect();
    }

    /// Whether a point of the surface with this normal is seen from far enough to its front. World frame.
    pub(crate) fn faces(&self, point: Vec3, normal: Vec3) -> bool {
        normal.dot((self.lens.origin - point).normalize_or_zero()) > LEAST_COSINE
    }
}

/// The contrasts of all levels.
fn contrasts(
    image: &CameraDepth,
    colour: &RgbImage,
    corner: [usize; 2],
    [width, height]: [usize; 2],
) -> Vec<[Contrast; CHANNELS]> {
    let mut level = picture::channels(colour, corner, width, height);
    let mut shows: Vec<bool> = (0..width * height)
        .map(|i| image.labels[(corner[1] + i / width, corner[0] + i % width)] == Label::Object)
        .collect();
    let mut contrasts = Vec::with_capacity(LEVELS);
    loop {
        let columns = level[0].width;
        contrasts.push(Contrast::of(&level, |u, v| shows[v * columns + u]));
        if contrasts.len() == LEVELS {
            return contrasts;
        }
        level = level.each_ref().map(Level::halved);
        let (width, height) = (level[0].width, level[0].height);
        let all = |i: usize| {
            let (u, v) = (2 * (i % width), 2 * (i / width));
            [(u, v), (u + 1, v), (u, v + 1), (u + 1, v + 1)].iter().all(|&(u, v)| shows[v * columns + u])
        };
        shows = (0..width * height).map(all).collect();
    }
}
