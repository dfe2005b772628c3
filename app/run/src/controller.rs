//! Choice of the controller of an episode.

use std::path::Path;
use std::sync::Arc;

use anyhow::{Result, bail};
use mvt_gaits::controller_file::{self, ChosenController, is_policy};
use mvt_gaits::gait::AUTO;
use mvt_gaits::schedule::Schedule;
use mvt_objects::object::Object;
use mvt_policy::{Policy, PolicyController};
use mvt_robot::hand::Hand;

/// Chooses the controller of a hand for an object by name, file, schedule, policy or `auto`, and warns if the object does not have the size for which
/// it was tuned.
///
/// # Errors
/// If there is no such controller, or the choice is left to `auto` and the object may fall.
pub fn choose_controller(controller: &str, object: &Object, hand: &Hand) -> Result<ChosenController> {
    if is_policy(controller) {
        return policy(controller, object, hand);
    }
    let chosen = controller_file::choose_all(controller, object, hand)?;
    match &chosen.misfit {
        Some(misfit) if chosen.falls => {
            bail!("{misfit}; to try it all the same, name a controller, such as --controller shared")
        }
        Some(misfit) => tracing::warn!("{misfit}"),
        None => (),
    }
    Ok(chosen)
}

/// Reads a policy. What its contract leaves open is that of the gait that suits the object.
fn policy(file: &str, object: &Object, hand: &Hand) -> Result<ChosenController> {
    let policy = Policy::read(Path::new(file), hand)?;
    policy.notes().iter().for_each(|note| tracing::warn!("{file}: {note}"));
    let suited = controller_file::choose(AUTO, object, hand).ok();
    let gait = policy.start(suited.as_ref().map(|chosen| &chosen.gait), hand);
    let mover = PolicyController::new(&policy, &Arc::new(hand.clone()), gait.torque_limit_nm)?;
    Ok(ChosenController {
        name: file.to_owned(),
        gait,
        mover: Some(Box::new(mover)),
        schedule: Schedule::default(),
        misfit: None,
        falls: false,
    })
}
