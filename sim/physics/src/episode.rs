//! Episodes: a randomised start, the controller in the loop, and the conditions that end them.

use std::sync::Arc;

use mvt_frames::{Isometry, Object as ObjectFrame, Vector, World as WorldFrame};
use mvt_gaits::clock::{FRAME_HZ, PHYSICS_HZ};
use mvt_gaits::controller::{Controller, Proprioception};
use mvt_gaits::directed::DirectedController;
use mvt_gaits::directive::Directive;
use mvt_gaits::feedback::{EstimatedPlace, HANDED_OVER_S, RehearsedPlace};
use mvt_gaits::gait;
use mvt_gaits::gait::{Gait, UnknownGait};
use mvt_gaits::schedule::{Schedule, TiltChange};
use mvt_objects::object::Object;
use mvt_robot::hand::{Hand, JointAngles, PerPad};
use mvt_robot::observation::{Press, SceneState};
use nalgebra as na;
use serde::{Deserialize, Serialize};

use crate::air::{AirOutcome, AirTally, PlaceErrors, Rehearsal};
use crate::shear::GelShears;
use crate::simulation::{PadContact, Simulation, SimulationError, SimulationState};

pub use crate::start::{EpisodeStart, Randomisation};

/// Reason for the end of an episode.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", tag = "reason", content = "detail")]
pub enum End {
    /// The duration was reached.
    Completed,
    /// The object fell off the palm.
    Dropped,
    /// The supervisor stopped the episode.
    Stopped,
    /// The controller failed, with the details.
    Uncontrolled(String),
    /// The physics became unstable, with the details.
    Unstable(String),
}

/// True state at the instant of one camera frame.
#[derive(Debug, Clone, PartialEq)]
pub struct EpisodeState {
    /// Hand and object.
    pub scene: SceneState,
    /// Contact of each pad with the object.
    pub pads: PerPad<PadContact>,
}

/// Configuration of an episode.
#[derive(Debug, Clone)]
pub struct EpisodeConfig {
    /// The hand. The gait must be one for it; joints for which the gait has no angle rest.
    pub hand: Arc<Hand>,
    /// Gait of the controller, which also sets gravity, torque limit and start.
    pub gait: Gait,
    /// Seed of the start.
    pub seed: u64,
    /// Longest duration, seconds.
    pub duration_s: f64,
    /// Randomisation of the start.
    pub randomisation: Randomisation,
}

/// State of a running episode. A restored episode continues bit for bit.
#[derive(Debug, Clone)]
pub struct EpisodeSnapshot {
    /// Shows to which episode it belongs.
    start: EpisodeStart,
    simulation: SimulationState,
    controller: Box<dyn Controller>,
    target: JointAngles,
    plan: Plan,
    gravity: [f64; 3],
    rehearsal: Option<Rehearsal>,
    air: Option<AirTally>,
    shears: GelShears,
    tick: u64,
    turned_rad: f64,
    end: Option<End>,
}

/// The controller of now, and the change to it.
#[derive(Debug, Clone)]
struct Plan {
    /// Number of changes that the schedule has made.
    changes: usize,
    /// Axis about which the gait turns the object, in the world.
    turn_axis: na::Vector3<f64>,
    /// Turn of gravity that is under way, and the integration step in which it began.
    tilting: Option<(TiltChange, u64)>,
}

/// Running episode.
pub struct Episode {
    simulation: Simulation,
    controller: Box<dyn Controller>,
    start: EpisodeStart,
    hand: Arc<Hand>,
    schedule: Schedule,
    target: JointAngles,
    plan: Plan,
    /// Shows the true place to a controller that holds the object in the air.
    rehearsal: Option<Rehearsal>,
    air: Option<AirTally>,
    shears: GelShears,
    /// Number of integration steps so far, and at the end.
    tick: u64,
    /// Integration steps per second.
    physics_hz: u32,
    /// Integration steps between two camera frames, and between two commands.
    steps_per_frame: u64,
    steps_per_command: u64,
    last_tick: u64,
    /// Angle turned about the gait's axis, radians.
    turned_rad: f64,
    end: Option<End>,
}

impl Episode {
    /// Draws the start and builds the simulation.
    ///
    /// # Errors
    /// [`SimulationError`] if MuJoCo refuses the object.
    pub fn new(object: &Object, config: &EpisodeConfig) -> Result<Self, SimulationError> {
        let controller = DirectedController::new(&config.gait, &config.hand);
        Self::moved_by(object, config, Box::new(controller))
    }

