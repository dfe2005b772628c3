//! How scores of controllers are measured and printed.

use anyhow::Result;
use clap::{Args, value_parser};
use mvt_gaits::axis::TurnAxis;
use mvt_run::io::print_line;
use mvt_tuning::search::GaitScore;
use serde::Serialize;

/// How a score is measured and printed.
#[derive(Debug, Args)]
pub(crate) struct Scoring {
    /// Starts per object of the score, each of 20 s
    #[arg(long, value_name = "N", default_value_t = 40, value_parser = value_parser!(u64).range(1..=1000))]
    pub(crate) scored_starts: u64,
    /// Print JSON instead of words
    #[arg(long)]
    pub(crate) json: bool,
}

/// Seconds of a start that is scored.
pub(crate) const SCORED_S: f64 = 20.0;

/// A score with the controller.
#[derive(Debug, Serialize)]
struct ScoreReport<'a> {
    controller: &'a str,
    axis: TurnAxis,
    #[serde(flatten)]
    score: GaitScore,
}

/// Prints a score.
pub(crate) fn print(scoring: &Scoring, controller: &str, axis: TurnAxis, score: GaitScore) -> Result<()> {
    if scoring.json {
        return print_line(&serde_json::to_string(&ScoreReport { controller, axis, score })?);
    }
    let GaitScore { object, starts, alive, rate_rad_s, other_share, pads } = score;
    print_line(&format!(
        "{object} with {controller}: {:.0} % of {starts} starts alive after {SCORED_S:.0} s, {rate_rad_s:.2} rad/s about {axis}, \
         {other_share:.2} of it about other axes, {pads:.1} pads",
        100.0 * alive
    ))
}
