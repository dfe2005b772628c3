//! The part of a camera's images that shows the gel.

use anyhow::{Result, ensure};
use image::imageops::interpolate_bilinear;
use image::{Rgb, RgbImage};
use mvt_robot::digit::profile::SensorProfile;
use nalgebra as na;

/// Where a gel lies in the images of a camera that sees more than it, or sees it askew or in a mirror.
#[derive(Debug, Clone)]
pub struct GelWindow {
    /// Takes a place on the gel, 0 to 1 to the right and downwards, to a pixel of the camera in homogeneous coordinates.
    image_from_gel: na::Matrix3<f64>,
    corners_px: [[f64; 2]; 4],
    size_px: [usize; 2],
}

/// Most samples along either side of a pixel.
const MOST_SAMPLES: usize = 8;

impl GelWindow {
    /// Returns the window of a sensor; `None` if its images show the gel and nothing else.
    pub fn of(profile: &SensorProfile) -> Option<Self> {
        let corners_px = profile.corners_px?;
        let image_from_gel = homography(corners_px)?;
        Some(Self { image_from_gel, corners_px, size_px: profile.size_px })
    }

    /// Returns the pixel of the camera for a place on the gel.
    fn pixel(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let place = self.image_from_gel * na::Vector3::new(x, y, 1.0);
        [place.x / place.z, place.y / place.z]
    }

    /// Cuts the gel out of an image and puts it upright, in the size of the sensor's images.
    ///
    /// # Errors
    /// If a corner lies outside of the image.
    pub fn cut(&self, image: &RgbImage) -> Result<RgbImage> {
        let (width, height) = image.dimensions();
        let is_inside =
            |[x, y]: &[f64; 2]| (0.0..=f64::from(width)).contains(x) && (0.0..=f64::from(height)).contains(y);
        ensure!(
            self.corners_px.iter().all(is_inside),
            "corners_px of the profile lie outside of an image of {width} x {height} pixels; give them for images of this size"
        );
        let [columns, rows] = self.size_px;
        // As many samples as pixels of the camera fall on one of the result, so that none is skipped.
        let sides = [0, 1, 2, 3].map(|k| {
            let [a, b] = [self.corners_px[k], self.corners_px[(k + 1) % 4]];
            (a[0] - b[0]).hypot(a[1] - b[1]) / self.size_px[k % 2] as f64
        });
        let samples = (sides.into_iter().fold(1.0, f64::max).round() as usize).clamp(1, MOST_SAMPLES);
        let step = 1.0 / samples as f64;
        Ok(RgbImage::from_fn(columns as u32, rows as u32, |column, row| {
            let mut sum = [0.0; 3];
            for (i, j) in (0..samples).flat_map(|i| (0..samples).map(move |j| (i, j))) {
                let x = (f64::from(column) + (i as f64 + 0.5) * step) / columns as f64;
                let y = (f64::from(row) + (j as f64 + 0.5) * step) / rows as f64;
                let level = sampled(image, self.pixel([x, y]));
                sum.iter_mut().zip(level).for_each(|(sum, level)| *sum += f64::from(level) * step * step);
            }
            Rgb(sum.map(|level| level.round() as u8))
        }))
    }
}

/// Returns the projective map of the unit square to four corners: top left, top right, bottom right and bottom left (Heckbert 1989, section
/// 2.2.3). `None` if they are on a line.
fn homography([a, b, c, d]: [[f64; 2]; 4]) -> Option<na::Matrix3<f64>> {
    let point = |[x, y]: [f64; 2]| na::Vector2::new(x, y);
    let [a, b, c, d] = [a, b, c, d].map(point);
    let lines = na::Matrix2::from_columns(&[b - c, d - c]);
    let perspective = lines.try_inverse()? * (a - b + c - d);
    let (g, h) = (perspective.x, perspective.y);
    let [right, down] = [b - a + g * b, d - a + h * d];
    Some(na::Matrix3::new(right.x, down.x, a.x, right.y, down.y, a.y, g, h, 1.0))
}

/// Returns the levels at a place in an image, between the middles of four pixels.
fn sampled(image: &RgbImage, [x, y]: [f64; 2]) -> [u8; 3] {
    let (width, height) = image.dimensions();
    let inside = |at: f64, side: u32| (at - 0.5).clamp(0.0, f64::from(side.saturating_sub(1))) as f32;
    // Only an image without pixels has no level there.
    interpolate_bilinear(image, inside(x, width), inside(y, height)).map_or([0; 3], |pixel| pixel.0)
}

#[cfg(test)]
mod tests {
    use image::imageops::{flip_horizontal, rotate90};

    use super::*;

    fn window(corners_px: [[f64; 2]; 4], size_px: [usize; 2]) -> GelWindow {
        GelWindow::of(&SensorProfile { corners_px: Some(corners_px), size_px, ..SensorProfile::tacto() }).unwrap()
    }

    /// A gel with a level that says where it is.
    fn level([x, y]: [f64; 2]) -> [f64; 3] {
        [20.0 + 200.0 * x, 20.0 + 200.0 * y, 120.0 + 80.0 * (6.0 * x).sin() * (5.0 * y).cos()]
    }

    #[test]
    fn a_gel_that_is_seen_askew_is_cut_out() {
        let corners = [[60.0, 40.0], [260.0, 80.0], [240.0, 300.0], [20.0, 260.0]];
        let gel_from_image = homography(corners).unwrap().try_inverse().unwrap();
        let image = RgbImage::from_fn(320, 320, |column, row| {
            let place = gel_from_image * na::Vector3::new(f64::from(column) + 0.5, f64::from(row) + 0.5, 1.0);
            Rgb(level([place.x / place.z, place.y / place.z]).map(|level| level.clamp(0.0, 255.0).round() as u8))
        });
        let cut = window(corners, [48, 64]).cut(&image).unwrap();
        assert_eq!(cut.dimensions(), (48, 64));
        for (column, row, pixel) in cut.enumerate_pixels() {
            let right = level([(f64::from(column) + 0.5) / 48.0, (f64::from(row) + 0.5) / 64.0]);
            for (found, right) in pixel.0.iter().zip(right) {
                assert!((f64::from(*found) - right).abs() < 1.6, "({column}, {row}): {found} instead of {right}");
            }
        }
    }

    #[test]
    fn the_order_of_the_corners_turns_and_mirrors() {
        let image = RgbImage::from_fn(48, 64, |column, row| Rgb([(5 * column) as u8, (3 * row) as u8, 7]));
        let corners = [[0.0, 0.0], [48.0, 0.0], [48.0, 64.0], [0.0, 64.0]];
        assert_eq!(window(corners, [48, 64]).cut(&image).unwrap(), image);
        let [a, b, c, d] = corners;
        assert_eq!(window([b, a, d, c], [48, 64]).cut(&image).unwrap(), flip_horizontal(&image));
        assert_eq!(window([d, a, b, c], [64, 48]).cut(&image).unwrap(), rotate90(&image));
        let error = window(corners, [48, 64]).cut(&RgbImage::new(40, 64)).unwrap_err().to_string();
        assert!(error.contains("corners_px") && error.contains("40 x 64"), "{error}");
    }
}
