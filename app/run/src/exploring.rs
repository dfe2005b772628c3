//! The supervisor of a simulated episode: with one controller, on a schedule, or exploring.

use anyhow::{Result, bail};
use mvt_gaits::axis::TurnAxis;
use mvt_gaits::controller_file::{ChosenController, is_path};
use mvt_gaits::gait;
use mvt_gaits::safe::{SafeController, safe_controllers};
use mvt_objects::object::Object;
use mvt_robot::hand::{Hand, Side};
use mvt_robot::rig::Placement;

use crate::controller::choose_controller;
use crate::explorer::{ExploreStrategy, Explorer, ExplorerOption};
use crate::supervisor::{Goal, Supervisor, SupervisorRules};

/// Chooses the first controller of an episode, and makes its supervisor. With a strategy it explores.
///
/// # Errors
/// If there is no such controller, or if the controller or the goal does not fit exploration.
pub fn direct(
    hand: &Hand,
    controller: &str,
    object: &Object,
    goal: Goal,
    camera: Option<&Placement>,
    rules: SupervisorRules,
    strategy: Option<ExploreStrategy>,
) -> Result<(ChosenController, Supervisor)> {
    let Some(strategy) = strategy else {
        if goal == Goal::Explored {
            bail!("--goal explored needs --explore");
        }
        let chosen = choose_controller(controller, object, hand)?;
        let supervisor = supervise(&chosen, hand.side(), goal, camera, rules);
        return Ok((chosen, supervisor));
    };
    if !matches!(goal, Goal::Time | Goal::Coverage(_) | Goal::Explored) {
        bail!("--goal {goal} needs a single axis, and --explore changes it; use --goal time, coverage=0.9 or explored");
    }
    // Explorers change between gaits.
    let controller = if controller == gait::AUTO { gait::SUITED } else { controller };
    let options = options(controller, object, hand)?;
    let chosen = match options.as_slice() {
        [(first, ..), _, ..] => choose_controller(first, object, hand)?,
        _ => choose_controller(controller, object, hand)?,
    };
    let options = options.into_iter().map(|(name, axis, rate_rad_s)| ExplorerOption {
        name,
        axis: axis.direction(hand.side()),
        rate_rad_s,
    });
    let explorer = Explorer::new(options.collect(), strategy, goal == Goal::Explored);
    // Changes of the axis move the object by plan, so that the supervisor neither pushes it back nor changes the gait.
    let rules = SupervisorRules { drift_begin_m: f64::INFINITY, ..rules };
    let axis = chosen.gait.axis.direction(hand.side());
    let supervisor = Supervisor::new(goal, axis, &[chosen.name.as_str()], rules).exploring(explorer);
    Ok((chosen, supervisor))
}

/// Makes the supervisor of one controller or schedule, which does not explore.
pub fn supervise(
    chosen: &ChosenController,
    side: Side,
    goal: Goal,
    camera: Option<&Placement>,
    mut rules: SupervisorRules,
) -> Supervisor {
    let ChosenController { name: controller, gait, schedule, .. } = chosen;
    // On a schedule the object changes its place and its axis by plan, so that the supervisor neither pushes nor changes.
    let is_scheduled = !schedule.is_empty();
    if is_scheduled {
        rules.drift_begin_m = f64::INFINITY;
    }
    if gait.feedback.is_some() {
        rules = rules.in_air();
    }
    let axis = gait.axis;
    // The supervisor can change between shipped gaits about one axis; no directive names a file.
    let others = gait::shipped().iter().filter(|(name, other)| *name != controller && other.follows(gait));
    let others = others.filter(|_| !is_scheduled && !is_path(controller)).map(|(name, _)| name.as_str());
    let gaits: Vec<&str> = std::iter::once(controller.as_str()).chain(others).collect();
    let goal = camera.map_or(goal, |camera| goal.facing(axis, camera));
    Supervisor::new(goal, axis.direction(side), &gaits, rules)
}

/// Returns the controllers among which an explorer chooses, the first one first, each with its axis and its rate.
fn options(controller: &str, object: &Object, hand: &Hand) -> Result<Vec<(String, TurnAxis, f64)>> {
    /// Rate that is assumed where none was measured, radians per second.
    const RATE_RAD_S: f64 = 0.7;
    if controller.contains(',') || is_path(controller) {
        bail!("--explore changes between strokes by name; give --controller auto or a stroke that `controllers` lists");
    }
    let safe = safe_controllers(object, hand);
    let first =
        if controller == gait::SUITED { safe.first() } else { safe.iter().find(|safe| safe.name == controller) };
    let Some(first) = first else {
        let (name, gait) = gait::choose(controller, object, hand)?;
        if gait.feedback.is_some() {
            bail!("--explore changes between controllers on the palm; {name} holds the object in the air");
        }
        tracing::warn!(
            "for {} no change from {name} to another controller is known to be safe; {name} plays alone",
            object.name
        );
        return Ok(vec![(name.to_owned(), gait.axis, RATE_RAD_S)]);
    };
    let others = safe.iter().filter(|safe| safe.name != first.name);
    let option = |safe: &SafeController| Ok((safe.name.clone(), gait::find(&safe.name)?.1.axis, safe.rate_rad_s));
    std::iter::once(first).chain(others).map(option).collect()
}
