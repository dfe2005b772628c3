//! `hand train`: training of policies that turn an object.

use std::ffi::OsString;
use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context as _, Result, bail};
use clap::{Args, value_parser};
use mvt_environment::{Scene, TaskError};
use mvt_files::{input, output};
use mvt_hands::load_rig;
use mvt_learning::{
    Curriculum, LearningConfig, LearningPoint, PolicyTraining, check_trainable, in_sizes, training_settings,
};
use mvt_objects::object::Object;
use mvt_robot::hand::ALLEGRO_DIGIT;
use mvt_run::arguments::HandSide;
use mvt_run::io::{check_named, print_line, write_named};
use mvt_run::object::load_object;
use mvt_run::progress;
use serde_json::json;

use crate::played;
use crate::scoring::{SCORED_S, Scoring, print};

/// Train a policy that turns objects in the hand
///
/// PPO changes a small network that observes joint angles and their targets, the estimated place of the object and the force on each pad, and
/// says by how much the targets change. Its critic knows the object's motion, mass and friction. The reward is that of
/// mambavitact/TurnInHand-v0. Friction, mass, centre of mass, stiffness, latency, size and start are drawn anew for each episode.
///
/// FILE receives the weights, and a file beside it with the ending .toml their contract; --controller plays them. A file with the ending .csv
/// receives the course of the training. At the end the policy is scored on starts that no training can have. After an interruption, the same
/// command continues from FILE.state. The result does not depend on the number of threads.
#[derive(Debug, Args)]
pub struct HandTrainArguments {
    /// Hand: a name that `rigs` lists, or the path of a hand file (.toml)
    #[arg(long, value_name = "NAME|FILE", default_value = ALLEGRO_DIGIT)]
    rig: String,
    /// Side of the hand allegro_digit [default: left, or that of the hand file]
    #[arg(long, value_enum)]
    side: Option<HandSide>,
    /// Objects, separated by commas: names that `assets list` shows, random:SEED with a seed below 1000, or paths of meshes in metres
    #[arg(long, value_name = "NAME,...", value_delimiter = ',', required = true)]
    object: Vec<String>,
    /// Objects with which the training begins, named likewise, such as ball; those of --object join when these are held (at most one fall per
    /// minute) and turned (0.5 rad/s) [default: those of --object]
    #[arg(long, value_name = "NAME,...", value_delimiter = ',')]
    first: Vec<String>,
    /// Train corrections of the gait that suits each object, by up to 0.2 rad for each joint, instead of all that the hand does
    #[arg(long)]
    correct: bool,
    /// File for the policy, which ends in .safetensors
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// Number of steps of all environments, 25 for each simulated second; it is rounded up to whole blocks
    #[arg(long, value_name = "N", default_value_t = 3_000_000, value_parser = value_parser!(u64).range(1..=10_000_000_000))]
    steps: u64,
    /// Greatest change of the objects' size, as a share
    #[arg(long, value_name = "X", default_value_t = 0.05, value_parser = share)]
    sizes: f32,
    /// Number of environments that step together
    #[arg(long, value_name = "N", default_value_t = 64, value_parser = value_parser!(u16).range(1..=4096))]
    environments: u16,
    /// Seed of the training
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Replace existing files
    #[arg(long)]
    overwrite: bool,
    #[command(flatten)]
    scoring: Scoring,
}

/// Number of sizes of each object.
const SIZES: usize = 5;
/// Largest state that is read, bytes: a hundred times that of the largest networks that are usual.
const LARGEST_STATE: u64 = 256 << 20;

fn share(text: &str) -> Result<f32, String> {
    let value = text.parse().ok().filter(|v: &f32| (0.0..=0.5).contains(v));
    value.ok_or_else(|| "give a number from 0 to 0.5".to_owned())
}

