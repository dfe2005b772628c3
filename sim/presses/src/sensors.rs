//! DIGITs: each its own lights, background and noise.

use std::collections::BTreeMap;

use anyhow::Result;
use image::RgbImage;
use mvt_frames::Isometry;
use mvt_render::rays::RayMesh;
use mvt_render::touch::{
    Background, Lights, TouchConfig, TouchFrame, TouchOptions, TouchRenderer, synthetic_background,
};
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

use super::backdrop::through_jpeg;
use super::example::DataConfig;

/// A DIGIT.
pub struct Sensor {
    /// Renders its images.
    pub renderer: TouchRenderer,
    /// Its image without contact and without noise.
    pub untouched: RgbImage,
    gel_depth_m: Vec<f32>,
}

impl Sensor {
    /// Draws a sensor. As in MidasTouch, what is subtracted from its images is the empty gel under undisturbed lights, so that disturbed
    /// ones show everywhere.
    fn draw(config: &DataConfig, seed: u64, calibration: &RgbImage) -> Result<Self> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut options = TouchOptions::new(TouchConfig::Fork);
        options.noise_sigma = rng.random_range(config.noise[0]..=config.noise[1]);
        let mut background = synthetic_background(seed);
        if rng.random_bool(config.disturbed_lights) {
            let strength = rng.random::<f64>() * config.light_strength;
            options.lights = Lights::perturbed(TouchConfig::Fork, strength, &mut rng);
            let lit = untouched(&TouchRenderer::new(&options)?).raw().clone();
            for ((level, lit), unlit) in background.iter_mut().zip(lit.as_raw()).zip(calibration.as_raw()) {
                // The gel's change is smooth, so that TACTO's blur would not be seen.
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

    /// Indentation of a frame of this sensor over the empty gel, millimetres.
    pub fn indentation_mm(&self, frame: &TouchFrame) -> impl Iterator<Item = f32> {
        self.gel_depth_m.iter().zip(frame.depth_m()).map(|(gel, depth)| (gel - depth) * 1e3)
    }

    /// The greatest of them.
    pub fn deepest_mm(&self, frame: &TouchFrame) -> f64 {
        f64::from(self.indentation_mm(frame).fold(0.0, f32::max))
    }
}

/// A frame, without noise, of the gel that touches nothing.
fn untouched(renderer: &TouchRenderer) -> TouchFrame {
    let mut frame = TouchFrame::default();
    let nothing = RayMesh::new(&mvt_mesh::Mesh::default());
    renderer.render(&nothing, Isometry::identity(), None, &mut frame);
    frame
}

/// The sensors in use: at step k, the numbers k to k + n - 1 of an endless row.
pub struct Rack {
    config: DataConfig,
    seed: u64,
    calibration: RgbImage,
    sensors: BTreeMap<u64, Sensor>,
}

impl Rack {
    /// An empty rack.
    pub fn new(config: &DataConfig, seed: u64) -> Result<Self> {
        let plain = TouchRenderer::new(&TouchOptions::new(TouchConfig::Fork))?;
        let calibration = untouched(&plain).raw().clone();
        Ok(Self { config: config.clone(), seed, calibration, sensors: BTreeMap::new() })
    }

    /// The sensors of a step.
    pub fn of_step(&mut self, step: u64) -> Result<Vec<&Sensor>> {
        let wanted = step..step + self.config.sensors as u64;
        self.sensors.retain(|number, _| wanted.contains(number));
        for number in wanted {
            if let std::collections::btree_map::Entry::Vacant(place) = self.sensors.entry(number) {
                let seed = self.seed ^ (number + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
                place.insert(Sensor::draw(&self.config, seed, &self.calibration)?);
            }
        }
        Ok(self.sensors.values().collect())
    }
}
