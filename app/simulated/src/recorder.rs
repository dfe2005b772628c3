//! Records an episode as a FeelSight log: simulate, render, encode, write.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context as _, Result, bail};
use clap::ValueEnum;
use indicatif::ProgressBar;
use mvt_feelsight::{
    EncodedFrame, EpisodeEnd, FORMAT_VERSION, LogFormat, LogMeta, LogWriter, SCENE_FILE, SceneFile, SceneObject,
};
use mvt_files::input;
use mvt_frames::camera::PosedCamera;
use mvt_gaits::clock::{CONTROL_HZ, FRAME_HZ, PHYSICS_HZ};
use mvt_gaits::controller_file::ChosenController;
use mvt_objects::catalogue;
use mvt_objects::object::Object;
use mvt_physics::air::PlaceErrors;
use mvt_physics::episode::{End, Episode, EpisodeConfig, EpisodeStart, EpisodeState, Randomisation};
use mvt_render::observer::{Observer, ObserverOptions, ObserverScratch};
use mvt_render::touch::{TouchConfig, TouchOptions};
use mvt_robot::hand::Hand;
use rayon::prelude::*;
use serde::{Deserialize, Serialize, Serializer};

use mvt_run::controller::choose_any;
use mvt_run::io::read_image;

/// All settings of a log except object, seed and cameras.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Settings {
    /// Name or file of a controller, or `auto`.
    #[serde(rename = "gait")]
    pub controller: String,
    /// The hand.
    // The checksums of logs contain the side of the Allegro as text.
    #[serde(rename = "side", serialize_with = "hand_text")]
    pub hand: Arc<Hand>,
    /// Longest duration of an episode, seconds.
    pub duration_s: f64,
    /// Noise in the recorded images.
    pub noise: Noise,
    /// Light configuration of the touch sensors.
    pub touch_config: TouchConfig,
    /// Image under every touch image; `None` for a synthetic one of its own for each sensor.
    pub background: Option<PathBuf>,
}

fn hand_text<S: Serializer>(hand: &Arc<Hand>, serializer: S) -> Result<S::Ok, S::Error> {
    match mvt_feelsight::hand::stored(hand) {
        None => hand.side().serialize(serializer),
        Some(description) => description.serialize(serializer),
    }
}

/// Noise in the recorded images.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Noise {
    /// Whether touch images have the noise of their configuration.
    pub touch: bool,
    /// Multiple of Redwood's noise on camera depth; `None` for true depth.
    pub camera_depth: Option<f64>,
}

// Why: notes/decisions/simulation.md, "Logs store exact camera depth by default".
/// Noise in the recorded images, by name.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, ValueEnum, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum NoiseLevel {
    /// Exact images
    None,
    /// Noise of TACTO on touch images; exact camera depth, as in FeelSight, whose loader adds noise
    #[default]
    Touch,
    /// The same, and Redwood-style noise on camera depth at five times its level, as NeuralFeels' loader adds
    Full,
}

impl From<NoiseLevel> for Noise {
    fn from(level: NoiseLevel) -> Self {
        match level {
            NoiseLevel::None => Self { touch: false, camera_depth: None },
            NoiseLevel::Touch => Self { touch: true, camera_depth: None },
            NoiseLevel::Full => Self { touch: true, camera_depth: Some(5.0) },
        }
    }
}

/// Frames that are rendered before any of them is written: enough to keep all threads busy, and about 100 MB.
const FRAMES_AT_ONCE: usize = 32;

/// Records episodes of one object.
pub struct Recorder<'a> {
    object: &'a Object,
    scene_object: SceneObject,
    settings: &'a Settings,
    controller: ChosenController,
    background: Option<image::RgbImage>,
}

/// Largest scene.json that is read, bytes.
const LARGEST_SCENE_FILE: u64 = 1 << 20;

