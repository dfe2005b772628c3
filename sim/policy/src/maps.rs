//! From the senses of the hand to the numbers that a network observes, and from its actions to the angles at which the joints aim.
//!
//! Environments and runs share these maps, so that the same weights move the hand alike in both, to the bit.

// Why: notes/decisions/simulation.md, "Environments and policies share the maps of observations and actions".

use std::collections::VecDeque;

use mvt_gaits::controller::Proprioception;
use mvt_gaits::feedback::STALE_S;
use mvt_gaits::feedback::SeenPlace;
use mvt_gaits::stroke::within_reach;
use mvt_robot::hand::{Drive, Hand, HandError, JointAngles, PerPad};
use mvt_robot::observation::Press;
use std::sync::Arc;

use crate::contract::{ActionKind, ObservedTerm, PolicyContract};
use crate::term::{ObservationTerm, TOUCH_GRID};

/// All that a policy may observe at an instant.
#[derive(Debug, Clone, Copy)]
pub struct PolicySenses<'a> {
    /// The hand's own senses.
    pub sensed: &'a Proprioception,
    /// Angles at which the joints of the hand aim, radians.
    pub targets: &'a [f64],
    /// Angles at which the gait aims that a policy corrects, radians; empty without one.
    pub gait_targets: &'a [f64],
    /// The action before, in the order of the network.
    pub action: &'a [f32],
    /// The last estimate of the object's place.
    pub place: Option<SeenPlace>,
    /// Mean indentation in the fields of [`TOUCH_GRID`] over each gel, millimetres; empty before the first touch image.
    pub touch_mm: &'a [f32],
}

/// Makes observations, and remembers those before.
#[derive(Debug, Clone)]
pub struct ObservationMap {
    hand: Arc<Hand>,
    order: Vec<usize>,
    default_pos: Vec<f64>,
    terms: Vec<ObservedTerm>,
    newest_first: bool,
    /// Instants of each term, the newest first.
    histories: Vec<VecDeque<Vec<f32>>>,
}

impl ObservationMap {
    /// Starts without a past: the first observation fills all histories, as mjlab's do.
    pub fn new(contract: &PolicyContract, hand: &Arc<Hand>) -> Self {
        Self {
            hand: Arc::clone(hand),
            order: contract.joint_order(hand),
            default_pos: contract.default_joint_pos.clone(),
            terms: contract.observation.clone(),
            newest_first: contract.newest_first,
            histories: vec![VecDeque::new(); contract.observation.len()],
        }
    }

    /// Adds an instant, and returns the observation: each term with its history. Values that are not finite become 0.
    pub fn observe(&mut self, senses: &PolicySenses<'_>) -> Vec<f32> {
        self.add(senses);
        self.observation()
    }

    /// Adds an instant.
    pub fn add(&mut self, senses: &PolicySenses<'_>) {
        for k in 0..self.terms.len() {
            let Some(observed) = self.terms.get(k) else { continue };
            let values = self.values(observed.term, senses);
            let instant = values.into_iter().enumerate().map(|(i, value)| {
                let scale = observed.scale.get(i).or(observed.scale.first()).copied().unwrap_or(1.0);
                let value = (value.clamp(observed.clip[0], observed.clip[1]) * scale) as f32;
                if value.is_finite() { value } else { 0.0 }
            });
            let (instant, length): (Vec<f32>, usize) = (instant.collect(), observed.history);
            if let Some(history) = self.histories.get_mut(k) {
                history.push_front(instant.clone());
                history.truncate(length);
                history.resize(length, instant);
            }
        }
    }

    /// Returns the observation of the last instant.
    pub fn observation(&self) -> Vec<f32> {
        let of_term = |history: &VecDeque<Vec<f32>>| -> Vec<f32> {
            if self.newest_first {
                history.iter().flatten().copied().collect()
            } else {
                history.iter().rev().flatten().copied().collect()
            }
        };
        self.histories.iter().flat_map(of_term).collect()
    }

