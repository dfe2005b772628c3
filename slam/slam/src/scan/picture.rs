//! The object in a colour image: its brightness at several resolutions, and places at which it is compared with later images.

use glam::Vec3;
use image::RgbImage;
use mvt_frames::depth::{CameraDepth, Label, extent};

use super::Lens;

/// Resolutions of a picture, each half of the one before.
pub(crate) const LEVELS: usize = 3;
/// Pixels around the object that belong to its picture: an object moves by so much from frame to frame.
const MARGIN_PX: usize = 24;
/// A place is at least this far from the edge of the object's pixels, where hand and background show, pixels.
const RIM_PX: usize = 6;
/// Of each square of this many pixels one place is taken, so that places spread over the object.
const CELL_PX: usize = 10;
/// Half the side of the square in which a place is judged, pixels of the second level.
const REACH_PX: usize = 4;
/// Least standard deviation of the slopes in it along their weakest direction, grey levels per pixel of the second level. Smooth shading
/// has constant slopes and lies below.
const LEAST_SLOPE: f64 = 0.5;
/// A place is even so far around, pixels, as a square of the second level reaches: the shading of an edge changes as it turns.
const EVEN_PX: usize = 9;
/// Least cosine between its normal and those around it. Noise moves normals by some ten degrees.
const LEAST_EVEN: f32 = 0.8;
/// A surface that is seen at a cosine below this is too foreshortened to be compared.
pub(crate) const LEAST_COSINE: f32 = 0.35;

/// Brightness around the object, or one of its colours, at one resolution.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Level {
    pub(super) width: usize,
    pub(super) height: usize,
    /// By rows.
    values: Vec<u8>,
}

impl Level {
    pub(super) fn at(&self, u: usize, v: usize) -> f32 {
        f32::from(self.values[v * self.width + u])
    }

    /// Whether a square of half side `reach` around a place lies inside.
    pub fn holds(&self, [u, v]: [f32; 2], reach: f32) -> bool {
        let inside = |x: f32, size: usize| x >= reach && x + reach < size as f32 - 1.0;
        inside(u, self.width) && inside(v, self.height)
    }

    /// The brightness at a place that [`Level::holds`], between pixels by interpolation.
    pub fn sample(&self, [u, v]: [f32; 2]) -> f32 {
        // A conversion to i32 is one instruction, to usize many.
        let (column, row) = (u as i32, v as i32);
        let (a, b) = (u - column as f32, v - row as f32);
        let first = row as usize * self.width + column as usize;
        let Some(&[p, q]) = self.values.get(first..first + 2).and_then(|pair| pair.first_chunk()) else { return 0.0 };
        let second = first + self.width;
        let Some(&[r, s]) = self.values.get(second..second + 2).and_then(|pair| pair.first_chunk()) else { return 0.0 };
        let [p, q, r, s] = [p, q, r, s].map(f32::from);
        let (top, bottom) = (p + a * (q - p), r + a * (s - r));
        top + b * (bottom - top)
    }

    pub(super) fn halved(&self) -> Self {
        let (width, height) = (self.width / 2, self.height / 2);
        let sum = |u: usize, v: usize| {
            let at = |u: usize, v: usize| u16::from(self.values[v * self.width + u]);
            at(2 * u, 2 * v) + at(2 * u + 1, 2 * v) + at(2 * u, 2 * v + 1) + at(2 * u + 1, 2 * v + 1)
        };
        let values = (0..width * height).map(|i| ((sum(i % width, i / width) + 2) / 4) as u8).collect();
        Self { width, height, values }
    }
}

/// Brightness, red, green and blue.
pub(super) const CHANNELS: usize = 4;

/// A place on the object at which its picture is compared.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Patch {
    /// Where it is seen, column and row.
    pub pixel: [f32; 2],
    /// Where it is, world frame, metres.
    pub point: Vec3,
    /// Its outward normal, world frame.
    pub normal: Vec3,
    /// The way along the surface from pixel to pixel of a row and of a column, world frame, metres.
    pub steps: [Vec3; 2],
}

/// The object in a colour image.
#[derive(Debug, Clone, PartialEq)]
pub struct Picture {
    pub(crate) lens: Lens,
    /// Column and row of the image at which the picture begins.
    corner: [usize; 2],
    /// Finest first.
    levels: Vec<Level>,
    /// Which pixels of the finest level show the object.
    shows_object: Vec<bool>,
    pub(crate) patches: Vec<Patch>,
}

