//! `inspect`: checks and summary of a log.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::Result;
use clap::Args;
use mvt_feelsight::{Log, LogFrame};
use mvt_mesh::SignedDistance;
use mvt_objects::distance::MeshDistance;
use mvt_picture::contact_sheet::{ContactSheet, ContactTimeline, SheetMoment, contact_sheet};

use mvt_run::io::{check_named, png, print_line, write_named};
use mvt_run::object::load_object;
use mvt_run::source::Recorded;

/// Check a FeelSight log, an RGB-D sequence or a bag, and print a summary
///
/// Reads every file. In a log counts, sizes, grey levels, poses, times and checksums must agree, and forward kinematics
/// must lead to the recorded poses of the DIGIT cameras. If the object is known, pixels in contact are compared with its
/// surface. Of an RGB-D sequence it says how large, near and fast the object is, and what will be hard. If files are
/// damaged, the program prints the reason and ends with exit code 1.
#[derive(Debug, Args)]
pub struct InspectArguments {
    /// Folder of a log, which contains data.pkl, or an RGB-D sequence or bag (docs/rgbd.md)
    log: PathBuf,
    /// Print one JSON object instead of words
    #[arg(long)]
    json: bool,
    /// Write a picture of the log: images of the last camera and the DIGITs at six moments, and the times at which each
    /// finger touched; of a sequence twelve frames with their masks
    #[arg(long, value_name = "PNG")]
    sheet: Option<PathBuf>,
    /// Replace an existing picture
    #[arg(long, requires = "sheet")]
    overwrite: bool,
}

/// Runs the command.
pub fn run(arguments: &InspectArguments) -> Result<()> {
    if Recorded::has_no_hand(&arguments.log) {
        return mvt_benchmark::inspect(&arguments.log, arguments.json, arguments.sheet.as_deref(), arguments.overwrite);
    }
    if let Some(path) = &arguments.sheet {
        check_named(path, arguments.overwrite)?;
    }
    let summary = match known_surface(&arguments.log)? {
        Some(surface) => mvt_feelsight::inspect_against(&arguments.log, &|p| surface.distance_m(p))?,
        None => mvt_feelsight::inspect(&arguments.log)?,
    };
    if let Some(path) = &arguments.sheet {
        write_named(path, &png(&sheet(&Log::open(&arguments.log)?)?)?, arguments.overwrite)?;
    }
    if arguments.json { print_line(&serde_json::to_string(&summary)?) } else { print_line(&summary.to_string()) }
}

/// Number of moments on the picture.
const MOMENTS: usize = 6;

/// Paints the picture: from each sixth of the log the moment at which most pads touch.
fn sheet(log: &Log) -> Result<image::RgbImage> {
    let stretch = log.len().div_ceil(MOMENTS).max(1);
    let mut timeline = ContactTimeline::default();
    let mut moments: Vec<SheetMoment> = Vec::new();
    for (i, frame) in log.frames()?.enumerate() {
        let LogFrame { observation, truth, .. } = frame?;
        let touches = |pad: usize| {
            let truth = truth.as_ref().and_then(|truth| truth.touch.get(pad));
            truth.is_some_and(|truth| truth.contact.iter().any(|&touches| touches))
        };
        let contact: Vec<bool> = (0..log.hand().pads().len()).map(touches).collect();
        timeline.times_s.push(observation.time_s);
        timeline.contact.push(contact.clone());
        let pads = |contact: &[bool]| contact.iter().filter(|touches| **touches).count();
        let is_first = i % stretch == 0;
        if is_first || moments.last().is_some_and(|best| pads(&best.contact) < pads(&contact)) {
            if !is_first {
                moments.pop();
            }
            let camera = observation.cameras.into_iter().next_back().map(|rgbd| rgbd.color).unwrap_or_default();
            moments.push(SheetMoment { time_s: observation.time_s, camera, touch: observation.touch.0, contact });
        }
    }
    let subtitle = log.scene().map_or(String::new(), |scene| format!("seed {}, {}", scene.seed, scene.end.reason));
    let pads = log.hand().pads().iter().map(|pad| pad.name.clone()).collect();
    let title = log.object_name().to_owned();
    Ok(contact_sheet(&ContactSheet { title, subtitle, pads, moments, timeline }))
}

/// Returns the surface of the object if the log names one (in scene.json) that can be loaded.
fn known_surface(folder: &Path) -> Result<Option<Arc<dyn SignedDistance>>> {
    let log = Log::open(folder)?;
    let Some(scene) = log.scene() else { return Ok(None) };
    match load_object(&scene.object.mesh) {
        Ok(object) => {
            let of_mesh =
                || MeshDistance::new(&object.mesh).map(|surface| Arc::new(surface) as Arc<dyn SignedDistance>);
            Ok(object.exact.clone().or_else(of_mesh))
        }
        Err(error) => {
            tracing::warn!("contact is not compared with the surface of the object: {error:#}");
            Ok(None)
        }
    }
}
