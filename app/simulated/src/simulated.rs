//! Frames of an episode that is simulated and rendered as they are asked for.

use std::ops::Range;
use std::sync::Arc;
use std::time::Instant;

use anyhow::Result;
use mvt_calibration::{Calibration, CalibrationError};
use mvt_frames::camera::PosedCamera;
use mvt_frames::depth::GivenLabels;
use mvt_frames::{Camera, Isometry, World};
use mvt_gaits::clock::FRAME_HZ;
use mvt_gaits::controller::Controller;
use mvt_gaits::directive::Directive;
use mvt_gaits::feedback::EstimatedPlace;
use mvt_gaits::gait::Gait;
use mvt_gaits::schedule::Schedule;
use mvt_objects::object::Object;
use mvt_perceive::{LabelSource, Perception, PerceptionConfig, PerceptionSetup, Seen, true_press};
use mvt_physics::episode::{Episode, EpisodeConfig, Randomisation};
use mvt_render::observer::{Observer, ObserverOptions, ObserverScratch};
use mvt_render::touch::{TouchConfig, TouchOptions};
use mvt_robot::hand::{Hand, JointAngles, PerPad};

use crate::recorder;
use mvt_run::source::{Modality, Pictures, Sensed, Source};
use mvt_touch::network::Weights;
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

/// Settings of a simulated episode and its sensors.
#[derive(Debug, Clone)]
pub struct SimulatedSettings {
    /// The hand, with its touch sensors.
    pub hand: Arc<Hand>,
    /// The gait at the start.
    pub gait: Gait,
    /// Moves the hand in place of the gait, which then decides the start alone.
    pub mover: Option<Box<dyn Controller>>,
    /// The controllers that follow one another; empty if there is only one.
    pub schedule: Schedule,
    /// Seed of the start and of all noise.
    pub seed: u64,
    /// Longest duration, seconds.
    pub duration_s: f64,
    /// The cameras; they are left out without vision.
    pub cameras: Vec<PosedCamera>,
    /// Noise of camera depth as a multiple of Redwood's; 0 for true depth.
    pub camera_noise: f64,
    /// Settings of perception, as for a real hand.
    pub perception: PerceptionConfig,
    /// Which sensors are used.
    pub modality: Modality,
    /// At every Nth frame the share of the object that the hand hides is computed; `None` for never. Some milliseconds each;
    /// see [`HIDDEN_EVERY`].
    pub hidden_every: Option<u64>,
    /// A fault that is injected.
    pub fault: Fault,
}

/// Interval of [`SimulatedSettings::hidden_every`] for the mean of a run, frames: once per second.
pub const HIDDEN_EVERY: u64 = 30;

/// A fault that is injected to test whether the estimate survives it.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Fault {
    /// Before this frame the object is moved: see [`Episode::displace_object`].
    pub displacement: Option<(u64, Isometry<World, World>)>,
    /// Frames in which the cameras deliver nothing.
    pub blank: Range<u64>,
    /// Before this frame each camera is turned and moved so in its own frame, as by a bump.
    pub bump: Option<(u64, Isometry<Camera, Camera>)>,
    /// Frames in which the joint readings stay as they were.
    pub frozen: Range<u64>,
    /// Share of the frames after the first that do not arrive, drawn at random.
    pub dropped: f64,
}

/// A simulated episode.
pub struct SimulatedSource {
    settings: SimulatedSettings,
    episode: Episode,
    observer: Observer,
    perception: Perception,
    scratch: ObserverScratch,
    /// The joint readings of the frame before.
    last_joints: Option<JointAngles>,
    /// The hand has begun to lower the object from the air.
    is_lowered: bool,
    frame: u32,
    frame_hz: u32,
    /// Draws the frames that do not arrive.
    fault_rng: ChaCha8Rng,
}

/// Combined with the seed for the frames that do not arrive.
const DROPPED: u64 = 0xd209;

impl SimulatedSource {
    /// Draws the start and prepares the rendering. Without `weights` of touch networks, by pad, the true indentation is used.
    ///
    /// # Errors
    /// If MuJoCo refuses the object.
    pub fn new(
        object: &Object,
        mut settings: SimulatedSettings,
        weights: Option<&PerPad<Arc<Weights>>>,
    ) -> Result<Self> {
        let SimulatedSettings { seed, duration_s, camera_noise, .. } = settings;
        let hand = Arc::clone(&settings.hand);
        if !settings.modality.has_vision() {
            settings.cameras.clear();
        }
        let config = EpisodeConfig {
            hand: Arc::clone(&hand),
            gait: settings.gait.clone(),
            seed,
            duration_s,
            randomisation: Randomisation::default(),
        };
        let mut episode = match settings.mover.clone() {
            Some(mover) => Episode::moved_by(object, &config, mover)?,
            None => Episode::new(object, &config)?,
        };
        episode.follow(settings.schedule.clone());
        let options = ObserverOptions {
            hand: Arc::clone(&hand),
            cameras: settings.cameras.clone(),
            touch: TouchOptions::of_hand(&hand, TouchConfig::Fork, None),
            touch_noise: true,
            camera_depth_noise: (camera_noise > 0.0).then_some(camera_noise),
            seed,
        };
        let observer = Observer::new(object, options)?;
        let setup = PerceptionSetup { weights, config: settings.perception };
        let mut perception = Perception::new(hand, settings.cameras.clone(), &setup);
        if perception.reads_touch_images() {
            for (pad, image) in observer.untouched_images().iter().enumerate() {
                perception.set_untouched(pad, image)?;
            }
        }
        Ok(Self {
            settings,
            episode,
            observer,
            perception,
            scratch: ObserverScratch::default(),
            last_joints: None,
            is_lowered: false,
            frame: 0,
            frame_hz: FRAME_HZ,
            fault_rng: ChaCha8Rng::seed_from_u64(seed ^ DROPPED),
        })
    }