impl<'a> Recorder<'a> {
    /// Prepares for an object that was loaded by `name`.
    pub fn new(object: &'a Object, name: &str, settings: &'a Settings) -> Result<Self> {
        let controller = choose_any(&settings.controller, object, &settings.hand)?;
        if controller.mover.as_ref().is_some_and(|mover| mover.needs_touch()) {
            bail!(
                "{}: it observes touch_depth, and nothing feels while a log is recorded; play it with `run`",
                controller.name
            );
        }
        let scene_object = SceneObject {
            name: object.name.clone(),
            mesh: name.to_owned(),
            mesh_sha256: mesh_sha256(name)?,
            object_from_file: object.object_from_file.to_matrix(),
            mass_kg: object.mass_kg,
        };
        let background = settings.background.as_deref().map(read_image).transpose()?;
        Ok(Self { object, scene_object, settings, controller, background })
    }

    /// Returns why the object may fall, or is not turned.
    pub fn misfit(&self) -> Option<&str> {
        self.controller.misfit.as_deref()
    }

    /// Whether a folder holds the complete log that [`Recorder::record`] would make.
    pub fn made(&self, folder: &Path, format: LogFormat, seed: u64, cameras: &[PosedCamera]) -> bool {
        let text = input::read(&folder.join(SCENE_FILE), LARGEST_SCENE_FILE).unwrap_or_default();
        serde_json::from_slice::<SceneFile>(&text)
            .is_ok_and(|scene| scene.config_sha256 == self.config_sha256(seed, cameras))
            && LogFormat::of(folder) == format
    }

    fn config_sha256(&self, seed: u64, cameras: &[PosedCamera]) -> String {
        let cameras: Vec<_> = cameras.iter().map(|c| (&c.name, c.intrinsics, c.pose.to_matrix())).collect();
        let background = self.background.as_ref().map(|image| mvt_pinned::sha256_of(image.as_raw()));
        let mut config = serde_json::json!([
            env!("CARGO_PKG_VERSION"),
            FORMAT_VERSION,
            self.scene_object,
            self.settings,
            background,
            self.controller.gait,
            Randomisation::default(),
            seed,
            cameras,
        ])
        .to_string();
        if !self.controller.schedule.is_empty() {
            config += &serde_json::json!(self.controller.schedule).to_string();
        }
        config += self.controller.policy_sha256.as_deref().unwrap_or_default();
        mvt_pinned::sha256_of(config.as_bytes())
    }

    /// Simulates, renders and writes one log, and says how the episode ended. The result depends on neither threads nor time.
    pub fn record(
        &self,
        seed: u64,
        cameras: &[PosedCamera],
        folder: &Path,
        format: LogFormat,
        overwrite: bool,
        bar: &ProgressBar,
    ) -> Result<EpisodeEnd> {
        let config = EpisodeConfig {
            hand: Arc::clone(&self.settings.hand),
            gait: self.controller.gait.clone(),
            seed,
            duration_s: self.settings.duration_s,
            randomisation: Randomisation::default(),
        };
        let mut episode = match self.controller.mover.clone() {
            Some(mover) => Episode::moved_by(self.object, &config, mover)?,
            None => Episode::new(self.object, &config)?,
        };
        episode.follow(self.controller.schedule.clone());
        // A log is recorded without an estimate.
        episode.rehearse(PlaceErrors::default(), seed);
        let snapshots: Vec<EpisodeState> = std::iter::from_fn(|| episode.next_frame()).collect();
        bar.set_length(snapshots.len() as u64);

        let observer = Observer::new(
            self.object,
            ObserverOptions {
                hand: Arc::clone(&self.settings.hand),
                cameras: cameras.to_vec(),
                touch: TouchOptions::of_hand(&self.settings.hand, self.settings.touch_config, self.background.as_ref()),
                touch_noise: self.settings.noise.touch,
                camera_depth_noise: self.settings.noise.camera_depth,
                seed,
            },
        )?;
        let untouched = (format == LogFormat::Compact).then(|| observer.untouched_images());
        let meta = LogMeta { scene: self.scene(seed, cameras, &episode), cameras: cameras.to_vec(), untouched };
        if let Some(parent) = folder.parent() {
            fs::create_dir_all(parent).with_context(|| format!("cannot make {}", parent.display()))?;
        }
        let mut writer = LogWriter::create(folder, meta, overwrite)?;
        for (chunk, first) in snapshots.chunks(FRAMES_AT_ONCE).zip((0..).step_by(FRAMES_AT_ONCE)) {
            let encode = |scratch: &mut ObserverScratch, (i, state): (u32, &EpisodeState)| {
                let (observation, truth) = observer.observe(first + i, &state.scene, scratch);
                bar.inc(1);
                EncodedFrame::encode(&observation, &truth, writer.meta())
            };
            let numbered: Vec<_> = (0..).zip(chunk).collect();
            let frames: Vec<EncodedFrame> =
                numbered.into_par_iter().map_init(ObserverScratch::default, encode).collect::<Result<_, _>>()?;
            for frame in &frames {
                writer.push(frame)?;
            }
        }
        let end = episode.end().map_or_else(|| ended(&End::Completed), ended);
        writer.finish(end.clone())?;
        Ok(end)
    }

