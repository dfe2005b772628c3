//! `controllers`: the list of controllers, and the check of a learnt policy.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Instant;

use anyhow::{Context as _, Result, bail};
use clap::{Args, Subcommand};
use mvt_gaits::controller_file::is_policy;
use mvt_hands::load_rig;
use mvt_physics::episode::{End, Episode, EpisodeConfig, Randomisation};
use mvt_policy::{ActionKind, Policy, PolicyContract};
use mvt_robot::hand::{ALLEGRO_DIGIT, Hand};
use mvt_run::arguments::HandSide;
use mvt_run::controller::choose_controller;
use mvt_run::io::print_line;
use mvt_run::object::load_object;

use crate::hand;

/// List the controllers of the hand: name, axis on the right hand, and purpose
#[derive(Debug, Args)]
#[command(args_conflicts_with_subcommands = true)]
pub struct ControllersArguments {
    #[command(subcommand)]
    command: Option<ControllersCommand>,
}

#[derive(Debug, Subcommand)]
enum ControllersCommand {
    Check(CheckArguments),
}

/// Print the contract of a learnt policy, and play it for a second
///
/// The file is refused with the field that is missing or does not fit the hand. Nothing estimates the object here, so that terms of its place
/// are zero.
#[derive(Debug, Args)]
struct CheckArguments {
    /// Policy: .onnx with mjlab's metadata, or .safetensors; FILE with the ending .toml completes the contract
    file: PathBuf,
    /// Hand: a name that `rigs` lists, or the path of a hand file (.toml)
    #[arg(long, value_name = "NAME|FILE", default_value = ALLEGRO_DIGIT)]
    rig: String,
    /// Side of the hand allegro_digit [default: left, or that of the hand file]
    #[arg(long, value_enum)]
    side: Option<HandSide>,
    /// Object with which it is played
    #[arg(long, default_value = "cube70")]
    object: String,
}

/// Runs the command.
pub fn run(arguments: &ControllersArguments) -> Result<()> {
    match &arguments.command {
        None => hand::list(),
        Some(ControllersCommand::Check(arguments)) => check(arguments),
    }
}

fn check(arguments: &CheckArguments) -> Result<()> {
    let name = arguments.file.to_str().context("the path of the policy is not UTF-8: rename it")?;
    if !is_policy(name) {
        bail!("{name}: a policy ends in .onnx or .safetensors");
    }
    let rig = load_rig(&arguments.rig, arguments.side.map(HandSide::side))?;
    let policy = Policy::read(&arguments.file, &rig.hand)?;
    print_line(&contract_in_words(&policy, &rig.hand))?;
    for note in policy.notes() {
        print_line(&format!("note            {note}"))?;
    }
    let object = load_object(&arguments.object)?;
    let chosen = choose_controller(name, &object, &rig.hand)?;
    let mover = chosen.mover.context("it is not a policy")?;
    let config = EpisodeConfig {
        hand: Arc::clone(&rig.hand),
        gait: chosen.gait,
        seed: 0,
        duration_s: 1.0,
        randomisation: Randomisation::none(),
    };
    let limit_nm = config.gait.torque_limit_nm;
    let rate_hz = mover.rate_hz();
    let mut timed = mover.clone();
    let mut episode = Episode::moved_by(&object, &config, mover)?;
    let begun = Instant::now();
    timed.command(&episode.proprioception());
    let command_us = begun.elapsed().as_secs_f64() * 1e6;
    let (mut strongest_nm, mut limited, mut steps) = (0.0_f64, 0, 0);
    while episode.end().is_none() {
        episode.advance(1, None);
        let torques = episode.simulation().joint_torques();
        strongest_nm = torques.iter().fold(strongest_nm, |most, torque| most.max(torque.abs()));
        limited += usize::from(torques.iter().any(|torque| torque.abs() > 0.999 * limit_nm));
        steps += 1;
    }
    let ended = match episode.end() {
        Some(End::Dropped) => "the object fell",
        Some(End::Uncontrolled(reason) | End::Unstable(reason)) => reason,
        _ => "the object stayed in the hand",
    };
    let time_s = episode.time_s();
    print_line(&format!(
        "played          {time_s:.1} s with {} at {rate_hz} Hz: {ended}, turned {:.2} rad; strongest torque {strongest_nm:.2} Nm, at the limit of \
         {limit_nm} Nm {:.0} % of the time; first command {command_us:.0} us",
        object.name,
        episode.turned_rad(),
        100.0 * limited as f64 / f64::from(steps.max(1)),
    ))
}

fn contract_in_words(policy: &Policy, hand: &Hand) -> String {
    let contract = policy.contract();
    let PolicyContract { joint_names, control_hz, observation, action_scale, .. } = contract;
    let mut lines = vec![
        format!("network         {}", policy.network_in_words()),
        format!("rate            {control_hz} Hz"),
        format!("observation     {} numbers", contract.observation_size(hand)),
    ];
    let histories = if contract.newest_first { "newest first" } else { "oldest first" };
    for observed in observation {
        let [low, high] = observed.clip;
        let scale =
            if observed.scale.len() == 1 { format!("{}", observed.scale[0]) } else { "one per number".to_owned() };
        lines.push(format!(
            "  {:<22} {:>3} x {}, {histories}, clipped to {low} to {high}, scale {scale}",
            observed.term.name(),
            observed.history,
            observed.term.size(hand)
        ));
    }
    let kind = match contract.action {
        ActionKind::Absolute => "default_joint_pos + action_scale * action",
        ActionKind::Incremental => "target before + action_scale * action",
        ActionKind::Correction => "target of the gait that suits the object + action_scale * action",
    };
    lines.push(format!("action          {} numbers: {kind}", joint_names.len()));
    lines.push(format!(
        "  {:<22} {:>9} {:>9} {:>11} {:>12}",
        "joint", "stiffness", "damping", "default_pos", "action_scale"
    ));
    let gains = contract.joint_stiffness.iter().zip(&contract.joint_damping);
    for ((name, (stiffness, damping)), (default, scale)) in
        joint_names.iter().zip(gains).zip(contract.default_joint_pos.iter().zip(action_scale))
    {
        lines.push(format!("  {name:<22} {stiffness:>9.3} {damping:>9.3} {default:>11.3} {scale:>12.3}"));
    }
    lines.join("\n")
}
