//! Touch sensors of one kind, each with its own lights, background and noise.

use std::collections::BTreeMap;
use std::ops::Range;

use image::RgbImage;
use mvt_frames::Isometry;
use mvt_render::rays::RayMesh;
use mvt_render::touch::{
    Background, Lights, TouchConfig, TouchFrame, TouchOptions, TouchRenderer, synthetic_background,
};
use mvt_robot::digit::profile::{Appearance, SensorProfile};
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

use crate::backdrop::{disturb, through_jpeg};
use crate::config::DataConfig;
use crate::error::PressError;

/// Touch sensor with its own lights, background and noise.
pub struct PressSensor {
    /// Renderer of its images.
    pub(crate) renderer: TouchRenderer,
    /// Untouched image, without noise.
    pub(crate) untouched: RgbImage,
    /// Its camera and gel.
    profile: SensorProfile,
    /// Whether it looks like a real sensor.
    pub(crate) is_real: bool,
    gel_depth_m: Vec<f32>,
}

impl PressSensor {
    /// Draws a sensor. As in MidasTouch, the gel under undisturbed lights (`calibration`) is subtracted from its
    /// images, so disturbed lights are visible everywhere.
    fn draw(
        config: &DataConfig,
        profile: &SensorProfile,
        (seed, stream): (u64, u64),
        calibration: &RgbImage,
    ) -> Result<Self, PressError> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(stream);
        let is_real = profile.appearance.is_some() || (config.real > 0.0 && rng.random_bool(config.real));
        if is_real {
            return Self::draw_real(config, draw_profile(profile, config.spread, &mut rng), seed, &mut rng);
        }
        let mut options = TouchOptions { markers: None, ..TouchOptions::of_profile(profile, TouchConfig::Fork) };
        options.noise_sigma = rng.random_range(config.noise[0]..=config.noise[1]);
        let mut background = synthetic_background(profile.size_px, seed);
        if rng.random_bool(config.disturbed_lights) {
            let strength = rng.random::<f64>() * config.light_strength;
            options.lights = Lights::perturbed(TouchConfig::Fork, strength, &mut rng);
            let lit = untouched(&TouchRenderer::new(&options)?).raw().clone();
            for ((level, lit), unlit) in background.iter_mut().zip(lit.as_raw()).zip(calibration.as_raw()) {
                // The change of the gel is smooth, so TACTO's blur would be invisible.
                *level = (f32::from(*level) + 0.5 * (f32::from(*lit) - f32::from(*unlit))).round() as u8;
            }
        }
        if rng.random_bool(0.5) {
            background = through_jpeg(&background, rng.random_range(60..=95))?;
        }
        options.background = Background::Image(background);
        let renderer = TouchRenderer::new(&options)?;
        let gel_depth_m = renderer.gel_depth_m().into_raw_vec_and_offset().0;
        let untouched = untouched(&renderer).calibrated().clone();
        Ok(Self { renderer, untouched, profile: profile.clone(), is_real: false, gel_depth_m })
    }

    /// Draws a sensor like a real one.
    fn draw_real(
        config: &DataConfig,
        profile: SensorProfile,
        seed: u64,
        rng: &mut ChaCha8Rng,
    ) -> Result<Self, PressError> {
        let mut options = TouchOptions::of_profile(&profile, TouchConfig::Fork);
        options.noise_sigma = rng.random_range(config.noise[0]..=config.noise[1]);
        let mut background = synthetic_background(profile.size_px, seed);
        disturb(&mut background, 2.0 * config.background, rng);
        if rng.random_bool(0.5) {
            background = through_jpeg(&background, rng.random_range(60..=95))?;
        }
        options.background = Background::Image(background.clone());
        let renderer = TouchRenderer::new(&options)?;
        let gel_depth_m = renderer.gel_depth_m().into_raw_vec_and_offset().0;
        Ok(Self { renderer, untouched: background, profile, is_real: true, gel_depth_m })
    }

    /// Returns its camera, gel and look.
    pub fn profile(&self) -> &SensorProfile {
        &self.profile
    }

    /// Returns the indentation of each pixel of a frame of this sensor, millimetres.
    pub(crate) fn indentation_mm(&self, frame: &TouchFrame) -> impl Iterator<Item = f32> {
        self.gel_depth_m.iter().zip(frame.depth_m()).map(|(gel, depth)| (gel - depth) * 1e3)
    }

    /// Returns the greatest indentation of a frame, millimetres.
    pub(crate) fn deepest_mm(&self, frame: &TouchFrame) -> f64 {
        f64::from(self.indentation_mm(frame).fold(0.0, f32::max))
    }
}

