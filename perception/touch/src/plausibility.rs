//! How far a reading can be trusted: what speaks for and against it, and the probability that follows.
//!
//! The change of an image must follow from the slopes of the indentation that is read from it: each LED brightens what faces it. So the change is
//! fitted by the slopes, with a gain for each colour that varies over the gel. What the fit does not explain, LEDs that would stand elsewhere
//! and gains that no such sensor has speak against the reading. The probability is a logistic regression on simulated sensors and disturbances.

use image::RgbImage;
use mvt_robot::digit::profile::Appearance;
use nalgebra::{SMatrix, SVector};
use ndarray::Array2;
use serde::Serialize;

use crate::light::SensorLight;
use crate::untouched::{EVEN, Squares};

/// Pixels of a cell along either axis, over which change and indentation are averaged.
const CELL: usize = 4;
/// A cell shows something if it is steeper than this, or its colour has changed by more than this many grey levels.
const STEEP: f32 = 0.03;
const CHANGED: f32 = 8.0;
/// With fewer such cells there is nothing to judge by.
const LEAST_CELLS: u32 = 24;
/// Terms of the change of a colour: slope to the right and down, both times the place along columns and rows, the square of the slope, and 1.
const TERMS: usize = 8;
/// Keeps the fit defined where terms are alike: the square of a slope that does not matter.
const RIDGE: f64 = 1e-5;

/// What speaks for and against a reading.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Evidence {
    /// Share of the image's change that follows from the slopes of the indentation, at most 1.
    pub explained: f32,
    /// Mean angle between the LEDs that the fit finds and those of the sensor, degrees, 0 to 180.
    pub turned_deg: f32,
    /// Natural logarithm of the gain that the fit finds over that of the sensor, mean of the colours.
    pub gain: f32,
    /// Root mean square of the indentation where nothing touches, millimetres.
    pub residual_mm: f32,
    /// Absolute natural logarithm of the exponent that makes the camera's response the usual one.
    pub response: f32,
    /// Greatest absolute natural logarithm of the gains of its light.
    pub light: f32,
    /// Cells of 4 x 4 pixels that show something.
    pub cells: u32,
}

impl Evidence {
    /// Compares a change from the untouched image, as the network saw it around [`EVEN`], with the indentation that was read.
    pub(crate) fn of(
        seen: &RgbImage,
        indentation_mm: &Array2<f32>,
        pixel_mm: f32,
        look: &Appearance,
        residual_mm: f32,
        light: &SensorLight,
    ) -> Self {
        let [response, light] = light.unusual();
        let nothing = Self { explained: 1.0, turned_deg: 0.0, gain: 0.0, residual_mm, response, light, cells: 0 };
        let (rows, columns) = (indentation_mm.nrows() / CELL, indentation_mm.ncols() / CELL);
        if rows < 3 || columns < 3 {
            return nothing;
        }
        let (change, height_mm) = cells(seen, indentation_mm, [rows, columns]);
        let mut normal = SMatrix::<f64, TERMS, TERMS>::zeros();
        let (mut right, mut squares) = ([SVector::<f64, TERMS>::zeros(); 3], 0.0);
        // Where the slopes are, weighted by them.
        let (mut count, mut middle, mut steepness) = (0, [0.0; 2], 0.0);
        let per_mm = 1.0 / (2.0 * CELL as f32 * pixel_mm);
        for (row, column) in (1..rows - 1).flat_map(|row| (1..columns - 1).map(move |column| (row, column))) {
            let cell = row * columns + column;
            // What faces an LED is lower on its side.
            let slope =
                [height_mm[cell - 1] - height_mm[cell + 1], height_mm[cell - columns] - height_mm[cell + columns]]
                    .map(|mm| mm * per_mm);
            let square = slope[0] * slope[0] + slope[1] * slope[1];
            if square < STEEP * STEEP && change[cell].iter().all(|grey| grey.abs() < CHANGED) {
                continue;
            }
            let place = [(column, columns), (row, rows)].map(|(at, side)| 2.0 * (at as f32 + 0.5) / side as f32 - 1.0);
            let [x, y] = slope;
            let terms = [x, y, x * place[0], y * place[0], x * place[1], y * place[1], square, 1.0];
            let terms = SVector::<f64, TERMS>::from(terms.map(f64::from));
            normal += terms * terms.transpose();
            for (right, grey) in right.iter_mut().zip(change[cell]) {
                *right += terms * f64::from(grey);
                squares += f64::from(grey * grey);
            }
            count += 1;
            let weight = square.sqrt();
            middle[0] += weight * place[0];
            middle[1] += weight * place[1];
            steepness += weight;
        }
        if count < LEAST_CELLS {
            return Self { cells: count, ..nothing };
        }
        normal += SMatrix::<f64, TERMS, TERMS>::identity() * (RIDGE * f64::from(count));
        let Some(inverse) = normal.try_inverse() else { return Self { cells: count, ..nothing } };
        let found = right.map(|right| inverse * right);
        let kept: f64 = found.iter().zip(&right).map(|(found, right)| found.dot(right)).sum();
        let place = middle.map(|sum| f64::from(sum / steepness.max(1e-6)));
        let (mut turned, mut gain, mut weights) = (0.0, 0.0, 0.0);
        for (found, (angle_deg, sensitivity)) in found.iter().zip(look.led_angles_deg.into_iter().zip(look.sensitivity))
        {
            let along = |axis: usize| found[axis] + found[2 + axis] * place[0] + found[4 + axis] * place[1];
            let (right, down) = (along(0), along(1));
            let strength = right.hypot(down);
            let apart = (down.atan2(right).to_degrees() - angle_deg + 540.0).rem_euclid(360.0) - 180.0;
            turned += strength * apart.abs();
            weights += strength;
            gain += (strength / f64::from(sensitivity)).max(1e-2).ln() / 3.0;
        }
        Self {
            explained: (kept / squares.max(1e-9)) as f32,
            turned_deg: (turned / weights.max(1e-9)) as f32,
            gain: gain as f32,
            cells: count,
            ..nothing
        }
    }

