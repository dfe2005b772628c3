//! Scores of learnt policies, as those of strokes.

use std::path::Path;

use anyhow::{Result, bail};
use mvt_gaits::axis::TurnAxis;
use mvt_gaits::clock::{CONTROL_HZ, PHYSICS_HZ};
use mvt_objects::object::Object;
use mvt_physics::air::PlaceErrors;
use mvt_physics::episode::{End, Episode, EpisodeConfig, Randomisation};
use mvt_robot::hand::Hand;
use mvt_run::controller::choose_controller;
use mvt_tuning::search::GaitScore;
use mvt_tuning::seeds;
use mvt_tuning::trial::TrialResult;
use nalgebra as na;
use rayon::prelude::*;
use std::sync::Arc;

/// Plays a policy from the first `starts` starts that no search and no training has seen, in parallel. The score is that of `hand score`.
///
/// # Errors
/// If the file is no policy for the hand, observes what nothing senses here, or MuJoCo refuses the object.
pub(crate) fn measure(
    file: &Path,
    object: &Object,
    hand: &Arc<Hand>,
    starts: u64,
    duration_s: f64,
) -> Result<(TurnAxis, GaitScore)> {
    let name = file.to_string_lossy();
    let chosen = choose_controller(&name, object, hand)?;
    let Some(mover) = chosen.mover else { bail!("{name}: a policy ends in .onnx or .safetensors") };
    if mover.needs_touch() {
        bail!("{name}: it observes touch_depth, which nothing measures here; play it with `run`");
    }
    let axis = chosen.gait.axis.direction(hand.side());
    let play = |place: u64| -> Result<TrialResult> {
        let config = EpisodeConfig {
            hand: Arc::clone(hand),
            gait: chosen.gait.clone(),
            seed: seeds::held_out().at(place),
            duration_s,
            randomisation: Randomisation::default(),
        };
        let mut episode = Episode::moved_by(object, &config, mover.clone())?;
        episode.rehearse(PlaceErrors::default(), config.seed);
        let rotation = |episode: &Episode| episode.simulation().object_pose().untyped().rotation;
        let (mut before, mut net, mut rocked_rad) = (rotation(&episode), na::Vector3::zeros(), 0.0);
        let (mut pads, mut samples) = (0, 0_u32);
        while episode.end().is_none() {
            episode.advance(PHYSICS_HZ / CONTROL_HZ, None);
            if !matches!(episode.end(), None | Some(End::Completed)) {
                break;
            }
            let now = rotation(&episode);
            let turn = (now * before.inverse()).scaled_axis();
            before = now;
            net += turn;
            rocked_rad += (turn - axis * turn.dot(&axis)).norm();
            pads += episode.simulation().contacts().iter().filter(|pad| pad.is_touching()).count();
            samples += 1;
        }
        let turned_rad = net.dot(&axis);
        Ok(TrialResult {
            survived_s: episode.time_s(),
            alive: episode.end() == Some(&End::Completed),
            turned_rad,
            net_rad: net.into(),
            other_rad: (net - axis * turned_rad).norm(),
            rocked_rad,
            pads: pads as f64 / f64::from(samples.max(1)),
            touched_beside_tips: None,
        })
    };
    let results = (0..starts).into_par_iter().map(play).collect::<Result<Vec<TrialResult>>>()?;
    Ok((chosen.gait.axis, GaitScore::of(&object.name, &results, duration_s)))
}
