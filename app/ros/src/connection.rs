//! A whole connection for a run: source, publisher and record.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use anyhow::{Context as _, Result, bail};
use mvt_calibration::Calibration;
use mvt_frames::camera::PosedCamera;
use mvt_gaits::controller_file::{self, ChosenController, is_policy};
use mvt_gaits::directed::DirectedController;
use mvt_gaits::gait::{AUTO, SUITED};
use mvt_objects::catalogue;
use mvt_objects::object::Object;
use mvt_perceive::PerceptionSetup;
use mvt_robot::hand::{Hand, Side};
use mvt_run::config::RunConfig;
use mvt_run::controller::choose_controller;
use mvt_run::estimator::{Init, Mode};
use mvt_run::exploring::supervise;
use mvt_run::live::LiveParts;
use mvt_run::source::{Modality, TouchArguments};
use mvt_run::supervisor::{Goal, Supervisor};

use crate::bus::Bus;
use crate::driver::Driver;
use crate::motion::Motion;
use crate::publisher::RosPublisher;
use crate::setup::RosSetup;
use crate::source::{Link, LiveOptions, RosSource};

/// How a run uses a connection.
pub struct LiveRun<'a> {
    /// The quantities to estimate, and where a given shape starts.
    pub mode: (Mode, Option<Init>),
    /// Sensors that are used.
    pub modality: Modality,
    /// How touch images are read.
    pub touch: &'a TouchArguments,
    /// Longest duration, seconds.
    pub duration_s: Option<f64>,
    /// Calibration with which to start.
    pub calibration: Option<Calibration>,
    /// Folder of the log that is recorded meanwhile.
    pub record: Option<&'a Path>,
    /// Name of the object, for the log.
    pub object: &'a str,
    /// Settings.
    pub config: &'a RunConfig,
    /// How the hand is driven; `None` to send nothing.
    pub drive: Option<LiveDrive<'a>>,
    /// Ends the source when it is set.
    pub stop: &'a Arc<AtomicBool>,
}

/// How a run drives the hand.
pub struct LiveDrive<'a> {
    /// Name or file of a controller, or `auto`.
    pub controller: &'a str,
    /// The object, or one like it; it decides for `auto`.
    pub object: Option<&'a Object>,
    /// Goal that ends the run.
    pub goal: Goal,
}

/// A hand, and the camera of it that was asked for, or its first one.
pub type LiveHand = (Arc<Hand>, Option<PosedCamera>);

/// A connection that is open.
pub struct LiveConnection {
    /// Its frames.
    pub source: RosSource,
    /// What it adds to the run: counts and publications.
    pub parts: LiveParts,
    /// Directs the hand; `None` if nothing is sent.
    pub supervisor: Option<Supervisor>,
}

/// Returns the settings that suit a file: those without a hand unless it names one.
///
/// # Errors
/// If the file cannot be used.
pub fn suited(file: &Path) -> Result<RunConfig> {
    Ok(if RosSetup::read(file)?.rig.is_some() { RunConfig::default() } else { RunConfig::without_hand() })
}

