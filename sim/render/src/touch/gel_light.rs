//! The light of real LEDs on the gel: near lights at low elevation, attached and cast shadows, a response that is not that of a screen,
//! and the camera's blur. It gives the change from the untouched image.
//!
//! Light from an LED at distance r falls on the gel as E = max(0, n.l) / r^2, and a level shows its direct part D as D (E / E0)^(1 /
//! response), where E0 belongs to the untouched gel. At elevation e a slope towards the LED changes E / E0 by cot(e) per unit.

use std::ops::Range;

use image::RgbImage;
use mvt_frames::camera::Intrinsics;
use mvt_robot::digit::profile::Appearance;

use super::membrane::between;
use super::shade::{Row, Shader};

/// Least elevation at which the untouched gel counts as lit, as a sine: beyond the horizon of an LED it shows no change of its colour.
const LEAST_SINE: f32 = 0.05;
/// Greatest change of light that is told apart, in shares of the untouched gel's.
const BRIGHTEST: f32 = 16.0;
/// Entries of the table of the response.
const ENTRIES: usize = 1024;
/// Pixels of a cell of the grid on which shadows are cast, along either axis.
const CELL: usize = 4;
/// Cells over which a shadow is looked for: gel that is 1.5 mm high at 15 degrees throws one of 5.6 mm, or 26 cells.
const LONGEST: usize = 26;
/// An obstacle that rises this much over the ray hides the whole LED, metres: real shadows have no border, since an LED is no point and
/// light scatters in the gel.
const PENUMBRA_M: f32 = 2.5e-4;

/// Light of the three LEDs of a sensor.
pub(super) struct GelLight {
    /// Positions of the red, green and blue LED in the gel frame, metres.
    leds: [[f32; 3]; 3],
    /// For each colour and pixel the direct part of the level, and the inverse of E0.
    direct: [Vec<f32>; 3],
    inverse_flat: [Vec<f32>; 3],
    /// Level over light, from 0 to [`BRIGHTEST`].
    response: Vec<f32>,
    cast_shadow: f32,
    /// Half of the kernel of the blur, from the centre outwards.
    kernel: Vec<f32>,
}

/// Working memory of one image.
#[derive(Default)]
pub(super) struct Scratch {
    /// Change of each colour, grey levels: of each pixel, and blurred along the rows.
    change: [Vec<f32>; 3],
    blurred: [Vec<f32>; 3],
    /// Indentation of each cell, metres, and the share of each LED's light that reaches it.
    height_m: Vec<f32>,
    light: [Vec<f32>; 3],
    /// A row with its borders, and a row of each colour.
    padded: Vec<f32>,
    sums: [Vec<f32>; 3],
}

impl GelLight {
    /// Prepares the light for an untouched image.
    pub fn new(appearance: &Appearance, background: &RgbImage, gel_depth: &[f32], shader: &Shader) -> Self {
        let elevation = appearance.led_elevation_deg.to_radians();
        let distance_m = 1e-3 * appearance.led_distance_mm;
        let leds = appearance.led_angles_deg.map(|degrees| {
            let (down, right) = degrees.to_radians().sin_cos();
            // Columns run towards -y, rows towards -z.
            [shader.gel.apex_m() - distance_m * elevation.tan(), -distance_m * right, -distance_m * down]
                .map(|x| x as f32)
        });
        let Intrinsics { width, height, .. } = shader.camera;
        let count = (width * height) as f32;
        let mean: [f32; 3] =
            std::array::from_fn(|c| background.pixels().map(|p| f32::from(p.0[c])).sum::<f32>() / count);
        let (mut direct, mut inverse_flat) = ([const { Vec::new() }; 3], [const { Vec::new() }; 3]);
        for (i, pixel) in background.pixels().enumerate() {
            let point = shader.point(i % width, i / width, gel_depth[i]);
            let [px, py, pz] = point.map(f64::from);
            let normal = shader.gel.normal(mvt_frames::Point::new(px, py, pz)).coords();
            let normal = [normal.x as f32, normal.y as f32, normal.z as f32];
            for c in 0..3 {
                let level = f32::from(pixel.0[c]);
                let share = (level / mean[c].max(1.0)).powf(appearance.background_exponent[c]);
                let height = appearance.sensitivity[c] * appearance.response * elevation.tan() as f32 * share;
                direct[c].push(height.min(level));
                inverse_flat[c].push(1.0 / arriving(leds[c], point, normal, LEAST_SINE));
            }
        }
        let entry = |k: usize| (k as f32 / ENTRIES as f32 * BRIGHTEST).powf(1.0 / appearance.response);
        let mut kernel: Vec<f32> = (0..=(2.5 * appearance.blur_px).ceil() as usize)
            .map(|k| (-0.5 * (k as f32 / appearance.blur_px.max(1e-3)).powi(2)).exp())
            .collect();
        let sum = 2.0 * kernel.iter().sum::<f32>() - kernel[0];
        kernel.iter_mut().for_each(|weight| *weight /= sum);
        Self {
            leds,
            direct,
            inverse_flat,
            response: (0..=ENTRIES).map(entry).collect(),
            cast_shadow: appearance.cast_shadow,
            kernel,
        }
    }

