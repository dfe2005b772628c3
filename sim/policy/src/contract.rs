//! What a policy expects of the hand and the simulator that it moves: joints, drives, rate, observations and actions.

use mvt_gaits::axis::TurnAxis;
use mvt_gaits::clock::{CONTROL_HZ, PHYSICS_HZ};
use mvt_robot::hand::{Hand, Side};

use crate::fields::Fields;
use crate::term::ObservationTerm;

/// Fields that every policy needs.
const NEEDED: [&str; 10] = [
    "joint_names",
    "joint_stiffness",
    "joint_damping",
    "default_joint_pos",
    "action_scale",
    "observation_names",
    "observation_terms_scale",
    "observation_terms_clip",
    "observation_terms_history_length",
    "control_hz",
];
/// Fields that a policy may have.
const OPTIONAL: [&str; 15] = [
    "observation_terms_flatten_history_dim",
    "command_names",
    "run_path",
    "action",
    "action_clip",
    "history_order",
    "hand",
    "side",
    "axis",
    "start",
    "torque_limit_nm",
    "activation",
    "output_activation",
    "normaliser",
    "normaliser_clip",
];
/// Most past observations of a term.
const MOST_HISTORY: usize = 256;
/// Stiffest drive, Nm/rad, and most damping, Nm s/rad: beyond, the integration of a hand becomes unstable.
const STIFFEST: f64 = 1e3;
const MOST_DAMPING: f64 = 1e2;

/// Relation between actions and the angles at which the joints aim.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ActionKind {
    /// `default_joint_pos + action_scale * action`.
    Absolute,
    /// The angles before, changed by `action_scale * action`.
    Incremental,
    /// The angles at which the gait that suits the object aims, changed by `action_scale * action`.
    Correction,
}

/// Pose of the hand at the start of an episode.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PolicyStart {
    /// `default_joint_pos`.
    Default,
    /// The open hand of the gait that suits the object, with which our environments start.
    Suited,
}

/// Term of the observation.
#[derive(Debug, Clone, PartialEq)]
pub struct ObservedTerm {
    /// The quantity.
    pub term: ObservationTerm,
    /// Least and greatest value, before the scale.
    pub clip: [f64; 2],
    /// Factor of all numbers, or of each.
    pub scale: Vec<f64>,
    /// Number of instants, at least one.
    pub history: usize,
}

/// Contract of a policy. Lists over joints are in the order of the network, which may be any.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct PolicyContract {
    /// Names of the joints.
    pub joint_names: Vec<String>,
    /// Stiffness of the joints' position controllers, Nm/rad.
    pub joint_stiffness: Vec<f64>,
    /// Damping of the joints, Nm s/rad.
    pub joint_damping: Vec<f64>,
    /// Joint angles to which observations and actions relate, radians.
    pub default_joint_pos: Vec<f64>,
    /// Change of the aim of each joint by an action of 1, radians.
    pub action_scale: Vec<f64>,
    /// Relation between actions and aims.
    pub action: ActionKind,
    /// Greatest absolute value of an action that counts.
    pub action_clip: f64,
    /// Commands per second.
    pub control_hz: u32,
    /// The observation, term by term.
    pub observation: Vec<ObservedTerm>,
    /// In histories the newest instant comes first.
    pub newest_first: bool,
    /// Name of the hand; `None` if any hand with these joints will do.
    pub hand: Option<String>,
    /// Side of the hand; `None` for both.
    pub side: Option<Side>,
    /// Axis about which it turns the object on the right hand; `None` for that of the gait that suits the object.
    pub axis: Option<TurnAxis>,
    /// Pose of the hand at the start.
    pub start: PolicyStart,
    /// Limit of the joints' torque, Nm; `None` for that of the gait that suits the object.
    pub torque_limit_nm: Option<f64>,
}

