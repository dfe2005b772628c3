//! What all environments of a kind share: object, gait, sensors and settings.

use std::sync::{Arc, OnceLock};

use mvt_frames::camera::PosedCamera;
use mvt_gaits::clock::{CONTROL_HZ, PHYSICS_HZ};
use mvt_gaits::gait::{self, Gait};
use mvt_objects::object::Object;
use mvt_physics::episode::Randomisation;
use mvt_policy::PolicyContract;
use mvt_render::camera::Renderer;
use mvt_render::observer::{Observer, ObserverOptions};
use mvt_render::touch::{TouchConfig, TouchOptions};
use mvt_robot::hand::{Hand, Side};
use mvt_robot::rig::PLACEMENTS;

use crate::error::TaskError;
use crate::sense::Sense;

/// Settings of a task.
#[derive(Debug, Clone)]
pub struct TurnSettings {
    /// The hand.
    pub hand: Arc<Hand>,
    /// Actions per second: a divisor of the integration steps per second, such as 25.
    pub control_hz: u32,
    /// Integration steps per second, a multiple of 150. With [`PHYSICS_HZ`] an environment moves as a run does, to the bit; with half as many it is
    /// nearly twice as fast.
    pub physics_hz: u32,
    /// Longest duration of an episode, seconds.
    pub duration_s: f64,
    /// Randomisation of the start.
    pub randomisation: Randomisation,
    /// Longest time from an action until the joints aim as it wants, seconds; each episode draws its own. 0 in a run.
    pub latency_s: f64,
    /// The observed quantities, in this order.
    pub senses: Vec<Sense>,
    /// The cameras of [`Sense::Cameras`] and [`Sense::Estimate`].
    pub cameras: Vec<PosedCamera>,
}

impl Default for TurnSettings {
    /// Returns a left hand with 25 actions per second, episodes of 20 s, proprioception, and the camera front-left.
    fn default() -> Self {
        let hand = Hand::allegro(Side::Left);
        Self {
            control_hz: 25,
            physics_hz: PHYSICS_HZ,
            duration_s: 20.0,
            randomisation: Randomisation::default(),
            latency_s: 0.0,
            senses: vec![Sense::Proprioception],
            cameras: PLACEMENTS.first().map(|place| place.camera(&hand)).into_iter().collect(),
            hand,
        }
    }
}

impl TurnSettings {
    /// Returns whether actions correct the gait that suits the object, instead of moving the hand alone.
    pub(crate) fn corrects(&self) -> bool {
        self.senses.contains(&Sense::Guided)
    }

    /// Returns the contract of the policies that observe the senses, as far as these are made of terms of contracts.
    pub fn contract(&self) -> PolicyContract {
        let contract = if self.corrects() {
            PolicyContract::correcting
        } else if self.senses.contains(&Sense::Sighted) {
            PolicyContract::sighted
        } else {
            PolicyContract::turning
        };
        contract(&self.hand, self.control_hz)
    }
}

/// Object, gait and sensors that all environments of a kind share.
pub struct Scene {
    pub(crate) object: Object,
    /// Gait that suits the object: it sets gravity, torque limit and start.
    pub(crate) gait: &'static Gait,
    pub(crate) settings: TurnSettings,
    /// `None` if no image is observed.
    pub(crate) observer: Option<Observer>,
    /// Renderer of pictures for people, made on first use.
    pub(crate) renderer: OnceLock<Renderer>,
}

impl Scene {
    /// Prepares the sensors for an object.
    ///
    /// # Errors
    /// [`TaskError::Setting`] if a setting is out of range.
    pub fn new(object: Object, settings: TurnSettings) -> Result<Self, TaskError> {
        let TurnSettings { hand, control_hz, physics_hz, duration_s, latency_s, senses, cameras, .. } = &settings;
        let check = |holds: bool, text: &str| if holds { Ok(()) } else { Err(TaskError::Setting(text.to_owned())) };
        check([150, 300, 450, 600].contains(physics_hz), "physics_hz must be 300, as in a run, or 150, 450 or 600")?;
        if *control_hz == 0 || !physics_hz.is_multiple_of(*control_hz) {
            return Err(TaskError::Setting(format!("control_hz must divide {physics_hz}, such as 25")));
        }
        check((0.1..=3600.0).contains(duration_s), "duration_s must be from 0.1 to 3600")?;
        check(
            (0.0..=1.0 / f64::from(*control_hz)).contains(latency_s),
            "latency_s must be from 0 to the time between two actions",
        )?;
        check(!senses.is_empty(), "observe at least one thing")?;
        let distinct = senses.iter().enumerate().all(|(k, sense)| !senses.iter().take(k).any(|other| other == sense));
        check(distinct, "each observation may be named once")?;
        let sizes = || hand.pads().iter().map(|pad| pad.profile.size_px);
        let is_touch = |sense: &Sense| matches!(sense, Sense::TouchDepth | Sense::TouchImages);
        check(
            !senses.iter().any(is_touch) || sizes().all(|size| sizes().next() == Some(size)),
            "touch_depth and touch_images need touch sensors whose images have one size; choose a rig with one profile for all pads",
        )?;
        let has_cameras = senses.iter().any(|sense| sense.needs_cameras());
        check(!has_cameras || !cameras.is_empty(), "the observations cameras and estimate need at least one camera")?;
        let (_, gait) = gait::choose("auto", &object, hand)?;
        let corrects = settings.corrects();
        check(!corrects || gait.feedback.is_none(), "gaits that hold an object in the air are not corrected")?;
        check(!corrects || *control_hz == CONTROL_HZ, "with guided, control_hz must be 25, as that of the gait")?;
        let observer = senses.iter().any(|sense| sense.needs_images()).then(|| {
            let options = ObserverOptions {
                hand: Arc::clone(hand),
                cameras: if has_cameras { cameras.clone() } else { Vec::new() },
                touch: TouchOptions::of_hand(hand, TouchConfig::Fork, None),
                touch_noise: true,
                camera_depth_noise: Some(mvt_run::config::RunConfig::default().camera_noise),
                seed: 0,
            };
            Observer::new(&object, options)
        });
        let observer = observer.transpose()?;
        Ok(Self { object, gait, settings, observer, renderer: OnceLock::new() })
    }

    /// Returns the settings.
    pub fn settings(&self) -> &TurnSettings {
        &self.settings
    }

    /// Returns the shape of an observation of one environment.
    pub fn shape(&self, sense: Sense) -> Vec<usize> {
        sense.shape(&self.settings.hand, &self.settings.cameras)
    }
}
