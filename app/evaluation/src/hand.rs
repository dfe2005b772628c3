//! `hand`: tuning, scores and the list of the hand's controllers.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context as _, Result, bail};
use clap::{Args, Subcommand, value_parser};
use mvt_gaits::axis::TurnAxis;
use mvt_gaits::controller_file::{self, CORRECTED, ControllerFile, is_policy};
use mvt_gaits::gait::{self, AUTO, Gait, SUITED};
use mvt_hands::load_rig;
use mvt_objects::object::Object;
use mvt_robot::hand::{ALLEGRO_DIGIT, Hand, Side};
use mvt_run::arguments::HandSide;
use mvt_run::controller::choose_any;
use mvt_run::io::{check_named, print_line, shell_word, write_named};
use mvt_run::object::load_object;
use mvt_run::progress;
use mvt_tuning::carried::carried_over;
use mvt_tuning::first_stroke::first_stroke;
use mvt_tuning::grasp::GraspFile;
use mvt_tuning::search::{Search, SearchSettings, measure};
use mvt_tuning::seeds;
use mvt_tuning::trial::{EPISODE_STEPS, TrialConditions};

use crate::grasps::{self, HandGraspsArguments};
use crate::played;
use crate::rigs::{self, HandCheckArguments};
use crate::scoring::{SCORED_S, Scoring, print};
use crate::speed::{self, HandSpeedArguments};
use crate::survey::{self, HandSurveyArguments};
#[cfg(feature = "train")]
use crate::train::{self, HandTrainArguments};

/// Check hand files, tune controllers of a hand, and score them
#[derive(Debug, Subcommand)]
pub enum HandCommand {
    #[allow(missing_docs, reason = "the arguments have the help text")]
    Check(HandCheckArguments),
    #[allow(missing_docs, reason = "the arguments have the help text")]
    Tune(HandTuneArguments),
    #[cfg(feature = "train")]
    #[allow(missing_docs, reason = "the arguments have the help text")]
    Train(HandTrainArguments),
    #[allow(missing_docs, reason = "the arguments have the help text")]
    Score(HandScoreArguments),
    #[allow(missing_docs, reason = "the arguments have the help text")]
    Survey(HandSurveyArguments),
    #[allow(missing_docs, reason = "the arguments have the help text")]
    Grasps(HandGraspsArguments),
    #[allow(missing_docs, reason = "the arguments have the help text")]
    Speed(HandSpeedArguments),
}

