//! Touch images with their ground truth.
//!
//! Each image shows a press of its own, drawn from (seed, index). No two belong to one slide, so that a split by object
//! is also one by trajectory. Half of the presses follow MidasTouch's protocol for YCB-Slide: the sensor stands on a
//! point of the surface within a few degrees of its normal. The others are like those in a hand: anywhere on the pad,
//! tilted, deeper or lighter.

use std::f64::consts::TAU;

use image::RgbImage;
use mvt_frames::{Gel, Isometry, Object};
use mvt_render::touch::{NoiseKey, TouchFrame};
use mvt_robot::digit::profile::SensorProfile;
use nalgebra::{Translation3, UnitQuaternion, Vector3};
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

use crate::backdrop::{disturb, drift, through_jpeg};
use crate::config::DataConfig;
use crate::objects::{self, PressedSurface};
use crate::sensors::PressSensor;

/// Least and greatest press depth of MidasTouch's protocol, millimetres.
const PROTOCOL_PRESS_MM: [f64; 2] = [0.5, 1.0];
/// Greatest tilt of MidasTouch's protocol (its "shear"), degrees.
const PROTOCOL_SHEAR_DEG: f64 = 5.0;
// Why: notes/decisions/touch.md, "Contact is MidasTouch's: indentation over 0.2 times the depth of the press".
/// Share of the press depth above which MidasTouch counts indentation as contact.
const CONTACT_SHARE: f64 = 0.2;
/// Greatest excess of any other part of the object over the press depth, as a share of it.
const SLACK: f64 = 0.5;
/// Least share of the image in contact. A smaller contact is a sliver at the rim or the back of a wall; MidasTouch's
/// reader drops such images, too.
const LEAST_AREA: f64 = 0.01;
/// The same on sensors like real ones, which see the gel half as large again: a light touch of a small ball.
const LEAST_REAL_AREA: f64 = 0.004;
/// Share of images of such sensors whose untouched image is of another day: light differs in shapes of its own.
const OTHER_DAY: f64 = 0.2;
/// Share of images of such sensors that went through a JPEG file or a video.
const COMPRESSED: f64 = 0.3;
// Why: notes/decisions/touch.md, "Impossible presses are drawn again".
/// Contacts that are drawn before one is used without these checks.
const TRIES: usize = 8;
/// Greatest indentation in the ground truth, millimetres: the gel is not much thicker.
const DEEPEST_MM: f32 = 4.0;

/// Touch image with its ground truth, of the size of its sensor or resized.
#[derive(Debug, Clone, PartialEq)]
pub struct Example {
    /// Rows and columns.
    pub size: [usize; 2],
    /// RGB of each pixel.
    pub levels: Vec<u8>,
    /// RGB of each pixel of the sensor's untouched image, if it is known.
    pub untouched: Option<Vec<u8>>,
    /// Indentation of each pixel, millimetres.
    pub indentation_mm: Vec<f32>,
    /// Share of each pixel that is in contact, 0 to 1.
    pub contact: Vec<f32>,
}

impl Example {
    /// Returns the image.
    pub fn image(&self) -> RgbImage {
        self.picture(&self.levels)
    }

    /// Returns the sensor's untouched image, if it is known.
    pub fn untouched(&self) -> Option<RgbImage> {
        self.untouched.as_ref().map(|levels| self.picture(levels))
    }

    fn picture(&self, levels: &[u8]) -> RgbImage {
        let [rows, columns] = self.size;
        RgbImage::from_fn(columns as u32, rows as u32, |u, v| {
            let at = 3 * (v as usize * columns + u as usize);
            image::Rgb([levels[at], levels[at + 1], levels[at + 2]])
        })
    }
}

/// Pose of an object on the gel.
struct Contact {
    gel_from_object: Isometry<Object, Gel>,
    press_mm: f64,
}

impl Contact {
    fn draw(surface: &PressedSurface, profile: &SensorProfile, config: &DataConfig, rng: &mut ChaCha8Rng) -> Self {
        let follows_protocol = rng.random_bool(config.protocol);
        let ([least, most], tilt_deg, reach) = if follows_protocol {
            (PROTOCOL_PRESS_MM, PROTOCOL_SHEAR_DEG, 0.0)
        } else {
            (config.press_mm, config.tilt_deg, 0.4)
        };
        let press_mm = rng.random_range(least..most);
        let (point, normal) = surface.point(rng);
        // Uniform in the cone's angle, so that small tilts are common; then any roll.
        let tilt = rng.random::<f64>() * tilt_deg.to_radians();
        let towards = rng.random::<f64>() * TAU;
        let facing = Vector3::new(-tilt.cos(), tilt.sin() * towards.cos(), tilt.sin() * towards.sin());
        let normal = Vector3::new(f64::from(normal.x), f64::from(normal.y), f64::from(normal.z));
        let turn = UnitQuaternion::rotation_between(&normal, &facing)
            .unwrap_or_else(|| UnitQuaternion::from_axis_angle(&Vector3::z_axis(), std::f64::consts::PI));
        let roll = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), rng.random::<f64>() * TAU);
        let rotation = roll * turn;
        let mut around_middle = |side: usize| (side as f64 - 1.0) * (0.5 + reach * (2.0 * rng.random::<f64>() - 1.0));
        let [width, height] = profile.size_px;
        let (u, v) = (around_middle(width), around_middle(height));
        let place =
            profile.gel_surface().point(&profile.intrinsics(), u, v).coords() - Vector3::new(press_mm * 1e-3, 0.0, 0.0);
        let moved = place - rotation * Vector3::new(f64::from(point.x), f64::from(point.y), f64::from(point.z));
        let pose = nalgebra::Isometry3::from_parts(Translation3::from(moved), rotation);
        Self { gel_from_object: Isometry::new(pose), press_mm }
    }

    /// Returns the pose, withdrawn from the camera.
    fn withdrawn(&self, millimetres: f64) -> Isometry<Object, Gel> {
        Isometry::<Gel, Gel>::translation(millimetres * 1e-3, 0.0, 0.0) * self.gel_from_object
    }
}

