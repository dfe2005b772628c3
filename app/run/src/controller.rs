//! Choice of the controller of an episode.

use anyhow::{Result, bail};
use mvt_gaits::controller_file::{self, ChosenController};
use mvt_objects::object::Object;
use mvt_robot::hand::Hand;

/// Chooses the controller of a hand for an object by name, file, schedule or `auto`, and warns if the object does not have the size for which
/// it was tuned.
///
/// # Errors
/// If there is no such controller, or the choice is left to `auto` and the object may fall.
pub fn choose_controller(controller: &str, object: &Object, hand: &Hand) -> Result<ChosenController> {
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
