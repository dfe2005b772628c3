//! `simulate`: an episode of physics and controller, without images.

use anyhow::{Result, bail};
use clap::Args;
use mvt_evaluation::manner::Subject;
use mvt_physics::air::PlaceErrors;
use mvt_physics::episode;
use mvt_physics::episode::{End, Episode, EpisodeConfig, EpisodeOutcome, Randomisation};
use mvt_robot::hand::{Hand, Side};
use mvt_run::io::print_line;
use serde::Serialize;

/// Simulate an episode without rendering, and print how long and how far the object turned
///
/// The turn is the one about the axis of the controller. The seed decides the start: yaw, position, friction, mass and centre of mass of the object, and stiffness and angles
/// of the joints.
#[derive(Debug, Args)]
pub struct SimulateArguments {
    #[command(flatten)]
    subject: Subject,
    /// Seed of the start
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Duration in seconds, at most 3600; the episode ends earlier if the object falls
    #[arg(long, default_value_t = 20.0, value_parser = mvt_run::arguments::duration)]
    duration: f64,
    /// Print one JSON object instead of words
    #[arg(long)]
    json: bool,
    #[cfg(feature = "ros")]
    #[command(flatten)]
    robot: mvt_simulated_robot::command::RobotArguments,
}

/// The printed result: the outcome and the arguments that led to it.
#[derive(Debug, Serialize)]
struct Report<'a> {
    object: &'a str,
    gait: &'a str,
    side: Side,
    seed: u64,
    #[serde(flatten)]
    outcome: EpisodeOutcome,
}

/// Runs the command.
pub fn run(arguments: &SimulateArguments) -> Result<()> {
    #[cfg(feature = "ros")]
    if arguments.robot.ros.is_some() {
        let of = (arguments.seed, arguments.duration, arguments.json);
        return arguments.robot.run(&arguments.subject, of, crate::signals::stop_on_signals);
    }
    let rig = arguments.subject.manner.rig()?;
    let (object, controller) = arguments.subject.load(&rig)?;
    let config = EpisodeConfig {
        hand: rig.hand,
        gait: controller.gait,
        seed: arguments.seed,
        duration_s: arguments.duration,
        randomisation: Randomisation::default(),
    };
    let mut episode = match controller.mover {
        Some(mover) if mover.needs_touch() => bail!(
            "{}: it observes touch_depth, and `simulate` renders no touch images; play it with `run`",
            controller.name
        ),
        Some(mover) => Episode::moved_by(&object, &config, mover)?,
        None => Episode::new(&object, &config)?,
    };
    episode.follow(controller.schedule);
    episode.rehearse(PlaceErrors::default(), arguments.seed);
    let outcome = episode::run(&mut episode);
    let side = config.hand.side();
    let report = Report { object: &object.name, gait: &controller.name, side, seed: arguments.seed, outcome };
    if arguments.json {
        print_line(&serde_json::to_string(&report)?)
    } else {
        print_line(&in_words(&report, &config.hand))
    }
}

fn in_words(report: &Report<'_>, hand: &Hand) -> String {
    let EpisodeOutcome { survived_s, turned_rad, turn_rate_rad_s, .. } = report.outcome;
    let ended = match &report.outcome.end {
        End::Completed => "stayed in the hand".to_owned(),
        End::Dropped => "fell off the hand".to_owned(),
        End::Stopped => "was stopped".to_owned(),
        End::Uncontrolled(reason) | End::Unstable(reason) => reason.clone(),
    };
    let pads: Vec<String> = hand
        .pads()
        .iter()
        .zip(&report.outcome.per_pad_contact)
        .map(|(pad, contact)| format!("{} {:.0} %", pad.name, 100.0 * contact))
        .collect();
    let air = report.outcome.in_air.map_or(String::new(), |air| format!("\n{air}"));
    format!(
        "{} (gait {}, seed {}): {ended} for {survived_s:.1} s and turned {turned_rad:.1} rad ({turn_rate_rad_s:.2} rad/s)\n\
         touched {:.0} % of the time by {:.1} pads on average ({}), {:.2} mm deep; tilted {:.0} degrees at the end{air}",
        report.object,
        report.gait,
        report.seed,
        100.0 * report.outcome.any_contact_fraction,
        report.outcome.mean_pads_in_contact,
        pads.join(", "),
        report.outcome.penetration_mm,
        report.outcome.tilt_deg
    )
}
