//! Controllers that hold an object in the air: their parameters, and trials with them.
//!
//! The hand closes around a supported object; then the support is taken away. A trial sees the true place of the object with
//! errors and as late as a run sees the estimate.

use std::f64::consts::TAU;
use std::sync::Arc;

use mvt_gaits::axis::TurnAxis;
use mvt_gaits::clock::{CONTROL_HZ, FRAME_HZ};
use mvt_gaits::controller::{Controller as _, Proprioception};
use mvt_gaits::feedback::{FeedbackController, HANDED_OVER_S, PlaceFeedback};
use mvt_gaits::gait::Gait;
use mvt_objects::object::Object;
use mvt_physics::air::{AirOutcome, AirTally, PlaceErrors, Rehearsal};
use mvt_physics::episode::{EpisodeStart, Randomisation, is_on_the_hand};
use mvt_physics::simulation::{Simulation, SimulationError};
use mvt_robot::hand::{Hand, JointAngles};
use nalgebra as na;

use crate::pads::{damped_inverse, jacobian, named_joints, own_joints};
use crate::stroke::{self, StrokeParameters};

/// Number of phases of the table.
const PHASES: usize = 32;
/// Parts of the motion of a pad, in the order of its parameters.
const WAVES: [&str; 4] = ["sin", "cos", "sin2", "cos2"];
const AXES: [&str; 3] = ["x", "y", "z"];

/// Returns the names and scales of the parameters, in the order of a search vector: the period; the joint angles at which the
/// fingers aim; per pad its path, and its motion per displacement and per velocity of the object along each axis, and per sag of the
/// object summed over time.
pub(crate) fn parameters(hand: &Hand) -> Vec<(String, f64)> {
    let mut names = vec![("period_s".to_owned(), 0.15)];
    names.extend(named_joints(hand).map(|(name, _)| (format!("pose_{name}"), 0.05)));
    let parts =
        WAVES.into_iter().zip([0.004, 0.004, 0.002, 0.002]).chain([("gain", 0.4), ("damping", 0.04), ("lift", 0.3)]);
    for (part, scale) in parts {
        for pad in hand.pads() {
            names.extend(AXES.map(|axis| (format!("{part}_{}_{axis}", pad.name), scale)));
        }
    }
    names
}

/// Returns the controller of these parameters, which takes its start, its lowering and the joint angles of the grasp, at which
/// pads move as the parameters say, from another one. A joint that moves no pad stays as in that one. `None` if it has no feedback.
pub fn gait(params: &StrokeParameters, hand: &Hand, from: &Gait, axis: TurnAxis, description: &str) -> Option<Gait> {
    let feedback = from.feedback.as_deref()?;
    let params: StrokeParameters = params.iter().map(|(name, value)| (name.clone(), stroke::rounded(*value))).collect();
    let p = |name: &str| -> f64 { params.get(name).copied().unwrap_or(0.0) };
    let joints = hand.joints().len();
    let all = |angles: Option<&JointAngles>| -> JointAngles {
        let mut angles = angles.cloned().unwrap_or_default();
        angles.resize(joints, 0.0);
        angles
    };
    let (mut grasp, mut touching) = (all(Some(&feedback.grasp)), all(feedback.touching.as_ref()));
    for (name, j) in named_joints(hand) {
        grasp[j] = p(&format!("pose_{name}"));
        touching[j] = p(&format!("touching_{name}"));
    }
    let mut gains = vec![[0.0; 3]; joints];
    let (mut damping, mut lift) = (gains.clone(), gains.clone());
    let mut table = vec![grasp.clone(); PHASES];
    for (pad, touch) in hand.pads().iter().enumerate() {
        let inverse = damped_inverse(&jacobian(hand, pad, &touching));
        let part = |name: &str| na::Vector3::from(AXES.map(|axis| p(&format!("{name}_{}_{axis}", touch.name))));
        let [sine, cosine, sine2, cosine2] = WAVES.map(part);
        let [gain, damp] = ["gain", "damping"].map(|name| &inverse * na::Matrix3::from_diagonal(&part(name)));
        for (k, j) in own_joints(hand, pad) {
            // Only the sag counts, which grows with the weight.
            lift[j] = [0.0, 0.0, stroke::rounded((&inverse * part("lift"))[k])];
            gains[j] = std::array::from_fn(|axis| stroke::rounded(gain[(k, axis)]));
            damping[j] = std::array::from_fn(|axis| stroke::rounded(damp[(k, axis)]));
            for (row, joints) in table.iter_mut().enumerate() {
                let phase = TAU * row as f64 / PHASES as f64;
                let tip = sine * phase.sin()
                    + cosine * phase.cos()
                    + sine2 * (2.0 * phase).sin()
                    + cosine2 * (2.0 * phase).cos();
                joints[j] = stroke::rounded(grasp[j] + (&inverse * tip)[k]);
            }
        }
    }
    let touching = feedback.touching.as_ref().map(|_| touching);
    Some(Gait {
        description: description.to_owned(),
        period_s: stroke::rounded(p("period_s").clamp(0.4, 4.0)),
        axis,
        table,
        feedback: Some(Box::new(PlaceFeedback { grasp, touching, gains, damping, lift, ..feedback.clone() })),
        params,
        ..from.clone()
    })
}