    /// Casts the shadows of the gel: computes the share of each LED's light that reaches each cell.
    #[inline(always)]
    pub fn cast(&self, gel_depth: &[f32], depth: &[f32], shader: &Shader, scratch: &mut Scratch) {
        let Scratch { height_m, light, change, .. } = scratch;
        let Intrinsics { width, height, .. } = shader.camera;
        let [columns, rows] = cells(&shader.camera);
        for change in change {
            change.clear();
            change.resize(width * height, 0.0);
        }
        height_m.clear();
        height_m.resize(columns * rows, 0.0);
        for v in 0..height {
            let cells = &mut height_m[v / CELL * columns..(v / CELL + 1) * columns];
            let pixels = |v: usize| v * width..(v + 1) * width;
            let (gel, depth) = (&gel_depth[pixels(v)], &depth[pixels(v)]);
            for (cell, (gel, depth)) in cells.iter_mut().zip(gel.chunks(CELL).zip(depth.chunks(CELL))) {
                *cell += gel.iter().zip(depth).map(|(gel, depth)| gel - depth).sum::<f32>() / (CELL * CELL) as f32;
            }
        }
        let highest = height_m.iter().copied().fold(0.0, |a: f32, b| if b > a { b } else { a });
        for (led, light) in self.leds.iter().zip(light) {
            light.clear();
            light.resize(columns * rows, 1.0);
            for (cell, light) in light.iter_mut().enumerate() {
                let (u, v) = (cell % columns, cell / columns);
                let middle = [(u * CELL + CELL / 2).min(width - 1), (v * CELL + CELL / 2).min(height - 1)];
                let [x, y, z] = shader.point(middle[0], middle[1], gel_depth[middle[1] * width + middle[0]]);
                // Towards the LED: metres to the right, down and out of the gel.
                let to = [y - led[1], z - led[2], x - led[0]];
                let along = (to[0] * to[0] + to[1] * to[1]).sqrt();
                let step_m = CELL as f32 * x / shader.camera.fx as f32;
                let rise = to[2] / along * step_m;
                let step = [to[0] / along, to[1] / along];
                let (mut ray, mut over) = (height_m[cell], 0.0);
                for k in 1..=LONGEST {
                    ray += rise;
                    let at = [u as f32 + k as f32 * step[0], v as f32 + k as f32 * step[1]];
                    let inside =
                        at[0] >= 0.0 && at[1] >= 0.0 && at[0] < (columns - 1) as f32 && at[1] < (rows - 1) as f32;
                    if !inside || ray > highest || k as f32 * step_m > along {
                        break;
                    }
                    let (left, up) = (at[0] as usize, at[1] as usize);
                    let [across, down] = [at[0] - left as f32, at[1] - up as f32];
                    let row = |at: usize| height_m[at] + across * (height_m[at + 1] - height_m[at]);
                    let first = up * columns + left;
                    let height = row(first) + down * (row(first + columns) - row(first));
                    over = if height - ray > over { height - ray } else { over };
                }
                *light = 1.0 - self.cast_shadow * (over / PENUMBRA_M).min(1.0);
            }
        }
    }