    fn values(&self, term: ObservationTerm, senses: &PolicySenses<'_>) -> Vec<f64> {
        let PolicySenses { sensed, targets, gait_targets, action, place, touch_mm } = *senses;
        let ordered = |values: &[f64]| -> Vec<f64> {
            self.order.iter().map(|&j| values.get(j).copied().unwrap_or(0.0)).collect()
        };
        let relative = |values: &[f64]| -> Vec<f64> {
            ordered(values).iter().zip(&self.default_pos).map(|(angle, default)| angle - default).collect()
        };
        let unit = |values: &[f64]| -> Vec<f64> {
            let of = |&j: &usize| {
                let [low, high] = self.hand.joints().get(j).map_or([-1.0, 1.0], |joint| joint.range);
                2.0 * (values.get(j).copied().unwrap_or(low) - low) / (high - low) - 1.0
            };
            self.order.iter().map(of).collect()
        };
        match term {
            ObservationTerm::JointPos => relative(&sensed.joints),
            ObservationTerm::JointVel => ordered(&sensed.velocities),
            ObservationTerm::JointPosUnit => unit(&sensed.joints),
            ObservationTerm::JointTarget => relative(targets),
            ObservationTerm::JointTargetUnit => unit(targets),
            ObservationTerm::JointPosTargetUnit => [unit(&sensed.joints), unit(targets)].concat(),
            ObservationTerm::GaitTargetUnit => unit(gait_targets),
            ObservationTerm::Actions => {
                (0..self.order.len()).map(|k| action.get(k).map_or(0.0, |action| f64::from(*action))).collect()
            }
            ObservationTerm::PadContact => self.of_pads(sensed, |force_n| f64::from(u8::from(force_n > 0.0))),
            ObservationTerm::PadForce => self.of_pads(sensed, |force_n| force_n),
            ObservationTerm::TouchDepth => {
                let size = term.size(&self.hand);
                (0..size).map(|k| touch_mm.get(k).map_or(0.0, |mm| f64::from(*mm))).collect()
            }
            ObservationTerm::ObjectPose => place.map_or_else(|| vec![0.0; 9], |place| self.pose(&place)),
            ObservationTerm::ObjectPosition => {
                place.map_or_else(|| vec![0.0; 3], |place| self.palm_offset_m(&place).iter().copied().collect())
            }
            ObservationTerm::ObjectConfidence => {
                let fresh = place.filter(|place| sensed.time_s - place.time_s <= STALE_S);
                vec![fresh.map_or(0.0, |place| place.confidence)]
            }
            ObservationTerm::ProjectedGravity => direction(sensed.gravity),
            ObservationTerm::Command => direction(sensed.axis),
        }
    }

    fn of_pads(&self, sensed: &Proprioception, value: impl Fn(f64) -> f64) -> Vec<f64> {
        (0..self.hand.pads().len()).map(|pad| value(sensed.forces_n.get(pad).copied().unwrap_or(0.0))).collect()
    }

    fn palm_offset_m(&self, place: &SeenPlace) -> nalgebra::Vector3<f64> {
        place.middle_m - nalgebra::Vector3::from(self.hand.palm_centre_m().unwrap_or_default())
    }

    fn pose(&self, place: &SeenPlace) -> Vec<f64> {
        let rotation = place.orientation.to_rotation_matrix();
        let columns = (0..2).flat_map(|column| (0..3).map(move |row| (row, column)));
        self.palm_offset_m(place).iter().copied().chain(columns.map(|at| rotation[at])).collect()
    }
}

/// Returns a vector with length 1; zeros for one without a length.
fn direction(vector: [f64; 3]) -> Vec<f64> {
    let length = vector.iter().map(|x| x * x).sum::<f64>().sqrt();
    vector.iter().map(|x| if length > 0.0 { x / length } else { 0.0 }).collect()
}

