//! Compares integration steps per second: speed of many environments that observe proprioception, and what becomes of the episodes.
//!
//! `cargo run --release -p mvt-environment --example rate [ENVIRONMENTS] [STEPS] [STARTS]` prints a line of JSON for each rate. Actions are random, as
//! those of an untrained policy. STARTS episodes of 20 s are played by the stroke that suits the cube.

#![expect(clippy::print_stdout, reason = "a program whose output is its lines")]

use std::sync::Arc;
use std::time::Instant;

use mvt_environment::{Environments, Scene, TurnSettings};
use mvt_gaits::directed::DirectedController;
use mvt_gaits::gait;
use mvt_objects::catalogue;
use mvt_physics::episode::{End, Episode, EpisodeConfig};
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

type Failure = Box<dyn std::error::Error + Send + Sync>;

fn main() -> Result<(), Failure> {
    let given: Vec<u64> = std::env::args().skip(1).map(|text| text.parse()).collect::<Result<_, _>>()?;
    let argument = |k: usize, default| given.get(k).copied().unwrap_or(default);
    let (count, steps, starts) = (argument(0, 64) as usize, argument(1, 200), argument(2, 100));
    for physics_hz in [300, 150] {
        let settings = TurnSettings { physics_hz, ..TurnSettings::default() };
        let object = catalogue::load("cube70", &mut Vec::new())?;
        let gait = gait::choose("auto", &object, &settings.hand)?.1.clone();
        let play = |seed| -> Result<(bool, bool, f64), Failure> {
            let TurnSettings { hand, duration_s, randomisation, .. } = settings.clone();
            let player = Box::new(DirectedController::new(&gait, &hand));
            let config = EpisodeConfig { hand, gait: gait.clone(), seed, duration_s, randomisation };
            let mut episode = Episode::at_rate(&object, &config, player, physics_hz)?;
            episode.advance(u32::MAX, None);
            let (end, rate) = (episode.end(), episode.turned_rad() / episode.time_s());
            Ok((end == Some(&End::Completed), matches!(end, Some(End::Unstable(_))), rate))
        };
        let played: Vec<(bool, bool, f64)> = (0..starts).into_par_iter().map(play).collect::<Result<_, _>>()?;
        let mut rates: Vec<f64> = played.iter().map(|(.., rate)| *rate).collect();
        rates.sort_by(f64::total_cmp);
        let of = |is: fn(&(bool, bool, f64)) -> bool| played.iter().filter(|episode| is(episode)).count();

        let mut environments = Environments::new(Arc::new(Scene::new(object.clone(), settings.clone())?), count, true)?;
        let mut random = ChaCha8Rng::seed_from_u64(0);
        let begun = Instant::now();
        let (mut fell, mut torque) = (0, 0.0);
        for _ in 0..steps {
            let actions: Vec<f32> = (0..16 * count).map(|_| random.random_range(-1.0..1.0)).collect();
            let outcome = environments.step(&actions)?;
            fell += outcome.terminated.iter().filter(|is| **is).count();
            torque += outcome.rewards.iter().map(|reward| reward.torque).sum::<f64>();
        }
        let made = (steps as usize * count) as f64;
        println!(
            "{{\"physics_hz\": {physics_hz}, \"steps_per_s\": {:.0}, \"random_falls_per_1000\": {:.2}, \"random_torque\": {:.5}, \"stroke_starts\": {starts}, \
             \"stroke_alive\": {}, \"stroke_unstable\": {}, \"stroke_median_rad_s\": {:.3}}}",
            made / begun.elapsed().as_secs_f64(),
            1e3 * fell as f64 / made,
            torque / made,
            of(|(completed, ..)| *completed),
            of(|(_, unstable, _)| *unstable),
            rates.get(rates.len() / 2).copied().unwrap_or(0.0),
        );
    }
    Ok(())
}