/// Field of view and reach of a usual DIGIT, from which those that are drawn differ.
const USUAL_FOV_Y_DEG: f64 = 42.3;
const USUAL_REACH_MM: f32 = 0.75;

/// Draws the profile of a real sensor: a DIGIT if the profile is TACTO's, one with a DIGIT's look if it has no appearance, else one that differs
/// from the profile as DIGITs differ from one another, or by the part `spread` of it. Its gel has no dots, which networks never see. The ranges
/// are those that images of ball presses on several sensors show, and a little more.
fn draw_profile(of: &SensorProfile, spread: f64, rng: &mut ChaCha8Rng) -> SensorProfile {
    let (fov_y_deg, reach_mm, digit) = draw_digit(rng);
    let Some(own) = &of.appearance else {
        let fov_y_deg = if of.is_tacto() { fov_y_deg } else { of.fov_y_deg };
        return SensorProfile { fov_y_deg, reach_mm, appearance: Some(digit), markers: None, ..of.clone() };
    };
    let usual = Appearance::default();
    let factor = |digit: f64, usual: f64| (digit / usual).powf(spread);
    let factor_f32 = |digit: f32, usual: f32| (digit / usual).powf(spread as f32);
    let scaled = |own: [f32; 3], digit: [f32; 3], usual: [f32; 3]| {
        std::array::from_fn(|c| own[c] * factor_f32(digit[c], usual[c]))
    };
    let appearance = Appearance {
        led_angles_deg: std::array::from_fn(|c| {
            own.led_angles_deg[c] + spread * (digit.led_angles_deg[c] - usual.led_angles_deg[c])
        }),
        led_distance_mm: own.led_distance_mm * factor(digit.led_distance_mm, usual.led_distance_mm),
        led_elevation_deg: (own.led_elevation_deg * factor(digit.led_elevation_deg, usual.led_elevation_deg)).min(80.0),
        sensitivity: scaled(own.sensitivity, digit.sensitivity, usual.sensitivity),
        background_exponent: scaled(own.background_exponent, digit.background_exponent, usual.background_exponent),
        response: own.response * factor_f32(digit.response, 1.0),
        cast_shadow: (1.0 - spread as f32) * own.cast_shadow + spread as f32 * digit.cast_shadow,
        blur_px: (own.blur_px * factor_f32(digit.blur_px, usual.blur_px)).min(4.0),
        noise_grey: 0.0,
        ..*own
    };
    SensorProfile {
        fov_y_deg: of.fov_y_deg * factor(fov_y_deg, USUAL_FOV_Y_DEG),
        reach_mm: (of.reach_mm * factor_f32(reach_mm, USUAL_REACH_MM)).min(1.5),
        appearance: Some(appearance),
        markers: None,
        ..of.clone()
    }
}

