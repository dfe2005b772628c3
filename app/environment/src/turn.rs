//! One environment: the object is to turn about the palm's normal.

use std::array::from_fn;
use std::sync::Arc;

use mvt_gaits::controller::Controller as _;
use mvt_gaits::directed::DirectedController;
use mvt_perceive::{Perception, PerceptionConfig, PerceptionSetup, true_press};
use mvt_physics::air::PlaceErrors;
use mvt_physics::episode::{End, Episode, EpisodeConfig};
use mvt_policy::{ActionMap, ObservationMap, PolicySenses};
use mvt_render::camera::{CameraScratch, Renderer};
use mvt_render::observer::ObserverScratch;
use mvt_robot::digit::gel::GelView;
use mvt_robot::hand::JointAngles;
use mvt_robot::observation::{GroundTruth, Observation};
use mvt_robot::rig::PLACEMENTS;
use mvt_run::estimator::Estimator;
use mvt_run::source::Modality;
use mvt_slam::{Estimate, SlamConfig, TrackState};
use nalgebra as na;
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

use crate::error::TaskError;
use crate::reward::Reward;
use crate::scene::{Scene, TurnSettings};
use crate::sense::{Part, Sense};

/// One environment.
pub(crate) struct Environment {
    scene: Arc<Scene>,
    episode: Episode,
    seed: u64,
    steps: u32,
    target: JointAngles,
    /// Plays the gait that actions correct, if they do, and where it aims now.
    corrected: Option<DirectedController>,
    gait_targets: JointAngles,
    /// Angles at which the joints aim until the next action arrives, and the integration steps that it takes.
    command: JointAngles,
    delay: u32,
    /// The maps of policies, as those of a run: of actions, and of those senses that are made of terms of contracts.
    observations: Vec<(Sense, ObservationMap)>,
    actions: ActionMap,
    /// Perception and estimator, as those of a run, if the estimate is observed.
    slam: Option<Box<(Perception, Estimator)>>,
    estimate: Option<Estimate>,
    warnings: Vec<String>,
    scratch: ObserverScratch,
}

/// Draws how many integration steps an action takes.
fn delay(settings: &TurnSettings, seed: u64) -> u32 {
    /// Combined with the seed of the episode.
    const LATENCY: u64 = 0x1a7e;
    let longest = (settings.latency_s * f64::from(settings.physics_hz)) as u32;
    let longest = longest.min(settings.physics_hz / settings.control_hz);
    if longest == 0 { 0 } else { ChaCha8Rng::seed_from_u64(seed ^ LATENCY).random_range(0..=longest) }
}

impl Environment {
    /// Starts an episode.
    pub(crate) fn new(scene: Arc<Scene>, seed: u64) -> Result<Self, TaskError> {
        let settings = scene.settings();
        let config = EpisodeConfig {
            hand: Arc::clone(&settings.hand),
            gait: scene.gait.clone(),
            seed,
            duration_s: settings.duration_s,
            randomisation: settings.randomisation.clone(),
        };
        let player = Box::new(DirectedController::new(&config.gait, &config.hand));
        let mut episode = Episode::at_rate(&scene.object, &config, player, settings.physics_hz)?;
        if settings.senses.iter().any(|sense| sense.needs_place()) {
            episode.rehearse(PlaceErrors::default(), seed);
        }
        let joints = episode.start().joints.clone();
        let slam = match settings.senses.contains(&Sense::Estimate) {
            true => {
                let setup = PerceptionSetup { weights: None, config: PerceptionConfig::default() };
                let perception = Perception::new(Arc::clone(&settings.hand), settings.cameras.clone(), &setup);
                Some(Box::new((perception, Estimator::new(&SlamConfig::default(), &settings.hand, seed)?)))
            }
            false => None,
        };
        let observed = settings.senses.iter().filter_map(|&sense| {
            let contract = sense.contract(&settings.hand, settings.control_hz)?;
            Some((sense, ObservationMap::new(&contract, &settings.hand)))
        });
        let torque_limit_nm = scene.gait.torque_limit_nm;
        let mut environment = Self {
            observations: observed.collect(),
            actions: ActionMap::new(&settings.contract(), &settings.hand, torque_limit_nm)?,
            episode,
            seed,
            steps: 0,
            target: joints.clone(),
            corrected: settings.corrects().then(|| DirectedController::new(&config.gait, &config.hand)),
            gait_targets: JointAngles::new(),
            command: joints,
            delay: delay(settings, seed),
            slam,
            estimate: None,
            warnings: Vec::new(),
            scratch: ObserverScratch::default(),
            scene,
        };
        environment.sense(&[]);
        Ok(environment)
    }

