//! Settings of random presses.

use anyhow::{Result, ensure};
use serde::{Deserialize, Serialize};

use crate::objects::Split;

/// Distributions of training images.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DataConfig {
    /// Objects that are pressed.
    #[serde(skip_serializing_if = "Split::is_published")]
    pub objects: Split,
    /// Share of images without contact.
    pub untouched: f64,
    /// Share of the images with contact that follow MidasTouch's protocol.
    pub protocol: f64,
    /// Share of contacts in which the finger is not withdrawn if another part of the object is deeper than the press
    /// depth: an edge beside the touched point may be as deep as the object allows.
    pub deep: f64,
    /// Least and greatest press depth beyond the protocol, millimetres.
    pub press_mm: [f64; 2],
    /// Greatest tilt beyond the protocol, degrees.
    pub tilt_deg: f64,
    /// Share of sensors whose lights differ from their calibration.
    pub disturbed_lights: f64,
    /// Size of that difference, in units of MidasTouch's distribution.
    pub light_strength: f64,
    /// Least and greatest standard deviation of the image noise, grey levels.
    pub noise: [f32; 2],
    /// Greatest height of each shape of light that is added to a background, grey levels.
    pub background: f32,
    /// Share of images of sensors whose untouched image is known.
    pub known_untouched: f64,
    /// Sensors in use at a time. Each step replaces one of them.
    pub sensors: usize,
}

impl Default for DataConfig {
    fn default() -> Self {
        Self {
            objects: Split::default(),
            untouched: 0.06,
            protocol: 0.5,
            deep: 0.04,
            press_mm: [0.1, 2.0],
            tilt_deg: 30.0,
            disturbed_lights: 0.6,
            light_strength: 1.0,
            noise: [1.5, 3.0],
            background: 12.0,
            known_untouched: 0.75,
            sensors: 24,
        }
    }
}

impl DataConfig {
    /// Returns MidasTouch's protocol for YCB-Slide alone, on sensors with the lights of their calibration.
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

    /// Checks the ranges of all numbers and the objects.
    pub fn check(&self) -> Result<()> {
        self.objects.check()?;
        let share = |value: f64| (0.0..=1.0).contains(&value);
        ensure!(share(self.untouched), "data.untouched must lie between 0 and 1");
        ensure!(share(self.protocol), "data.protocol must lie between 0 and 1");
        ensure!(share(self.deep), "data.deep must lie between 0 and 1");
        ensure!(share(self.disturbed_lights), "data.disturbed_lights must lie between 0 and 1");
        ensure!((0.0..=10.0).contains(&self.light_strength), "data.light_strength must lie between 0 and 10");
        let [least, most] = self.press_mm;
        ensure!(0.0 < least && least < most && most <= 5.0, "data.press_mm must rise and lie between 0 and 5");
        ensure!((0.0..=80.0).contains(&self.tilt_deg), "data.tilt_deg must lie between 0 and 80");
        let [least, most] = self.noise;
        ensure!(0.0 < least && least <= most && most <= 28.0, "data.noise must not fall and lie between 0 and 28");
        ensure!((0.0..=100.0).contains(&self.background), "data.background must lie between 0 and 100");
        ensure!(share(self.known_untouched), "data.known_untouched must lie between 0 and 1");
        ensure!((1..=1000).contains(&self.sensors), "data.sensors must lie between 1 and 1000");
        Ok(())
    }
}
