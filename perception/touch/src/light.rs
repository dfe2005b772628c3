//! The light of a sensor and the response of its camera, as its untouched image shows them, and their change since.
//!
//! A press changes an image in proportion to the light, and by the slope of the camera's response. Half the light, another gamma, a limited
//! range of levels or an LED that has grown weak therefore change what the same press shows. The untouched image shows each of them: its mean
//! levels are others, or its contrast is.

use image::RgbImage;
use mvt_robot::digit::profile::Appearance;

use crate::untouched::{EVEN, Squares, squares};

/// Light counts as usual up to this share of difference. DIGITs differ by 0.08.
const USUAL_SPREAD: f32 = 0.12;
/// A response counts as usual up to this share of difference. Images of one DIGIT on two days differ by 0.24.
const USUAL_RESPONSE: f32 = 0.35;
/// Gains from the first of these on make an image less plausible, and from the second on not at all: noise and steps of the levels grow, too.
const MOST_GAIN: [f32; 2] = [7.0, 12.0];
/// Exponents beyond these are no response of a camera: the image shows something else.
const RESPONSES: [f32; 2] = [0.25, 4.0];
/// Squares that are darker show no contrast, grey levels.
const DARK: f32 = 4.0;
/// A colour with a lower mean is missing: its LED is dead.
const DEAD: f32 = 12.0;
/// Share of the squares of an image that shows the present exposure, and how far their ratios to the untouched image may lie apart.
const STEADY: (f32, f32) = (0.25, 0.04);
/// Exposure is followed within these ratios; beyond them an image is another sensor's.
const EXPOSURES: [f32; 2] = [0.6, 1.6];

/// How the levels of a sensor become those of the sensors for which its network was trained.
#[derive(Debug, Clone, PartialEq)]
pub struct SensorLight {
    /// Levels to the power of this grow as those of the usual camera do; 1 for a usual response.
    exponent: f32,
    /// Multiply the change of red, green and blue, after that.
    gains: [f32; 3],
    /// Red, green and blue light as shares of the usual.
    light: [f32; 3],
    /// For each level of a camera that of the usual one.
    levels: Box<[f32; 256]>,
}

impl SensorLight {
    /// A sensor whose gains for red, green and blue are known: it was calibrated, or is as those for which its network was trained.
    pub fn known(gains: [f32; 3]) -> Self {
        Self { exponent: 1.0, gains, light: [1.0; 3], levels: Box::new(std::array::from_fn(|level| level as f32)) }
    }

    /// Returns the light that an untouched image shows, beside that of the usual sensor of this look. Without `follows_response` the
    /// camera's response is taken to be the usual one, and light that is nearly usual to be usual.
    pub fn of(untouched: &RgbImage, usual: &Appearance, follows_response: bool) -> Self {
        let squares = squares(untouched);
        let lit = |levels: [f32; 3]| levels.map(|level| level >= DEAD);
        let found = mean(&squares);
        let light = std::array::from_fn(|c| found[c].max(1.0) / usual.untouched_levels[c]);
        let contrast = contrast(&squares, lit(found));
        let is_known = follows_response && contrast > 0.0 && usual.untouched_contrast > 0.0;
        let exponent = Some(usual.untouched_contrast / contrast).filter(|_| is_known);
        let exponent = exponent.filter(|exponent| (RESPONSES[0]..=RESPONSES[1]).contains(exponent)).unwrap_or(1.0);
        let levels: [f32; 256] = std::array::from_fn(|level| 255.0 * (level as f32 / 255.0).powf(exponent));
        let found = if exponent == 1.0 {
            found
        } else {
            let mapped: Squares = squares.iter().map(|rgb| rgb.map(|x| 255.0 * (x / 255.0).powf(exponent))).collect();
            mean(&mapped)
        };
        let gains = std::array::from_fn(|c| usual.untouched_levels[c] / found[c].max(1.0));
        let known = Self { exponent, gains, light, levels: Box::new(levels) };
        if known.is_usual() && !follows_response { Self { gains: [1.0; 3], ..known } } else { known }
    }

    /// Returns whether light and response are those of usual sensors.
    pub fn is_usual(&self) -> bool {
        let is_like = |ratio: f32, spread: f32| (ratio - 1.0).abs() <= spread;
        self.light.iter().all(|&share| is_like(share, USUAL_SPREAD)) && is_like(self.exponent, USUAL_RESPONSE)
    }

