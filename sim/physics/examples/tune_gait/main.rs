//! Tunes a gait by CMA-ES for a class of objects and writes it as an entry of sim/gaits/assets/gaits.json.
//!
//! `cargo run --release -p mvt-physics --example tune_gait -- --from bal --object 005_tomato_soup_can --object cube70
//!  --generations 40 --out tuned.json`. A killed run resumes from its output file.

#![expect(clippy::print_stderr, reason = "a program that reports its search")]

mod stroke;

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Mutex;

use anyhow::{Context as _, Result};
use clap::Parser;
use cmaes::{CMAESOptions, DVector, ParallelObjectiveFunction};
use mvt_gaits::gait;
use mvt_gaits::gait::Gait;
use mvt_objects::object::Object;
use mvt_physics::episode;
use mvt_physics::episode::{End, Episode, EpisodeConfig, EpisodeOutcome, Randomisation};
use mvt_robot::hand::Side;
use stroke::PARAMETERS;

/// Tune a gait for a class of objects.
#[derive(Debug, Parser)]
struct Arguments {
    /// Shipped gait to start from.
    #[arg(long)]
    from: String,
    /// Objects to turn; repeat.
    #[arg(long = "object", required = true)]
    objects: Vec<String>,
    /// Starts per object and candidate.
    #[arg(long, default_value_t = 2)]
    starts: u64,
    /// Seconds per rollout; short ones hide late drops.
    #[arg(long, default_value_t = 12.0)]
    duration: f64,
    /// Generations of the search.
    #[arg(long, default_value_t = 40)]
    generations: usize,
    /// Candidates per generation.
    #[arg(long, default_value_t = 14)]
    population: usize,
    /// Step size relative to the parameters' scales.
    #[arg(long, default_value_t = 0.4)]
    sigma: f64,
    /// Seed of the search.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// File for the best gait, written after every improvement.
    #[arg(long)]
    out: PathBuf,
}

struct Tuner {
    objects: Vec<Object>,
    origin: BTreeMap<String, f64>,
    rest: [f64; 16],
    description: String,
    starts: u64,
    duration_s: f64,
    out: PathBuf,
    /// Cost of the best candidate so far, and number of candidates.
    best: Mutex<(f64, usize)>,
}

impl Tuner {
    fn params(&self, x: &DVector<f64>) -> BTreeMap<String, f64> {
        let value = |(i, &(name, scale, low, high)): (usize, &(&str, f64, f64, f64))| {
            let origin = self.origin.get(name).copied().unwrap_or(0.0);
            (name.to_owned(), (origin + scale * x[i]).clamp(low, high))
        };
        PARAMETERS.iter().enumerate().map(value).collect()
    }

    /// Returns a weighted mean of the mean and the worst score, so that bad starts count more.
    fn score(&self, gait: &Gait) -> Result<(f64, Vec<EpisodeOutcome>)> {
        let mut scores = Vec::new();
        let mut outcomes = Vec::new();
        for object in &self.objects {
            for seed in 0..self.starts {
                let config = EpisodeConfig {
                    side: Side::Right,
                    gait: gait.clone(),
                    seed: 10_000 + seed,
                    duration_s: self.duration_s,
                    randomisation: Randomisation::default(),
                };
                let outcome = episode::run(&mut Episode::new(object, &config)?);
                scores.push(reward(&outcome, self.duration_s));
                outcomes.push(outcome);
            }
        }
        let mean = scores.iter().sum::<f64>() / scores.len() as f64;
        let worst = scores.iter().copied().fold(f64::INFINITY, f64::min);
        Ok((0.7 * mean + 0.3 * worst, outcomes))
    }
}

/// Returns the reward of an outcome. Turning counts up to the rate at which images blur, and contact up to the required
/// share, so that the search neither squeezes without turning nor turns without contact.
fn reward(outcome: &EpisodeOutcome, duration_s: f64) -> f64 {
    let survived = if outcome.end == End::Completed { 1.0 } else { outcome.survived_s / duration_s };
    let rate = outcome.turn_rate_rad_s;
    let turning = 2.5 * rate.min(0.7) + 0.1 * (rate - 0.7).clamp(0.0, 0.5);
    let any = 1.5 * outcome.any_contact_fraction.min(0.88) / 0.88;
    let pads = 1.5 * outcome.mean_pads_in_contact.min(1.75) / 1.75;
    turning + any + pads - 2.5 * (1.0 - survived)
}

impl ParallelObjectiveFunction for &Tuner {
    fn evaluate_parallel(&self, x: &DVector<f64>) -> f64 {
        let gait = stroke::gait(&self.params(x), &self.rest, &self.description);
        // Parameters outside their bounds were clamped; a penalty for the distance keeps the search inside.
        let outside: f64 = PARAMETERS
            .iter()
            .enumerate()
            .map(|(i, &(name, scale, low, high))| {
                let raw = self.origin.get(name).copied().unwrap_or(0.0) + scale * x[i];
                ((raw - raw.clamp(low, high)) / scale).powi(2)
            })
            .sum();
        let Ok((score, outcomes)) = self.score(&gait) else { return f64::MAX };
        let cost = 0.05 * outside - score;
        let mut best = self.best.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        best.1 += 1;
        if cost < best.0 {
            best.0 = cost;
            let of = |f: fn(&EpisodeOutcome) -> f64| {
                let mut v: Vec<String> = outcomes.iter().map(|o| format!("{:.2}", f(o))).collect();
                v.dedup();
                v.join(" ")
            };
            eprintln!(
                "{} candidates, cost {cost:.3}\n  rate {}\n  any  {}\n  pads {}\n  s    {}",
                best.1,
                of(|o| o.turn_rate_rad_s),
                of(|o| o.any_contact_fraction),
                of(|o| o.mean_pads_in_contact),
                of(|o| o.survived_s)
            );
            let partial = self.out.with_extension("partial");
            let written = serde_json::to_string_pretty(&gait)
                .map_err(std::io::Error::other)
                .and_then(|text| std::fs::write(&partial, text))
                .and_then(|()| std::fs::rename(&partial, &self.out));
            if let Err(error) = written {
                eprintln!("{}: {error}", self.out.display());
            }
        }
        cost
    }
}

fn main() -> Result<()> {
    let arguments = Arguments::parse();
    let start = if arguments.out.exists() {
        let text = std::fs::read_to_string(&arguments.out)?;
        serde_json::from_str(&text).with_context(|| format!("{} contains no gait", arguments.out.display()))?
    } else {
        gait::find(&arguments.from)?.1.clone()
    };
    let mut warnings = Vec::new();
    let objects = arguments.objects.iter().map(|name| mvt_objects::catalogue::load(name, &mut warnings));
    let tuner = Tuner {
        objects: objects.collect::<Result<_, _>>()?,
        origin: start.params,
        rest: start.open_pose,
        description: format!("tuned from {} on {}", arguments.from, arguments.objects.join(", ")),
        starts: arguments.starts,
        duration_s: arguments.duration,
        out: arguments.out,
        best: Mutex::new((f64::INFINITY, 0)),
    };
    // Evaluates the start first, so that a resumed search never writes a worse gait.
    (&tuner).evaluate_parallel(&DVector::zeros(PARAMETERS.len()));
    let mut search = CMAESOptions::new(vec![0.0; PARAMETERS.len()], arguments.sigma)
        .population_size(arguments.population)
        .max_generations(arguments.generations)
        .seed(arguments.seed)
        .build(&tuner)
        .map_err(|error| anyhow::anyhow!("the search cannot start: {error:?}"))?;
    search.run_parallel();
    Ok(())
}