impl LiveConnection {
    /// Connects as a file states, and waits until the camera model and a depth image have arrived. `load` loads a rig by name or path and side,
    /// with the camera of a name.
    ///
    /// # Errors
    /// If the file cannot be used or does not fit the run or the hand, or the network cannot be used.
    pub fn open(
        file: &Path,
        run: &LiveRun<'_>,
        load: impl FnOnce(&str, Option<Side>, Option<&str>) -> Result<LiveHand>,
    ) -> Result<Self> {
        let setup = RosSetup::read(file)?;
        if run.modality == Modality::Tac {
            bail!("--ros needs the camera: leave out --modality tac");
        }
        if run.mode.0 != Mode::Slam && run.mode != (Mode::Pose, Some(Init::Search)) {
            bail!("--ros knows no true pose: use --mode slam, or --mode pose --init search with --object");
        }
        // Before the topics are waited for.
        if let Some(folder) =
            run.record.filter(|folder| folder.read_dir().is_ok_and(|mut files| files.next().is_some()))
        {
            bail!("--record {}: the folder is not empty; name a new one", folder.display());
        }
        let (hand, camera) = match setup.rig_beside(file) {
            Some(rig) => {
                let (hand, camera) =
                    load(&rig, setup.side, setup.camera.as_deref()).with_context(|| file.display().to_string())?;
                if camera.is_none() && setup.world_frame.is_none() {
                    bail!(
                        "{}: the place of the camera is unknown: name a camera of the rig as `camera`, or `world_frame`",
                        file.display()
                    );
                }
                (run.touch.equipped(&hand)?, camera)
            }
            None => (Hand::none(), None),
        };
        let reads_touch = run.modality.has_touch() && setup.touch_pads().next().is_some();
        let weights = if reads_touch { run.touch.weights(&hand)? } else { None };
        let options = LiveOptions {
            hand,
            camera,
            perception: PerceptionSetup { weights: weights.as_ref(), config: run.config.perception() },
            duration_s: run.duration_s,
            stop: Arc::clone(run.stop),
            record: run.record.map(|folder| (folder, run.object)),
        };
        let drive = match &run.drive {
            Some(drive) => {
                Some(prepared(&setup, drive, &options.hand, run).with_context(|| file.display().to_string())?)
            }
            None => None,
        };
        let bus = Arc::new(Bus::join(setup.domain(), &setup.addresses)?);
        let link = Arc::new(Link::new(setup.sim_time));
        let publisher = RosPublisher::announce(&bus, &setup.publish, &options.hand, Arc::clone(&link))?;
        let record = Arc::clone(&link.record);
        let hand = Arc::clone(&options.hand);
        let mut source = RosSource::open(Arc::clone(&bus), &setup, file, options, Arc::clone(&link))?;
        if let Some(calibration) = &run.calibration {
            source.start_from(calibration)?;
        }
        let supervisor = match (drive, &setup.command) {
            (Some((motion, supervisor)), Some(command)) => {
                let (clock, stop) = (Arc::clone(&link.clock), Arc::clone(run.stop));
                let driver = Driver::start(bus, clock, &setup, command, &hand, motion, stop)
                    .with_context(|| file.display().to_string())?;
                // It is the first: the link was made here.
                let _ = link.driver.set(driver);
                Some(supervisor)
            }
            _ => None,
        };
        Ok(Self { source, parts: LiveParts { record, listener: Box::new(publisher) }, supervisor })
    }
}

/// Chooses the controller, and prepares the motion of the hand and its supervisor.
fn prepared(
    setup: &RosSetup,
    drive: &LiveDrive<'_>,
    hand: &Arc<Hand>,
    run: &LiveRun<'_>,
) -> Result<(Motion, Supervisor)> {
    /// Tilts of the palm below this go without saying, degrees.
    const LEVEL_DEG: f64 = 3.0;
    let command = setup.command.as_ref().context("--drive needs the table [ros.command], see docs/live.md")?;
    if matches!(drive.goal, Goal::Show(_) | Goal::Explored) {
        bail!("--goal {} is not for --ros: use turn, pose, coverage or time", drive.goal);
    }
    // A policy moves a real hand only by its name.
    let controller = if drive.controller == AUTO { SUITED } else { drive.controller };
    let chosen = match drive.object {
        Some(object) => choose_controller(controller, object, hand)?,
        None if controller == SUITED => {
            bail!("--drive needs --controller NAME, or --object for a controller that suits it")
        }
        // The controller is named: whether the object suits it is not known.
        None => named_controller(controller, hand)?,
    };
    if !chosen.schedule.is_empty() {
        bail!("--controller {}: the palm cannot be tilted anew; name one controller", chosen.name);
    }
    let supervisor = supervise(&chosen, hand.side(), drive.goal, None, run.config.supervisor);
    let gait = chosen.gait;
    let controller = chosen.mover.unwrap_or_else(|| Box::new(DirectedController::new(&gait, hand)));
    if controller.needs_forces() {
        bail!("{}: it observes forces on the pads, which no topic delivers", chosen.name);
    }
    let [x, y, z] = gait.gravity_on(hand.side());
    let tilt_deg = x.hypot(y).atan2(-z).to_degrees();
    if tilt_deg > LEVEL_DEG {
        tracing::warn!(
            "controller {}: it was made for a palm that is tilted by {tilt_deg:.0} degrees, with gravity along ({x:.1}, {y:.1}, {z:.1}) of its axes",
            chosen.name
        );
    }
    let limits = command.limits(hand).map_err(anyhow::Error::msg)?;
    Ok((Motion::new(controller, &gait, hand, limits, command.on_stop), supervisor))
}

/// Chooses a controller by name or file without an object. A policy whose contract leaves the start open takes that of a cube.
fn named_controller(name: &str, hand: &Hand) -> Result<ChosenController> {
    let cube = catalogue::load("cube70", &mut Vec::new())?;
    if is_policy(name) {
        return choose_controller(name, &cube, hand);
    }
    Ok(controller_file::choose_all(name, &cube, hand)?)
}