    /// Draws the start and builds the simulation, whose hand another controller moves than the one that plays the gait of the configuration.
    ///
    /// # Errors
    /// [`SimulationError`] if MuJoCo refuses the object, or the controller needs drives or a rate that the simulation cannot have.
    pub fn moved_by(
        object: &Object,
        config: &EpisodeConfig,
        controller: Box<dyn Controller>,
    ) -> Result<Self, SimulationError> {
        Self::at_rate(object, config, controller, PHYSICS_HZ)
    }

    /// Does the same with another number of integration steps per second than [`PHYSICS_HZ`]. With fewer, episodes are cheaper, and not those of
    /// a run.
    ///
    /// # Errors
    /// As [`Episode::moved_by`], or if the commands or the [`FRAME_HZ`] images per second do not fall on integration steps.
    pub fn at_rate(
        object: &Object,
        config: &EpisodeConfig,
        controller: Box<dyn Controller>,
        physics_hz: u32,
    ) -> Result<Self, SimulationError> {
        let EpisodeConfig { hand, gait, seed, duration_s, randomisation } = config;
        let rate_hz = controller.rate_hz();
        if rate_hz == 0 || !physics_hz.is_multiple_of(rate_hz) {
            return Err(SimulationError::Controller(format!(
                "it gives {rate_hz} commands per second, which do not divide {physics_hz}; give it a rate such as 20, 25 or 50"
            )));
        }
        if physics_hz == 0 || !physics_hz.is_multiple_of(FRAME_HZ) {
            return Err(SimulationError::Rate(physics_hz));
        }
        let driven = match controller.drives() {
            Some(drives) => hand.with_drives(&drives).map_err(|e| SimulationError::Controller(e.to_string()))?,
            None => Arc::clone(hand),
        };
        let mut start = EpisodeStart::draw(object, gait, hand, randomisation, *seed);
        start.physics.timestep_s = 1.0 / f64::from(physics_hz);
        let mut simulation = Simulation::new(&driven, object, &start.physics)?;
        simulation.reset(&start.joints, start.object);
        Ok(Self {
            simulation,
            steps_per_command: u64::from(physics_hz / rate_hz),
            controller,
            hand: Arc::clone(hand),
            schedule: Schedule::default(),
            target: start.joints.clone(),
            plan: Plan { changes: 0, turn_axis: gait.axis.direction(hand.side()), tilting: None },
            rehearsal: None,
            air: gait.feedback.as_ref().map(|_| AirTally::new(object, hand, &start.joints)),
            shears: GelShears::new(hand),
            start,
            tick: 0,
            physics_hz,
            steps_per_frame: u64::from(physics_hz / FRAME_HZ),
            last_tick: (duration_s.max(0.0) * f64::from(physics_hz)).round() as u64,
            turned_rad: 0.0,
            end: None,
        })
    }

    /// Lets the controllers of a schedule follow one another. The first one must be that of the configuration; its torque limit
    /// holds for all.
    pub fn follow(&mut self, schedule: Schedule) {
        self.schedule = schedule;
    }

    /// Shows the true place of the object, with errors, to a controller that needs it. Without this, such a
    /// controller knows only what [`Episode::see`] tells it. `seed` decides the errors.
    pub fn rehearse(&mut self, errors: PlaceErrors, seed: u64) {
        self.rehearsal = Some(Rehearsal::new(errors, seed));
    }

    /// Returns the last place that the rehearsal has shown; `None` without one, or before the first.
    pub fn rehearsed(&self) -> Option<RehearsedPlace> {
        self.rehearsal.as_ref().and_then(Rehearsal::shown)
    }

    /// Tells the estimated place of the object to a controller that needs it; has no effect on others.
    pub fn see(&mut self, place: EstimatedPlace) {
        self.controller.see(place);
    }

    /// Tells a controller that needs it how the object presses into each gel; has no effect on others.
    pub fn feel(&mut self, presses: &PerPad<Option<Press>>) {
        self.controller.feel(presses);
    }

    /// Returns the controller.
    pub fn controller(&self) -> &dyn Controller {
        self.controller.as_ref()
    }

    /// Returns how the object was held in the air; `None` if the gait has no feedback.
    pub fn in_air(&self) -> Option<AirOutcome> {
        self.air.as_ref().map(|air| air.outcome(self.controller.lowered_at_s()))
    }

    /// Returns the drawn start.
    pub fn start(&self) -> &EpisodeStart {
        &self.start
    }

    /// Returns the hand.
    pub fn hand(&self) -> &Arc<Hand> {
        &self.hand
    }