    /// Returns the probability that the reading is [`GOOD`].
    pub fn probability(&self) -> f32 {
        if self.cells < LEAST_CELLS {
            return 1.0;
        }
        let terms = self.terms();
        let logit: f32 = WEIGHTS.iter().zip(terms).map(|(weight, term)| weight * term).sum();
        1.0 / (1.0 + (-logit).exp())
    }

    /// Terms of the regression.
    fn terms(&self) -> [f32; 8] {
        let &Self { explained, turned_deg, gain, residual_mm, response, light, .. } = self;
        let turned = (turned_deg - USUAL_TURN_DEG).max(0.0) / 45.0;
        [1.0, 1.0 - explained, turned, gain.max(0.0), (-gain).max(0.0), residual_mm / 0.1, response, light]
    }
}

/// Of a good reading: greatest mean error of the depth in contact, millimetres, and least IoU of the contact.
pub const GOOD: (f32, f32) = (0.15, 0.7);

/// An angle below this, degrees, says nothing: so far LEDs differ from sensor to sensor, and so far a fit to a few slopes may turn them.
const USUAL_TURN_DEG: f32 = 25.0;

/// Weights of the terms, from 960 readings of 120 simulated DIGITs of which half had a fault (`touch units --units 120 --faults 0.5 --seed 1
/// --objects validation`). Of 640 readings of other units 7, 37, 58, 72 and 78 % were good where the probability was 0.0 to 0.2, and so on.
const WEIGHTS: [f32; 8] = [1.94, -4.05, -0.17, 1.0, -0.35, -1.33, -0.55, 0.35];

/// Returns the mean change of each colour, grey levels, and the mean indentation of each cell.
fn cells(seen: &RgbImage, indentation_mm: &Array2<f32>, [rows, columns]: [usize; 2]) -> (Vec<[f32; 3]>, Vec<f32>) {
    let (mut change, mut height_mm) = (vec![[0.0; 3]; rows * columns], vec![0.0; rows * columns]);
    let share = 1.0 / (CELL * CELL) as f32;
    let pixels = seen.as_chunks::<3>().0.chunks(seen.width().max(1) as usize);
    for (v, (row, heights)) in pixels.zip(indentation_mm.rows()).take(rows * CELL).enumerate() {
        for (u, (rgb, mm)) in row.iter().zip(heights).take(columns * CELL).enumerate() {
            let cell = v / CELL * columns + u / CELL;
            height_mm[cell] += share * mm;
            for (sum, &level) in change[cell].iter_mut().zip(rgb) {
                *sum += share * (f32::from(level) - f32::from(EVEN));
            }
        }
    }
    (change, height_mm)
}

/// Share of the contact in clipped pixels from which an image is less plausible, and from which not at all.
const CLIPPED: [f32; 2] = [0.1, 0.5];

/// Returns from 0 to 1 how far a contact lies where neither an image nor the untouched one is as bright as a pixel can be: there its depth is
/// unknown. For sensors with another light than the usual one.
pub(crate) fn unclipped(image: &RgbImage, untouched: &RgbImage, contact: &Array2<bool>) -> f32 {
    let is_clipped = |rgb: &[u8; 3]| rgb.contains(&u8::MAX);
    let pixels = image.as_chunks::<3>().0.iter().zip(untouched.as_chunks::<3>().0);
    let touching = pixels.zip(contact).filter(|(_, touches)| **touches);
    let (all, clipped) = touching.fold((0, 0), |(all, clipped), ((image, untouched), _)| {
        (all + 1, clipped + usize::from(is_clipped(image) || is_clipped(untouched)))
    });
    1.0 - ramp(clipped as f32 / all.max(1) as f32, CLIPPED[0], CLIPPED[1])
}