impl PolicyContract {
    /// Returns the contract of the environments that turn an object: three instants of proprioception, the newest first, and actions from -1
    /// to 1 that change the aims by up to 1/24 rad, at 25 Hz the fastest stroke of the shipped gaits.
    pub fn turning(hand: &Hand, control_hz: u32) -> Self {
        let joints = hand.joints();
        let term = ObservationTerm::JointPosTargetUnit;
        Self {
            joint_names: joints.iter().map(|joint| joint.name.clone()).collect(),
            joint_stiffness: joints.iter().map(|joint| joint.drive.stiffness).collect(),
            joint_damping: joints.iter().map(|joint| joint.drive.damping).collect(),
            default_joint_pos: joints.iter().map(|joint| 0.0_f64.clamp(joint.range[0], joint.range[1])).collect(),
            action_scale: vec![1.0 / 24.0; joints.len()],
            action: ActionKind::Incremental,
            action_clip: 1.0,
            control_hz,
            observation: vec![ObservedTerm { term, clip: [-1.0, 1.0], scale: vec![1.0], history: 3 }],
            newest_first: true,
            hand: Some(hand.name().to_owned()),
            side: None,
            axis: None,
            start: PolicyStart::Suited,
            torque_limit_nm: None,
        }
    }

    /// Returns the same contract for a policy that also observes the object's place and the normal force on each pad, at three instants.
    pub fn sighted(hand: &Hand, control_hz: u32) -> Self {
        let observed = |term, clip, scale| ObservedTerm { term, clip, scale: vec![scale], history: 3 };
        let mut contract = Self::turning(hand, control_hz);
        // A tenth of a metre becomes 1, as does a newton.
        contract.observation.push(observed(ObservationTerm::ObjectPosition, [-1.0, 1.0], 10.0));
        contract.observation.push(observed(ObservationTerm::PadForce, [0.0, 10.0], 1.0));
        contract
    }

    /// Returns the same contract for a policy that corrects the gait that suits the object, by up to 0.2 rad for each joint, and also observes
    /// where the gait aims.
    pub fn correcting(hand: &Hand, control_hz: u32) -> Self {
        let term = ObservationTerm::GaitTargetUnit;
        let mut contract = Self::sighted(hand, control_hz);
        contract.observation.push(ObservedTerm { term, clip: [-1.0, 1.0], scale: vec![1.0], history: 3 });
        contract.action = ActionKind::Correction;
        contract.action_scale.fill(0.2);
        contract
    }

    /// Reads a contract for a hand.
    ///
    /// # Errors
    /// The first field that is missing, contradicts another one, or does not fit the hand or the simulator.
    pub(crate) fn read(fields: &Fields, hand: &Hand) -> Result<Self, String> {
        // All that is missing in one list is easier to repair than one after the other.
        let missing: Vec<&str> = NEEDED.into_iter().filter(|name| !fields.has(name)).collect();
        if !missing.is_empty() {
            return Err(format!(
                "{}: missing in the metadata; export it, or write it into a .toml file of the same name beside the policy",
                missing.join(", ")
            ));
        }
        let joint_names: Vec<String> = fields.words("joint_names")?.iter().map(|name| last_part(name)).collect();
        check_joints(&joint_names, hand)?;
        let of_joints = |name: &str| fields.numbers(name, joint_names.len(), "joints");
        let contract = Self {
            joint_stiffness: of_joints("joint_stiffness")?,
            joint_damping: of_joints("joint_damping")?,
            default_joint_pos: of_joints("default_joint_pos")?,
            action_scale: of_joints("action_scale")?,
            action: choice(
                fields,
                "action",
                &[
                    ("absolute", ActionKind::Absolute),
                    ("incremental", ActionKind::Incremental),
                    ("correction", ActionKind::Correction),
                ],
            )?,
            action_clip: match fields.has("action_clip") {
                true => within("action_clip", &fields.numbers("action_clip", 1, "limits")?, [1e-3, 1e3])?,
                false => f64::INFINITY,
            },
            control_hz: rate(fields)?,
            observation: observation(fields, hand)?,
            newest_first: choice(fields, "history_order", &[("oldest_first", false), ("newest_first", true)])?,
            hand: optional(fields, "hand")?,
            side: match fields.has("side") {
                true => Some(choice(fields, "side", &[("left", Side::Left), ("right", Side::Right)])?),
                false => None,
            },
            axis: optional(fields, "axis")?.map(|text| text.parse().map_err(|e| format!("axis: {e}"))).transpose()?,
            start: choice(fields, "start", &[("default", PolicyStart::Default), ("suited", PolicyStart::Suited)])?,
            torque_limit_nm: match fields.has("torque_limit_nm") {
                true => {
                    Some(within("torque_limit_nm", &fields.numbers("torque_limit_nm", 1, "limits")?, [0.01, 100.0])?)
                }
                false => None,
            },
            joint_names,
        };
        contract.check(hand)?;
        Ok(contract)
    }

