//! Touch images with their truth.
//!
//! Each image is a contact of its own, drawn from (seed, index): no two belong to one slide, so that a split by object is one by
//! trajectory too. Half of them follow MidasTouch's protocol for YCB-Slide (the finger stands on a point of the surface within a few
//! degrees of its normal), the others what happens in a hand (anywhere on the pad, tilted, deeper or lighter).

use std::f64::consts::TAU;

use image::RgbImage;
use mvt_frames::{Gel, Isometry, Object};
use mvt_render::touch::{NoiseKey, TouchFrame};
use mvt_robot::digit::{HEIGHT, WIDTH, gel};
use mvt_settings::{SettingError, Unlimited, settings};
use nalgebra::{Translation3, UnitQuaternion, Vector3};
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

use super::backdrop::disturb;
use super::objects::{Split, Surface};
use super::sensors::Sensor;

settings! {
    /// Distributions of training images. Check [`Split::check`] as well: [`DataConfig::validate`] does not look up the objects.
    pub struct DataConfig {
        /// Objects that are pressed.
        #[serde(skip_serializing_if = "Split::is_published")]
        pub objects: Split;
        /// Share of images without contact.
        pub untouched: f64 = 0.06, 0.0..=1.0;
        /// Share of the images with contact that follow MidasTouch's protocol.
        pub protocol: f64 = 0.5, 0.0..=1.0;
        /// Share of contacts in which the finger is not withdrawn if another part of the object is deeper than the press depth: an edge
        /// beside the touched point may be as deep as the object allows.
        pub deep: f64 = 0.04, 0.0..=1.0;
        /// Least and greatest press depth beyond the protocol, millimetres.
        pub press_mm: [f64; 2] = [0.1, 2.0], 1e-6..=5.0;
        /// Greatest tilt beyond the protocol, degrees.
        pub tilt_deg: f64 = 30.0, 0.0..=80.0;
        /// Share of sensors whose lights differ from their calibration.
        pub disturbed_lights: f64 = 0.6, 0.0..=1.0;
        /// Size of that difference, in units of MidasTouch's distribution.
        pub light_strength: f64 = 1.0, 0.0..=10.0;
        /// Least and greatest standard deviation of the image noise, grey levels.
        pub noise: [f32; 2] = [1.5, 3.0], 1e-6..=28.0;
        /// Greatest height of each shape of light that is added to a background, grey levels.
        pub background: f32 = 12.0, 0.0..=100.0;
        /// Share of images of sensors whose untouched image is known.
        pub known_untouched: f64 = 0.75, 0.0..=1.0;
        /// Sensors in use at a time. Each step replaces one of them.
        pub sensors: usize = 24, 1..=1000;
    }
    rule = ranges_rise;
}

fn ranges_rise(config: &DataConfig) -> Result<(), SettingError> {
    let ([least_mm, most_mm], [quiet, loud]) = (config.press_mm, config.noise);
    // Press depths are drawn below the greatest, so that the two must differ.
    if least_mm >= most_mm {
        return Err(SettingError::new("press_mm", format!("[{least_mm}, {most_mm}]"), "a least and a greater value"));
    }
    if quiet > loud {
        return Err(SettingError::new("noise", format!("[{quiet}, {loud}]"), "a least and a greatest value"));
    }
    Ok(())
}

impl Unlimited for Split {}

/// MidasTouch's press depth, from and to, millimetres, and shear, degrees.
const PROTOCOL_PRESS_MM: [f64; 2] = [0.5, 1.0];
const PROTOCOL_SHEAR_DEG: f64 = 5.0;
/// MidasTouch counts indentation over this share of the press depth as contact.
const CONTACT_SHARE: f64 = 0.2;
/// How much deeper than the press depth, as a share of it, anything else may be.
const SLACK: f64 = 0.5;
/// A contact of a smaller share of the image is a sliver at its rim or the back of a wall; MidasTouch's reader drops such images, too.
const LEAST_AREA: f64 = 0.01;
/// Contacts that are drawn before one is taken as it is.
const TRIES: usize = 8;
/// Indentation that a network is taught at most, millimetres: the gel is not much thicker.
const DEEPEST_MM: f32 = 4.0;

impl DataConfig {
    /// MidasTouch's protocol for YCB-Slide and nothing else, on sensors with the lights they were calibrated with.
    pub fn protocol() -> Self {
        Self {
            untouched: 0.0,
            protocol: 1.0,
            deep: 0.0,
            disturbed_lights: 0.0,
            noise: [2.0, 2.0],
            background: 0.0,
            known_untouched: 1.0,
            ..Self::default()
        }
    }
}

/// A touch image with what it shows, of 320 rows and 240 columns or a whole fraction of that.
#[derive(Debug, Clone, PartialEq)]
pub struct Example {
    /// Rows and columns.
    pub size: [usize; 2],
    /// RGB of each pixel.
    pub levels: Vec<u8>,
    /// The same of the sensor without contact, if that is known.
    pub untouched: Option<Vec<u8>>,
    /// Indentation over the empty gel, millimetres.
    pub indentation_mm: Vec<f32>,
    /// How much of each pixel is in contact.
    pub contact: Vec<f32>,
}

impl Example {
    /// Its image.
    pub fn image(&self) -> RgbImage {
        self.picture(&self.levels)
    }