    fn scene(&self, seed: u64, cameras: &[PosedCamera], episode: &Episode) -> SceneFile {
        let EpisodeStart { physics, .. } = episode.start();
        let [cx, cy, cz] = physics.com_offset_m;
        let number = |name: &str, value: f64| (name.to_owned(), value);
        let Settings { noise, touch_config, .. } = self.settings;
        // All joints of the Allegro have one stiffness; of other hands it is that of the first.
        let mover = self.controller.mover.as_ref();
        let drives = mover.and_then(|mover| mover.drives());
        let drives = drives.unwrap_or_else(|| self.settings.hand.joints().iter().map(|joint| joint.drive).collect());
        let stiffness = drives.first().map_or(0.0, |drive| drive.stiffness);
        let touch_sigma = if noise.touch { f64::from(touch_config.noise_sigma()) } else { 0.0 };
        SceneFile {
            format_version: FORMAT_VERSION,
            program_version: env!("CARGO_PKG_VERSION").to_owned(),
            object: self.scene_object.clone(),
            hand: Arc::clone(&self.settings.hand),
            seed,
            gravity_m_s2: physics.gravity,
            gait: self.controller.name.clone(),
            cameras: cameras.iter().map(|camera| camera.name.clone()).collect(),
            frame_rate_hz: f64::from(FRAME_HZ),
            control_rate_hz: f64::from(mover.map_or(CONTROL_HZ, |mover| mover.rate_hz())),
            physics_rate_hz: f64::from(PHYSICS_HZ),
            noise: BTreeMap::from([
                number("touch_sigma_grey", touch_sigma),
                number("camera_depth_multiple_of_redwood", noise.camera_depth.unwrap_or(0.0)),
            ]),
            randomised: BTreeMap::from([
                number("gel_friction", physics.gel_friction),
                number("link_friction", physics.link_friction),
                number("joint_stiffness_nm_rad", stiffness * physics.stiffness_factor),
                number("object_mass_kg", physics.object_mass_kg),
                number("com_offset_x_m", cx),
                number("com_offset_y_m", cy),
                number("com_offset_z_m", cz),
            ]),
            config_sha256: self.config_sha256(seed, cameras),
            // Replaced when the log is finished.
            end: EpisodeEnd { complete: false, reason: "unfinished".to_owned() },
        }
    }
}

/// How an episode ended, as scene.json has it.
pub fn ended(end: &End) -> EpisodeEnd {
    let (complete, reason) = match end {
        End::Completed => (true, "time is up".to_owned()),
        End::Dropped => (false, "the object was dropped".to_owned()),
        End::Stopped => (false, "it was stopped".to_owned()),
        End::Uncontrolled(reason) | End::Unstable(reason) => (false, reason.clone()),
    };
    EpisodeEnd { complete, reason }
}

/// SHA-256 of the file that a mesh came from; `None` for procedural and random objects.
fn mesh_sha256(name: &str) -> Result<Option<String>> {
    if let Some(file) = catalogue::mesh_path(name) {
        return Ok(Some(mvt_pinned::sha256(&file)?));
    }
    catalogue::check(name)?;
    Ok(catalogue::ycb_files().find(|file| file.name == name).map(|file| file.sha256.to_owned()))
}