    /// Returns the first field of a file beside a policy that nothing reads.
    pub(crate) fn unknown(fields: &Fields) -> Option<String> {
        let known: Vec<&str> = NEEDED.into_iter().chain(OPTIONAL).collect();
        fields.unknown(&known).map(|name| format!("{name}: there is no such field; choose of {}", known.join(", ")))
    }

    fn check(&self, hand: &Hand) -> Result<(), String> {
        let corrects = self.action == ActionKind::Correction;
        if !corrects && self.observation.iter().any(|observed| observed.term == ObservationTerm::GaitTargetUnit) {
            return Err("observation_names: gait_target_unit is for policies that correct a gait; write action = \"correction\", or leave it out".to_owned());
        }
        if corrects && (self.start == PolicyStart::Default || self.axis.is_some() || self.torque_limit_nm.is_some()) {
            return Err("axis, start and torque_limit_nm are those of the gait that a policy corrects; leave them out, and write start = \"suited\"".to_owned());
        }
        if corrects && self.control_hz != CONTROL_HZ {
            return Err(format!(
                "control_hz is {}; gaits, which this policy corrects, have {CONTROL_HZ} commands per second",
                self.control_hz
            ));
        }
        if let Some(name) = self.hand.as_deref().filter(|name| *name != hand.name()) {
            return Err(format!("hand: the policy was made for {name:?}; this is the hand {:?}", hand.name()));
        }
        if self.side.is_some_and(|side| side != hand.side()) {
            return Err("side: the policy was made for the other hand; give --side".to_owned());
        }
        for (k, name) in self.joint_names.iter().enumerate() {
            let at = |list: &[f64]| list.get(k..=k).unwrap_or_default().to_vec();
            let named = |field: &str| format!("{field}: that of joint {name}");
            within(&named("joint_stiffness"), &at(&self.joint_stiffness), [1e-3, STIFFEST])?;
            within(&named("joint_damping"), &at(&self.joint_damping), [0.0, MOST_DAMPING])?;
            within(&named("action_scale"), &at(&self.action_scale), [-10.0, 10.0])?;
            /// Rounding of metadata, which has three decimals.
            const ROUNDING: f64 = 1e-3;
            let range = hand.joints().iter().find(|joint| joint.name == *name).map_or([0.0; 2], |joint| joint.range);
            let [low, high] = range;
            within(&named("default_joint_pos"), &at(&self.default_joint_pos), [low - ROUNDING, high + ROUNDING])?;
        }
        Ok(())
    }

    /// Returns how many numbers the observation has.
    pub fn observation_size(&self, hand: &Hand) -> usize {
        self.observation.iter().map(|observed| observed.history * observed.term.size(hand)).sum()
    }

    /// Returns for each joint of the network which one of the hand it is.
    pub(crate) fn joint_order(&self, hand: &Hand) -> Vec<usize> {
        let index = |name: &String| hand.joints().iter().position(|joint| joint.name == *name);
        self.joint_names.iter().filter_map(index).collect()
    }
}

/// Returns the name of a joint without the entity in front, as in `robot/index_0`.
fn last_part(name: &str) -> String {
    name.rsplit('/').next().unwrap_or(name).to_owned()
}

fn check_joints(names: &[String], hand: &Hand) -> Result<(), String> {
    let own: Vec<&str> = hand.joints().iter().map(|joint| joint.name.as_str()).collect();
    let listed = || own.join(", ");
    if let Some(name) = names.iter().find(|name| !own.contains(&name.as_str())) {
        return Err(format!(
            "joint_names: the hand {} has no joint {name:?}; its joints are {}",
            hand.name(),
            listed()
        ));
    }
    if let Some((_, name)) =
        names.iter().enumerate().find(|(k, name)| names.iter().take(*k).any(|other| other == *name))
    {
        return Err(format!("joint_names: {name:?} stands there twice"));
    }
    match own.iter().find(|name| !names.iter().any(|other| other == *name)) {
        Some(name) => Err(format!("joint_names: joint {name:?} of the hand {} is missing", hand.name())),
        None => Ok(()),
    }
}