    /// Returns the reason for the end; `None` while the episode runs.
    pub fn end(&self) -> Option<&End> {
        self.end.as_ref()
    }

    /// Returns the simulated time, seconds.
    pub fn time_s(&self) -> f64 {
        self.tick as f64 / f64::from(self.physics_hz)
    }

    /// Returns the angle by which the object has turned about the gait's axis, radians.
    pub fn turned_rad(&self) -> f64 {
        self.turned_rad
    }

    /// Obeys a directive of the supervisor from the next command on.
    ///
    /// # Errors
    /// [`UnknownGait`], which lists the names, or says that the hand has no shipped gaits; the episode then continues unchanged.
    pub fn direct(&mut self, directive: Directive) -> Result<(), UnknownGait> {
        self.controller.obey(&directive)?;
        match directive {
            Directive::ChangeController(name) => self.change(gait::find_for(&self.hand, &name)?.1),
            Directive::Stop => {
                self.end.get_or_insert(End::Stopped);
            }
            _ => (),
        }
        Ok(())
    }

    /// Injects a fault: moves the object by `change`, rotating it about its centre, and stops its motion. If the object
    /// then penetrates the hand, lifts it by at most 4 cm.
    pub fn displace_object(&mut self, change: Isometry<WorldFrame, WorldFrame>) {
        const LIFT_M: f64 = 0.002;
        const LIFTS: usize = 20;
        let (pose, change) = (self.simulation.object_pose().untyped(), change.untyped());
        let mut moved = na::Isometry3::from_parts(
            na::Translation3::from(pose.translation.vector + change.translation.vector),
            change.rotation * pose.rotation,
        );
        self.simulation.place_object(Isometry::new(moved));
        for _ in 0..LIFTS {
            if self.simulation.penetration_m() < LIFT_M {
                break;
            }
            moved.translation.z += LIFT_M;
            self.simulation.place_object(Isometry::new(moved));
        }
    }

    /// Sets how many camera frames there are per second; without this call [`FRAME_HZ`]. The nearest rate that divides that of the
    /// integration steps is taken.
    pub fn set_frame_rate(&mut self, hz: u32) {
        self.steps_per_frame = u64::from((self.physics_hz / hz.max(1)).max(1));
    }

    /// Returns the state at the next camera frame, the first one at time 0; `None` after the end of the episode.
    pub fn next_frame(&mut self) -> Option<EpisodeState> {
        let due = if self.tick == 0 { 0 } else { self.tick.next_multiple_of(self.steps_per_frame) };
        while self.tick < due && self.end.is_none() {
            self.step(None);
        }
        if self.end.is_none() && self.tick >= self.last_tick {
            self.end = Some(End::Completed);
        }
        if self.end.is_some() {
            return None;
        }
        let state = self.state();
        // Steps past this frame's instant, so that the next call runs up to the next frame.
        self.step(None);
        Some(state)
    }

    /// Returns the true state now.
    pub fn state(&self) -> EpisodeState {
        EpisodeState {
            scene: SceneState {
                time_s: self.time_s(),
                joints: self.simulation.joints(),
                object_pose: self.simulation.object_pose(),
                shear: self.shears.shear().clone(),
            },
            pads: self.simulation.contacts(),
        }
    }

    /// Returns the input of a controller now.
    pub fn proprioception(&self) -> Proprioception {
        Proprioception {
            time_s: self.time_s(),
            joints: self.simulation.joints(),
            velocities: self.simulation.joint_velocities(),
            forces_n: self.simulation.contacts().map(|pad| pad.force_n),
            gravity: self.simulation.gravity(),
            axis: self.plan.turn_axis.into(),
        }
    }

    /// Returns the simulation, for its velocities and torques.
    pub fn simulation(&self) -> &Simulation {
        &self.simulation
    }

    /// Returns the joint angles at which the joints aim, radians.
    pub fn target(&self) -> &[f64] {
        &self.target
    }

    /// Makes so many integration steps, fewer if the episode ends. The joints aim at `targets`, radians; without them the
    /// gait plays.
    pub fn advance(&mut self, steps: u32, targets: Option<&[f64]>) {
        for _ in 0..steps {
            if self.end.is_some() {
                return;
            }
            self.step(targets);
            if self.end.is_none() && self.tick >= self.last_tick {
                self.end = Some(End::Completed);
            }
        }
    }

