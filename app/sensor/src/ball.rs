//! Gains and directions of a sensor's LEDs from presses of a ball of known size.
//!
//! Where a ball lies on the gel its slope is known: at distance r from the middle of the contact it is r / sqrt(R^2 - r^2). Each colour
//! changes in proportion to the slope towards its LED, as long as no shadow falls there, and to a power of the untouched level: where less of
//! an LED's light arrives, less of it changes.

use image::RgbImage;
use mvt_robot::digit::profile::{Appearance, SensorProfile};
use nalgebra::{Matrix3, Vector3};
use ndarray::Array2;

/// Contacts on fewer pixels are not used: their middle is uncertain.
const LEAST_PIXELS: usize = 300;
/// Share of the contact's radius within which slopes are used: the gel leaves the ball near the rim.
const INSIDE: f64 = 0.8;
/// Steeper slopes may lie in shadow.
const STEEPEST: f64 = 0.28;
/// Contacts that are longer than wide by more than this, or end at the image's border, are not round.
const ROUND: f64 = 1.35;

/// A fit of a sensor to presses of a ball.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BallFit {
    /// Presses that were used.
    pub presses: usize,
    /// Change of red, green and blue per unit of slope towards the LED where the untouched image has its mean level, grey levels.
    pub sensitivity: [f64; 3],
    /// Direction towards the red, green and blue LED in the image, degrees; 0 is right and 90 is down.
    pub led_angles_deg: [f64; 3],
    /// Share of the variance of each colour's change that this explains, up to 1.
    pub explained: [f64; 3],
}

impl BallFit {
    /// Returns the profile of a sensor with these gains and directions.
    pub fn applied_to(&self, profile: &SensorProfile) -> SensorProfile {
        let sensitivity = self.sensitivity.map(|gain| gain as f32);
        let usual = profile.appearance.unwrap_or_default();
        let appearance = Appearance { sensitivity, led_angles_deg: self.led_angles_deg, ..usual };
        SensorProfile { appearance: Some(appearance), ..profile.clone() }
    }
}

/// Image of a press and where a network finds contact in it.
pub type BallPress<'a> = (&'a RgbImage, &'a Array2<bool>);