/// Returns a single number within a range.
fn within(name: &str, numbers: &[f64], [low, high]: [f64; 2]) -> Result<f64, String> {
    match numbers {
        [value] if (low..=high).contains(value) => Ok(*value),
        [value] => Err(format!("{name} is {value}; it must be from {low} to {high}")),
        _ => Err(format!("{name}: write one number")),
    }
}

fn optional(fields: &Fields, name: &str) -> Result<Option<String>, String> {
    if fields.has(name) { fields.word(name, "").map(Some) } else { Ok(None) }
}

/// Returns the value of a word; that of the first one if the field is not there.
fn choice<T: Copy>(fields: &Fields, name: &str, choices: &[(&str, T)]) -> Result<T, String> {
    let names: Vec<&str> = choices.iter().map(|(choice, _)| *choice).collect();
    let word = fields.word(name, names.first().copied().unwrap_or_default())?;
    let chosen = choices.iter().find(|(choice, _)| *choice == word);
    chosen.map(|(_, value)| *value).ok_or_else(|| format!("{name} is {word:?}; choose {}", names.join(" or ")))
}

fn rate(fields: &Fields) -> Result<u32, String> {
    let numbers = fields.numbers("control_hz", 1, "rates")?;
    let hz = within("control_hz", &numbers, [1.0, f64::from(PHYSICS_HZ)])?;
    let whole = hz as u32;
    if f64::from(whole) != hz || !PHYSICS_HZ.is_multiple_of(whole) {
        return Err(format!(
            "control_hz is {hz}; the simulator makes {PHYSICS_HZ} steps per second, so choose a divisor, such as 20, 25 or 50"
        ));
    }
    Ok(whole)
}

fn observation(fields: &Fields, hand: &Hand) -> Result<Vec<ObservedTerm>, String> {
    let names = fields.words("observation_names")?;
    if names.is_empty() {
        return Err("observation_names: the policy observes nothing".to_owned());
    }
    let history = fields.numbers("observation_terms_history_length", names.len(), "observations")?;
    if fields.has("observation_terms_flatten_history_dim") {
        let flat = fields.numbers("observation_terms_flatten_history_dim", names.len(), "observations")?;
        if flat.iter().zip(&history).any(|(flat, length)| *flat == 0.0 && *length > 1.0) {
            return Err(
                "observation_terms_flatten_history_dim: a history must be flattened; export the policy so".to_owned()
            );
        }
    }
    let (scales, clips) = (fields.lists("observation_terms_scale")?, fields.lists("observation_terms_clip")?);
    let all: Vec<f64> = clips.iter().flatten().copied().collect();
    let mut terms = Vec::new();
    for (k, (name, length)) in names.iter().zip(history).enumerate() {
        let term: ObservationTerm = name.parse()?;
        let of = |field: &str| format!("{field}: that of {name}");
        let scale = match scales.as_slice() {
            [one] => one,
            scales => scales.get(k).filter(|_| scales.len() == names.len()).ok_or_else(|| {
                format!("observation_terms_scale: it has {} entries for {} observations", scales.len(), names.len())
            })?,
        };
        if ![1, term.size(hand)].contains(&scale.len()) || scale.iter().any(|factor| !factor.is_finite()) {
            return Err(format!("{} must be one finite number or {}", of("observation_terms_scale"), term.size(hand)));
        }
        let clip = match (all.as_slice(), clips.get(k).map(Vec::as_slice)) {
            ([low, high], _) => [*low, *high],
            (_, Some([low, high])) if clips.len() == names.len() => [*low, *high],
            _ => return Err(format!("{} must be a least and a greatest value", of("observation_terms_clip"))),
        };
        if clip[0] > clip[1] {
            return Err(format!("{} has its least value above its greatest", of("observation_terms_clip")));
        }
        let length = within(&of("observation_terms_history_length"), &[length], [0.0, MOST_HISTORY as f64])?;
        if length.fract() != 0.0 {
            return Err(format!("{} is {length}; write a whole number", of("observation_terms_history_length")));
        }
        // mjlab's 0 means no history, which is one instant.
        terms.push(ObservedTerm { term, clip, scale: scale.clone(), history: (length as usize).max(1) });
    }
    Ok(terms)
}
