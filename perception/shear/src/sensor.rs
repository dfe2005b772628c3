//! A sensor whose gel carries dots.

use image::RgbImage;
use mvt_frames::camera::Intrinsics;
use mvt_robot::digit::gel::GelSurface;
use mvt_robot::digit::profile::SensorProfile;
use ndarray::Array2;

use crate::dots::DotFinder;
use crate::fit::{ShearFit, fit};
use crate::matching::{follow, nearest};

/// Reason that shear cannot be seen.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ShearError {
    /// The sensor has no dots.
    #[error("the gel of this sensor has no dots, so that its shear cannot be seen; choose a profile with markers")]
    NoMarkers,
    /// The untouched image does not show the dots of the profile.
    #[error(
        "the untouched image shows {found} of the {expected} dots of the profile; choose the profile of this sensor, or give its untouched image"
    )]
    Unmarked {
        /// Dots that were found.
        found: usize,
        /// Dots of the profile that are in view.
        expected: usize,
    },
    /// An image does not show the dots of the untouched image.
    #[error("the image shows {found} of the {expected} dots of the untouched image")]
    Lost {
        /// Dots that were found again.
        found: usize,
        /// Dots of the untouched image.
        expected: usize,
    },
    /// An image has another size.
    #[error("the image is {width} x {height} pixels; {} x {} are expected", expected[0], expected[1])]
    Size {
        /// Width and height of the sensor's images, pixels.
        expected: [usize; 2],
        /// Width, pixels.
        width: u32,
        /// Height, pixels.
        height: u32,
    },
}

/// Motion of one dot.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DotMotion {
    /// Place in the untouched image, column and row.
    pub untouched_px: [f64; 2],
    /// Place now, column and row.
    pub now_px: [f64; 2],
    /// Motion along the gel, millimetres to the right and downwards.
    pub moved_mm: [f64; 2],
}

/// Motion of the dots of one image, and what explains it.
#[derive(Debug, Clone, PartialEq)]
pub struct ShearField {
    /// The dots that were found again.
    pub dots: Vec<DotMotion>,
    /// What explains their motion; `None` without contact.
    pub fit: Option<ShearFit>,
}

/// Sensor whose gel carries dots.
#[derive(Debug, Clone)]
pub struct ShearSensor {
    camera: Intrinsics,
    gel: GelSurface,
    finder: DotFinder,
    /// Dots of the untouched image, pixels.
    untouched: Vec<[f64; 2]>,
}

/// Share of a dot's darkness that its image must show: blur spreads the rest.
const SHOWN: f32 = 0.3;
/// Share of the dots of a profile that an untouched image must show, and at most so many times their number.
const FOUND: [f64; 2] = [0.7, 1.3];
/// Share of the untouched dots that an image must show: a deep press hides some.
const FOUND_AGAIN: f64 = 0.5;
/// Times that dots are assigned anew by the prediction of the fit.
const CHECKS: usize = 2;
/// Distance from there at which a dot is still the same, in pitches.
const OFF: f64 = 0.3;

impl ShearSensor {
    /// Finds the dots of a sensor's untouched image.
    ///
    /// # Errors
    /// [`ShearError`] if the profile has no dots, or the image does not show them.
    pub fn new(profile: &SensorProfile, untouched: &RgbImage) -> Result<Self, ShearError> {
        let pattern = profile.markers.ok_or(ShearError::NoMarkers)?;
        let (camera, gel) = (profile.intrinsics(), profile.gel_surface());
        check(untouched, &camera)?;
        let px_per_mm = gel.pixel(&camera, [1.0, 0.0])[0] - camera.cx;
        let finder = DotFinder {
            radius_px: 0.5 * pattern.diameter_mm * px_per_mm,
            pitch_px: pattern.pitch_mm * px_per_mm,
            least_darkness: SHOWN * pattern.darkness,
        };
        let is_in_view = |place: &[f64; 2]| {
            let [u, v] = gel.pixel(&camera, *place);
            let rim = 0.5 * finder.pitch_px;
            u > rim && v > rim && u < camera.width as f64 - rim && v < camera.height as f64 - rim
        };
        let expected = pattern.places_mm().filter(is_in_view).count();
        let untouched = finder.find(untouched);
        let share = untouched.len() as f64 / expected.max(1) as f64;
        if !(FOUND[0]..=FOUND[1]).contains(&share) {
            return Err(ShearError::Unmarked { found: untouched.len(), expected });
        }
        Ok(Self { camera, gel, finder, untouched })
    }