    /// Returns the state for [`Episode::restore`].
    pub fn save(&self) -> EpisodeSnapshot {
        EpisodeSnapshot {
            start: self.start.clone(),
            simulation: self.simulation.save(),
            controller: self.controller.clone(),
            target: self.target.clone(),
            plan: self.plan.clone(),
            gravity: self.simulation.gravity(),
            rehearsal: self.rehearsal.clone(),
            air: self.air.clone(),
            shears: self.shears.clone(),
            tick: self.tick,
            turned_rad: self.turned_rad,
            end: self.end.clone(),
        }
    }

    /// Sets the state to a saved one of an episode with the same object, configuration and seed.
    ///
    /// # Errors
    /// [`SimulationError::State`] if the state belongs to an episode with another start.
    pub fn restore(&mut self, snapshot: &EpisodeSnapshot) -> Result<(), SimulationError> {
        let EpisodeSnapshot {
            start,
            simulation,
            controller,
            target,
            plan,
            gravity,
            rehearsal,
            air,
            shears,
            tick,
            turned_rad,
            end,
        } = snapshot.clone();
        if start != self.start {
            let reason = "it was saved in an episode with another object, seed or configuration".to_owned();
            return Err(SimulationError::State(reason));
        }
        self.simulation.set_gravity(gravity);
        self.simulation.restore(&simulation)?;
        (self.controller, self.target, self.plan, self.tick) = (controller, target, plan, tick);
        (self.rehearsal, self.air, self.shears) = (rehearsal, air, shears);
        (self.turned_rad, self.end) = (turned_rad, end);
        Ok(())
    }

    /// Changes to a gait: the hand opens, the palm is levelled and tilted as the gait needs it, and the hand closes.
    fn change(&mut self, gait: &Gait) {
        if !self.controller.change(gait) {
            return;
        }
        let tilt = TiltChange { from: self.simulation.gravity(), to: gait.gravity_on(self.hand.side()) };
        self.plan.turn_axis = gait.axis.direction(self.hand.side());
        self.plan.tilting = Some((tilt, self.tick));
    }

    /// Obeys the schedule and turns gravity.
    fn follow_plan(&mut self) {
        let changes = self.schedule.changes_until(self.time_s());
        if changes > self.plan.changes {
            self.plan.changes = changes;
            if let Some(gait) = self.schedule.gait_after(changes).cloned() {
                self.change(&gait);
            }
        }
        if let Some((tilt, since)) = self.plan.tilting {
            let elapsed_s = (self.tick - since) as f64 / f64::from(self.physics_hz);
            self.simulation.set_gravity(tilt.gravity(elapsed_s));
            if TiltChange::is_over(elapsed_s) {
                self.plan.tilting = None;
            }
        }
    }

    /// Makes one integration step towards `targets`, or of the gait with a new command if one is due.
    fn step(&mut self, targets: Option<&[f64]>) {
        /// Limit of the counted turn rate, rad/s. A free object may spin faster for an instant than a pad can turn it.
        const FASTEST_TURN: f64 = 10.0;
        self.follow_plan();
        if let Some(targets) = targets {
            self.target = targets.to_vec();
        } else if self.tick.is_multiple_of(self.steps_per_command) {
            self.target = self.controller.command(&self.proprioception());
        }
        let is_supported = self.air.is_some() && self.time_s() < HANDED_OVER_S;
        if is_supported {
            self.simulation.support(self.start.object);
        }
        self.simulation.step(&self.target);
        self.tick += 1;
        let (joints, object) = (self.simulation.joints(), self.simulation.object_pose());
        self.shears.step(&self.hand, &joints, object, &self.simulation.contacts());
        self.watch(is_supported);
        let rate = self.simulation.object_angular_velocity().dot(&self.plan.turn_axis);
        if rate.is_finite() {
            self.turned_rad += rate.clamp(-FASTEST_TURN, FASTEST_TURN) / f64::from(self.physics_hz);
        }
        self.end = self.fault();
    }

    /// Shows the place to the controller in a rehearsal, and notes how an object in the air is held.
    fn watch(&mut self, is_supported: bool) {
        let (pose, time_s) = (self.simulation.object_pose(), self.time_s());
        if let Some(rehearsal) = &mut self.rehearsal {
            let is_frame = self.tick.is_multiple_of(self.steps_per_frame);
            if let Some(place) = rehearsal.step(is_frame.then_some((time_s, pose))) {
                self.controller.rehearse(place);
            }
        }
        if !is_supported && let Some(air) = &mut self.air {
            air.add(pose, self.simulation.touches_beside_fingertips());
        }
    }