    /// Returns from 0 to 1 how far images under this light can be read.
    pub fn plausibility(&self) -> f32 {
        let greatest = self.gains.into_iter().fold(0.0, f32::max);
        ((MOST_GAIN[1] - greatest) / (MOST_GAIN[1] - MOST_GAIN[0])).clamp(0.0, 1.0)
    }

    /// Returns how unusual response and light are: the absolute logarithm of the exponent, and the greatest of those of the gains.
    pub(crate) fn unusual(&self) -> [f32; 2] {
        [self.exponent.ln().abs(), self.gains.into_iter().map(|gain| gain.ln().abs()).fold(0.0, f32::max)]
    }

    /// Returns the greatest gain of a colour.
    pub fn greatest_gain(&self) -> f32 {
        self.gains.into_iter().fold(1.0, f32::max)
    }

    /// Writes the change from the untouched image, as the network sees it, around [`EVEN`]. `exposure` is that of the image, relative to
    /// the untouched one. All images have one size.
    pub fn change(&self, image: &RgbImage, untouched: &RgbImage, exposure: [f32; 3], to: &mut RgbImage) {
        let even = f32::from(EVEN);
        let shares = exposure.map(|ratio| ratio.powf(-self.exponent));
        let pixels = image.as_chunks::<3>().0.iter().zip(untouched.as_chunks::<3>().0);
        for ((image, untouched), to) in pixels.zip(to.as_chunks_mut::<3>().0) {
            for c in 0..3 {
                let [level, empty] = [image[c], untouched[c]].map(|level| self.levels[usize::from(level)]);
                let grey = (even + self.gains[c] * (shares[c] * level - empty)).clamp(0.0, 255.0);
                // Rounds; `f32::round` is a call of a function where the CPU need not have the instruction.
                to[c] = grey as u8 + u8::from(grey - f32::from(grey as u8) >= 0.5);
            }
        }
    }
}

impl std::fmt::Display for SensorLight {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let [red, green, blue] = self.light;
        write!(f, "the untouched image has {red:.2}, {green:.2} and {blue:.2} of the usual red, green and blue light")?;
        if (self.exponent - 1.0).abs() > USUAL_RESPONSE {
            write!(f, " and {:.2} of the usual contrast", 1.0 / self.exponent)?;
        }
        f.write_str(
            "; the change of the images is scaled to match, which `mambavitact touch calibrate` does more exactly",
        )
    }
}

/// Returns the exposure of each colour of an image relative to the untouched one: the ratio of levels that most of the gel shows. 1 where the
/// ratios of no quarter of the gel agree, as under a contact that covers the view. Both images have one size.
pub fn exposure(image: &RgbImage, untouched: &RgbImage) -> [f32; 3] {
    exposure_of(&squares(image), &squares(untouched))
}

/// The same from the mean colours of squares.
pub(crate) fn exposure_of(image: &Squares, untouched: &Squares) -> [f32; 3] {
    std::array::from_fn(|c| {
        let mut ratios: Vec<f32> =
            image.iter().zip(untouched).filter(|(_, b)| b[c] >= DEAD).map(|(a, b)| a[c] / b[c]).collect();
        ratios.sort_unstable_by(f32::total_cmp);
        let window = (STEADY.0 * image.len() as f32) as usize;
        let width = |at: usize| ratios[at + window] - ratios[at];
        let densest = (0..ratios.len().saturating_sub(window)).min_by(|&a, &b| width(a).total_cmp(&width(b)));
        let steady = densest.filter(|&at| window > 0 && width(at) <= STEADY.1).map(|at| ratios[at + window / 2]);
        steady.filter(|ratio| (EXPOSURES[0]..=EXPOSURES[1]).contains(ratio)).unwrap_or(1.0)
    })
}

fn mean(squares: &Squares) -> [f32; 3] {
    let count = squares.len().max(1) as f32;
    std::array::from_fn(|c| squares.iter().map(|rgb| rgb[c]).sum::<f32>() / count)
}

/// Mean over the colours that are lit of the standard deviation of the logarithm of levels; 0 if none is.
fn contrast(squares: &Squares, lit: [bool; 3]) -> f32 {
    let of_colour = |c: usize| {
        let logs = || squares.iter().map(move |rgb| rgb[c].max(DARK).ln());
        let count = squares.len().max(1) as f32;
        let mean = logs().sum::<f32>() / count;
        (logs().map(|log| (log - mean).powi(2)).sum::<f32>() / count).sqrt()
    };
    let count = lit.iter().filter(|lit| **lit).count();
    (0..3).filter(|&c| lit[c]).map(of_colour).sum::<f32>() / count.max(1) as f32
}

