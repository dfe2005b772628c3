//! Measures how well the hand turns objects: a table over many randomised starts of each object.
//!
//! `cargo run --release -p mvt-physics --example evaluate_gaits -- --starts 50` uses the objects and gaits that
//! RESULTS.md quotes.

#![expect(clippy::print_stdout, reason = "a program whose output is its table")]

use anyhow::Result;
use clap::Parser;
use mvt_gaits::gait;
use mvt_physics::episode;
use mvt_physics::episode::{End, Episode, EpisodeConfig, EpisodeOutcome, Randomisation};
use mvt_robot::hand::{Hand, Side};
use rayon::prelude::*;

/// Evaluate gaits over randomised starts.
#[derive(Debug, Parser)]
struct Arguments {
    /// Name of an object (repeatable); by default those of RESULTS.md
    #[arg(long = "object")]
    objects: Vec<String>,
    /// Name of a gait; by default the one that suits each object
    #[arg(long)]
    gait: Option<String>,
    /// Starts per object.
    #[arg(long, default_value_t = 50)]
    starts: u64,
    /// Seed of the first start.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Seconds per start.
    #[arg(long, default_value_t = 20.0)]
    duration: f64,
    /// Use the right hand, for which the gaits were written, instead of its mirror image.
    #[arg(long)]
    right: bool,
}

const QUOTED: [&str; 10] = [
    "005_tomato_soup_can",
    "077_rubiks_cube",
    "055_baseball",
    "017_orange",
    "002_master_chef_can",
    "cube70",
    "013_apple",
    "061_foam_brick",
    "016_pear",
    "010_potted_meat_can",
];

fn main() -> Result<()> {
    let arguments = Arguments::parse();
    let hand = Hand::allegro(if arguments.right { Side::Right } else { Side::Left });
    let quoted = || QUOTED.map(str::to_owned).to_vec();
    let names = if arguments.objects.is_empty() { quoted() } else { arguments.objects };
    let names_of_pads = hand.pads().iter().map(|pad| pad.name.as_str()).collect::<Vec<_>>().join(" ");
    println!(
        "| object | gait | alive % | rad/s median (q10-q90) | any pad % | pads | {names_of_pads} % | depth mm | tilt deg |"
    );
    println!("|---|---|---|---|---|---|---|---|---|");
    for name in names {
        let mut warnings = Vec::new();
        let object = mvt_objects::catalogue::load(&name, &mut warnings)?;
        let (gait_name, gait) = gait::find(arguments.gait.as_deref().unwrap_or_else(|| gait::suited_to(&object)))?;
        let play = |seed| -> Result<EpisodeOutcome> {
            let (hand, gait, duration_s) = (hand.clone(), gait.clone(), arguments.duration);
            let config = EpisodeConfig { hand, gait, seed, duration_s, randomisation: Randomisation::default() };
            Ok(episode::run(&mut Episode::new(&object, &config)?))
        };
        let seeds = arguments.seed..arguments.seed + arguments.starts;
        let outcomes = seeds.into_par_iter().map(play).collect::<Result<Vec<_>>>()?;
        let mean = |f: &dyn Fn(&EpisodeOutcome) -> f64| outcomes.iter().map(f).sum::<f64>() / outcomes.len() as f64;
        let alive = mean(&|o| f64::from(u8::from(o.end == End::Completed)));
        let mut rates: Vec<f64> = outcomes.iter().map(|o| o.turn_rate_rad_s).collect();
        rates.sort_by(f64::total_cmp);
        let quantile = |q: f64| rates[((rates.len() - 1) as f64 * q).round() as usize];
        let pads = hand.per_pad(|pad| format!("{:.0}", 100.0 * mean(&|o| o.per_pad_contact[pad])));
        println!(
            "| {name} | {gait_name} | {:.0} | {:.2} ({:.2}-{:.2}) | {:.0} | {:.2} | {} | {:.2} | {:.0} |",
            100.0 * alive,
            quantile(0.5),
            quantile(0.1),
            quantile(0.9),
            100.0 * mean(&|o| o.any_contact_fraction),
            mean(&|o| o.mean_pads_in_contact),
            pads.join(" "),
            mean(&|o| o.penetration_mm),
            mean(&|o| o.tilt_deg)
        );
    }
    Ok(())
}