/// Search for a controller that turns objects about an axis
///
/// CMA-ES changes the stroke of a controller: period, tilt of the palm, torque, start, middle pose of the hand, and the
/// path of each fingertip. A candidate is tried on several starts of each object; friction, mass, centre of mass,
/// stiffness and start are drawn as in episodes. The score counts the net angle about the axis; turning back, turning
/// about other axes, and drops cost.
///
/// At the end the controller is scored on starts that the search never saw. After an interruption, the same command
/// continues from FILE.state. The result does not depend on the number of threads.
#[derive(Debug, Args)]
pub struct HandTuneArguments {
    /// Hand: a name that `rigs` lists, or the path of a hand file (.toml)
    #[arg(long, value_name = "NAME|FILE", default_value = ALLEGRO_DIGIT)]
    rig: String,
    /// Objects, separated by commas: names that `assets list` shows, random:SEED, or paths of meshes in metres
    #[arg(long, value_name = "NAME,...", value_delimiter = ',', required = true)]
    object: Vec<String>,
    /// Axis about which the right hand turns the objects: +x, -x, +y, -y, +z or -z. x points to the fingertips, z up;
    /// the left hand turns about the mirror image
    #[arg(long, allow_hyphen_values = true)]
    axis: TurnAxis,
    /// Controller from which the search starts: a name that `controllers` lists, a file, or `first` for a stroke that is computed from the
    /// hand and the first object. A controller of the Allegro is carried over to the pads of the same names of another hand. If it turns
    /// the other way round, its stroke is first played backwards [default: tumble_back for the Allegro, first for any other hand]
    #[arg(long, value_name = "NAME|FILE")]
    from: Option<String>,
    /// Start with the first grasp of a file that `hand grasps` wrote, instead of the grasp of the controller, which must hold
    /// objects in the air
    #[arg(long, value_name = "FILE")]
    grasp: Option<PathBuf>,
    /// File for the controller
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// Number of generations of 14 candidates
    #[arg(long, value_name = "N", default_value_t = 40, value_parser = value_parser!(u64).range(1..=10_000))]
    generations: u64,
    /// Starts per object and candidate
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = value_parser!(u64).range(1..=100))]
    starts: u64,
    /// Seconds of a start; short ones hide late drops
    #[arg(long, value_name = "S", default_value_t = 10.0, value_parser = mvt_run::arguments::duration)]
    duration: f64,
    /// Rate about the axis above which faster turning gains nothing, rad/s. With a low rate drops and turns about other axes
    /// weigh more [default: 1.2 on the palm, 0.3 in the air]
    #[arg(long, value_name = "RAD/S", value_parser = positive)]
    rate: Option<f64>,
    /// First step size, relative to the usual one of each parameter
    #[arg(long, value_name = "X", default_value_t = 0.3, value_parser = positive)]
    step: f64,
    /// Change only the parameters whose names begin so, separated by commas, such as `lift_,pose_thumb`. The table `params` of
    /// a controller file has the names. Fewer parameters need fewer generations
    #[arg(long, value_name = "NAME,...", value_delimiter = ',')]
    only: Vec<String>,
    /// Seed of the search
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Replace an existing file
    #[arg(long)]
    overwrite: bool,
    #[command(flatten)]
    scoring: Scoring,
}

/// Score controllers on starts that no search has seen
///
/// Prints for each object the share of the starts after which it was still in the hand, the median net rate about the
/// controller's axis, the net turn about the other axes relative to that, and the mean number of touching pads.
#[derive(Debug, Args)]
pub struct HandScoreArguments {
    /// Hand: a name that `rigs` lists, or the path of a hand file (.toml)
    #[arg(long, value_name = "NAME|FILE", default_value = ALLEGRO_DIGIT)]
    rig: String,
    /// Objects, separated by commas: names that `assets list` shows, random:SEED, or paths of meshes in metres
    #[arg(long, value_name = "NAME,...", value_delimiter = ',', required = true)]
    object: Vec<String>,
    /// Controller: a name that `controllers` lists, a file, the path of a learnt policy, or `auto` as of `run`
    #[arg(long, value_name = "NAME|FILE", default_value = "auto")]
    controller: String,
    /// Side of the hand allegro_digit [default: left, or that of the hand file]
    #[arg(long, value_enum)]
    side: Option<HandSide>,
    /// Integration steps per command: 12 as in episodes, 24 for steps of half the length
    #[arg(long, value_name = "N", default_value_t = EPISODE_STEPS, value_parser = value_parser!(u32).range(1..=1000))]
    steps: u32,
    #[command(flatten)]
    scoring: Scoring,
}

/// Candidates per generation: 4 + 3 ln(number of parameters), as is usual for CMA-ES.
const POPULATION: usize = 14;

fn positive(text: &str) -> Result<f64, String> {
    let value = text.parse().ok().filter(|v: &f64| *v > 0.0 && *v <= 10.0);
    value.ok_or_else(|| "give a number greater than 0 and at most 10".to_owned())
}

/// Runs a command of the group `hand`.
pub fn run(command: &HandCommand) -> Result<()> {
    match command {
        HandCommand::Check(arguments) => rigs::check(arguments),
        HandCommand::Tune(arguments) => tune(arguments),
        #[cfg(feature = "train")]
        HandCommand::Train(arguments) => train::run(arguments),
        HandCommand::Score(arguments) => score(arguments),
        HandCommand::Survey(arguments) => survey::run(arguments),
        HandCommand::Grasps(arguments) => grasps::run(arguments),
        HandCommand::Speed(arguments) => speed::run(arguments),
    }
}