    /// Adds the present instant to the observations of policies.
    fn sense(&mut self, action: &[f32]) {
        let sensed = self.episode.proprioception();
        let place = self.episode.rehearsed().map(|place| place.seen());
        if let Some(gait) = &mut self.corrected {
            self.gait_targets = gait.command(&sensed);
        }
        let (targets, gait_targets) = (&self.target, &self.gait_targets);
        let senses = PolicySenses { sensed: &sensed, targets, gait_targets, action, place, touch_mm: &[] };
        self.observations.iter_mut().for_each(|(_, map)| map.add(&senses));
    }

    /// Moves the targets by an action and simulates until the next one. Does nothing after the end.
    pub(crate) fn step(&mut self, action: &[f32]) -> Reward {
        let settings = self.scene.settings();
        self.actions.apply(action, &self.gait_targets, &mut self.target);
        let command = self.actions.compliant(&self.target, &self.episode.simulation().joints());
        let turned_rad = self.episode.turned_rad();
        self.episode.advance(self.delay, Some(&self.command));
        self.episode.advance(settings.physics_hz / settings.control_hz - self.delay, Some(&command));
        self.command = command;
        self.steps += 1;
        let rate = (self.episode.turned_rad() - turned_rad) * f64::from(settings.control_hz);
        self.sense(action);
        Reward::of(
            self.episode.simulation(),
            self.episode.start(),
            rate,
            matches!(self.episode.end(), Some(End::Dropped)),
        )
    }

    /// Returns whether the episode failed, and whether its time is up.
    pub(crate) fn ended(&self) -> (bool, bool) {
        match self.episode.end() {
            None => (false, false),
            Some(End::Completed) => (false, true),
            Some(_) => (true, false),
        }
    }

