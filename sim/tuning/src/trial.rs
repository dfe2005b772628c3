//! Trials: a gait, an object and a start in the simulator, and how far the object turned about each axis.

use std::sync::Arc;

use mvt_gaits::clock::{CONTROL_HZ, PHYSICS_HZ};
use mvt_gaits::controller::{Controller as _, Proprioception};
use mvt_gaits::gait::Gait;
use mvt_gaits::stroke::GaitController;
use mvt_objects::object::Object;
use mvt_physics::episode::{EpisodeStart, Randomisation, is_on_the_hand};
use mvt_physics::simulation::{Simulation, SimulationError};
use mvt_robot::hand::{Hand, JointAngles};
use nalgebra as na;
use serde::{Deserialize, Serialize};

use crate::air;

/// Conditions of a trial.
#[derive(Debug, Clone, PartialEq)]
pub struct TrialConditions {
    /// The hand.
    pub hand: Arc<Hand>,
    /// Longest duration, seconds.
    pub duration_s: f64,
    /// Integration steps per command. An episode makes [`EPISODE_STEPS`]; a search makes fewer, to be faster.
    pub steps: u32,
}

/// Integration steps per command in an episode.
pub const EPISODE_STEPS: u32 = PHYSICS_HZ / CONTROL_HZ;

/// Result of a trial.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct TrialResult {
    /// Time until the object fell or the trial ended, seconds.
    pub survived_s: f64,
    /// The object was on the hand at the end; in the air if the controller holds it there.
    pub alive: bool,
    /// Net angle about the gait's axis, radians.
    pub turned_rad: f64,
    /// Net angle about x, y and z of the world, radians.
    pub net_rad: [f64; 3],
    /// Net angle about the two axes at right angles to it together, radians.
    pub other_rad: f64,
    /// Length of the path that the orientation made about those two axes, radians: rocking counts.
    pub rocked_rad: f64,
    /// Mean number of pads that touched the object.
    pub pads: f64,
    /// In the air: share of the time in which something else than fingertips touched the object; `None` on the palm.
    pub touched_beside_tips: Option<f64>,
}

/// Runs a trial. The start is the one that an episode with this seed draws.
///
/// The angle is the sum over the control steps of the rotation between them. Rotation back counts against it, so that a
/// snap cannot gain anything.
///
/// # Errors
/// [`SimulationError`] if MuJoCo refuses the object.
pub fn run(
    gait: &Gait,
    object: &Object,
    seed: u64,
    conditions: &TrialConditions,
) -> Result<TrialResult, SimulationError> {
    // Why: notes/decisions/simulation.md, "Tuning counts the net angle".
    run_watched(gait, object, seed, conditions, |_| ())
}

/// As [`run`]; `watch` receives each command to the joints, unless the controller holds the object in the air.
pub(crate) fn run_watched(
    gait: &Gait,
    object: &Object,
    seed: u64,
    conditions: &TrialConditions,
    mut watch: impl FnMut(JointAngles),
) -> Result<TrialResult, SimulationError> {
    let &TrialConditions { ref hand, duration_s, steps } = conditions;
    let axis = gait.axis.direction(hand.side());
    if let Some(trial) = air::run(gait, object, hand, seed, duration_s, steps.max(1))? {
        let net = na::Vector3::from(trial.outcome.net_rad);
        let turned_rad = net.dot(&axis);
        return Ok(TrialResult {
            survived_s: trial.survived_s,
            alive: trial.alive,
            turned_rad,
            net_rad: trial.outcome.net_rad,
            other_rad: (net - axis * turned_rad).norm(),
            rocked_rad: trial.rocked_rad,
            pads: trial.pads,
            touched_beside_tips: Some(trial.outcome.touched_beside_tips),
        });
    }
    let mut simulation = simulation_at_start(gait, object, seed, conditions)?;
    let mut controller = GaitController::new(gait.clone(), Arc::clone(hand));
    let commands = (duration_s * f64::from(CONTROL_HZ)).round() as u32;
    let mut rotation = simulation.object_pose().untyped().rotation;
    let mut net = na::Vector3::zeros();
    let (mut rocked_rad, mut pads, mut done) = (0.0, 0, 0);
    let mut alive = true;
    while alive && done < commands {
        let time_s = f64::from(done) / f64::from(CONTROL_HZ);
        let targets = controller.command(&Proprioception::at(time_s, simulation.joints()));
        for _ in 0..steps.max(1) {
            simulation.step(&targets);
        }
        watch(targets);
        done += 1;
        let pose = simulation.object_pose();
        alive = simulation.fault().is_none() && is_on_the_hand(hand, &simulation.joints(), pose);
        if !alive {
            break;
        }
        let turn = (pose.untyped().rotation * rotation.inverse()).scaled_axis();
        rotation = pose.untyped().rotation;
        net += turn;
        rocked_rad += (turn - axis * turn.dot(&axis)).norm();
        pads += simulation.contacts().iter().filter(|pad| pad.is_touching()).count();
    }
    let turned_rad = net.dot(&axis);
    Ok(TrialResult {
        survived_s: f64::from(done) / f64::from(CONTROL_HZ),
        alive,
        turned_rad,
        net_rad: net.into(),
        other_rad: (net - axis * turned_rad).norm(),
        rocked_rad,
        pads: pads as f64 / f64::from(done.max(1)),
        touched_beside_tips: None,
    })
}

/// The simulation with hand and object where a trial begins.
pub(crate) fn simulation_at_start(
    gait: &Gait,
    object: &Object,
    seed: u64,
    conditions: &TrialConditions,
) -> Result<Simulation, SimulationError> {
    let mut start = EpisodeStart::draw(object, gait, &conditions.hand, &Randomisation::default(), seed);
    start.physics.timestep_s = 1.0 / f64::from(CONTROL_HZ * conditions.steps.max(1));
    let mut simulation = Simulation::new(&conditions.hand, object, &start.physics)?;
    simulation.reset(&start.joints, start.object);
    Ok(simulation)
}
