//! Settings of random presses.

use mvt_settings::{SettingError, Unlimited, settings};

use crate::objects::Split;

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
        /// Share of contacts in which the sensor is not withdrawn if another part of the object is deeper than the press depth: an edge
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
        /// Share of sensors that are drawn like real DIGITs: view, gel, lights, response and blur differ from one to the next. On them a
        /// pixel is in contact where the object lies on the gel.
        #[serde(skip_serializing_if = "is_zero")]
        pub real: f64 = 0.0, 0.0..=1.0;
        /// How far sensors of a profile with an appearance lie from it: 1 as DIGITs differ from one another, less for one that was calibrated.
        #[serde(skip_serializing_if = "is_one")]
        pub spread: f64 = 1.0, 0.0..=1.0;
        /// Greatest slow change of such a sensor between its untouched image and the others, grey levels.
        #[serde(skip_serializing_if = "is_zero_f32")]
        pub drift: f32 = 0.0, 0.0..=20.0;
        /// Share of contacts with objects of 3 to 20 mm: balls, dice, cans and others of the procedural ones, made smaller.
        #[serde(skip_serializing_if = "is_zero")]
        pub small: f64 = 0.0, 0.0..=1.0;
        /// Sensors in use at a time. Each step replaces one of them.
        pub sensors: usize = 24, 1..=1000;
    }
    rule = ranges_rise;
}

// These values are left out of the file and of the hash of the data, which then stay those of versions without them.
fn is_zero(share: &f64) -> bool {
    *share == 0.0
}

fn is_one(share: &f64) -> bool {
    *share == 1.0
}

fn is_zero_f32(levels: &f32) -> bool {
    *levels == 0.0
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

impl DataConfig {
    /// Returns real sensors that differ from one another as DIGITs do, of which the untouched image is known.
    pub fn units() -> Self {
        Self {
            untouched: 0.05,
            protocol: 0.25,
            press_mm: [0.1, 1.2],
            noise: [1.0, 3.0],
            background: 6.0,
            known_untouched: 1.0,
            real: 1.0,
            drift: 5.0,
            small: 0.5,
            ..Self::default()
        }
    }

    /// Returns MidasTouch's protocol for YCB-Slide alone, on sensors with the lights of their calibration or the look of their profile.
    pub fn protocol() -> Self {
        Self {
            untouched: 0.0,
            protocol: 1.0,
            deep: 0.0,
            disturbed_lights: 0.0,
            noise: [2.0, 2.0],
            background: 0.0,
            known_untouched: 1.0,
            spread: 0.0,
            ..Self::default()
        }
    }
}