    /// Follows the dots into an image, and fits shear where the object touches. Both arrays have a value per pixel; indentation is in
    /// millimetres.
    ///
    /// # Errors
    /// [`ShearError`] if the image has another size or does not show the dots.
    pub fn see(
        &self,
        image: &RgbImage,
        contact: &Array2<bool>,
        indentation_mm: &Array2<f32>,
    ) -> Result<ShearField, ShearError> {
        check(image, &self.camera)?;
        let place_mm = |pixel: [f64; 2]| self.gel.place_mm(&self.camera, pixel);
        let pressed = self.untouched.iter().filter_map(|dot| {
            let at = (dot[1].round() as usize, dot[0].round() as usize);
            contact.get(at).filter(|touches| **touches)?;
            Some((place_mm(*dot), f64::from(*indentation_mm.get(at)?)))
        });
        let pressed: Vec<_> = pressed.collect();
        let centre = middle(contact);
        let seen = self.finder.find(image);
        let explained = |found: &[Option<[f64; 2]>]| {
            let pairs =
                self.untouched.iter().zip(found).filter_map(|(from, to)| Some((place_mm(*from), place_mm((*to)?))));
            centre.map(|centre| fit(&pairs.collect::<Vec<_>>(), place_mm(centre), &pressed))
        };
        let mut found = follow(&self.untouched, &seen, centre, self.finder.pitch_px);
        let mut fit = explained(&found);
        for _ in 0..CHECKS {
            // The fit tells which dots were taken for their neighbours.
            let Some(motion) = fit.map(|fit| fit.motion(&pressed)) else { break };
            let expected = |dot: &[f64; 2]| self.gel.pixel(&self.camera, motion.moved(place_mm(*dot)));
            let expected: Vec<_> = self.untouched.iter().map(expected).collect();
            found = nearest(&expected, &seen, OFF * self.finder.pitch_px);
            fit = explained(&found);
        }
        let dots: Vec<DotMotion> = self
            .untouched
            .iter()
            .zip(found)
            .filter_map(|(untouched_px, now_px)| {
                let (from, to) = (place_mm(*untouched_px), place_mm(now_px?));
                let moved_mm = [to[0] - from[0], to[1] - from[1]];
                Some(DotMotion { untouched_px: *untouched_px, now_px: now_px?, moved_mm })
            })
            .collect();
        if (dots.len() as f64) < FOUND_AGAIN * self.untouched.len() as f64 {
            return Err(ShearError::Lost { found: dots.len(), expected: self.untouched.len() });
        }
        Ok(ShearField { dots, fit })
    }

    /// Returns an image in which the colours around the dots fill them.
    pub fn erased(&self, image: &RgbImage) -> RgbImage {
        // Why: notes/decisions/touch.md, "A network never sees dots".
        let mut erased = image.clone();
        self.finder.erase(&self.finder.find(image), &mut erased);
        erased
    }
}

fn check(image: &RgbImage, camera: &Intrinsics) -> Result<(), ShearError> {
    let ((width, height), expected) = (image.dimensions(), [camera.width, camera.height]);
    let is_same = [width as usize, height as usize] == expected;
    if is_same { Ok(()) } else { Err(ShearError::Size { expected, width, height }) }
}

/// Returns the middle of a contact, column and row.
fn middle(contact: &Array2<bool>) -> Option<[f64; 2]> {
    let (mut count, mut sums) = (0.0, [0.0; 2]);
    for ((v, u), _) in contact.indexed_iter().filter(|(_, touches)| **touches) {
        count += 1.0;
        sums = [sums[0] + u as f64, sums[1] + v as f64];
    }
    (count > 0.0).then(|| sums.map(|sum| sum / count))
}
