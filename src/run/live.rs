//! Input of a run from the topics of ROS 2.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use anyhow::{Context as _, Result, bail};
use mvt_hands::LoadedHand;
use mvt_perceive::PerceptionSetup;
use mvt_robot::hand::Hand;
use mvt_ros::{LiveConnection, LiveOptions, RosPublisher, RosSetup};
use mvt_run::config::RunConfig;
use mvt_run::estimator::{Init, Mode};
use mvt_run::object::load_object;
use mvt_run::pipeline::Progress;
use mvt_run::source::Modality;

use super::RunArguments;
use super::input::{LiveListener, LiveParts, RunInput};
use crate::calibrate;

impl LiveListener for RosPublisher {
    fn receive(&mut self, progress: &Progress<'_>) {
        self.receive(progress);
    }

    fn finish(self: Box<Self>) {
        RosPublisher::finish(*self);
    }
}

/// Returns the settings that suit a file: those without a hand unless it names one.
pub fn suited(file: &Path) -> Result<RunConfig> {
    Ok(if RosSetup::read(file)?.rig.is_some() { RunConfig::default() } else { RunConfig::without_hand() })
}

/// Connects as a file states.
pub fn from_ros(arguments: &RunArguments, file: &Path, config: &RunConfig, stop: &Arc<AtomicBool>) -> Result<RunInput> {
    let setup = RosSetup::read(file)?;
    if arguments.modality == Modality::Tac {
        bail!("--ros needs the camera: leave out --modality tac");
    }
    let is_given_pose = arguments.mode == Mode::Pose && arguments.init == Some(Init::Search);
    if arguments.mode != Mode::Slam && !is_given_pose {
        bail!("--ros knows no true pose: use --mode slam, or --mode pose --init search with --object");
    }
    let loaded = setup.rig.as_deref().map(|rig| load_rig(rig, file)).transpose()?;
    let hand = match &loaded {
        Some(loaded) => arguments.touch.equipped(&loaded.hand)?,
        None => Hand::none(),
    };
    let camera = match (&loaded, &setup.camera) {
        (Some(loaded), Some(name)) => {
            loaded.placed(name).with_context(|| format!("{}: camera", file.display()))?.into_iter().next()
        }
        (Some(loaded), None) => loaded.cameras.first().cloned(),
        (None, _) => None,
    };
    if loaded.is_some() && camera.is_none() && setup.world_frame.is_none() {
        bail!(
            "{}: the place of the camera is unknown: name a camera of the rig as `camera`, or `world_frame`",
            file.display()
        );
    }
    let reads_touch = arguments.modality.has_touch() && !setup.touch.is_empty();
    let weights = if reads_touch { arguments.touch.weights(&hand)? } else { None };
    let options = LiveOptions {
        hand,
        camera,
        perception: PerceptionSetup { weights: weights.as_ref(), config: config.perception() },
        duration_s: arguments.duration,
        stop: Arc::clone(stop),
    };
    let LiveConnection { mut source, publisher, record } = LiveConnection::open(&setup, file, options)?;
    if let Some(path) = &arguments.calibration_file {
        source.start_from(&calibrate::read(path)?).with_context(|| path.display().to_string())?;
    }
    let object = arguments.object.as_deref().map(load_object).transpose()?;
    Ok(RunInput {
        cameras: vec![source.camera().clone()],
        source: Box::new(source),
        seed: arguments.seed.unwrap_or(0),
        name: arguments.object.clone().unwrap_or_else(|| "unknown".to_owned()),
        object,
        supervisor: None,
        frame_cameras: Vec::new(),
        live: Some(LiveParts { record, listener: Box::new(publisher) }),
    })
}

/// Loads a rig; a file stands relative to the one that names it.
fn load_rig(rig: &str, file: &Path) -> Result<LoadedHand> {
    let beside = file.parent().unwrap_or(Path::new("")).join(rig);
    let path = if beside.is_file() { beside.display().to_string() } else { rig.to_owned() };
    let loaded = LoadedHand::rig(&path, None)?;
    loaded.warnings.iter().for_each(|warning| tracing::warn!("{warning}"));
    Ok(loaded)
}
