//! `hand survey`: which controllers turn which objects.

use std::path::PathBuf;
use std::sync::Arc;

use anyhow::{Context as _, Result};
use clap::{Args, value_parser};
use mvt_files::{input, output};
use mvt_gaits::{controller_file, gait};
use mvt_hands::load_rig;
use mvt_objects::catalogue;
use mvt_robot::hand::ALLEGRO_DIGIT;
use mvt_run::arguments::HandSide;
use mvt_run::io::print_line;
use mvt_run::object::load_object;
use mvt_run::progress;
use mvt_tuning::seeds;
use mvt_tuning::survey::{SurveyRow, survey};
use mvt_tuning::trial::{EPISODE_STEPS, TrialConditions};
use rayon::prelude::*;

/// Play controllers on objects, and write which of them turn what
///
/// Physics alone, 20 s per start. A pair of controller and object ends with the first start in which the object falls.
/// FILE gets one JSON object per line and pair: size, fill and mass of the object, seeds, seconds until a fall, and the
/// net angle about x, y and z of the world in each start. After an interruption, the same command plays only the pairs
/// that FILE lacks. The result does not depend on the number of threads.
#[derive(Debug, Args)]
pub struct HandSurveyArguments {
    /// Objects, separated by commas [default: the whole catalogue]
    #[arg(long, value_name = "NAME,...", value_delimiter = ',')]
    object: Vec<String>,
    /// Controllers, separated by commas: names that `controllers` lists, files, or `suited` to choose by the object's shape
    /// [default: all for the palm]
    #[arg(long, value_name = "NAME|FILE,...", value_delimiter = ',')]
    controller: Vec<String>,
    /// Starts per pair
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = value_parser!(u64).range(1..=1000))]
    starts: u64,
    /// Seed of the first start [default: the first seed of the search]
    #[arg(long)]
    seed: Option<u64>,
    /// Hand: a name that `rigs` lists, or the path of a hand file (.toml)
    #[arg(long, value_name = "NAME|FILE", default_value = ALLEGRO_DIGIT)]
    rig: String,
    /// Side of the hand allegro_digit [default: left, or that of the hand file]
    #[arg(long, value_enum)]
    side: Option<HandSide>,
    /// File for the results
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
}

/// Seconds of a start.
const DURATION_S: f64 = 20.0;
/// Net angle from which on an object counts as turned, radians.
const TURNED_RAD: f64 = 6.0;
/// Largest file of results that is read, bytes.
const LARGEST_FILE: u64 = 64 << 20;

/// Runs the command.
pub fn run(arguments: &HandSurveyArguments) -> Result<()> {
    let HandSurveyArguments { starts, seed, out, .. } = arguments;
    let hand = load_rig(&arguments.rig, arguments.side.map(HandSide::side))?.hand;
    let all = |given: &[String], names: Vec<String>| if given.is_empty() { names } else { given.to_vec() };
    let objects = all(&arguments.object, catalogue::entries().map(|entry| entry.name.to_owned()).collect());
    let on_palm = gait::shipped().iter().filter(|(_, gait)| gait.feedback.is_none()).map(|(name, _)| name.clone());
    let controllers = all(&arguments.controller, on_palm.collect());
    let first = seed.unwrap_or_else(|| seeds::tuning().at(0));
    let seeds: Vec<u64> = (0..*starts).map(|start| first.wrapping_add(start)).collect();
    let conditions = TrialConditions { hand: Arc::clone(&hand), duration_s: DURATION_S, steps: EPISODE_STEPS };
    let mut rows: Vec<SurveyRow> = if out.exists() { read(arguments)? } else { Vec::new() };
    let bar = progress::bar(objects.len() as u64, "survey");
    let (mut turned, mut kept) = (0, 0);
    for name in &objects {
        let object = load_object(name)?;
        let play = |controller: &String| -> Result<SurveyRow> {
            let chosen = controller_file::choose(controller, &object, &hand)?;
            let is_same =
                |row: &&SurveyRow| (&row.object, &row.controller, &row.seeds) == (&object.name, &chosen.name, &seeds);
            match rows.iter().find(is_same) {
                Some(row) => Ok(row.clone()),
                None => Ok(survey((&chosen.name, &chosen.gait), &object, &seeds, &conditions)?),
            }
        };
        let played = controllers.par_iter().map(play).collect::<Result<Vec<SurveyRow>>>()?;
        turned += usize::from(played.iter().any(|row| row.turned_rad() >= TURNED_RAD));
        kept += usize::from(played.iter().any(|row| row.kept));
        let fresh: Vec<SurveyRow> = played.into_iter().filter(|row| !rows.contains(row)).collect();
        if !fresh.is_empty() {
            rows.extend(fresh);
            write(arguments, &rows)?;
        }
        bar.inc(1);
    }
    bar.finish_and_clear();
    let count = objects.len();
    print_line(&format!(
        "{turned} of {count} objects turn by {TURNED_RAD} rad or more about one axis in each of {starts} starts, and {kept} never fall"
    ))?;
    print_line(&format!("results in {}", out.display()))
}

fn read(arguments: &HandSurveyArguments) -> Result<Vec<SurveyRow>> {
    let out = &arguments.out;
    let text = input::read_text(out, LARGEST_FILE).with_context(|| format!("cannot read {}", out.display()))?;
    let row = |(k, line): (usize, &str)| {
        serde_json::from_str(line).with_context(|| {
            format!("line {} of {} is no result of a survey; give another --out", k + 1, out.display())
        })
    };
    text.lines().enumerate().map(row).collect()
}

fn write(arguments: &HandSurveyArguments, rows: &[SurveyRow]) -> Result<()> {
    let lines = rows.iter().map(|row| Ok(serde_json::to_string(row)? + "\n")).collect::<Result<String>>()?;
    output::replace(&arguments.out, lines.as_bytes())
        .with_context(|| format!("cannot write {}", arguments.out.display()))
}