/// Prints the controllers.
pub fn list() -> Result<()> {
    for (name, axis, purpose) in controller_file::list() {
        print_line(&format!("{name:<18} {axis}  {purpose}"))?;
    }
    print_line(&format!("{SUITED:<18}     the one of these that suits an object, by its shape"))?;
    print_line(&format!(
        "{CORRECTED:<18}     a learnt policy that corrects the gait that suits an object; for the left hand"
    ))?;
    print_line(&format!("{:<18}     a controller file, which `hand tune` writes", "FILE.toml"))?;
    print_line(&format!("{:<18}     a learnt policy, see docs/policies.md and `controllers check`", "FILE.onnx"))?;
    print_line(&format!("{:<18}     the same, with its contract in a .toml file beside it", "FILE.safetensors"))
}

fn load(names: &[String]) -> Result<Vec<Object>> {
    names.iter().map(|name| load_object(name)).collect()
}

fn tune(arguments: &HandTuneArguments) -> Result<()> {
    let HandTuneArguments { out, generations, axis, overwrite, .. } = arguments;
    let mut state = out.clone().into_os_string();
    state.push(".state");
    let state = PathBuf::from(state);
    check_named(out, *overwrite)?;
    let objects = load(&arguments.object)?;
    let first = objects.first().context("name at least one object")?;
    // The Allegro is tuned as a right hand, and scored as a left one.
    let is_allegro = arguments.rig == ALLEGRO_DIGIT;
    let hand = load_rig(&arguments.rig, is_allegro.then_some(Side::Right))?.hand;
    let name = from_name(arguments);
    let mut from = match name {
        FIRST => first_stroke(&hand, first, *axis),
        name => match gait::find(name) {
            Ok((_, of_allegro)) if !gait::suits(&hand) => carried_over(of_allegro, &Hand::allegro(Side::Right), &hand)
                .with_context(|| {
                    format!("{name} moves an Allegro on its palm, and a pad of {} has no namesake there; choose --from {FIRST}", hand.name())
                })?,
            _ => controller_file::choose(name, first, &hand)?.gait,
        },
    };
    if let Some(path) = &arguments.grasp {
        from = with_grasp(&from, path, &objects, name, &hand)?;
    }
    if let Some(begin) = arguments.only.iter().find(|begin| !Search::has_parameter(&from, &hand, begin)) {
        bail!("--only {begin}: {name} has no parameter whose name begins so; its file lists them under `params`");
    }
    let settings = SearchSettings {
        objects: arguments.object.clone(),
        axis: *axis,
        duration_s: arguments.duration,
        starts: arguments.starts,
        sufficient_rate_rad_s: arguments.rate,
        population: POPULATION,
        sigma: arguments.step,
        only: arguments.only.clone(),
        seed: arguments.seed,
    };
    let mut search = Search::resume(&state, settings, &from, &hand)?;
    let bar = progress::bar(*generations, "tuning");
    bar.set_position(search.generation());
    while search.generation() < *generations {
        let mean = search.advance(&objects)?;
        search.save(&state)?;
        bar.set_message(format!("tuning, mean score {mean:.2}"));
        bar.inc(1);
    }
    bar.finish_and_clear();
    let gait = search.gait(&format!("made by `{}`", command(arguments)));
    let file = ControllerFile::new(gait, &objects, &hand);
    write_named(out, toml::to_string(&file)?.as_bytes(), *overwrite)?;
    fs::remove_file(&state).or_else(|error| match error.kind() {
        std::io::ErrorKind::NotFound => Ok(()),
        _ => Err(error).with_context(|| format!("cannot remove {}", state.display())),
    })?;
    let scored = if is_allegro { Hand::allegro(Side::Left) } else { hand };
    let conditions = TrialConditions { hand: scored, duration_s: SCORED_S, steps: EPISODE_STEPS };
    for object in &objects {
        let result = measure(&file.gait, object, seeds::held_out(), arguments.scoring.scored_starts, &conditions)?;
        print(&arguments.scoring, &path_text(out), *axis, result)?;
    }
    Ok(())
}