/// 0 up to `low`, 1 from `high` on.
pub(crate) fn ramp(x: f32, low: f32, high: f32) -> f32 {
    ((x - low) / (high - low)).clamp(0.0, 1.0)
}

/// From 0 to 1 how far an image is neither black nor saturated.
pub(crate) fn exposure(image: &RgbImage) -> f32 {
    let is_exposed = |rgb: &&[u8; 3]| (12..=250).contains(&rgb.iter().max().copied().unwrap_or(0));
    let pixels = image.as_chunks::<3>().0;
    ramp(pixels.iter().filter(is_exposed).count() as f32 / pixels.len().max(1) as f32, 0.4, 0.8)
}

/// From 0 to 1 how far colours vary over an image: a DIGIT's LEDs light its gel from three sides.
pub(crate) fn contrast(squares: &Squares) -> f32 {
    let count = squares.len().max(1) as f32;
    let spread = [0, 1, 2].map(|c| {
        let mean = squares.iter().map(|rgb| rgb[c]).sum::<f32>() / count;
        (squares.iter().map(|rgb| (rgb[c] - mean).powi(2)).sum::<f32>() / count).sqrt()
    });
    ramp(spread.into_iter().fold(0.0, f32::max), 1.0, 4.0)
}

#[cfg(test)]
mod tests {
    use image::Rgb;

    use super::*;

    /// The change that a ball of 3 mm makes under LEDs that stand where those of the look do, turned by some degrees.
    fn ball(turned_deg: f64) -> (RgbImage, Array2<f32>, Appearance) {
        let (look, pixel_mm) = (Appearance::default(), 1.0 / 18.8);
        let indentation_mm = Array2::from_shape_fn((320, 240), |(v, u)| {
            let r_mm = pixel_mm * (u as f64 - 120.0).hypot(v as f64 - 160.0);
            if r_mm < 1.3 {
                (0.4 - 0.5 * r_mm * r_mm / 3.0) as f32
            } else {
                (0.118 * (-(r_mm - 1.3) / 0.5).exp()) as f32
            }
        });
        let image = RgbImage::from_fn(240, 320, |u, v| {
            let (x, y) = (f64::from(u) - 120.0, f64::from(v) - 160.0);
            let r_mm = pixel_mm * x.hypot(y);
            let slope = if r_mm < 1.3 { r_mm / 3.0 } else { 0.236 * (-(r_mm - 1.3) / 0.5).exp() };
            Rgb(std::array::from_fn(|c| {
                let (down, right) = (look.led_angles_deg[c] + turned_deg).to_radians().sin_cos();
                let towards = slope * (x * right + y * down) / x.hypot(y).max(1e-9);
                (f64::from(EVEN) + f64::from(look.sensitivity[c]) * towards).round().clamp(0.0, 255.0) as u8
            }))
        });
        (image, indentation_mm, look)
    }

    fn evidence((image, indentation_mm, look): &(RgbImage, Array2<f32>, Appearance)) -> Evidence {
        Evidence::of(image, indentation_mm, 1.0 / 18.8, look, 0.02, &SensorLight::known([1.0; 3]))
    }

    #[test]
    fn a_change_that_follows_from_the_slopes_is_believed() {
        let found = evidence(&ball(0.0));
        assert!(found.explained > 0.95 && found.turned_deg < 3.0 && found.gain.abs() < 0.1, "{found:?}");
        assert!(found.probability() > 0.7, "{found:?}");
    }

    #[test]
    fn leds_that_stand_elsewhere_are_seen() {
        let found = evidence(&ball(60.0));
        assert!((found.turned_deg - 60.0).abs() < 5.0, "{found:?}");
        assert!(found.probability() < evidence(&ball(0.0)).probability());
    }

    #[test]
    fn a_change_without_slopes_is_not_believed() {
        let (image, _, look) = ball(0.0);
        let found = evidence(&(image, Array2::zeros((320, 240)), look));
        assert!(found.explained < 0.3 && found.probability() < 0.3, "{found:?}");
        let (_, indentation_mm, look) = ball(0.0);
        let found = evidence(&(RgbImage::from_pixel(240, 320, Rgb([EVEN; 3])), indentation_mm, look));
        assert!(found.gain < -2.0, "{found:?}");
    }

    #[test]
    fn an_untouched_sensor_is_believed() {
        let nothing =
            (RgbImage::from_pixel(240, 320, Rgb([EVEN; 3])), Array2::zeros((320, 240)), Appearance::default());
        assert_eq!(evidence(&nothing).probability(), 1.0);
        let tiny = (RgbImage::new(4, 4), Array2::zeros((4, 4)), Appearance::default());
        assert_eq!(evidence(&tiny).cells, 0);
    }
}
