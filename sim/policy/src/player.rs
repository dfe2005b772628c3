//! The controller that plays a policy.

use std::sync::Arc;

use mvt_gaits::controller::{Controller, Proprioception};
use mvt_gaits::directed::DirectedController;
use mvt_gaits::directive::Directive;
use mvt_gaits::feedback::{EstimatedPlace, RehearsedPlace, SeenPlace};
use mvt_gaits::gait::{Gait, UnknownGait};
use mvt_robot::hand::{Drive, Hand, HandError, JointAngles, PerPad};
use mvt_robot::observation::Press;

use crate::maps::{ActionMap, ObservationMap, PolicySenses, pooled_touch_mm};
use crate::policy::Policy;
use crate::term::ObservationTerm;

/// Controller that plays a policy. Of a supervisor's directives it obeys those that hold the fingers and let them go; the gait that a policy
/// corrects obeys all that change a gait.
#[derive(Debug, Clone)]
pub struct PolicyController {
    policy: Arc<Policy>,
    observations: ObservationMap,
    actions: ActionMap,
    /// Plays the gait that the policy corrects, if it does.
    corrected: Option<DirectedController>,
    /// What the network remembers.
    state: Vec<Vec<f32>>,
    /// Angles at which the joints aim; `None` before the first command.
    targets: Option<JointAngles>,
    action: Vec<f32>,
    place: Option<SeenPlace>,
    touch_mm: Vec<f32>,
    is_held: bool,
    fault: Option<String>,
}

impl PolicyController {
    /// Starts a policy on a hand with the gait of [`Policy::start`]: it sets the torque limit, and a policy of corrections corrects it.
    ///
    /// # Errors
    /// [`HandError`] if the contract's drives are impossible.
    pub fn new(policy: &Arc<Policy>, hand: &Arc<Hand>, gait: &Gait) -> Result<Self, HandError> {
        let contract = policy.contract();
        Ok(Self {
            observations: ObservationMap::new(contract, hand),
            actions: ActionMap::new(contract, hand, gait.torque_limit_nm)?,
            corrected: policy.corrects().then(|| DirectedController::new(gait, hand)),
            state: policy.first_state(),
            targets: None,
            action: vec![0.0; contract.joint_names.len()],
            place: None,
            touch_mm: Vec::new(),
            is_held: false,
            fault: None,
            policy: Arc::clone(policy),
        })
    }

    fn observes(&self, terms: &[ObservationTerm]) -> bool {
        self.policy.contract().observation.iter().any(|observed| terms.contains(&observed.term))
    }
}

impl Controller for PolicyController {
    fn command(&mut self, sensed: &Proprioception) -> JointAngles {
        let mut targets = self.targets.take().unwrap_or_else(|| sensed.joints.clone());
        let gait_targets = self.corrected.as_mut().map(|gait| gait.command(sensed)).unwrap_or_default();
        if !self.is_held && self.fault.is_none() {
            let senses = PolicySenses {
                sensed,
                targets: &targets,
                gait_targets: &gait_targets,
                action: &self.action,
                place: self.place,
                touch_mm: &self.touch_mm,
            };
            let observation = self.observations.observe(&senses);
            match self.policy.act(&observation, &mut self.state) {
                Ok(action) => {
                    self.actions.apply(&action, &gait_targets, &mut targets);
                    self.action = action;
                }
                Err(reason) => self.fault = Some(reason),
            }
        }
        let command = self.actions.compliant(&targets, &sensed.joints);
        self.targets = Some(targets);
        command
    }

    fn copy(&self) -> Box<dyn Controller> {
        Box::new(self.clone())
    }

    fn rate_hz(&self) -> u32 {
        self.policy.contract().control_hz
    }

    fn drives(&self) -> Option<Vec<Drive>> {
        Some(self.actions.drives())
    }

    fn needs_place(&self) -> bool {
        self.observes(&[
            ObservationTerm::ObjectPose,
            ObservationTerm::ObjectPosition,
            ObservationTerm::ObjectConfidence,
        ])
    }

    fn see(&mut self, place: EstimatedPlace) {
        self.place = Some(place.seen());
    }

    fn rehearse(&mut self, place: RehearsedPlace) {
        self.place = Some(place.seen());
    }

    fn needs_forces(&self) -> bool {
        self.observes(&[ObservationTerm::PadContact, ObservationTerm::PadForce])
    }

    fn needs_touch(&self) -> bool {
        self.observes(&[ObservationTerm::TouchDepth])
    }

    fn feel(&mut self, presses: &PerPad<Option<Press>>) {
        self.touch_mm = pooled_touch_mm(presses);
    }

    fn obey(&mut self, directive: &Directive) -> Result<(), UnknownGait> {
        if let Some(gait) = &mut self.corrected {
            gait.obey(directive)?;
        }
        self.is_held = *directive == Directive::Hold;
        Ok(())
    }

    fn fault(&self) -> Option<String> {
        self.fault.clone()
    }
}
