//! Recordings of any kind as sources, with what they say of object and seed.

use std::path::Path;

use anyhow::{Context as _, Result, bail};
use mvt_calibration::Calibration;
use mvt_frames::Isometry;
use mvt_frames::camera::PosedCamera;
use mvt_objects::object::Object;

use super::{LogSource, Modality, RgbdSequence, RgbdSource, Source, TouchArguments};
use crate::config::RunConfig;
use crate::object::load_object;
use crate::report::FrameCamera;

/// How a recording is used.
pub struct RecordedOptions<'a> {
    /// Names of the cameras of a log; the first one without.
    pub cameras: Option<&'a str>,
    /// Sensors that are used.
    pub modality: Modality,
    /// Touch depth of a log.
    pub touch: &'a TouchArguments,
    /// The true object; without it the one that the recording names.
    pub object: Option<&'a str>,
    /// Whether nothing can be done without the true object.
    pub needs_object: bool,
    /// Calibration with which to start, and the file from which it comes.
    pub calibration: Option<(&'a Path, Calibration)>,
    /// Longest duration, seconds.
    pub duration_s: Option<f64>,
    /// Whether the pictures of a frame, by its number, are wanted.
    pub wants_pictures: fn(u64) -> bool,
    /// Settings.
    pub config: &'a RunConfig,
}

/// A recording with what it says.
pub struct Recorded {
    /// Its frames.
    pub source: Box<dyn Source>,
    /// Seed of the episode; 0 where it is unknown.
    pub seed: u64,
    /// Name of the object in the catalogue, or the path of its mesh.
    pub name: String,
    /// The true object, if it could be loaded.
    pub object: Option<Object>,
    /// Its cameras.
    pub cameras: Vec<PosedCamera>,
    /// Its frames with the poses of the camera, if it has no hand.
    pub frame_cameras: Vec<FrameCamera>,
}

impl Recorded {
    /// Whether a folder or file is an RGB-D sequence without a hand.
    pub fn has_no_hand(path: &Path) -> bool {
        RgbdSequence::is_here(path)
    }

    /// Opens a FeelSight log, or an RGB-D sequence without a hand.
    ///
    /// # Errors
    /// If it cannot be used so.
    pub fn open(folder: &Path, options: &RecordedOptions<'_>) -> Result<Self> {
        if Self::has_no_hand(folder) {
            return Self::rgbd(folder, options);
        }
        let &RecordedOptions { cameras, modality, touch, config, .. } = options;
        let mut source = LogSource::open(folder, cameras, modality, config.camera_noise, touch, config.perception())?;
        let (name, object) = truth(options, Some(source.object()))?;
        let tracker = &config.slam.tracker;
        source.limit_pictures(options.wants_pictures, tracker.colour_weight > 0.0 || tracker.texel_weight > 0.0);
        if let Some((path, calibration)) = &options.calibration {
            source.start_from(calibration).with_context(|| path.display().to_string())?;
        }
        if let Some(object) = &object {
            source.set_object_from_file(object.object_from_file);
        }
        if let Some(duration_s) = options.duration_s {
            source.limit(duration_s);
        }
        Ok(Self {
            seed: source.seed(),
            name,
            object,
            cameras: source.cameras().to_vec(),
            frame_cameras: Vec::new(),
            source: Box::new(source),
        })
    }

    fn rgbd(folder: &Path, options: &RecordedOptions<'_>) -> Result<Self> {
        if options.modality == Modality::Tac {
            bail!("{}: an RGB-D sequence has no touch sensors; --modality vi", folder.display());
        }
        if options.calibration.is_some() {
            bail!("{}: without a hand there is nothing that --calibration-file could calibrate", folder.display());
        }
        let mut source = RgbdSource::open(folder, options.config.perception())?;
        let (name, object) = truth(options, source.sequence().object_name())?;
        if let Some(object) = &object {
            source.set_object_from_file(object.object_from_file);
        }
        if let Some(duration_s) = options.duration_s {
            source.limit(duration_s);
        }
        let object_from_file = object.as_ref().map_or_else(Isometry::identity, |object| object.object_from_file);
        let frame_cameras = FrameCamera::of_sequence(source.sequence(), object_from_file, source.frame_count());
        let cameras = vec![source.camera().clone()];
        Ok(Self { seed: 0, name, object, cameras, frame_cameras, source: Box::new(source) })
    }
}

/// The name of the true object and, if it can be loaded, the object.
fn truth(options: &RecordedOptions<'_>, named: Option<&str>) -> Result<(String, Option<Object>)> {
    let Some(name) = options.object.or(named) else {
        if options.needs_object {
            bail!("the recording names no object; give it with --object");
        }
        return Ok(("unknown".to_owned(), None));
    };
    match load_object(name) {
        Ok(object) => Ok((name.to_owned(), Some(object))),
        Err(error) if options.object.is_some() || options.needs_object => Err(error),
        Err(error) => {
            tracing::warn!("{error:#}; the run continues without scores");
            Ok((name.to_owned(), None))
        }
    }
}