    fn fault(&self) -> Option<End> {
        if let Some(reason) = self.controller.fault() {
            return Some(End::Uncontrolled(reason));
        }
        if let Some(reason) = self.simulation.fault() {
            return Some(End::Unstable(reason));
        }
        let (joints, object) = (self.simulation.joints(), self.simulation.object_pose());
        (!is_on_the_hand(&self.hand, &joints, object)).then_some(End::Dropped)
    }
}

/// Returns whether an object at this pose has not fallen off the hand: it is over a palm of human size or its fingers, which point along x,
/// or, for a hand without a palm, near the grasp.
pub fn is_on_the_hand(hand: &Hand, joints: &[f64], pose: Isometry<ObjectFrame, WorldFrame>) -> bool {
    /// Distance from the grasp up to which a hand without a palm holds an object, metres.
    const NEAR_M: f64 = 0.15;
    let p = pose.origin().coords();
    match hand.palm_centre_m() {
        // A palm reaches to 48 mm along x and 57 mm along y from its middle, stretched fingers to 205 mm along x.
        Some([x, y, z]) => p.z > z - 0.0211 && (p.y - y).abs() < 0.11 && (x - 0.0725..x + 0.2075).contains(&p.x),
        None => hand.grasp_centre(joints).is_none_or(|centre| (p - centre.coords()).norm() < NEAR_M),
    }
}

/// Outcome of an episode. Fractions are of its camera frames.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct EpisodeOutcome {
    /// Time until the end, seconds.
    pub survived_s: f64,
    /// Angle turned about the gait's axis, radians.
    pub turned_rad: f64,
    /// Mean rate of turning until the end, rad/s.
    pub turn_rate_rad_s: f64,
    /// Fraction in which at least one pad touched the object.
    pub any_contact_fraction: f64,
    /// Mean number of pads that touched the object.
    pub mean_pads_in_contact: f64,
    /// Fraction in which each pad touched the object.
    pub per_pad_contact: PerPad<f64>,
    /// Mean penetration of the object into a touching gel, millimetres.
    pub penetration_mm: f64,
    /// Angle between the object's own z axis and the palm's normal at the end, degrees.
    pub tilt_deg: f64,
    /// How the object was held in the air; `None` if the gait has no feedback.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub in_air: Option<AirOutcome>,
    /// Reason for the end.
    pub end: End,
}

/// Statistics of an episode, added frame by frame.
#[derive(Debug, Clone, Default)]
pub struct Tally {
    frames: usize,
    any: usize,
    /// Number of frames in which each pad touched; empty before the first frame.
    pads: PerPad<usize>,
    penetration_m: f64,
    tilt_rad: f64,
}

impl Tally {
    /// Adds one frame.
    pub fn add(&mut self, state: &EpisodeState) {
        self.frames += 1;
        self.any += usize::from(state.pads.iter().any(PadContact::is_touching));
        self.pads.0.resize(state.pads.len(), 0);
        for (count, pad) in self.pads.iter_mut().zip(&state.pads).filter(|(_, pad)| pad.is_touching()) {
            *count += 1;
            self.penetration_m += pad.penetration_m;
        }
        let up = (state.scene.object_pose * Vector::<ObjectFrame>::new(0.0, 0.0, 1.0)).coords();
        self.tilt_rad = up.z.clamp(-1.0, 1.0).acos();
    }

    /// Returns the outcome of the episode whose frames were added.
    pub fn outcome(&self, episode: &Episode) -> EpisodeOutcome {
        let of_frames = |count: usize| count as f64 / self.frames.max(1) as f64;
        let touches: usize = self.pads.iter().sum();
        let survived_s = episode.time_s();
        EpisodeOutcome {
            survived_s,
            turned_rad: episode.turned_rad(),
            turn_rate_rad_s: if survived_s > 0.0 { episode.turned_rad() / survived_s } else { 0.0 },
            any_contact_fraction: of_frames(self.any),
            mean_pads_in_contact: of_frames(touches),
            per_pad_contact: episode.hand.per_pad(|pad| of_frames(self.pads.get(pad).copied().unwrap_or(0))),
            penetration_mm: 1e3 * self.penetration_m / touches.max(1) as f64,
            tilt_deg: self.tilt_rad.to_degrees(),
            in_air: episode.in_air(),
            end: episode.end().cloned().unwrap_or(End::Completed),
        }
    }
}

/// Runs an episode to its end without rendering.
pub fn run(episode: &mut Episode) -> EpisodeOutcome {
    let mut tally = Tally::default();
    while let Some(state) = episode.next_frame() {
        tally.add(&state);
    }
    tally.outcome(episode)
}