/// Draws field of view, reach and look of a real DIGIT.
fn draw_digit(rng: &mut ChaCha8Rng) -> (f64, f32, Appearance) {
    let mut between = |low: f64, high: f64| rng.random_range(low..=high);
    let common = between(75.0_f64.ln(), 250.0_f64.ln()).exp();
    let sensitivity = std::array::from_fn(|_| (common * between(0.7, 1.3)) as f32);
    let background_exponent = [between(0.3, 2.0), between(0.8, 3.0), between(0.0, 1.0)].map(|p| p as f32);
    let (fov_y_deg, reach_mm) = (between(38.0, 46.0), between(0.4, 1.1) as f32);
    let appearance = Appearance {
        led_angles_deg: [-47.0, -163.0, 77.0].map(|angle| angle + between(-15.0, 15.0)),
        led_distance_mm: between(8.0_f64.ln(), 22.0_f64.ln()).exp(),
        led_elevation_deg: between(12.0, 38.0),
        sensitivity,
        background_exponent,
        response: between(0.75, 1.6) as f32,
        cast_shadow: between(0.0, 1.0) as f32,
        blur_px: between(0.8, 2.6) as f32,
        noise_grey: 0.0,
        ..Appearance::default()
    };
    (fov_y_deg, reach_mm, appearance)
}

/// Renders the untouched gel, without noise.
fn untouched(renderer: &TouchRenderer) -> TouchFrame {
    let mut frame = TouchFrame::default();
    let empty = RayMesh::new(&mvt_mesh::Mesh::default());
    renderer.render(&empty, Isometry::identity(), None, &mut frame);
    frame
}

/// Stream of the random numbers of sensors that are held out.
const HELD_OUT: u64 = 1;

/// Sensors in use: at step k the numbers k to k + n - 1 of an infinite sequence.
pub struct Rack {
    config: DataConfig,
    profile: SensorProfile,
    seed: u64,
    /// Stream of the random numbers of each sensor.
    stream: u64,
    calibration: RgbImage,
    sensors: BTreeMap<u64, PressSensor>,
}

impl Rack {
    /// Creates an empty rack for sensors of a profile. Those of TACTO's are DIGITs, as TACTO renders them and, in part, like real ones.
    ///
    /// # Errors
    /// [`PressError::Touch`] if the renderer cannot be created.
    pub fn new(config: &DataConfig, profile: &SensorProfile, seed: u64) -> Result<Self, PressError> {
        let plain = TouchRenderer::new(&TouchOptions::of_profile(profile, TouchConfig::Fork))?;
        let calibration = untouched(&plain).raw().clone();
        let (config, profile) = (config.clone(), profile.clone());
        Ok(Self { config, profile, seed, stream: 0, calibration, sensors: BTreeMap::new() })
    }

    /// Turns it into a rack of sensors that no other rack has, whatever its seed: for judging networks.
    #[must_use]
    pub fn held_out(self) -> Self {
        Self { stream: HELD_OUT, ..self }
    }

    /// Returns the sensors of a step, and draws those that are new.
    ///
    /// # Errors
    /// [`PressError`] if the configuration is out of range.
    pub fn of_step(&mut self, step: u64) -> Result<Vec<&PressSensor>, PressError> {
        Ok(self.of_steps(step..step + 1)?.pop().unwrap_or_default())
    }

    /// Returns the sensors of each of some steps, and draws those that are new, side by side.
    ///
    /// # Errors
    /// [`PressError`] if the configuration is out of range.
    pub fn of_steps(&mut self, steps: Range<u64>) -> Result<Vec<Vec<&PressSensor>>, PressError> {
        let count = self.config.sensors as u64;
        let wanted = steps.start..steps.end + count - 1;
        self.sensors.retain(|number, _| wanted.contains(number));
        let missing: Vec<u64> = wanted.filter(|number| !self.sensors.contains_key(number)).collect();
        let drawn = missing.into_par_iter().map(|number| {
            let seed = self.seed ^ (number + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
            Ok((number, PressSensor::draw(&self.config, &self.profile, (seed, self.stream), &self.calibration)?))
        });
        let drawn: Vec<_> = drawn.collect::<Result<_, PressError>>()?;
        self.sensors.extend(drawn);
        let of_step = |step: u64| self.sensors.range(step..step + count).map(|(_, sensor)| sensor).collect();
        Ok(steps.map(of_step).collect())
    }
}