impl Picture {
    /// The picture of the object with at most `patches` places; `None` without a colour image of the size of the depth image, and
    /// where the object is not seen.
    pub(crate) fn new(image: &CameraDepth, patches: usize) -> Option<Self> {
        let colour = image.colour.as_ref().filter(|_| patches > 0)?;
        let (rows, columns) = image.depth_m.dim();
        if (colour.width() as usize, colour.height() as usize) != (columns, rows)
            || image.labels.dim() != (rows, columns)
        {
            return None;
        }
        let [left, top, right, bottom] = bounds(image)?;
        let corner = [left.saturating_sub(MARGIN_PX), top.saturating_sub(MARGIN_PX)];
        // A whole number of pixels at each resolution.
        let whole = |length: usize| length >> (LEVELS - 1) << (LEVELS - 1);
        let width = whole((right + MARGIN_PX + 1).min(columns) - corner[0]);
        let height = whole((bottom + MARGIN_PX + 1).min(rows) - corner[1]);
        let mut levels = vec![grey(colour, corner, width, height)];
        while levels.len() < LEVELS {
            levels.extend(levels.last().map(Level::halved));
        }
        let is_object = |i: usize| image.labels[(corner[1] + i / width, corner[0] + i % width)] == Label::Object;
        let shows_object = (0..width * height).map(is_object).collect();
        // Colours stay where they are; only depth is displaced.
        let lens = Lens::new(&image.intrinsics, image.world_from_camera, [0.0; 2]);
        let mut picture = Self { lens, corner, levels, shows_object, patches: Vec::new() };
        picture.patches = picture.choose(image, patches);
        Some(picture)
    }

    /// A place of the image at a resolution.
    pub(crate) fn to_level(&self, place: [f32; 2], level: usize) -> [f32; 2] {
        to_level(place, self.corner, level)
    }

    pub(crate) fn level(&self, level: usize) -> Option<&Level> {
        self.levels.get(level)
    }

    /// Whether the pixels around a place of the image show the object.
    pub(crate) fn shows_object(&self, place: [f32; 2]) -> bool {
        let [u, v] = self.to_level(place, 0).map(|x| x.round() as isize);
        let width = self.levels[0].width;
        let shows = |u: isize, v: isize| {
            let (u, v) = (usize::try_from(u).ok()?, usize::try_from(v).ok()?);
            self.shows_object.get(v * width + u).copied().filter(|_| u < width)
        };
        // Depth has holes.
        let around = [(0, 0), (3, 0), (-3, 0), (0, 3), (0, -3)].map(|(du, dv)| shows(u + du, v + dv));
        around.iter().filter(|shows| **shows == Some(true)).count() >= 4
    }

    /// The places with the greatest changes of slope, spread over the object.
    fn choose(&self, image: &CameraDepth, most: usize) -> Vec<Patch> {
        let level = &self.levels[1.min(LEVELS - 1)];
        let slopes = Slopes::new(level);
        let cell = CELL_PX / 2;
        let mut found: Vec<(f64, [usize; 2])> = Vec::new();
        for row in (REACH_PX + 1..level.height.saturating_sub(REACH_PX + 1)).step_by(cell) {
            for column in (REACH_PX + 1..level.width.saturating_sub(REACH_PX + 1)).step_by(cell) {
                let mut best: Option<(f64, [usize; 2])> = None;
                for v in row..(row + cell).min(level.height - REACH_PX - 1) {
                    for u in column..(column + cell).min(level.width - REACH_PX - 1) {
                        let pixel = [self.corner[0] + 2 * u, self.corner[1] + 2 * v];
                        if !is_deep(image, pixel) {
                            continue;
                        }
                        let strength = slopes.weakest(u, v);
                        if strength > best.map_or(LEAST_SLOPE * LEAST_SLOPE, |(best, _)| best) {
                            best = Some((strength, pixel));
                        }
                    }
                }
                found.extend(best);
            }
        }
        found.sort_by(|a, b| b.0.total_cmp(&a.0));
        found.into_iter().filter_map(|(_, pixel)| self.patch(image, pixel)).take(most).collect()
    }

    fn patch(&self, image: &CameraDepth, [u, v]: [usize; 2]) -> Option<Patch> {
        let lens = &self.lens;
        let z = image.depth_m[(v, u)];
        let normal = lens.fitted_normal(&image.depth_m, u, v);
        let (direction, length) = lens.ray(u as f32, v as f32);
        if !(z > 0.0 && z.is_finite()) || -normal.dot(direction) < LEAST_COSINE {
            return None;
        }
        let is_even = |u: usize, v: usize| lens.fitted_normal(&image.depth_m, u, v).dot(normal) > LEAST_EVEN;
        const REACH: usize = EVEN_PX;
        let around = [(u.checked_sub(REACH)?, v), (u + REACH, v), (u, v.checked_sub(REACH)?), (u, v + REACH)];
        let (rows, columns) = image.depth_m.dim();
        if !around.into_iter().all(|(u, v)| u < columns && v < rows && is_even(u, v)) {
            return None;
        }
        let point = lens.origin + direction * (z * length);
        let height = normal.dot(point - lens.origin);
        let beside = |u: usize, v: usize| {
            let (direction, _) = lens.ray(u as f32, v as f32);
            lens.origin + direction * (height / normal.dot(direction)) - point
        };
        Some(Patch { pixel: [u as f32, v as f32], point, normal, steps: [beside(u + 1, v), beside(u, v + 1)] })
    }
}

