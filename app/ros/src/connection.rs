//! A whole connection for a run: source, publisher and record.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use anyhow::{Context as _, Result, bail};
use mvt_calibration::Calibration;
use mvt_frames::camera::PosedCamera;
use mvt_perceive::PerceptionSetup;
use mvt_robot::hand::{Hand, Side};
use mvt_run::config::RunConfig;
use mvt_run::estimator::{Init, Mode};
use mvt_run::live::LiveParts;
use mvt_run::source::{Modality, TouchArguments};

use crate::bus::Bus;
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
    /// Ends the source when it is set.
    pub stop: &'a Arc<AtomicBool>,
}

/// A hand, and the camera of it that was asked for, or its first one.
pub type LiveHand = (Arc<Hand>, Option<PosedCamera>);

/// A connection that is open.
pub struct LiveConnection {
    /// Its frames.
    pub source: RosSource,
    /// What it adds to the run: counts and publications.
    pub parts: LiveParts,
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
        let (hand, camera) = match &setup.rig {
            Some(rig) => {
                // A file stands relative to the one that names it.
                let beside = file.parent().unwrap_or(Path::new("")).join(rig);
                let path = if beside.is_file() { beside.display().to_string() } else { rig.clone() };
                let (hand, camera) =
                    load(&path, setup.side, setup.camera.as_deref()).with_context(|| file.display().to_string())?;
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
        let bus = Arc::new(Bus::join(setup.domain(), &setup.addresses)?);
        let link = Arc::new(Link::default());
        let publisher = RosPublisher::announce(&bus, &setup.publish, Arc::clone(&link))?;
        let record = Arc::clone(&link.record);
        let mut source = RosSource::open(bus, &setup, file, options, link)?;
        if let Some(calibration) = &run.calibration {
            source.start_from(calibration)?;
        }
        Ok(Self { source, parts: LiveParts { record, listener: Box::new(publisher) } })
    }
}
