//! Speed of trials beside bare steps of MuJoCo.

use std::sync::Arc;
use std::time::Instant;

use mvt_gaits::gait::Gait;
use mvt_objects::object::Object;
use mvt_physics::simulation::SimulationError;
use mvt_robot::hand::{Hand, JointAngles};
use rayon::prelude::*;
use serde::Serialize;

use crate::search::SEARCH_STEPS;
use crate::seeds;
use crate::trial::{TrialConditions, run, run_watched, simulation_at_start};

/// Integration steps per second of the search, and of MuJoCo alone.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct SearchSpeed {
    /// Integration steps of a round.
    pub steps: u64,
    /// Steps per second of trials as the search makes them: the model is built, the start drawn, the result counted.
    pub search_steps_per_s: f64,
    /// Steps per second of the same commands, played to simulations that are ready at the same starts.
    pub bare_steps_per_s: f64,
}

/// Times `rounds` rounds of trials on as many starts of the search, in turns with the same steps of MuJoCo alone, on all threads of the
/// present pool. Each figure is that of the fastest round.
///
/// # Errors
/// [`SimulationError`] if MuJoCo refuses the object.
pub fn measure(
    gait: &Gait,
    object: &Object,
    hand: &Arc<Hand>,
    starts: u64,
    duration_s: f64,
    rounds: u32,
) -> Result<SearchSpeed, SimulationError> {
    let conditions = TrialConditions { hand: Arc::clone(hand), duration_s, steps: SEARCH_STEPS };
    let seeds: Vec<u64> = (0..starts).map(|place| seeds::tuning().at(place)).collect();
    let commands = seeds.par_iter().map(|&seed| {
        let mut commands = Vec::new();
        run_watched(gait, object, seed, &conditions, |targets| commands.push(targets))?;
        Ok(commands)
    });
    let commands: Vec<Vec<JointAngles>> = commands.collect::<Result<_, SimulationError>>()?;
    let steps = u64::from(SEARCH_STEPS) * commands.iter().map(|commands| commands.len() as u64).sum::<u64>();
    let (mut search_s, mut bare_s) = (f64::INFINITY, f64::INFINITY);
    for _ in 0..rounds {
        let begun = Instant::now();
        seeds.par_iter().try_for_each(|&seed| run(gait, object, seed, &conditions).map(|_| ()))?;
        search_s = search_s.min(begun.elapsed().as_secs_f64());
        let ready = seeds.par_iter().map(|&seed| simulation_at_start(gait, object, seed, &conditions));
        let mut ready = ready.collect::<Result<Vec<_>, _>>()?;
        let begun = Instant::now();
        ready.par_iter_mut().zip(&commands).for_each(|(simulation, commands)| {
            for targets in commands {
                (0..SEARCH_STEPS).for_each(|_| simulation.step(targets));
            }
        });
        bare_s = bare_s.min(begun.elapsed().as_secs_f64());
    }
    let per_s = |seconds: f64| steps as f64 / seconds;
    Ok(SearchSpeed { steps, search_steps_per_s: per_s(search_s), bare_steps_per_s: per_s(bare_s) })
}