    /// Sets how many images each sensor takes per second, a divisor of 300; without this call [`FRAME_HZ`].
    pub fn set_frame_rate(&mut self, hz: u32) {
        self.frame_hz = hz;
        self.episode.set_frame_rate(hz);
    }

    /// Starts from a calibration that was measured before, in place of the given one.
    ///
    /// # Errors
    /// If a number of it is invalid.
    pub fn start_from(&mut self, calibration: &Calibration) -> Result<(), CalibrationError> {
        self.perception.start_from(calibration)
    }
}

impl Source for SimulatedSource {
    fn next(&mut self) -> Result<Option<Sensed>> {
        let begun = Instant::now();
        let frame = u64::from(self.frame);
        if let Some((_, change)) = self.settings.fault.displacement.filter(|(at, _)| *at == frame) {
            self.episode.displace_object(change);
        }
        if let Some((_, change)) = self.settings.fault.bump.filter(|(at, _)| *at == frame) {
            self.observer.move_cameras(change);
        }
        while self.frame > 0 && self.fault_rng.random_bool(self.settings.fault.dropped) {
            self.frame += 1;
            if self.episode.next_frame().is_none() {
                return Ok(None);
            }
        }
        let frame = u64::from(self.frame);
        let Some(state) = self.episode.next_frame() else { return Ok(None) };
        let (mut observation, truth) = self.observer.observe(self.frame, &state.scene, &mut self.scratch);
        self.frame += 1;
        let SimulatedSettings { modality, hidden_every, fault, .. } = &self.settings;
        if fault.frozen.contains(&frame) {
            observation.joints = self.last_joints.take().unwrap_or(observation.joints);
        }
        self.last_joints = Some(observation.joints.clone());
        if fault.blank.contains(&frame) {
            observation.cameras.iter_mut().for_each(|rgbd| rgbd.depth_m = Default::default());
        }
        if self.settings.perception.segmentation.labels == LabelSource::Given {
            for (rgbd, labels) in observation.cameras.iter_mut().zip(&truth.labels) {
                rgbd.labels = Some(GivenLabels::Labels(labels.clone()));
            }
        }
        let is_felt = modality.has_touch() && self.perception.reads_touch_images();
        let touched = || truth.touch.iter().zip(self.settings.hand.gel_views().iter());
        let presses = match modality.has_touch() {
            false => Some(self.settings.hand.per_pad(|_| None)),
            true if is_felt => None,
            true => Some(touched().map(|(truth, gel)| true_press(truth, gel)).collect()),
        };
        let Seen { percept, touch_images, warnings } = self.perception.see(frame, observation, presses)?;
        if self.episode.controller().needs_touch() {
            self.episode.feel(&percept.touch);
        }
        let events = match self.episode.in_air().and_then(|air| air.lowered_at_s) {
            Some(_) if !self.is_lowered => {
                self.is_lowered = true;
                vec!["lowers the object to the palm, because its place is unknown".to_owned()]
            }
            _ => Vec::new(),
        };
        let is_wanted = hidden_every.is_some_and(|every| frame.is_multiple_of(every));
        let hidden = if is_wanted { self.observer.hidden_share(&truth, &mut self.scratch) } else { None };
        let touched = truth.touch.iter().zip(self.settings.hand.gel_views().iter());
        let pictures = Pictures {
            touch: touch_images,
            true_indentation_mm: touched
                .map(|(truth, gel)| is_felt.then(|| gel.indentation_of(&truth.depth_m)).flatten())
                .collect(),
            forces_n: Some(state.pads.map(|pad| pad.force_n)),
        };
        let sense_ms = begun.elapsed().as_secs_f64() * 1e3;
        Ok(Some(Sensed {
            frame,
            percept,
            truth: Some(state.scene.object_pose),
            carried: None,
            pictures,
            sense_ms,
            hidden,
            warnings,
            events,
        }))
    }

    fn needs_place(&self) -> bool {
        self.episode.controller().needs_place()
    }

    fn see(&mut self, place: EstimatedPlace) {
        self.episode.see(place);
    }

    fn direct(&mut self, directive: Directive) -> Result<()> {
        Ok(self.episode.direct(directive)?)
    }

    fn hand(&self) -> &Arc<Hand> {
        &self.settings.hand
    }

    fn frame_count(&self) -> usize {
        (self.settings.duration_s * f64::from(self.frame_hz)).ceil() as usize
    }

    fn end(&self) -> (String, bool) {
        match self.episode.end() {
            Some(end) => {
                let end = recorder::ended(end);
                let air = self.episode.in_air().map(|air| format!("; {air}"));
                (end.reason + air.as_deref().unwrap_or_default(), end.complete)
            }
            None => ("it goes on".to_owned(), false),
        }
    }

    fn calibration(&self) -> Option<Calibration> {
        self.perception.calibration()
    }
}
