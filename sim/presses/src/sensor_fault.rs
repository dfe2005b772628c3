//! What is wrong with the images of a sensor in use: light, camera, mounts, and things that are no presses.

use image::imageops::{flip_horizontal, rotate180};
use image::{Rgb, RgbImage};
use rand::RngExt as _;
use rand_chacha::ChaCha8Rng;
use serde::Serialize;

use crate::backdrop::grey_level;

/// A fault of a sensor or of its images.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum SensorFault {
    /// Light of this strength, 1 as usual.
    Light(f32),
    /// Another response of the camera: levels to the power of this.
    Gamma(f32),
    /// Levels lie between these two, grey levels.
    Range([f32; 2]),
    /// Strength of each colour: an LED that is weak or dead, another white balance.
    Colours([f32; 3]),
    /// Exposure of the images, relative to the untouched one.
    Exposure(f32),
    /// Red and blue exchanged.
    Swapped,
    /// Left and right exchanged.
    Mirrored,
    /// On its head.
    Turned,
    /// The last share of the rows is missing, as in a file that was cut off.
    Cut(f32),
    /// Light of this colour and many grey levels falls in from this side: 0 left, 1 right.
    Stray([f32; 3], f32),
    /// The untouched image shows a press.
    TouchedUntouched,
}

impl SensorFault {
    /// Draws a fault.
    pub fn draw(rng: &mut ChaCha8Rng) -> Self {
        let between = |rng: &mut ChaCha8Rng, low: f32, high: f32| rng.random_range(low..high);
        let around = |rng: &mut ChaCha8Rng, low: f32, high: f32| between(rng, low.ln(), high.ln()).exp();
        match rng.random_range(0..11) {
            0 => Self::Light(around(rng, 0.15, 2.0)),
            1 => Self::Gamma(around(rng, 0.45, 2.2)),
            2 => Self::Range([between(rng, 0.0, 64.0), between(rng, 180.0, 255.0)]),
            3 => {
                let mut strength = [1.0; 3];
                strength[rng.random_range(0..3)] = between(rng, 0.03, 0.7);
                Self::Colours(strength)
            }
            4 => Self::Exposure(around(rng, 0.8, 1.25)),
            5 => Self::Mirrored,
            6 => Self::Turned,
            7 => Self::Cut(between(rng, 0.2, 0.6)),
            8 => {
                let colour = std::array::from_fn(|_| between(rng, 10.0, 90.0));
                Self::Stray(colour, if rng.random_bool(0.5) { 1.0 } else { 0.0 })
            }
            9 => Self::Swapped,
            _ => Self::TouchedUntouched,
        }
    }

    /// Applies the fault to an image and the untouched image. `other` is another image of the sensor, with a press. Returns whether pixels are
    /// where they were: where they are not, nothing is told by a comparison with the truth.
    pub fn apply(self, image: &mut RgbImage, untouched: &mut RgbImage, other: &RgbImage) -> bool {
        let levels = |image: &mut RgbImage, map: &dyn Fn(f32, usize) -> f32| {
            for pixel in image.pixels_mut() {
                for (c, level) in pixel.0.iter_mut().enumerate() {
                    *level = grey_level(map(f32::from(*level), c));
                }
            }
        };
        let both = |image: &mut RgbImage, untouched: &mut RgbImage, map: &dyn Fn(f32, usize) -> f32| {
            levels(image, map);
            levels(untouched, map);
        };
        match self {
            Self::Light(strength) => both(image, untouched, &|level, _| strength * level),
            Self::Gamma(power) => both(image, untouched, &|level, _| 255.0 * (level / 255.0).powf(power)),
            Self::Range([low, high]) => both(image, untouched, &|level, _| low + (high - low) * level / 255.0),
            Self::Colours(strength) => both(image, untouched, &|level, c| strength[c] * level),
            Self::Exposure(ratio) => levels(image, &|level, _| ratio * level),
            Self::Swapped => {
                for image in [image, untouched] {
                    image.pixels_mut().for_each(|pixel| pixel.0.swap(0, 2));
                }
            }
            Self::Mirrored => {
                *image = flip_horizontal(image);
                *untouched = flip_horizontal(untouched);
                return false;
            }
            Self::Turned => {
                *image = rotate180(image);
                *untouched = rotate180(untouched);
                return false;
            }
            Self::Cut(share) => {
                let left = ((1.0 - share) * image.height() as f32) as u32;
                image.enumerate_pixels_mut().filter(|(_, v, _)| *v >= left).for_each(|(_, _, p)| *p = Rgb([0; 3]));
            }
            Self::Stray(colour, side) => {
                let width = image.width().max(1) as f32;
                for (u, _, pixel) in image.enumerate_pixels_mut() {
                    let share = (-2.0 * (u as f32 / width - side).abs()).exp();
                    for (level, added) in pixel.0.iter_mut().zip(colour) {
                        *level = grey_level(f32::from(*level) + share * added);
                    }
                }
            }
            Self::TouchedUntouched => untouched.clone_from(other),
        }
        true
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng as _;

    use super::*;

    #[test]
    fn every_fault_changes_an_image_or_its_untouched_one() {
        let image = RgbImage::from_fn(24, 32, |u, v| Rgb([90 + u as u8, 80 + v as u8, 100]));
        let other = RgbImage::from_pixel(24, 32, Rgb([140, 60, 30]));
        let mut rng = ChaCha8Rng::seed_from_u64(4);
        let mut kinds = std::collections::BTreeSet::new();
        for _ in 0..200 {
            let fault = SensorFault::draw(&mut rng);
            let (mut seen, mut untouched) = (image.clone(), image.clone());
            fault.apply(&mut seen, &mut untouched, &other);
            assert!(seen != image || untouched != image, "{fault:?}");
            kinds.insert(format!("{fault:?}").split(['(', ' ']).next().map(str::to_owned));
        }
        assert_eq!(kinds.len(), 11);
    }
}
