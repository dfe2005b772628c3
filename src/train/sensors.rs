//! DIGITs to train with: each its own lights, background and noise.

use std::collections::BTreeMap;
use std::f32::consts::TAU;

use anyhow::Result;
use image::RgbImage;
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use scenes::digit::{HEIGHT, WIDTH};
use scenes::frame::Isometry;
use sim::rays::RayMesh;
use sim::touch::{Background, Lights, TouchConfig, TouchFrame, TouchOptions, TouchRenderer, synthetic_background};

use super::contacts::DataConfig;

/// A DIGIT.
pub struct Sensor {
    /// Renders its images.
    pub renderer: TouchRenderer,
    gel_depth_m: Vec<f32>,
}

impl Sensor {
    /// Draws a sensor. As in MidasTouch, what is subtracted from its images is the empty gel under undisturbed lights, so that disturbed
    /// ones show everywhere.
    fn draw(config: &DataConfig, seed: u64, calibration: &RgbImage) -> Result<Self> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut options = TouchOptions::new(TouchConfig::Fork);
        options.noise_sigma = rng.random_range(config.noise[0]..config.noise[1]);
        let mut background = synthetic_background(seed);
        if rng.random_bool(config.disturbed_lights) {
            let strength = rng.random::<f64>() * config.light_strength;
            options.lights = Lights::perturbed(TouchConfig::Fork, strength, &mut rng);
            let lit = empty_gel(&TouchRenderer::new(&options)?);
            for ((level, lit), unlit) in background.iter_mut().zip(lit.as_raw()).zip(calibration.as_raw()) {
                // The gel's change is smooth, so that TACTO's blur would not be seen.
                *level = (f32::from(*level) + 0.5 * (f32::from(*lit) - f32::from(*unlit))).round() as u8;
            }
        }
        options.background = Background::Image(background);
        let renderer = TouchRenderer::new(&options)?;
        let gel_depth_m = renderer.gel_depth_m().into_raw_vec_and_offset().0;
        Ok(Self { renderer, gel_depth_m })
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

/// The image of the gel that touches nothing, before calibration.
fn empty_gel(renderer: &TouchRenderer) -> RgbImage {
    let mut frame = TouchFrame::default();
    let nothing = RayMesh::new(&scenes::mesh::Mesh::default());
    renderer.render(&nothing, Isometry::identity(), None, &mut frame);
    frame.raw().clone()
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
        let calibration = empty_gel(&TouchRenderer::new(&TouchOptions::new(TouchConfig::Fork))?);
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

/// Changes what lies under an image's contact: brightness and colour by waves over the whole image, and specks.
pub fn disturb(image: &mut RgbImage, height: f32, rng: &mut ChaCha8Rng) {
    let wave = |rng: &mut ChaCha8Rng| {
        let along = rng.random::<f32>() * TAU;
        let frequency = TAU * rng.random_range(0.2..1.5_f32);
        let heights: [f32; 3] = std::array::from_fn(|_| height * (2.0 * rng.random::<f32>() - 1.0));
        (frequency * along.cos(), frequency * along.sin(), rng.random::<f32>() * TAU, heights)
    };
    let waves: [_; 3] = std::array::from_fn(|_| wave(rng));
    let offset: [f32; 3] = std::array::from_fn(|_| height * (2.0 * rng.random::<f32>() - 1.0));
    // A wave is a product of two in rows and columns: cos(a + b) = cos a cos b - sin a sin b.
    let columns: Vec<[[f32; 2]; 3]> = (0..WIDTH)
        .map(|u| waves.map(|(x, _, _, _)| [(x * u as f32 / WIDTH as f32).cos(), (x * u as f32 / WIDTH as f32).sin()]))
        .collect();
    let pixels: &mut [u8] = image;
    for (v, row) in pixels.chunks_exact_mut(3 * WIDTH).enumerate() {
        let phases = waves.map(|(_, y, phase, _)| (y * v as f32 / HEIGHT as f32 + phase).sin_cos());
        for (pixel, column) in row.as_chunks_mut::<3>().0.iter_mut().zip(&columns) {
            let mut added = offset;
            for ((wave, (sin, cos)), [c, s]) in waves.iter().zip(phases).zip(column) {
                let size = c * cos - s * sin;
                for (added, height) in added.iter_mut().zip(wave.3) {
                    *added += size * height;
                }
            }
            for (level, added) in pixel.iter_mut().zip(added) {
                *level = (f32::from(*level) + added).round() as u8;
            }
        }
    }
    for _ in 0..rng.random_range(0..12) {
        speck(image, rng);
    }
}

/// A grain of dust or a scratch's end: a small round spot, darker or lighter.
fn speck(image: &mut RgbImage, rng: &mut ChaCha8Rng) {
    let (x, y) = (rng.random_range(0..WIDTH) as f32, rng.random_range(0..HEIGHT) as f32);
    let radius = rng.random_range(1.0..4.0_f32);
    let heights: [f32; 3] = std::array::from_fn(|_| rng.random_range(-10.0..6.0_f32));
    let reach = (3.0 * radius).ceil();
    let span = |at: f32, side: usize| ((at - reach).max(0.0) as u32)..((at + reach) as u32 + 1).min(side as u32);
    for (v, u) in span(y, HEIGHT).flat_map(|v| span(x, WIDTH).map(move |u| (v, u))) {
        let (dx, dy) = (u as f32 - x, v as f32 - y);
        let share = (-(dx * dx + dy * dy) / (2.0 * radius * radius)).exp();
        for (level, height) in image.get_pixel_mut(u, v).0.iter_mut().zip(heights) {
            *level = (f32::from(*level) + share * height).round() as u8;
        }
    }
}
