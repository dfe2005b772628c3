//! `hand speed`: steps per second of the search for controllers.

use anyhow::{Result, bail};
use clap::{Args, value_parser};
use mvt_gaits::gait;
use mvt_robot::hand::{Hand, Side};
use mvt_run::io::print_line;
use mvt_run::object::load_object;
use mvt_tuning::speed;

/// Measure the steps per second of the search for controllers beside those of MuJoCo alone
///
/// Trials of a controller are made as `hand tune` makes them, in turns with the same commands played to simulations that are ready at the
/// same starts.
#[derive(Debug, Args)]
pub struct HandSpeedArguments {
    /// Object: a name that `assets list` shows, random:SEED, or the path of a mesh in metres
    #[arg(long, default_value = "cube70")]
    object: String,
    /// Controller that turns it: a name that `controllers` lists
    #[arg(long, default_value = "tumble_back")]
    controller: String,
    /// Number of trials in a round
    #[arg(long, default_value_t = 28, value_parser = value_parser!(u64).range(1..=10_000))]
    starts: u64,
    /// Number of rounds; the fastest counts
    #[arg(long, default_value_t = 5, value_parser = value_parser!(u32).range(1..=1000))]
    rounds: u32,
    /// Number of threads
    #[arg(long, default_value_t = 2, value_parser = value_parser!(u16).range(1..=256))]
    threads: u16,
    /// Print JSON instead of words
    #[arg(long)]
    json: bool,
}

/// Seconds of a trial, as `hand tune` has by default.
const DURATION_S: f64 = 10.0;

/// Times the search and prints its speed.
pub(crate) fn run(arguments: &HandSpeedArguments) -> Result<()> {
    let object = load_object(&arguments.object)?;
    let (_, gait) = gait::find(&arguments.controller)?;
    if gait.feedback.is_some() {
        bail!("{} holds objects in the air; name a controller that turns them on the palm", arguments.controller);
    }
    let pool = rayon::ThreadPoolBuilder::new().num_threads(usize::from(arguments.threads)).build()?;
    let speed = pool.install(|| {
        speed::measure(gait, &object, &Hand::allegro(Side::Right), arguments.starts, DURATION_S, arguments.rounds)
    })?;
    if arguments.json {
        return print_line(&serde_json::to_string(&speed)?);
    }
    let (search, bare) = (speed.search_steps_per_s, speed.bare_steps_per_s);
    print_line(&format!("search {search:.0} steps/s, MuJoCo alone {bare:.0} steps/s: {:.2} of it", search / bare))
}