#[cfg(test)]
mod tests {
    use image::Rgb;
    use proptest::prelude::*;

    use super::*;

    const USUAL: fn() -> Appearance = Appearance::default;

    /// Light that falls from the left, with the usual means and contrast.
    fn sensor() -> RgbImage {
        RgbImage::from_fn(240, 320, |u, _| {
            let share = 0.45 + 1.1 * (1.0 - f64::from(u) / 239.0);
            Rgb([97.0, 101.0, 95.0].map(|mean: f64| (mean * share).round() as u8))
        })
    }

    fn mapped(image: &RgbImage, map: impl Fn(f32) -> f32) -> RgbImage {
        let mut image = image.clone();
        image.iter_mut().for_each(|level| *level = map(f32::from(*level)).round().clamp(0.0, 255.0) as u8);
        image
    }

    #[test]
    fn the_light_of_a_sensor_is_that_of_each_colour() {
        let image = |light: [f32; 3]| {
            RgbImage::from_pixel(32, 32, Rgb(std::array::from_fn(|c| (light[c] * USUAL().untouched_levels[c]) as u8)))
        };
        let of = |light| SensorLight::of(&image(light), &USUAL(), false);
        for usual in [[1.0; 3], [0.9, 1.1, 1.0]] {
            assert!(of(usual).is_usual());
            assert_eq!(of(usual).gains, [1.0; 3]);
        }
        for (light, gains) in [([0.5; 3], [2.0; 3]), ([1.4; 3], [0.71; 3]), ([1.0, 0.4, 1.0], [1.0, 2.5, 1.0])] {
            let found = of(light);
            assert!(!found.is_usual());
            assert!(found.gains.iter().zip(gains).all(|(a, b)| (a / b - 1.0).abs() < 0.03), "{light:?}: {found:?}");
            assert_eq!(found.plausibility(), 1.0);
        }
        assert_eq!(of([0.03; 3]).plausibility(), 0.0);
    }

    proptest! {
        /// The network sees the same change through any camera.
        #[test]
        fn a_change_is_the_same_through_any_response(gamma in 0.5_f32..2.0, light in 0.4_f32..1.2, change in -25_i16..25) {
            let untouched = sensor();
            let touched = mapped(&untouched, |level| level + f32::from(change));
            let seen = |map: &dyn Fn(f32) -> f32| {
                let (image, untouched) = (mapped(&touched, map), mapped(&untouched, map));
                let mut seen = image.clone();
                SensorLight::of(&untouched, &USUAL(), true).change(&image, &untouched, [1.0; 3], &mut seen);
                seen
            };
            let (plain, through) = (seen(&|x| x), seen(&|x| light * 255.0 * (x / 255.0).powf(gamma)));
            for (a, b) in plain.iter().zip(through.iter()).step_by(97) {
                let [a, b] = [a, b].map(|level| f32::from(*level) - f32::from(EVEN));
                // Levels are whole numbers, which the curve stretches where it is flat.
                prop_assert!((a - b).abs() < 4.0 + 0.15 * a.abs(), "{a} and {b} grey levels");
            }
        }

        #[test]
        fn exposure_is_found_beside_a_press(ratio in 0.7_f32..1.4, left in 0_u32..120) {
            let untouched = mapped(&sensor(), |level| 0.7 * level);
            let mut image = mapped(&untouched, |level| ratio * level);
            for (u, v, pixel) in image.enumerate_pixels_mut() {
                if (left..left + 100).contains(&u) && v < 250 {
                    pixel.0[0] = pixel.0[0].saturating_add(40);
                }
            }
            let found = exposure(&image, &untouched);
            prop_assert!(found.iter().all(|found| (found / ratio - 1.0).abs() < 0.03), "{found:?} instead of {ratio}");
        }
    }

    #[test]
    fn another_sensor_has_no_exposure() {
        let stripes = RgbImage::from_fn(240, 320, |u, v| Rgb([(30 + (u * 7 + v * 13) % 200) as u8, 40, 90]));
        assert_eq!(exposure(&stripes, &RgbImage::from_pixel(240, 320, Rgb([97, 101, 20])))[2], 1.0);
        assert_eq!(exposure(&RgbImage::new(8, 8), &RgbImage::new(8, 8)), [1.0; 3]);
    }
}