/// Returns the mean indentation in the fields of [`TOUCH_GRID`] over each gel, row by row, millimetres; 0 from a sensor that delivered nothing.
pub fn pooled_touch_mm(presses: &PerPad<Option<Press>>) -> Vec<f32> {
    let [rows, columns] = TOUCH_GRID;
    let mut means = Vec::with_capacity(presses.len() * rows * columns);
    for press in presses {
        let mut sums = vec![(0.0_f32, 0_u32); rows * columns];
        if let Some(Press { indentation_mm, .. }) = press {
            let (height, width) = indentation_mm.dim();
            for ((y, x), mm) in indentation_mm.indexed_iter() {
                let field = (y * rows / height.max(1)) * columns + x * columns / width.max(1);
                if let Some((sum, count)) = sums.get_mut(field) {
                    *sum += mm;
                    *count += 1;
                }
            }
        }
        means.extend(sums.into_iter().map(|(sum, count)| sum / count.max(1) as f32));
    }
    means
}

/// Turns actions into the angles at which the joints aim.
#[derive(Debug, Clone)]
pub struct ActionMap {
    /// The hand with the drives of the contract.
    hand: Arc<Hand>,
    order: Vec<usize>,
    default_pos: Vec<f64>,
    scale: Vec<f64>,
    kind: ActionKind,
    clip: f64,
    torque_limit_nm: f64,
}

impl ActionMap {
    /// Serves a hand whose joints have this torque limit, Nm.
    ///
    /// # Errors
    /// [`HandError`] if the contract's drives are impossible.
    pub fn new(contract: &PolicyContract, hand: &Arc<Hand>, torque_limit_nm: f64) -> Result<Self, HandError> {
        let order = contract.joint_order(hand);
        let mut drives: Vec<Drive> = hand.joints().iter().map(|joint| joint.drive).collect();
        for (&j, (stiffness, damping)) in order.iter().zip(contract.joint_stiffness.iter().zip(&contract.joint_damping))
        {
            if let Some(drive) = drives.get_mut(j) {
                (drive.stiffness, drive.damping) = (*stiffness, *damping);
            }
        }
        Ok(Self {
            // Many environments share one hand.
            hand: match hand.joints().iter().map(|joint| &joint.drive).eq(&drives) {
                true => Arc::clone(hand),
                false => hand.with_drives(&drives)?,
            },
            order,
            default_pos: contract.default_joint_pos.clone(),
            scale: contract.action_scale.clone(),
            kind: contract.action,
            clip: contract.action_clip,
            torque_limit_nm,
        })
    }

    /// Returns the drives of the contract, in the order of the hand.
    pub fn drives(&self) -> Vec<Drive> {
        self.hand.joints().iter().map(|joint| joint.drive).collect()
    }

    /// Changes the angles at which the joints of the hand aim by an action in the order of the network, within the joints' limits.
    /// `gait_targets` are those of the gait that is corrected, if one is.
    pub fn apply(&self, action: &[f32], gait_targets: &[f64], targets: &mut JointAngles) {
        let of_joints = self.order.iter().zip(self.default_pos.iter().zip(&self.scale));
        for ((&j, (default, scale)), action) in of_joints.zip(action) {
            let change = scale * f64::from(*action).clamp(-self.clip, self.clip);
            if let Some(target) = targets.get_mut(j) {
                *target = match self.kind {
                    ActionKind::Absolute => default + change,
                    ActionKind::Incremental => *target + change,
                    ActionKind::Correction => gait_targets.get(j).unwrap_or(target) + change,
                };
            }
        }
        *targets = self.hand.within_ranges(targets);
    }

    /// Returns the angles as the drives get them: within the reach of the torque limit, as those of strokes.
    pub fn compliant(&self, targets: &[f64], measured: &[f64]) -> JointAngles {
        within_reach(&self.hand, self.torque_limit_nm, targets, measured)
    }
}