    /// Computes the change of the pixels of row `v` for which `changed` holds. The row's normals have any length.
    #[inline(always)]
    pub fn shade(&self, v: usize, row: &Row, shader: &Shader, changed: impl Fn(usize) -> bool, scratch: &mut Scratch) {
        let [columns, rows] = cells(&shader.camera);
        let (upper, lower, down) = between(v, CELL, rows);
        for u in (0..shader.camera.width).filter(|&u| changed(u)) {
            let point = shader.point(u, v, row.depth[u]);
            let normal = row.normal.each_ref().map(|lane| lane[u]);
            let length = (normal[0] * normal[0] + normal[1] * normal[1] + normal[2] * normal[2]).sqrt();
            let normal = normal.map(|x| x / length);
            let (left, right, across) = between(u, CELL, columns);
            for c in 0..3 {
                let cells = &scratch.light[c];
                let at = |row: usize| {
                    let row = &cells[row * columns..(row + 1) * columns];
                    row[left] + across * (row[right] - row[left])
                };
                let light = at(upper) + down * (at(lower) - at(upper));
                let i = v * shader.camera.width + u;
                let ratio = light * arriving(self.leds[c], point, normal, 0.0) * self.inverse_flat[c][i];
                let place = (ratio * (ENTRIES as f32 / BRIGHTEST)).min(ENTRIES as f32 - 1.0);
                let entry = place as usize;
                let (low, high) = (self.response[entry], self.response[entry + 1]);
                let level = low + (place - entry as f32) * (high - low);
                scratch.change[c][i] = self.direct[c][i] * (level - 1.0);
            }
        }
    }

    /// Blurs the change of the `rows` that hold it, and adds it to the background.
    #[inline(always)]
    pub fn overlay(&self, width: usize, rows: Range<usize>, scratch: &mut Scratch, background: &[u8], out: &mut [u8]) {
        let (reach, height) = (self.kernel.len() - 1, out.len() / (3 * width));
        let pixels = |v: usize| v * width..(v + 1) * width;
        let Scratch { change, blurred, padded, sums, .. } = scratch;
        padded.resize(width + 2 * MOST_REACH, 0.0);
        for (change, blurred) in change.iter().zip(blurred.iter_mut()) {
            blurred.clear();
            blurred.resize(width * height, 0.0);
            for v in rows.clone() {
                padded[MOST_REACH..MOST_REACH + width].copy_from_slice(&change[pixels(v)]);
                padded[..MOST_REACH].fill(change[v * width]);
                padded[MOST_REACH + width..].fill(change[(v + 1) * width - 1]);
                let out = &mut blurred[pixels(v)];
                for (k, weight) in self.kernel.iter().enumerate() {
                    let weight = if k == 0 { 0.5 * weight } else { *weight };
                    let (before, after) = (&padded[MOST_REACH - k..][..width], &padded[MOST_REACH + k..][..width]);
                    for ((out, before), after) in out.iter_mut().zip(before).zip(after) {
                        *out += weight * (before + after);
                    }
                }
            }
        }
        for v in rows.start.saturating_sub(reach)..(rows.end + reach).min(height) {
            for (sum, blurred) in sums.iter_mut().zip(blurred.iter()) {
                sum.clear();
                sum.resize(width, 0.0);
                for (k, weight) in self.kernel.iter().enumerate() {
                    let weight = if k == 0 { 0.5 * weight } else { *weight };
                    let (above, below) = (v.saturating_sub(k), (v + k).min(height - 1));
                    for ((sum, above), below) in
                        sum.iter_mut().zip(&blurred[pixels(above)]).zip(&blurred[pixels(below)])
                    {
                        *sum += weight * (above + below);
                    }
                }
            }
            let row = 3 * v * width..3 * (v + 1) * width;
            let levels = out[row.clone()].as_chunks_mut::<3>().0.iter_mut().zip(background[row].as_chunks::<3>().0);
            for (u, (out, under)) in levels.enumerate() {
                for c in 0..3 {
                    // A number beyond a byte is cut off by the conversion.
                    out[c] = (f32::from(under[c]) + sums[c][u] + 0.5) as u8;
                }
            }
        }
    }
}

/// Returns the numbers of columns and rows of cells of a camera's images.
fn cells(camera: &Intrinsics) -> [usize; 2] {
    [camera.width, camera.height].map(|pixels| pixels.div_ceil(CELL))
}

/// Pixels that the widest blur reaches.
const MOST_REACH: usize = 10;

/// Returns the light that falls on a surface from an LED, relative to its strength.
#[inline(always)]
fn arriving(led: [f32; 3], point: [f32; 3], normal: [f32; 3], least_sine: f32) -> f32 {
    let to = [led[0] - point[0], led[1] - point[1], led[2] - point[2]];
    let square = to[0] * to[0] + to[1] * to[1] + to[2] * to[2];
    let sine = (normal[0] * to[0] + normal[1] * to[1] + normal[2] * to[2]) / square.sqrt();
    (if sine > least_sine { sine } else { least_sine }) / square
}
