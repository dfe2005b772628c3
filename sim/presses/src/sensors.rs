//! DIGITs, each with its own lights, background and noise.

use std::collections::BTreeMap;

use image::RgbImage;
use mvt_frames::Isometry;
use mvt_render::rays::RayMesh;
use mvt_render::touch::{
    Background, Lights, TouchConfig, TouchFrame, TouchOptions, TouchRenderer, synthetic_background,
};
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

use crate::backdrop::through_jpeg;
use crate::config::DataConfig;
use crate::error::PressError;

/// DIGIT with its own lights, background and noise.
pub struct PressSensor {
    /// Renderer of its images.
    pub(crate) renderer: TouchRenderer,
    /// Untouched image, without noise.
    pub(crate) untouched: RgbImage,
    gel_depth_m: Vec<f32>,
}

impl PressSensor {
    /// Draws a sensor. As in MidasTouch, the gel under undisturbed lights (`calibration`) is subtracted from its
    /// images, so disturbed lights are visible everywhere.
    fn draw(config: &DataConfig, seed: u64, calibration: &RgbImage) -> Result<Self, PressError> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut options = TouchOptions::new(TouchConfig::Fork);
        options.noise_sigma = rng.random_range(config.noise[0]..=config.noise[1]);
        let mut background = synthetic_background(seed);
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
        Ok(Self { renderer, untouched, gel_depth_m })
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

/// Renders the untouched gel, without noise.
fn untouched(renderer: &TouchRenderer) -> TouchFrame {
    let mut frame = TouchFrame::default();
    let empty = RayMesh::new(&mvt_mesh::Mesh::default());
    renderer.render(&empty, Isometry::identity(), None, &mut frame);
    frame
}

/// Sensors in use: at step k the numbers k to k + n - 1 of an infinite sequence.
pub struct Rack {
    config: DataConfig,
    seed: u64,
    calibration: RgbImage,
    sensors: BTreeMap<u64, PressSensor>,
}

impl Rack {
    /// Creates an empty rack.
    ///
    /// # Errors
    /// [`PressError::Touch`] if the renderer cannot be created.
    pub fn new(config: &DataConfig, seed: u64) -> Result<Self, PressError> {
        let plain = TouchRenderer::new(&TouchOptions::new(TouchConfig::Fork))?;
        let calibration = untouched(&plain).raw().clone();
        Ok(Self { config: config.clone(), seed, calibration, sensors: BTreeMap::new() })
    }

    /// Returns the sensors of a step, and draws those that are new.
    ///
    /// # Errors
    /// [`PressError`] if the configuration is out of range.
    pub fn of_step(&mut self, step: u64) -> Result<Vec<&PressSensor>, PressError> {
        let wanted = step..step + self.config.sensors as u64;
        self.sensors.retain(|number, _| wanted.contains(number));
        for number in wanted {
            if let std::collections::btree_map::Entry::Vacant(place) = self.sensors.entry(number) {
                let seed = self.seed ^ (number + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
                place.insert(PressSensor::draw(&self.config, seed, &self.calibration)?);
            }
        }
        Ok(self.sensors.values().collect())
    }
}
