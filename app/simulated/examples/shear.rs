//! Shear as a sensor with dots sees it, beside the simulator's: a JSON line per press or touching pad.
//!
//! `cargo run --release -p mvt-simulated --example shear -- presses` presses balls and drags them; `-- episodes` lets the hand turn objects.
//! `results/shear.py` makes figures of the lines.

#![expect(clippy::print_stdout, reason = "a program whose output is its lines")]

use anyhow::{Context as _, Result};
use clap::{Parser, ValueEnum};
use mvt_frames::{Gel, Isometry, Object as ObjectFrame};
use mvt_gaits::controller_file;
use mvt_objects::catalogue;
use mvt_objects::object::Object;
use mvt_physics::episode::{Episode, EpisodeConfig, Randomisation};
use mvt_physics::shear::stiffness_n_per_m;
use mvt_render::rays::RayMesh;
use mvt_render::touch::{Background, GelPress, NoiseKey, TouchConfig, TouchFrame, TouchOptions, TouchRenderer};
use mvt_robot::digit::gel::GelView;
use mvt_robot::digit::markers::{GelMotion, GelShear};
use mvt_robot::digit::profile::SensorProfile;
use mvt_robot::hand::{Hand, PerPad, Side};
use mvt_shear::{ShearField, ShearSensor};
use nalgebra as na;
use ndarray::Array2;
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use serde_json::json;

/// Compare seen with simulated shear.
#[derive(Debug, Parser)]
struct Arguments {
    /// What presses the gel
    #[arg(value_enum)]
    what: What,
    /// Sensor with dots
    #[arg(long, default_value = "digit_markers")]
    profile: String,
    /// Objects of the episodes, separated by commas
    #[arg(long, value_delimiter = ',', default_value = "077_rubiks_cube")]
    objects: Vec<String>,
    /// First seed.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Presses, or episodes per object.
    #[arg(long, default_value_t = 200)]
    count: u64,
    /// Length of an episode, seconds.
    #[arg(long, default_value_t = 8.0)]
    duration: f64,
}

/// What presses the gel.
#[derive(Debug, Clone, Copy, ValueEnum)]
enum What {
    /// Balls at random places, with random shear
    Presses,
    /// Objects that the hand turns
    Episodes,
}

const SIDE: Side = Side::Left;

fn main() -> Result<()> {
    let arguments = Arguments::parse();
    let profile = SensorProfile::load(&arguments.profile)?;
    match arguments.what {
        What::Presses => presses(&arguments, &profile),
        What::Episodes => {
            for name in &arguments.objects {
                let object = catalogue::load(name, &mut Vec::new())?;
                for seed in arguments.seed..arguments.seed + arguments.count {
                    episode(&arguments, &profile, name, &object, seed)?;
                }
            }
            Ok(())
        }
    }
}

/// A sensor that is rendered and read.
struct Sensor {
    profile: SensorProfile,
    renderer: TouchRenderer,
    reader: ShearSensor,
    view: GelView,
}

impl Sensor {
    fn new(profile: &SensorProfile, background: u64) -> Result<Self> {
        let options = TouchOptions {
            background: Background::Synthetic { seed: background },
            ..TouchOptions::of_profile(profile, TouchConfig::Fork)
        };
        let renderer = TouchRenderer::new(&options)?;
        let reader = ShearSensor::new(profile, &renderer.empty())?;
        Ok(Self { profile: profile.clone(), renderer, reader, view: profile.gel_view() })
    }

    /// Renders a press and reads it, with the true contact and indentation. Returns the motion of the gel by the formula of FOTS, too; `None`
    /// if nothing touches in view.
    fn feel(
        &self,
        object: &RayMesh,
        press: GelPress,
        noise: NoiseKey,
        frame: &mut TouchFrame,
    ) -> Result<Option<(ShearField, GelMotion)>> {
        self.renderer.render_dragged(object, press, Some(noise), frame);
        let indentation_mm = self.view.indentation_of(frame.depth_m()).context("the frame has another size")?;
        let contact = frame.contact();
        let Some(middle) = middle(contact) else { return Ok(None) };
        let field = self.reader.see(frame.calibrated(), contact, &indentation_mm)?;
        let (camera, gel) = (self.profile.intrinsics(), self.profile.gel_surface());
        let pattern = self.profile.markers.context("the profile has no dots")?;
        let pressed = pattern.places_mm().filter_map(|place| {
            let [u, v] = gel.pixel(&camera, place).map(f64::round);
            let at = (u >= 0.0 && v >= 0.0).then_some((v as usize, u as usize))?;
            contact.get(at).filter(|touches| **touches).map(|_| (place, f64::from(indentation_mm[at])))
        });
        let motion =
            GelMotion { centre_mm: gel.place_mm(&camera, middle), shear: press.shear, pressed: pressed.collect() };
        Ok(Some((field, motion)))
    }

