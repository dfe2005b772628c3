//! `hand grasps`: grasps that hold an object in the air.

use std::path::PathBuf;

use anyhow::{Result, bail};
use clap::{Args, value_parser};
use mvt_gaits::controller_file;
use mvt_robot::hand::{Hand, Side};
use mvt_run::io::{check_named, print_line, write_named};
use mvt_run::object::load_object;
use mvt_run::progress;
use mvt_tuning::grasp::{self, Attempt, Grasp, GraspFile};
use rayon::prelude::*;

/// Find grasps that hold an object in the air on the fingertips
///
/// A try draws a place over the palm and a turn of the object, finds joint angles at which the gels touch it there, and keeps
/// them if fingertips can carry its weight at these contacts. It is a grasp if the hand then holds the object in four trials of
/// 2.5 s after the support is taken away, at least 30 mm over the palm; friction, mass and start are drawn as in episodes.
///
/// FILE gets the grasps in TOML, for the right hand: first those that hold by nothing but fingertips, and by the most of them. `hand
/// tune --grasp FILE` makes a controller from the first one. The result does not depend on the number of threads.
#[derive(Debug, Args)]
pub struct HandGraspsArguments {
    /// Object: a name that `assets list` shows, random:SEED, or the path of a mesh in metres. It is held as it would stand on the
    /// palm
    #[arg(long, value_name = "NAME|FILE")]
    object: String,
    /// Number of tries
    #[arg(long, value_name = "N", default_value_t = 1000, value_parser = value_parser!(u64).range(1..=1_000_000))]
    tries: u64,
    /// Controller with feedback whose torque, gravity and way of closing the trials have
    #[arg(long, value_name = "NAME|FILE", default_value = "air_ball")]
    controller: String,
    /// Seed of the tries
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// File for the grasps
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// Replace an existing file
    #[arg(long)]
    overwrite: bool,
}

/// Runs the command.
pub fn run(arguments: &HandGraspsArguments) -> Result<()> {
    let HandGraspsArguments { tries, controller, seed, out, overwrite, .. } = arguments;
    check_named(out, *overwrite)?;
    let object = load_object(&arguments.object)?;
    let hand = Hand::allegro(Side::Right);
    let from = controller_file::choose(controller, &object, &hand)?.gait;
    if from.feedback.is_none() {
        bail!("{controller} holds nothing in the air; name a controller with feedback, such as air_ball");
    }
    let bar = progress::bar(*tries, "grasping");
    let attempt = |number| {
        let grasp = grasp::attempt(&object, &from, &hand, *seed, number);
        bar.inc(1);
        grasp
    };
    let found = (0..*tries).into_par_iter().map(attempt).collect::<Result<Vec<Attempt>, _>>()?;
    bar.finish_and_clear();
    let balanced = found.iter().filter(|attempt| **attempt != Attempt::Unbalanced).count();
    let held =
        found.into_iter().filter_map(|attempt| if let Attempt::Held(grasp) = attempt { Some(*grasp) } else { None });
    let grasps: Vec<Grasp> = held.collect();
    if grasps.is_empty() {
        bail!(
            "none of {tries} tries holds {}; make more of them, or choose an object of 60 to 80 mm and at most 200 g",
            object.name
        );
    }
    let on_tips = grasps.iter().filter(|grasp| grasp.touched_beside_tips == 0.0).count();
    let pads = grasps.iter().map(|grasp| grasp.pads).sum::<f64>() / grasps.len() as f64;
    let file = GraspFile::new(&object, &hand, grasps);
    write_named(out, toml::to_string(&file)?.as_bytes(), *overwrite)?;
    print_line(&format!(
        "in {balanced} of {tries} tries fingertips can carry {}; {} hold it, {on_tips} of them by nothing but fingertips, with {pads:.1} \
         pads in the mean",
        object.name,
        file.grasps.len()
    ))
}