/// A place of an image at a resolution of the part of it that begins at `corner`.
pub(super) fn to_level([u, v]: [f32; 2], corner: [usize; 2], level: usize) -> [f32; 2] {
    let scale = 1.0 / (1_u32 << level) as f32;
    [(u - corner[0] as f32 + 0.5) * scale - 0.5, (v - corner[1] as f32 + 0.5) * scale - 0.5]
}

/// Least and greatest column and row that show the object.
pub(super) fn bounds(image: &CameraDepth) -> Option<[usize; 4]> {
    extent(&image.labels, |label| *label == Label::Object)
}

/// The mean of the colours in a part of an image.
fn grey(colour: &RgbImage, corner: [usize; 2], width: usize, height: usize) -> Level {
    part(colour, corner, width, height, |[r, g, b]| ((u16::from(r) + u16::from(g) + u16::from(b)) / 3) as u8)
}

/// Brightness and colours in a part of an image.
pub(super) fn channels(colour: &RgbImage, corner: [usize; 2], width: usize, height: usize) -> [Level; CHANNELS] {
    let of = |channel: usize| part(colour, corner, width, height, |rgb| rgb[channel]);
    [grey(colour, corner, width, height), of(0), of(1), of(2)]
}

fn part(colour: &RgbImage, corner: [usize; 2], width: usize, height: usize, value: impl Fn([u8; 3]) -> u8) -> Level {
    let row = 3 * colour.width() as usize;
    let rows = colour.as_raw().chunks_exact(row.max(1)).skip(corner[1]).take(height);
    let pixels = rows.flat_map(|row| row.as_chunks::<3>().0.iter().skip(corner[0]).take(width));
    Level { width, height, values: pixels.map(|rgb| value(*rgb)).collect() }
}

/// Whether all pixels around one show the object.
fn is_deep(image: &CameraDepth, [u, v]: [usize; 2]) -> bool {
    let (rows, columns) = image.labels.dim();
    let is_inside = u >= RIM_PX && v >= RIM_PX && u + RIM_PX < columns && v + RIM_PX < rows;
    let at = |u: usize, v: usize| image.labels[(v, u)] == Label::Object;
    let across =
        |reach: usize| [(u - reach, v - reach), (u + reach, v - reach), (u - reach, v + reach), (u + reach, v + reach)];
    is_inside
        && at(u, v)
        && [(u - RIM_PX, v), (u + RIM_PX, v), (u, v - RIM_PX), (u, v + RIM_PX)].iter().all(|&(u, v)| at(u, v))
        && across(RIM_PX * 2 / 3).iter().all(|&(u, v)| at(u, v))
}

/// Sums of slopes, their squares and products over all pixels above and left of one.
struct Slopes {
    columns: usize,
    sums: Vec<[f64; 5]>,
}

impl Slopes {
    fn new(level: &Level) -> Self {
        let columns = level.width + 1;
        let mut sums = vec![[0.0; 5]; columns * (level.height + 1)];
        for v in 0..level.height {
            let mut row = [0.0; 5];
            for u in 0..level.width {
                if u > 0 && v > 0 && u + 1 < level.width && v + 1 < level.height {
                    let x = 0.5 * (level.at(u + 1, v) - level.at(u - 1, v));
                    let y = 0.5 * (level.at(u, v + 1) - level.at(u, v - 1));
                    row = add(row, [x, y, x * x, x * y, y * y].map(f64::from));
                }
                sums[(v + 1) * columns + u + 1] = add(sums[v * columns + u + 1], row);
            }
        }
        Self { columns, sums }
    }

    /// Variance of the slopes around a pixel along the direction in which it is least.
    fn weakest(&self, u: usize, v: usize) -> f64 {
        let [left, right, top, bottom] = [u - REACH_PX, u + REACH_PX + 1, v - REACH_PX, v + REACH_PX + 1];
        let at = |u: usize, v: usize| self.sums[v * self.columns + u];
        let (whole, beside) = (add(at(right, bottom), at(left, top)), add(at(left, bottom), at(right, top)));
        let n = ((right - left) * (bottom - top)) as f64;
        let [x, y, xx, xy, yy] = std::array::from_fn(|i| (whole[i] - beside[i]) / n);
        let [xx, xy, yy] = [xx - x * x, xy - x * y, yy - y * y];
        0.5 * (xx + yy - ((xx - yy) * (xx - yy) + 4.0 * xy * xy).sqrt())
    }
}

fn add(a: [f64; 5], b: [f64; 5]) -> [f64; 5] {
    std::array::from_fn(|i| a[i] + b[i])
}