    /// Returns the root mean squares over the dots of the motion by the formula, and of the seen motion less that, millimetres.
    fn errors(&self, field: &ShearField, motion: &GelMotion) -> [f64; 2] {
        let (camera, gel) = (self.profile.intrinsics(), self.profile.gel_surface());
        let mut squares = [0.0; 2];
        for dot in &field.dots {
            let start = gel.place_mm(&camera, dot.untouched_px);
            let end = motion.moved(start);
            let expected = [end[0] - start[0], end[1] - start[1]];
            for axis in 0..2 {
                squares[0] += expected[axis].powi(2);
                squares[1] += (dot.moved_mm[axis] - expected[axis]).powi(2);
            }
        }
        squares.map(|sum| (sum / field.dots.len().max(1) as f64).sqrt())
    }
}

/// Returns the middle of a contact, column and row.
fn middle(contact: &Array2<bool>) -> Option<[f64; 2]> {
    let places: Vec<[f64; 2]> =
        contact.indexed_iter().filter(|(_, touches)| **touches).map(|((v, u), _)| [u as f64, v as f64]).collect();
    let count = places.len() as f64;
    (count > 0.0).then(|| [0, 1].map(|k| places.iter().map(|place| place[k]).sum::<f64>() / count))
}

/// Presses balls of 3 to 9 mm radius at places around the middle, and drags and turns the gel.
fn presses(arguments: &Arguments, profile: &SensorProfile) -> Result<()> {
    let sensor = Sensor::new(profile, arguments.seed)?;
    let mut frame = TouchFrame::default();
    let mut rng = ChaCha8Rng::seed_from_u64(arguments.seed);
    // All balls are one, enlarged.
    let ball = catalogue::load("055_baseball", &mut Vec::new())?.mesh;
    let radius_m = f64::from(ball.extents_m().x) / 2.0;
    for k in 0..arguments.count {
        let mut between = |low: f64, high: f64| rng.random_range(low..=high);
        let (wanted_m, pressed_m) = (between(3e-3, 9e-3), between(0.4e-3, 1.2e-3));
        let mut ball = ball.clone();
        ball.vertices.iter_mut().for_each(|vertex| *vertex *= (wanted_m / radius_m) as f32);
        let place_mm = [between(-3.0, 3.0), between(-4.0, 4.0)];
        let (way, angle) = (between(0.0, 1.1), between(0.0, std::f64::consts::TAU));
        let shear =
            GelShear { displacement_mm: [way * angle.cos(), way * angle.sin()], twist_rad: between(-0.25, 0.25) };
        let [u, v] = profile.gel_surface().pixel(&profile.intrinsics(), place_mm);
        let gel = profile.gel_surface().point(&profile.intrinsics(), u, v);
        let normal = profile.gel_surface().normal(gel).coords();
        let middle = gel.coords() - normal * (wanted_m - pressed_m);
        let pose = Isometry::<ObjectFrame, Gel>::translation(middle.x, middle.y, middle.z);
        let noise = NoiseKey { seed: arguments.seed, pad: 0, frame: k as u32 };
        let press = GelPress { gel_from_object: pose, shear };
        let Some((field, motion)) = sensor.feel(&RayMesh::new(&ball), press, noise, &mut frame)? else { continue };
        let fit = field.fit.context("the press has no contact")?;
        let [moved_mm, missed_mm] = sensor.errors(&field, &motion);
        let line = json!({
            "case": "press",
            "profile": arguments.profile,
            "dots": field.dots.len(),
            "moved_mm": moved_mm,
            "missed_mm": missed_mm,
            "true_mm": shear.displacement_mm,
            "seen_mm": fit.shear.displacement_mm,
            "true_rad": shear.twist_rad,
            "seen_rad": fit.shear.twist_rad,
            "dilation": fit.dilation,
            "residual_mm": fit.residual_mm,
        });
        println!("{line}");
    }
    Ok(())
}