    /// Writes the observations in the order of the settings' senses.
    pub(crate) fn observe(&mut self, parts: &mut [Part<'_>]) -> Result<(), TaskError> {
        let scene = Arc::clone(&self.scene);
        // Noise differs between the steps and between the episodes.
        let frame = (self.seed as u32).wrapping_mul(0x9E37_79B9).wrapping_add(self.steps);
        let state = self.episode.state();
        let images = scene.observer.as_ref().map(|observer| observer.observe(frame, &state.scene, &mut self.scratch));
        if let Some((observation, truth)) = &images
            && self.slam.is_some()
        {
            self.estimate(observation.clone(), truth)?;
        }
        for (&sense, part) in scene.settings().senses.iter().zip(parts) {
            match (sense, &images) {
                (Sense::Proprioception | Sense::Sighted | Sense::Guided, _) => {
                    let map = self.observations.iter().find(|(of, _)| *of == sense);
                    part.write(sense, map.map(|(_, map)| map.observation()).unwrap_or_default());
                }
                (Sense::Privileged, _) => part.write(sense, self.privileged()),
                (Sense::Estimate, _) => part.write(sense, self.estimate_numbers()),
                (Sense::TouchDepth, Some((_, truth))) => {
                    let touch = truth.touch.iter().zip(scene.settings.hand.gel_views().iter().map(GelView::depth_m));
                    let depths = touch.flat_map(|(touch, gel_m)| gel_m.iter().zip(&touch.depth_m));
                    part.write(sense, depths.map(|(gel, depth)| (gel - depth) * 1e3));
                }
                (Sense::TouchImages, Some((observation, _))) => {
                    part.write_images(observation.touch.iter().map(|image| image.as_raw().as_slice()));
                }
                (Sense::Cameras, Some((observation, _))) => {
                    part.write_images(observation.cameras.iter().map(|rgbd| rgbd.color.as_raw().as_slice()));
                }
                // The scene has an observer if one of them is observed.
                (Sense::TouchDepth | Sense::TouchImages | Sense::Cameras, None) => {}
            }
        }
        Ok(())
    }

    /// Returns colours of the first placement's camera, for people.
    pub(crate) fn picture(&self) -> Option<image::RgbImage> {
        let scene = &self.scene;
        let hand = &scene.settings().hand;
        let renderer = scene.renderer.get_or_init(|| Renderer::new(hand, &scene.object));
        let state = self.episode.state().scene;
        let camera = PLACEMENTS.first()?.camera(hand);
        Some(renderer.render(&camera, &state.joints, state.object_pose, &mut CameraScratch::default()).rgbd.color)
    }

    /// Returns the seconds since the start, and the angle turned in the gait's direction, radians.
    pub(crate) fn progress(&self) -> [f64; 2] {
        [self.episode.time_s(), self.episode.turned_rad()]
    }

    /// Takes an observation into the estimator. Its touch sensors measure the true indentation.
    fn estimate(&mut self, observation: Observation, truth: &GroundTruth) -> Result<(), TaskError> {
        let Some((perception, estimator)) = self.slam.as_deref_mut() else { return Ok(()) };
        let hand = &self.scene.settings.hand;
        let touched = truth.touch.iter().zip(hand.gel_views().iter());
        let presses = touched.map(|(truth, gel)| true_press(truth, gel)).collect();
        let seen = perception.see(u64::from(self.steps), observation, Some(presses))?;
        self.warnings.extend(seen.warnings);
        self.estimate = Some(estimator.observe(hand, &seen.percept, Modality::Vitac));
        Ok(())
    }

    /// Returns warnings of perception that were not returned before.
    pub(crate) fn take_warnings(&mut self) -> Vec<String> {
        std::mem::take(&mut self.warnings)
    }

    fn privileged(&self) -> impl Iterator<Item = f32> {
        let (simulation, physics) = (self.episode.simulation(), &self.episode.start().physics);
        let pads = simulation.contacts();
        let [vx, vy, vz]: [f64; 3] = simulation.object_velocity().into();
        let [wx, wy, wz]: [f64; 3] = simulation.object_angular_velocity().into();
        let forces = pads.into_iter().map(|pad| pad.force_n);
        let [cx, cy, cz] = physics.com_offset_m;
        self.place(&simulation.object_pose().untyped())
            .into_iter()
            .chain([vx, vy, vz, wx, wy, wz])
            .chain(forces)
            .chain([physics.gel_friction, physics.link_friction, physics.object_mass_kg, cx, cy, cz])
            .map(|x| x as f32)
    }

    /// Returns the position from the palm's centre, and the first two columns of the rotation. Without a palm the position is that in the world.
    fn place(&self, pose: &na::Isometry3<f64>) -> [f64; 9] {
        let palm_m = self.scene.settings().hand.palm_centre_m().unwrap_or_default();
        let position = pose.translation.vector - na::Vector3::from(palm_m);
        let rotation = pose.rotation.to_rotation_matrix();
        from_fn(|k| if k < 3 { position[k] } else { rotation[(k % 3, k / 3 - 1)] })
    }

    fn estimate_numbers(&self) -> impl Iterator<Item = f32> {
        let seen = self.estimate.filter(|estimate| estimate.state != TrackState::Waiting);
        let numbers = seen.map(|estimate| {
            let trusted = f64::from(u8::from(estimate.state.is_tracking()));
            self.place(&estimate.pose.untyped()).into_iter().chain([estimate.confidence, trusted])
        });
        numbers.into_iter().flatten().map(|x| x as f32)
    }
}
