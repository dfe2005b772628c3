//! Input of a run: the source of its frames, and the facts about them that the arguments or the log give.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use anyhow::{Context as _, Result};
use mvt_frames::camera::PosedCamera;
use mvt_gaits::controller_file::ChosenController;
use mvt_objects::object::Object;
use mvt_robot::rig::Placement;
use mvt_run::config::RunConfig;
use mvt_run::estimator::Mode;
use mvt_run::explorer::ExploreStrategy;
use mvt_run::exploring::direct;
use mvt_run::live::LiveParts;
use mvt_run::object::{default_object, load_object};
use mvt_run::report::FrameCamera;
use mvt_run::source::{Recorded, RecordedOptions, Source};
use mvt_run::supervisor::Supervisor;
use mvt_simulated::{Fault, HIDDEN_EVERY, SimulatedSettings, SimulatedSource};

use super::RunArguments;
use crate::calibrate;

/// Duration of an episode without --duration, seconds.
const DURATION_S: f64 = 30.0;

/// Source of frames with its facts.
pub struct RunInput {
    pub source: Box<dyn Source>,
    pub seed: u64,
    /// Name of the object in the catalogue, or the path of its mesh.
    pub name: String,
    /// The true object, if it could be loaded.
    pub object: Option<Object>,
    /// Directs the hand of a simulated episode.
    pub supervisor: Option<Supervisor>,
    pub cameras: Vec<PosedCamera>,
    /// The frames of a recording without a hand.
    pub frame_cameras: Vec<FrameCamera>,
    /// What a live connection adds to the run; `None` for other sources.
    pub live: Option<LiveParts>,
}

impl RunInput {
    /// Prepares a simulated episode, or opens the log that the arguments name.
    ///
    /// `stop` ends a live connection, whose end is not foreseen.
    pub fn new(arguments: &RunArguments, config: &RunConfig, stop: &Arc<AtomicBool>) -> Result<Self> {
        #[cfg(feature = "ros")]
        if let Some(file) = &arguments.live.ros {
            return from_ros(arguments, file, config, stop);
        }
        #[cfg(not(feature = "ros"))]
        let _ = stop;
        match &arguments.log {
            Some(log) => from_log(arguments, log, config),
            None => simulated(arguments, config),
        }
    }
}

#[cfg(feature = "ros")]
fn from_ros(arguments: &RunArguments, file: &Path, config: &RunConfig, stop: &Arc<AtomicBool>) -> Result<RunInput> {
    let object = arguments.object.as_deref().map(load_object).transpose()?;
    let (controller, goal) = (arguments.manner.controller.as_str(), arguments.goal);
    let name = arguments.object.clone().unwrap_or_else(|| "unknown".to_owned());
    let run = mvt_ros::LiveRun {
        mode: (arguments.mode, arguments.init),
        modality: arguments.modality,
        touch: &arguments.touch,
        duration_s: arguments.duration,
        calibration: arguments.calibration_file.as_deref().map(calibrate::read).transpose()?,
        record: arguments.live.record.as_deref(),
        object: &name,
        config,
        drive: arguments.live.drive.then_some(mvt_ros::LiveDrive { controller, object: object.as_ref(), goal }),
        stop,
    };
    let live = mvt_ros::LiveConnection::open(file, &run, |rig, side, camera| {
        let loaded = mvt_hands::load_rig(rig, side)?;
        let cameras = camera.map_or_else(|| Ok(loaded.cameras.clone()), |name| loaded.placed(name))?;
        Ok((loaded.hand, cameras.into_iter().next()))
    })?;
    Ok(RunInput {
        cameras: vec![live.source.camera().clone()],
        source: Box::new(live.source),
        seed: arguments.seed.unwrap_or(0),
        name,
        object,
        supervisor: live.supervisor,
        frame_cameras: Vec::new(),
        live: Some(live.parts),
    })
}

fn from_log(arguments: &RunArguments, folder: &Path, config: &RunConfig) -> Result<RunInput> {
    let calibration =
        arguments.calibration_file.as_deref().map(|path| calibrate::read(path).map(|calibration| (path, calibration)));
    let options = RecordedOptions {
        cameras: arguments.cameras.as_deref(),
        modality: arguments.modality,
        touch: &arguments.touch,
        object: arguments.object.as_deref(),
        needs_object: arguments.mode == Mode::Pose,
        calibration: calibration.transpose()?,
        duration_s: arguments.duration,
        wants_pictures: mvt_recording::has_images,
        config,
    };
    let Recorded { source, seed, name, object, cameras, frame_cameras } = Recorded::open(folder, &options)?;
    Ok(RunInput {
        seed: arguments.seed.unwrap_or(seed),
        name,
        object,
        supervisor: None,
        cameras,
        frame_cameras,
        source,
        live: None,
    })
}

fn simulated(arguments: &RunArguments, config: &RunConfig) -> Result<RunInput> {
    let mut rig = arguments.manner.rig()?;
    rig.hand = arguments.touch.equipped(&rig.hand)?;
    let weights = arguments.touch.weights(&rig.hand)?.filter(|_| arguments.modality.has_touch());
    let cameras = arguments.cameras.as_deref().unwrap_or("side");
    // A goal to show a side needs a place around the hand.
    let placements = Placement::parse_list(cameras).unwrap_or_default();
    let (name, object) = match &arguments.object {
        Some(name) => (name.clone(), load_object(name)?),
        None => default_object()?,
    };
    let cameras = rig.placed(cameras)?;
    let seed = arguments.seed.unwrap_or(0);
    let strategy = arguments.explore.then_some(ExploreStrategy::Frontier);
    let (ChosenController { gait, mover, schedule, .. }, supervisor) = direct(
        &rig.hand,
        &arguments.manner.controller,
        &object,
        arguments.goal,
        placements.first(),
        config.supervisor,
        strategy,
    )?;
    let settings = SimulatedSettings {
        hand: Arc::clone(&rig.hand),
        gait,
        mover,
        schedule,
        seed,
        duration_s: arguments.duration.unwrap_or(DURATION_S),
        cameras,
        camera_noise: config.camera_noise,
        perception: config.perception(),
        modality: arguments.modality,
        hidden_every: Some(HIDDEN_EVERY),
        fault: Fault::default(),
    };
    let cameras = if arguments.modality.has_vision() { settings.cameras.clone() } else { Vec::new() };
    let mut source = Box::new(SimulatedSource::new(&object, settings, weights.as_ref())?);
    if let Some(path) = &arguments.calibration_file {
        source.start_from(&calibrate::read(path)?).with_context(|| path.display().to_string())?;
    }
    Ok(RunInput {
        source,
        seed,
        name,
        object: Some(object),
        supervisor: Some(supervisor),
        cameras,
        frame_cameras: Vec::new(),
        live: None,
    })
}