/// Returns the controller that holds as another one does, but with pads that neither move nor follow the object.
pub(crate) fn still(from: &Gait, hand: &Hand) -> Gait {
    let mut params = stroke::parameters_of(from, hand);
    params.retain(|name, _| ["period_s", "pose_", "touching_"].iter().any(|kept| name.starts_with(kept)));
    Gait { params, ..from.clone() }
}

/// Result of a trial in the air.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AirTrial {
    /// Time from the hand-over until the object was no longer in the air, or the trial ended, seconds.
    pub survived_s: f64,
    /// The object was in the air at the end.
    pub alive: bool,
    /// How it was held.
    pub outcome: AirOutcome,
    /// Length of the path of the orientation about axes other than the gait's, radians.
    pub rocked_rad: f64,
    /// Mean number of pads that touched the object.
    pub pads: f64,
}

/// Runs a trial of a gait with feedback from a start that an episode with this seed draws, for `duration_s` seconds after the
/// hand-over, with so many integration steps per command. It ends when the object is no longer in the air. `None` if the gait
/// has no feedback.
///
/// # Errors
/// [`SimulationError`] if MuJoCo refuses the object.
pub fn run(
    gait: &Gait,
    object: &Object,
    hand: &Arc<Hand>,
    seed: u64,
    duration_s: f64,
    steps: u32,
) -> Result<Option<AirTrial>, SimulationError> {
    let Some(mut controller) = FeedbackController::new(gait, hand) else { return Ok(None) };
    let mut start = EpisodeStart::draw(object, gait, hand, &Randomisation::default(), seed);
    start.physics.timestep_s = 1.0 / f64::from(CONTROL_HZ * steps);
    let mut simulation = Simulation::new(hand, object, &start.physics)?;
    simulation.reset(&start.joints, start.object);
    let mut rehearsal = Rehearsal::new(PlaceErrors::default(), seed);
    let mut air = AirTally::new(object, hand, &start.joints);
    let axis = gait.axis.direction(hand.side());
    let supported = (HANDED_OVER_S * f64::from(CONTROL_HZ)).round() as u32;
    let last = supported + (duration_s * f64::from(CONTROL_HZ)).round() as u32;
    let frames = |ticks: u32| ticks * FRAME_HZ / (CONTROL_HZ * steps);
    let (mut command, mut pads, mut rocked_rad, mut alive) = (0, 0, 0.0, true);
    let mut rotation = start.object.untyped().rotation;
    while alive && command < last {
        let time_s = f64::from(command) / f64::from(CONTROL_HZ);
        let is_supported = command < supported;
        let targets = controller.command(&Proprioception::at(time_s, simulation.joints()));
        for tick in command * steps..(command + 1) * steps {
            if is_supported {
                simulation.support(start.object);
            }
            simulation.step(&targets);
            let is_frame = frames(tick + 1) > frames(tick);
            let time_s = f64::from(tick + 1) / f64::from(CONTROL_HZ * steps);
            if let Some(place) = rehearsal.step(is_frame.then(|| (time_s, simulation.object_pose()))) {
                controller.rehearse(place);
            }
        }
        command += 1;
        if is_supported {
            continue;
        }
        let pose = simulation.object_pose();
        air.add(pose, simulation.touches_beside_fingertips());
        let turn = (pose.untyped().rotation * rotation.inverse()).scaled_axis();
        rotation = pose.untyped().rotation;
        rocked_rad += (turn - axis * turn.dot(&axis)).norm();
        pads += simulation.contacts().iter().filter(|pad| pad.is_touching()).count();
        let is_held = match hand.palm_centre_m() {
            Some(_) => air.outcome(None).least_height_mm >= AirOutcome::IN_AIR_MM,
            None => is_on_the_hand(hand, &simulation.joints(), pose),
        };
        alive = simulation.fault().is_none() && is_held;
    }
    let held = command.saturating_sub(supported);
    Ok(Some(AirTrial {
        survived_s: f64::from(held) / f64::from(CONTROL_HZ),
        alive,
        outcome: air.outcome(controller.lowered_at_s()),
        rocked_rad,
        pads: pads as f64 / f64::from(held.max(1)),
    }))
}