/// Runs the command.
pub(crate) fn run(arguments: &HandTrainArguments) -> Result<()> {
    let HandTrainArguments { out, object: names, first, seed, sizes, overwrite, scoring, .. } = arguments;
    if out.extension().is_none_or(|ending| ending != "safetensors") {
        bail!("--out {}: a policy ends in .safetensors", out.display());
    }
    let [contract_path, curve_path] = ["toml", "csv"].map(|ending| out.with_extension(ending));
    for path in [out, &contract_path, &curve_path] {
        check_named(path, *overwrite)?;
    }
    let mut state_path = OsString::from(out);
    state_path.push(".state");
    let state_path = PathBuf::from(state_path);
    names.iter().chain(first).try_for_each(|name| check_trainable(name))?;
    let hand = load_rig(&arguments.rig, arguments.side.map(HandSide::side))?.hand;
    let settings = training_settings(&hand, arguments.correct);
    let load = |names: &[String]| names.iter().map(|name| load_object(name)).collect::<Result<Vec<Object>>>();
    let scene = |object| Ok(Arc::new(Scene::new(object, settings.clone())?));
    let scenes = |objects: &[Object]| -> Result<Vec<Arc<Scene>>, TaskError> {
        objects.iter().flat_map(|object| in_sizes(object, SIZES, *sizes)).map(scene).collect()
    };
    let objects = load(names)?;
    let curriculum = match first.is_empty() {
        true => scenes(&objects)?.into(),
        false => Curriculum { first: scenes(&load(first)?)?, later: scenes(&objects)? },
    };
    let mut config = LearningConfig { environments: usize::from(arguments.environments), ..LearningConfig::default() };
    if arguments.correct {
        // A gait is good already, and large random changes would only drop its objects.
        config.spread = 0.15;
    }
    let block = config.block;
    let identity = json!([names, first, arguments.correct, sizes, hand.description(), hand.side().sign()]).to_string();
    let mut training = match state_path.exists() {
        true => {
            let state = input::read(&state_path, LARGEST_STATE)
                .with_context(|| format!("cannot read {}", state_path.display()))?;
            PolicyTraining::resume(curriculum, config, *seed, &identity, &state)
                .with_context(|| state_path.display().to_string())?
        }
        false => PolicyTraining::new(curriculum, config, *seed)?,
    };
    let updates = arguments.steps.div_ceil(training.steps_per_update()).next_multiple_of(block);
    let bar = progress::bar(updates, "training");
    bar.set_position(training.updates());
    while training.updates() < updates {
        training.advance()?;
        bar.inc(1);
        if let Some(state) = training.state(&identity)? {
            output::replace(&state_path, &state).with_context(|| format!("cannot write {}", state_path.display()))?;
            if let Some(LearningPoint { reward, rate_rad_s, falls_per_minute, .. }) = training.curve().last() {
                bar.set_message(format!(
                    "training, reward {reward:.3}, {rate_rad_s:.2} rad/s, {falls_per_minute:.1} falls/min"
                ));
            }
        }
    }
    bar.finish_and_clear();
    let (weights, contract) = training.policy_files()?;
    let first = if first.is_empty() { String::new() } else { format!(" --first {}", first.join(",")) };
    let correct = if arguments.correct { " --correct" } else { "" };
    let contract = format!(
        "# Made by `hand train --object {}{first}{correct} --steps {} --seed {seed}`.\n{contract}",
        names.join(","),
        arguments.steps
    );
    write_named(out, &weights, *overwrite)?;
    write_named(&contract_path, contract.as_bytes(), *overwrite)?;
    write_named(&curve_path, curve(training.curve()).as_bytes(), *overwrite)?;
    remove(&state_path)?;
    for object in &objects {
        let (axis, score) = played::measure(out, object, &hand, scoring.scored_starts, SCORED_S)?;
        print(scoring, &out.display().to_string(), axis, score)?;
    }
    if scoring.json {
        return Ok(());
    }
    print_line(&format!("next: mambavitact controllers check {}", mvt_run::io::shell_word(&out.display().to_string())))
}

fn remove(path: &Path) -> Result<()> {
    match fs::remove_file(path) {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
            Err(error).with_context(|| format!("cannot remove {}", path.display()))
        }
        _ => Ok(()),
    }
}

fn curve(points: &[LearningPoint]) -> String {
    let mut text = "steps,reward,rate_rad_s,falls_per_minute\n".to_owned();
    for LearningPoint { steps, reward, rate_rad_s, falls_per_minute } in points {
        // Writing to a String cannot fail.
        let _ = writeln!(text, "{steps},{reward:.5},{rate_rad_s:.4},{falls_per_minute:.3}");
    }
    text
}