    /// The image of its sensor without contact, if that is known.
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

/// How an object lies on the gel.
struct Contact {
    gel_from_object: Isometry<Object, Gel>,
    press_mm: f64,
}

impl Contact {
    fn draw(surface: &Surface, config: &DataConfig, rng: &mut ChaCha8Rng) -> Self {
        let follows_protocol = rng.random_bool(config.protocol);
        let ([least, most], tilt_deg, reach) = if follows_protocol {
            (PROTOCOL_PRESS_MM, PROTOCOL_SHEAR_DEG, 0.0)
        } else {
            (config.press_mm, config.tilt_deg, 0.4)
        };
        let press_mm = rng.random_range(least..most);
        let (point, normal) = surface.point(rng);
        // Evenly over the cone's angle, so that small tilts are common; then any roll.
        let tilt = rng.random::<f64>() * tilt_deg.to_radians();
        let towards = rng.random::<f64>() * TAU;
        let facing = Vector3::new(-tilt.cos(), tilt.sin() * towards.cos(), tilt.sin() * towards.sin());
        let normal = Vector3::new(f64::from(normal.x), f64::from(normal.y), f64::from(normal.z));
        let turn = UnitQuaternion::rotation_between(&normal, &facing)
            .unwrap_or_else(|| UnitQuaternion::from_axis_angle(&Vector3::z_axis(), std::f64::consts::PI));
        let roll = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), rng.random::<f64>() * TAU);
        let rotation = roll * turn;
        let mut around_middle = |side: usize| (side as f64 - 1.0) * (0.5 + reach * (2.0 * rng.random::<f64>() - 1.0));
        let (u, v) = (around_middle(WIDTH), around_middle(HEIGHT));
        let place = gel::point(u, v).coords() - Vector3::new(press_mm * 1e-3, 0.0, 0.0);
        let moved = place - rotation * Vector3::new(f64::from(point.x), f64::from(point.y), f64::from(point.z));
        let pose = nalgebra::Isometry3::from_parts(Translation3::from(moved), rotation);
        Self { gel_from_object: Isometry::new(pose), press_mm }
    }

    /// The same, farther from the camera.
    fn withdrawn(&self, millimetres: f64) -> Isometry<Object, Gel> {
        Isometry::<Gel, Gel>::translation(millimetres * 1e-3, 0.0, 0.0) * self.gel_from_object
    }
}

/// Renders the `index`-th image of a seed with one of the sensors.
pub fn example(
    surfaces: &[Surface],
    sensors: &[&Sensor],
    config: &DataConfig,
    (seed, index): (u64, u64),
    frame: &mut TouchFrame,
) -> Example {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(index);
    let sensor = sensors[rng.random_range(0..sensors.len())];
    let noise = Some(NoiseKey { seed: seed ^ index, finger: 0, frame: 0 });
    let mut press_mm = 0.0;
    if rng.random_bool(config.untouched) {
        sensor.renderer.render(&surfaces[0].rays, Isometry::translation(1.0, 0.0, 0.0), noise, frame);
    } else {
        let covers_enough = |frame: &TouchFrame, press_mm: f64| {
            let least_mm = contact_threshold_mm(press_mm) as f32;
            let covered = sensor.indentation_mm(frame).filter(|mm| *mm > least_mm).count();
            covered as f64 > LEAST_AREA * (WIDTH * HEIGHT) as f64
        };
        let may_be_deep = rng.random_bool(config.deep);
        for _ in 0..TRIES {
            let surface = &surfaces[rng.random_range(0..surfaces.len())];
            let contact = Contact::draw(surface, config, &mut rng);
            press_mm = contact.press_mm;
            sensor.renderer.render(&surface.rays, contact.gel_from_object, noise, frame);
            let excess = sensor.deepest_mm(frame) - press_mm;
            if may_be_deep || (excess < SLACK * press_mm && covers_enough(frame, press_mm)) {
                break;
            }
            // As MidasTouch does: where something else than the touched point is too deep, the finger is drawn back.
            sensor.renderer.render(&surface.rays, contact.withdrawn(excess), noise, frame);
            // Where a finger does not fit, in a cup say, something is still too deep.
            if sensor.deepest_mm(frame) < (1.0 + SLACK) * press_mm && covers_enough(frame, press_mm) {
                break;
            }
        }
    }
    let indentation_mm: Vec<f32> = sensor.indentation_mm(frame).map(|mm| mm.min(DEEPEST_MM)).collect();
    let threshold = contact_threshold_mm(press_mm) as f32;
    let contact = indentation_mm.iter().map(|&x| f32::from(u8::from(x > threshold))).collect();
    let mut image: RgbImage = frame.calibrated().clone();
    let untouched = rng.random_bool(config.known_untouched).then(|| {
        let mut untouched = sensor.untouched.clone();
        disturb(&mut untouched, config.background, &mut rng.clone());
        untouched.into_raw()
    });
    disturb(&mut image, config.background, &mut rng);
    Example { size: [HEIGHT, WIDTH], levels: image.into_raw(), untouched, indentation_mm, contact }
}

/// From which indentation on a pixel is in contact: MidasTouch's share of the press depth, which is taken to be within the protocol's
/// range, so that the threshold lies between 0.1 and 0.2 mm.
pub fn contact_threshold_mm(press_mm: f64) -> f64 {
    CONTACT_SHARE * press_mm.clamp(PROTOCOL_PRESS_MM[0], PROTOCOL_PRESS_MM[1])
}

#[cfg(test)]
mod tests {
    use super::super::objects;
    use super::super::sensors::Rack;
    use super::*;

    #[test]
    fn images_depend_on_seed_and_index_alone() {
        let config = DataConfig { sensors: 2, untouched: 0.0, deep: 0.0, ..DataConfig::default() };
        let surfaces = objects::load(&["mug", "large_dice"]).unwrap();
        let mut rack = Rack::new(&config, 3).unwrap();
        let sensors = rack.of_step(5).unwrap();
        let mut frame = TouchFrame::default();
        let mut image = |index| example(&surfaces, &sensors, &config, (3, index), &mut frame);
        let (first, second) = (image(0), image(1));
        assert_ne!(first, second);
        let mut again = Rack::new(&config, 3).unwrap();
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
