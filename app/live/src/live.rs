//! Frames of an episode that is simulated and rendered as they are asked for.

use std::time::Instant;

use anyhow::Result;
use mvt_frames::camera::PosedCamera;
use mvt_frames::{Isometry, World};
use mvt_gaits::clock::FRAME_HZ;
use mvt_gaits::directive::Directive;
use mvt_gaits::gait::Gait;
use mvt_objects::object::Object;
use mvt_physics::episode::{Episode, EpisodeConfig, Randomisation};
use mvt_render::observer::{Observer, ObserverOptions, ObserverScratch};
use mvt_render::touch::{Background, TouchConfig, TouchOptions};
use mvt_robot::hand::{Finger, PerFinger, Side};
use mvt_robot::observation::GroundTruth;
use mvt_segmentation::SegmentationConfig;

use crate::recorder;
use mvt_run::source::{Modality, Pictures, Sensed, Source, TouchNetwork, true_touch};

/// What decides a live episode and what is sensed of it.
#[derive(Debug, Clone)]
pub struct LiveSettings {
    /// Which hand.
    pub side: Side,
    /// The gait at the start.
    pub gait: Gait,
    /// Seed of the start and of all noise.
    pub seed: u64,
    /// Longest duration, seconds.
    pub duration_s: f64,
    /// The cameras; none without vision.
    pub cameras: Vec<PosedCamera>,
    /// Noise of camera depth as a multiple of Redwood's; 0 for true depth.
    pub camera_noise: f64,
    /// Which sensors are used.
    pub modality: Modality,
}

/// A live episode.
pub struct LiveSource {
    settings: LiveSettings,
    episode: Episode,
    observer: Observer,
    /// What makes touch depth; without it the true one is taken.
    network: Option<TouchNetwork>,
    scratch: ObserverScratch,
    frame: u32,
    /// What only the simulator knows of the newest frame, but for touch.
    truth: Option<GroundTruth>,
}

impl LiveSource {
    /// Draws the start and prepares the rendering. `network` makes touch depth; without it the true one is taken.
    ///
    /// # Errors
    /// If MuJoCo refuses the object.
    pub fn new(object: &Object, mut settings: LiveSettings, mut network: Option<TouchNetwork>) -> Result<Self> {
        let LiveSettings { side, seed, duration_s, camera_noise, .. } = settings;
        if !settings.modality.has_vision() {
            settings.cameras.clear();
        }
        let episode = Episode::new(
            object,
            &EpisodeConfig {
                side,
                gait: settings.gait.clone(),
                seed,
                duration_s,
                randomisation: Randomisation::default(),
            },
        )?;
        let touch = |finger: Finger| TouchOptions {
            background: Background::Synthetic { seed: finger as u64 },
            ..TouchOptions::new(TouchConfig::Fork)
        };
        let options = ObserverOptions {
            side,
            cameras: settings.cameras.clone(),
            touch: PerFinger::from_fn(touch),
            touch_noise: true,
            camera_depth_noise: (camera_noise > 0.0).then_some(camera_noise),
            seed,
        };
        let observer = Observer::new(object, options)?;
        if let Some(network) = &mut network {
            for (finger, image) in observer.empty_touch().iter() {
                network.set_empty(finger, image)?;
            }
        }
        Ok(Self { settings, episode, observer, network, scratch: ObserverScratch::default(), frame: 0, truth: None })
    }

    /// Share of the object that the hand hides from the first camera in the newest frame: known to the simulator alone, and for reports.
    /// None without cameras, and before the first frame. Some milliseconds.
    pub fn hidden_share(&mut self) -> Option<f64> {
        self.observer.hidden_share(self.truth.as_ref()?, &mut self.scratch)
    }

    /// Injects a fault: see [`Episode::displace_object`].
    pub fn displace_object(&mut self, change: Isometry<World, World>) {
        self.episode.displace_object(change);
    }
}

impl Source for LiveSource {
    fn next(&mut self) -> Result<Option<Sensed>> {
        let begun = Instant::now();
        let Some(snapshot) = self.episode.next_frame() else { return Ok(None) };
        let (observation, mut truth) = self.observer.observe(self.frame, &snapshot.scene, &mut self.scratch);
        let frame = u64::from(self.frame);
        self.frame += 1;
        let LiveSettings { side, cameras, modality, .. } = &self.settings;
        let mut warnings = Vec::new();
        let touch = match &mut self.network {
            _ if !modality.has_touch() => PerFinger::default(),
            None => PerFinger::from_fn(|finger| Some(true_touch(&truth.touch[finger]))),
            Some(network) => network.feel(frame, &observation.touch, &mut warnings)?,
        };
        let segmentation = SegmentationConfig::default();
        let (depth, _) = mvt_segmentation::depth_frame(&observation, touch, cameras, *side, &segmentation)?;
        let true_touch = std::mem::take(&mut truth.touch);
        let is_felt = self.network.is_some() && modality.has_touch();
        let pictures = Pictures {
            cameras: observation.cameras.into_iter().map(|camera| camera.color).collect(),
            touch: observation.touch,
            true_touch_m: PerFinger(true_touch.0.map(|truth| is_felt.then_some(truth.depth_m))),
            forces_n: Some(PerFinger(snapshot.pads.0.map(|pad| pad.force_n))),
        };
        self.truth = Some(truth);
        let sense_ms = begun.elapsed().as_secs_f64() * 1e3;
        Ok(Some(Sensed { frame, depth, truth: Some(snapshot.scene.object_pose), pictures, sense_ms, warnings }))
    }

    fn direct(&mut self, directive: Directive) -> Result<()> {
        Ok(self.episode.direct(directive)?)
    }

    fn len(&self) -> usize {
        (self.settings.duration_s * f64::from(FRAME_HZ)).ceil() as usize
    }

    fn end(&self) -> (String, bool) {
        match self.episode.end() {
            Some(end) => {
                let end = recorder::ended(end);
                (end.reason, end.complete)
            }
            None => ("it goes on".to_owned(), false),
        }
    }
}
