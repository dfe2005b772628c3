//! Choice of the controller of an episode.

use std::path::Path;
use std::sync::Arc;

use anyhow::{Result, bail};
use mvt_gaits::controller_file::{self, CORRECTED, ChosenController, is_policy};
use mvt_gaits::gait::{AUTO, SUITED};
use mvt_gaits::schedule::Schedule;
use mvt_objects::catalogue;
use mvt_objects::object::Object;
use mvt_policy::{Policy, PolicyController};
use mvt_robot::hand::Hand;

/// Chooses the controller of a hand for an object by name, file, schedule, policy, `suited` or `auto`, and warns if the object does not have the size
/// for which it was tuned. `suited` is the gait that suits the object; `auto` too, but where the carried policy corrects it to advantage, that policy.
///
/// # Errors
/// If there is no such controller, or the choice is left open and the object may fall.
pub fn choose_controller(controller: &str, object: &Object, hand: &Hand) -> Result<ChosenController> {
    let chosen = choose_any(controller, object, hand)?;
    match &chosen.misfit {
        Some(misfit) if chosen.falls => {
            bail!("{misfit}; to try it all the same, name a controller, such as --controller shared")
        }
        Some(misfit) => tracing::warn!("{misfit}"),
        None => (),
    }
    Ok(chosen)
}

/// Does the same without a warning, also if the choice is left open and the object may fall.
///
/// # Errors
/// If there is no such controller.
pub fn choose_any(controller: &str, object: &Object, hand: &Hand) -> Result<ChosenController> {
    if is_policy(controller) && !controller.contains(',') {
        return policy(controller, object, hand);
    }
    let chosen = controller_file::choose_all(controller, object, hand)?;
    // It was trained for a gait of one hand on the palm, and does no better than strokes that were tuned for an object.
    let may_be_corrected =
        controller == AUTO && !chosen.falls && chosen.gait.feedback.is_none() && catalogue::find(&object.name).is_err();
    let corrected = if may_be_corrected { policy(CORRECTED, object, hand).ok() } else { None };
    Ok(corrected.unwrap_or(chosen))
}

/// Returns the SHA-256 of a policy with the file beside it.
fn sha256(file: &Path) -> Result<String> {
    let (weights, contract) = Policy::files(file)?;
    Ok(mvt_pinned::sha256_of(&[weights.as_slice(), contract.as_bytes()].concat()))
}

/// Reads a policy. What its contract leaves open is that of the gait that suits the object.
fn policy(file: &str, object: &Object, hand: &Hand) -> Result<ChosenController> {
    let policy = Policy::read(Path::new(file), hand)?;
    policy.notes().iter().for_each(|note| tracing::warn!("{file}: {note}"));
    let suited = controller_file::choose(SUITED, object, hand).ok();
    let gait = suited.as_ref().map(|chosen| &chosen.gait);
    if policy.corrects() && gait.is_none_or(|gait| gait.feedback.is_some()) {
        bail!("{file} corrects the gait that suits an object on the palm, and no gait suits {}", object.name);
    }
    let gait = policy.start(gait, hand);
    // Corrections may not suit an object that the gait does not.
    let misfit = suited.filter(|_| policy.corrects()).and_then(|chosen| chosen.misfit);
    let mover = PolicyController::new(&policy, &Arc::new(hand.clone()), &gait)?;
    Ok(ChosenController {
        name: file.to_owned(),
        gait,
        mover: Some(Box::new(mover)),
        policy_sha256: Some(sha256(Path::new(file))?),
        schedule: Schedule::default(),
        misfit,
        falls: false,
    })
}

#[cfg(test)]
mod tests {
    use mvt_robot::hand::Side;

    use super::*;
    use crate::object::load_object;

    #[test]
    fn auto_plays_the_carried_policy_where_it_does_better_than_the_gait() {
        let (left, right) = (Hand::allegro(Side::Left), Hand::allegro(Side::Right));
        let stranger = load_object("random:204").unwrap();
        let name = |controller, object: &Object, hand| choose_any(controller, object, hand).unwrap().name;
        assert_eq!(name(AUTO, &stranger, &left), CORRECTED);
        let gait = name(SUITED, &stranger, &left);
        assert_ne!(gait, CORRECTED);
        // The policy was trained for the left hand, and strokes were tuned for the catalogue.
        assert_eq!(name(AUTO, &stranger, &right), gait);
        let known = load_object("cube70").unwrap();
        assert_eq!(name(AUTO, &known, &left), name(SUITED, &known, &left));
        // It lets fall what the gait would.
        let heavy = Object { mass_kg: 5.0, ..stranger };
        for controller in [AUTO, SUITED] {
            let refused = choose_controller(controller, &heavy, &left).unwrap_err().to_string();
            assert!(refused.contains("too heavy"), "{refused}");
        }
    }
}