/// Renders the `index`-th image of a seed with one of the sensors.
///
/// # Panics
/// If there are no surfaces or no sensors.
pub fn example(
    surfaces: &[PressedSurface],
    sensors: &[&PressSensor],
    config: &DataConfig,
    (seed, index): (u64, u64),
    frame: &mut TouchFrame,
) -> Example {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(index);
    let sensor = sensors[rng.random_range(0..sensors.len())];
    let [width, height] = sensor.profile().size_px;
    let noise = Some(NoiseKey { seed: seed ^ index, pad: 0, frame: 0 });
    let mut press_mm = 0.0;
    if rng.random_bool(config.untouched) {
        sensor.renderer.render(&surfaces[0].rays, Isometry::translation(1.0, 0.0, 0.0), noise, frame);
    } else {
        let covers_enough = |frame: &TouchFrame, press_mm: f64| {
            let least_mm = contact_threshold_mm(press_mm) as f32;
            let covered = sensor.indentation_mm(frame).filter(|mm| *mm > least_mm).count();
            covered as f64 > if sensor.is_real { LEAST_REAL_AREA } else { LEAST_AREA } * (width * height) as f64
        };
        let may_be_deep = rng.random_bool(config.deep);
        for _ in 0..TRIES {
            let surfaces =
                if config.small > 0.0 && rng.random_bool(config.small) { objects::small() } else { surfaces };
            let surface = &surfaces[rng.random_range(0..surfaces.len())];
            let contact = Contact::draw(surface, sensor.profile(), config, &mut rng);
            press_mm = contact.press_mm;
            sensor.renderer.render(&surface.rays, contact.gel_from_object, noise, frame);
            let excess = sensor.deepest_mm(frame) - press_mm;
            if may_be_deep || (excess < SLACK * press_mm && covers_enough(frame, press_mm)) {
                break;
            }
            // As in MidasTouch, the sensor is withdrawn if another part than the touched point is too deep.
            sensor.renderer.render(&surface.rays, contact.withdrawn(excess), noise, frame);
            // Where a sensor does not fit, for example in a cup, another part may still be too deep.
            if sensor.deepest_mm(frame) < (1.0 + SLACK) * press_mm && covers_enough(frame, press_mm) {
                break;
            }
        }
    }
    let indentation_mm: Vec<f32> = sensor.indentation_mm(frame).map(|mm| mm.min(DEEPEST_MM)).collect();
    let threshold = contact_threshold_mm(press_mm) as f32;
    let contact = if sensor.is_real {
        frame.contact().iter().map(|&touches| f32::from(u8::from(touches))).collect()
    } else {
        indentation_mm.iter().map(|&x| f32::from(u8::from(x > threshold))).collect()
    };
    let mut image: RgbImage = frame.calibrated().clone();
    let untouched = rng.random_bool(config.known_untouched).then(|| {
        let mut untouched = sensor.untouched.clone();
        disturb(&mut untouched, config.background, &mut rng.clone());
        untouched.into_raw()
    });
    disturb(&mut image, config.background, &mut rng);
    if sensor.is_real {
        drift(&mut image, config.drift, &mut rng);
        if rng.random_bool(OTHER_DAY) {
            disturb(&mut image, 1.5 * config.drift, &mut rng);
        }
        if rng.random_bool(COMPRESSED) {
            // An image in memory always has a JPEG; without one it stays as it is.
            image = through_jpeg(&image, rng.random_range(60..=95)).unwrap_or(image);
        }
    }
    Example { size: [height, width], levels: image.into_raw(), untouched, indentation_mm, contact }
}

/// Returns the indentation above which a pixel is in contact: MidasTouch's share of the press depth, which is clamped
/// to the protocol's range, so that the threshold lies between 0.1 and 0.2 mm.
pub fn contact_threshold_mm(press_mm: f64) -> f64 {
    CONTACT_SHARE * press_mm.clamp(PROTOCOL_PRESS_MM[0], PROTOCOL_PRESS_MM[1])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::objects;
    use crate::sensors::Rack;

    #[test]
    fn images_depend_on_seed_and_index_alone() {
        let config = DataConfig { sensors: 2, untouched: 0.0, deep: 0.0, ..DataConfig::default() };
        let surfaces = objects::load(&["mug", "large_dice"]).unwrap();
        let mut rack = Rack::new(&config, &SensorProfile::tacto(), 3).unwrap();
        let sensors = rack.of_step(5).unwrap();
        let mut frame = TouchFrame::default();
        let mut image = |index| example(&surfaces, &sensors, &config, (3, index), &mut frame);
        let (first, second) = (image(0), image(1));
        assert_ne!(first, second);
        let mut again = Rack::new(&config, &SensorProfile::tacto(), 3).unwrap();
        let fresh = example(&surfaces, &again.of_step(5).unwrap(), &config, (3, 0), &mut TouchFrame::default());
        assert_eq!(fresh, first);
        for Example { indentation_mm, contact, .. } in [first, second] {
            let deepest = indentation_mm.iter().copied().fold(0.0, f32::max);
            assert!(deepest > 0.05 && deepest < 3.1, "{deepest} mm");
            assert!(
                contact
                    .iter()
                    .zip(&indentation_mm)
                    .all(|(c, mm)| (*c > 0.5) == (*mm > 0.2) || (0.1..=0.2).contains(mm))
            );
        }
    }
}