/// Returns a controller with the first grasp of a file, which must be of one of the objects.
fn with_grasp(from: &Gait, path: &Path, objects: &[Object], name: &str, hand: &Hand) -> Result<Gait> {
    let file = GraspFile::read(path, hand)?;
    if objects.iter().all(|object| object.name != file.object) {
        bail!(
            "{} has grasps of {}; name this object, or make grasps of yours with `hand grasps`",
            path.display(),
            file.object
        );
    }
    let gait = file.grasps.first().and_then(|grasp| grasp.gait(from, hand));
    gait.with_context(|| {
        format!("{name} holds nothing in the air; give --from a controller with feedback, such as air_ball")
    })
}

fn path_text(path: &Path) -> String {
    path.display().to_string()
}

/// Name of the stroke that is computed.
const FIRST: &str = "first";

/// Returns the name of the controller from which a search starts.
fn from_name(arguments: &HandTuneArguments) -> &str {
    let default = if arguments.rig == ALLEGRO_DIGIT { "tumble_back" } else { FIRST };
    arguments.from.as_deref().unwrap_or(default)
}

/// Returns the command that makes the same controller.
fn command(arguments: &HandTuneArguments) -> String {
    let HandTuneArguments { object, axis, grasp, generations, starts, duration, rate, step, only, seed, .. } =
        arguments;
    let (objects, from) = (shell_word(&object.join(",")), shell_word(from_name(arguments)));
    let grasp = grasp.as_ref().map_or(String::new(), |path| format!(" --grasp {}", shell_word(&path_text(path))));
    let rig = &arguments.rig;
    let rig = if rig == ALLEGRO_DIGIT { String::new() } else { format!(" --rig {}", shell_word(rig)) };
    let rate = rate.map_or(String::new(), |rate| format!(" --rate {rate}"));
    let only = if only.is_empty() { String::new() } else { format!(" --only {}", shell_word(&only.join(","))) };
    format!(
        "mambavitact hand tune{rig} --object {objects} --axis {axis} --from {from}{grasp} --generations {generations} --starts {starts} \
         --duration {duration}{rate} --step {step}{only} --seed {seed}"
    )
}

fn score(arguments: &HandScoreArguments) -> Result<()> {
    let hand = load_rig(&arguments.rig, arguments.side.map(HandSide::side))?.hand;
    let conditions = TrialConditions { hand: Arc::clone(&hand), duration_s: SCORED_S, steps: arguments.steps };
    let bar = progress::bar(arguments.object.len() as u64, "scoring");
    for name in &arguments.object {
        let object = load_object(name)?;
        let starts = arguments.scoring.scored_starts;
        let controller = arguments.controller.as_str();
        let chosen = match is_policy(controller) || controller == AUTO {
            true => choose_any(controller, &object, &hand)?,
            false => controller_file::choose(controller, &object, &hand)?,
        };
        if chosen.mover.is_some() {
            if arguments.steps != EPISODE_STEPS {
                bail!(
                    "--steps {}: a policy is played with the integration steps of an episode; leave --steps out, or name a stroke",
                    arguments.steps
                );
            }
            let (axis, result) = played::measure(Path::new(&chosen.name), &object, &hand, starts, SCORED_S)?;
            bar.suspend(|| print(&arguments.scoring, &chosen.name, axis, result))?;
            bar.inc(1);
            continue;
        }
        let result = measure(&chosen.gait, &object, seeds::held_out(), starts, &conditions)?;
        bar.suspend(|| print(&arguments.scoring, &chosen.name, chosen.gait.axis, result))?;
        bar.inc(1);
    }
    bar.finish_and_clear();
    Ok(())
}