/// A touching pad at a frame.
struct Touching {
    gel_from_object: na::Isometry3<f64>,
    /// Middle of the contact in the gel frame.
    place: na::Point3<f64>,
    pixels: usize,
    deepest_mm: f64,
    volume_mm3: f64,
    seen: Option<GelShear>,
}

/// Plays an episode and prints a line for each pad that touches in two frames after one another.
fn episode(arguments: &Arguments, profile: &SensorProfile, name: &str, object: &Object, seed: u64) -> Result<()> {
    let hand = Hand::allegro(SIDE);
    let controller = controller_file::choose("auto", object, &hand)?;
    let config = EpisodeConfig {
        hand: hand.clone(),
        gait: controller.gait.clone(),
        seed,
        duration_s: arguments.duration,
        randomisation: Randomisation::default(),
    };
    let mut episode = Episode::new(object, &config)?;
    let sensors = hand.per_pad(|pad| Sensor::new(profile, pad as u64));
    let rays = RayMesh::new(&object.mesh);
    let mut scratch = TouchFrame::default();
    let mut before: PerPad<Option<(Touching, GelShear)>> = hand.per_pad(|_| None);
    for number in 0.. {
        let Some(state) = episode.next_frame() else { break };
        for (pad, (sensor, world_from_gel)) in sensors.iter().zip(hand.world_from_gels(&state.scene.joints)).enumerate()
        {
            let sensor = sensor.as_ref().map_err(|error| anyhow::anyhow!("{error}"))?;
            let press = GelPress {
                gel_from_object: world_from_gel.inverse() * state.scene.object_pose,
                shear: state.scene.shear[pad],
            };
            let noise = NoiseKey { seed, pad: pad as u32, frame: number };
            let felt = sensor.feel(&rays, press, noise, &mut scratch);
            // Dots that are lost tell nothing; where none touches, nothing is printed.
            let seen = felt.as_ref().ok().and_then(|felt| felt.as_ref()?.0.fit.map(|fit| fit.shear));
            let now = middle(scratch.contact()).map(|[u, v]| {
                let indentation_mm = sensor.view.indentation_of(scratch.depth_m()).unwrap_or_default();
                let point = profile.gel_surface().point(&profile.intrinsics(), u, v).coords();
                let pressed = || indentation_mm.iter().zip(scratch.contact()).filter(|(_, touches)| **touches);
                let mm_per_px = 1e3 * point.x / profile.intrinsics().fx;
                Touching {
                    gel_from_object: press.gel_from_object.untyped(),
                    place: point.into(),
                    pixels: pressed().count(),
                    deepest_mm: pressed().map(|(mm, _)| f64::from(*mm)).fold(0.0, f64::max),
                    volume_mm3: pressed().map(|(mm, _)| f64::from(*mm)).sum::<f64>() * mm_per_px.powi(2),
                    seen,
                }
            });
            let contact = &state.pads[pad];
            if let (Some((was, shear_before)), Some(now)) = (&before[pad], &now) {
                // Way of the touched surface over the gel.
                let material = was.gel_from_object.inverse() * was.place;
                let slip = now.gel_from_object * material - was.place;
                let friction = world_from_gel.untyped().rotation.inverse() * na::Vector3::from(contact.friction_n);
                let line = json!({
                    "case": "pad",
                    "object": name,
                    "seed": seed,
                    "frame": number,
                    "pad": pad,
                    "slip_mm": [-1e3 * slip.y, -1e3 * slip.z],
                    "true_mm": [shear_before.displacement_mm, press.shear.displacement_mm],
                    "true_rad": [shear_before.twist_rad, press.shear.twist_rad],
                    "seen_mm": [was.seen.map(|s| s.displacement_mm), now.seen.map(|s| s.displacement_mm)],
                    "seen_rad": [was.seen.map(|s| s.twist_rad), now.seen.map(|s| s.twist_rad)],
                    "pixels": [was.pixels, now.pixels],
                    "deepest_mm": [was.deepest_mm, now.deepest_mm],
                    "volume_mm3": [was.volume_mm3, now.volume_mm3],
                    "force_n": contact.force_n,
                    "friction_n": [-friction.y, -friction.z],
                    "friction_limit_n": contact.friction_limit_n,
                    "stiffness_n_per_mm": 1e-3 * stiffness_n_per_m(contact.force_n),
                });
                println!("{line}");
            }
            before[pad] = now.map(|now| (now, press.shear));
        }
    }
    Ok(())
}