/// Fits gains and directions, with the exponent of the untouched level of each colour. Returns `None` if no press is usable: round, clear of
/// the image's border, and not small.
pub fn fit(
    presses: &[BallPress<'_>],
    untouched: &RgbImage,
    background_exponent: [f32; 3],
    px_per_mm: f64,
    ball_radius_mm: f64,
) -> Option<BallFit> {
    let mut used = 0;
    let pixels = f64::from(untouched.width() * untouched.height()).max(1.0);
    let mean: [f64; 3] =
        std::array::from_fn(|c| untouched.pixels().map(|pixel| f64::from(pixel.0[c])).sum::<f64>() / pixels);
    // Of each colour: normal equations over slope to the right, slope downwards and 1, and moments of the change.
    let mut normal = [Matrix3::zeros(); 3];
    let (mut right, mut squares, mut sums, mut count) = ([Vector3::zeros(); 3], [0.0; 3], [0.0; 3], 0.0);
    for (image, contact) in presses {
        let Some(Circle { x, y, radius }) = Circle::of(contact) else { continue };
        if image.dimensions() != untouched.dimensions() {
            continue;
        }
        used += 1;
        for ((u, v, pixel), empty) in image.enumerate_pixels().zip(untouched.pixels()) {
            let (dx, dy) = (f64::from(u) - x, f64::from(v) - y);
            let r = dx.hypot(dy);
            let r_mm = r / px_per_mm;
            let slope = r_mm / (ball_radius_mm * ball_radius_mm - r_mm * r_mm).max(1e-9).sqrt();
            if r > INSIDE * radius || slope > STEEPEST {
                continue;
            }
            // The gel rises towards the middle of the ball: it faces outwards.
            let slopes = [slope * dx / r.max(1e-9), slope * dy / r.max(1e-9)];
            count += 1.0;
            for c in 0..3 {
                let share = (f64::from(empty.0[c]) / mean[c].max(1.0)).powf(f64::from(background_exponent[c]));
                let terms = Vector3::new(share * slopes[0], share * slopes[1], 1.0);
                normal[c] += terms * terms.transpose();
                let change = f64::from(pixel.0[c]) - f64::from(empty.0[c]);
                right[c] += terms * change;
                squares[c] += change * change;
                sums[c] += change;
            }
        }
    }
    let mut solved = [Vector3::zeros(); 3];
    for (c, solved) in solved.iter_mut().enumerate() {
        *solved = normal[c].try_inverse().filter(|_| used > 0)? * right[c];
    }
    let angle = |s: &Vector3<f64>| s.y.atan2(s.x).to_degrees();
    Some(BallFit {
        presses: used,
        sensitivity: solved.map(|s| s.x.hypot(s.y)),
        led_angles_deg: solved.each_ref().map(angle),
        explained: std::array::from_fn(|c| {
            let total: f64 = squares[c] - sums[c] * sums[c] / count;
            let left = squares[c] - solved[c].dot(&right[c]);
            if total > 0.0 { 1.0 - left / total } else { 0.0 }
        }),
    })
}

/// Returns the radius of the ball that an indentation shows where it touches, millimetres, and the mean error of the indentation there beside
/// that of a ball of the true radius that is pressed in as deep. `None` if the contact is not round, or not curved as a ball is.
pub(crate) fn judge(
    indentation_mm: &Array2<f32>,
    contact: &Array2<bool>,
    px_per_mm: f64,
    ball_radius_mm: f64,
) -> Option<(f64, f64)> {
    let Circle { x, y, radius } = Circle::of(contact)?;
    let places = || {
        indentation_mm.indexed_iter().filter_map(|((v, u), &mm)| {
            let r_mm = (u as f64 - x).hypot(v as f64 - y) / px_per_mm;
            (r_mm <= INSIDE * radius / px_per_mm).then_some((0.5 * r_mm * r_mm, f64::from(mm)))
        })
    };
    let (count, sums) =
        places().fold((0.0, [0.0; 2]), |(count, [a, b]), (half_square, mm)| (count + 1.0, [a + half_square, b + mm]));
    let [mean_square, mean_mm] = sums.map(|sum| sum / f64::max(count, 1.0));
    let (falls, spread) = places().fold((0.0, 0.0), |(falls, spread), (half_square, mm)| {
        let away = half_square - mean_square;
        (falls - away * (mm - mean_mm), spread + away * away)
    });
    let error_mm = places()
        .map(|(half_square, mm)| (mm - mean_mm + (half_square - mean_square) / ball_radius_mm).abs())
        .sum::<f64>()
        / f64::max(count, 1.0);
    (falls > 0.0).then_some((spread / falls, error_mm))
}

/// Middle and radius of a contact, pixels.
struct Circle {
    x: f64,
    y: f64,
    radius: f64,
}

impl Circle {
    /// Returns the circle of a contact's area around its middle; `None` if the contact is not round.
    fn of(contact: &Array2<bool>) -> Option<Self> {
        let places: Vec<[f64; 2]> =
            contact.indexed_iter().filter(|(_, touches)| **touches).map(|((v, u), _)| [u as f64, v as f64]).collect();
        if places.len() < LEAST_PIXELS {
            return None;
        }
        let count = places.len() as f64;
        let [x, y] = [0, 1].map(|axis| places.iter().map(|place| place[axis]).sum::<f64>() / count);
        let moment = |i: usize, j: usize| {
            let mean = [x, y];
            places.iter().map(|place| (place[i] - mean[i]) * (place[j] - mean[j])).sum::<f64>() / count
        };
        let covariance = nalgebra::Matrix2::new(moment(0, 0), moment(0, 1), moment(0, 1), moment(1, 1));
        let spread = covariance.symmetric_eigenvalues();
        let radius = (count / std::f64::consts::PI).sqrt();
        let (rows, columns) = contact.dim();
        let is_inside = x > radius && y > radius && x < columns as f64 - radius && y < rows as f64 - radius;
        // Of a disk of this area, not of some patches.
        let is_whole = spread.max().sqrt() < ROUND * radius / 2.0;
        (is_inside && is_whole && spread.max() < ROUND * ROUND * spread.min()).then_some(Self { x, y, radius })
    }
}

#[cfg(test)]
mod tests {
    use image::Rgb;

    use super::*;

    /// Draws a ball's press as the model says, and returns image and contact.
    fn press(x: f64, y: f64, sensitivity: [f64; 3], angles_deg: [f64; 3]) -> (RgbImage, Array2<bool>) {
        let radius = 26.0;
        let image = RgbImage::from_fn(240, 320, |u, v| {
            let (dx, dy) = (f64::from(u) - x, f64::from(v) - y);
            let r = dx.hypot(dy);
            let r_mm: f64 = r / 18.8;
            let slope = if r < radius { r_mm / (9.0 - r_mm * r_mm).sqrt() } else { 0.0 };
            Rgb(std::array::from_fn(|c| {
                let (down, right) = angles_deg[c].to_radians().sin_cos();
                let towards = slope * (dx * right + dy * down) / r.max(1e-9);
                (95.0 + sensitivity[c] * towards).round().clamp(0.0, 255.0) as u8
            }))
        });
        (image, Array2::from_shape_fn((320, 240), |(v, u)| (u as f64 - x).hypot(v as f64 - y) < radius))
    }

    #[test]
    fn drawn_gains_and_directions_are_found() {
        let (sensitivity, angles) = ([90.0, 150.0, 120.0], [-40.0, -170.0, 85.0]);
        let presses: Vec<_> =
            [(80.0, 90.0), (150.5, 200.0), (120.0, 160.3)].map(|(x, y)| press(x, y, sensitivity, angles)).into();
        let pairs: Vec<BallPress<'_>> = presses.iter().map(|(image, contact)| (image, contact)).collect();
        let untouched = RgbImage::from_pixel(240, 320, Rgb([95; 3]));
        let fit = fit(&pairs, &untouched, [0.0; 3], 18.8, 3.0).unwrap();
        assert_eq!(fit.presses, 3);
        for c in 0..3 {
            assert!((fit.sensitivity[c] / sensitivity[c] - 1.0).abs() < 0.02, "{fit:?}");
            assert!((fit.led_angles_deg[c] - angles[c]).abs() < 1.0, "{fit:?}");
            assert!(fit.explained[c] > 0.97, "{fit:?}");
        }
    }

    #[test]
    fn a_ball_is_judged_by_its_curvature() {
        let contact = |radius: f64| {
            Array2::from_shape_fn((320, 240), |(v, u)| (u as f64 - 120.0).hypot(v as f64 - 160.0) < radius)
        };
        let ball = |radius_mm: f64| {
            Array2::from_shape_fn((320, 240), |(v, u)| {
                let r_mm = (u as f64 - 120.0).hypot(v as f64 - 160.0) / 18.8;
                (0.5 - 0.5 * r_mm * r_mm / radius_mm) as f32
            })
        };
        let (radius_mm, error_mm) = judge(&ball(3.0), &contact(26.0), 18.8, 3.0).unwrap();
        assert!((radius_mm - 3.0).abs() < 0.01 && error_mm < 1e-3, "{radius_mm} mm, {error_mm} mm");
        let (radius_mm, error_mm) = judge(&ball(2.0), &contact(26.0), 18.8, 3.0).unwrap();
        assert!((radius_mm - 2.0).abs() < 0.01 && error_mm > 0.01, "{radius_mm} mm, {error_mm} mm");
        assert_eq!(judge(&Array2::zeros((320, 240)), &contact(26.0), 18.8, 3.0), None);
    }

    #[test]
    fn presses_that_are_no_disks_are_left_out() {
        let untouched = RgbImage::from_pixel(240, 320, Rgb([95; 3]));
        let (image, _) = press(120.0, 160.0, [100.0; 3], [0.0; 3]);
        let shapes: [fn(f64, f64) -> bool; 3] =
            [|u, v| u.abs() < 5.0 && v.abs() < 80.0, |u, v| u.hypot(v) < 5.0, |u, v| (u + 118.0).hypot(v) < 26.0];
        for shape in shapes {
            let contact = Array2::from_shape_fn((320, 240), |(v, u)| shape(u as f64 - 120.0, v as f64 - 160.0));
            assert_eq!(fit(&[(&image, &contact)], &untouched, [1.0; 3], 18.8, 3.0), None);
        }
        assert_eq!(fit(&[], &untouched, [1.0; 3], 18.8, 3.0), None);
    }
}
