//! The main job: a recorded episode with the Rubik's cube, with a contact sheet to look at.

use std::fs;
use std::path::Path;

use anyhow::{Context as _, Result};
use scenes::camera::Placement;
use scenes::hand::{Finger, PerFinger, Side};
use scenes::object::Object;
use sim::episode::{Outcome, Snapshot};
use sim::feelsight::{ContactSheet, Log, Moment, Timeline, contact_sheet};
use sim::touch::TouchConfig;

use crate::generate::check_vacant;
use crate::progress;
use crate::recorder::{Noise, Recorder, Recording, Settings};
use crate::simulate::print_line;
use crate::subject::load_object;

const OBJECT: &str = "077_rubiks_cube";
/// Needs no download.
const OFFLINE_OBJECT: &str = "rubiks_cube_small";
const OUT: &str = "out";
const SEED: u64 = 0;
const DURATION_S: f64 = 20.0;
/// FeelSight's primary camera, and one that sees more of the object.
const CAMERAS: &str = "front-left,side";
/// Columns of the contact sheet.
const MOMENTS: usize = 6;

/// Runs the main job.
pub fn run() -> Result<()> {
    let (name, object) = object()?;
    let settings = Settings {
        gait: "auto".to_owned(),
        side: Side::Left,
        duration_s: DURATION_S,
        noise: Noise { touch: true, camera_depth: None },
        touch_config: TouchConfig::Fork,
        background: None,
    };
    let out = Path::new(OUT);
    // An earlier run's results are replaced; anything else in the folder is not ours.
    let sheet_path = out.join("contact_sheet.png");
    if sheet_path.exists() {
        fs::remove_file(&sheet_path).with_context(|| format!("cannot remove {}", sheet_path.display()))?;
    }
    check_vacant(out, false)?;
    let cameras: Vec<_> = Placement::parse_list(CAMERAS)?.iter().map(|p| p.camera(settings.side)).collect();
    let folder = out.join(&object.name).join("00");
    let bar = progress::bar(0, &format!("recording {}", object.name));
    let recorder = Recorder::new(&object, name, &settings)?;
    let recording = recorder.record(SEED, &cameras, &folder, true, &bar)?;
    bar.finish_and_clear();
    sheet(&folder, &object, &recording)?
        .save(&sheet_path)
        .with_context(|| format!("cannot write {}", sheet_path.display()))?;
    let Outcome { turned_rad, any_contact_fraction, mean_pads_in_contact, .. } = recording.outcome;
    print_line(&format!(
        "{}: {} frames, turned {:.1} times, touched {:.0} % of the time by {mean_pads_in_contact:.1} pads on average ({})\n\
         log    {}\n\
         look   {}",
        object.name,
        recording.snapshots.len(),
        turned_rad / std::f64::consts::TAU,
        100.0 * any_contact_fraction,
        recording.end.reason,
        folder.display(),
        sheet_path.display()
    ))
}

/// The Rubik's cube, or without a network its procedural likeness.
fn object() -> Result<(&'static str, Object)> {
    match load_object(OBJECT) {
        Ok(object) => Ok((OBJECT, object)),
        Err(error) => {
            tracing::warn!("{error:#}");
            tracing::warn!("going on with the procedural object {OFFLINE_OBJECT}");
            Ok((OFFLINE_OBJECT, load_object(OFFLINE_OBJECT)?))
        }
    }
}

/// The moment of each stretch of the episode at which most fingers touch.
fn sheet(folder: &Path, object: &Object, recording: &Recording) -> Result<image::RgbImage> {
    let touching = |snapshot: &Snapshot| PerFinger::from_fn(|finger| snapshot.pads[finger].is_touching());
    let pads = |snapshot: &Snapshot| Finger::ALL.iter().filter(|&&finger| touching(snapshot)[finger]).count();
    let log = Log::open(folder)?;
    let stretch = recording.snapshots.len().div_ceil(MOMENTS).max(1);
    let mut moments = Vec::new();
    for (k, snapshots) in recording.snapshots.chunks(stretch).enumerate() {
        let best = (0..snapshots.len()).max_by_key(|&i| (pads(&snapshots[i]), std::cmp::Reverse(i))).unwrap_or(0);
        let Some(frame) = log.frame(k * stretch + best)? else { continue };
        let observation = frame.observation;
        moments.push(Moment {
            time_s: observation.time_s,
            camera: observation.cameras.into_iter().next_back().map(|rgbd| rgbd.color).unwrap_or_default(),
            touch: observation.touch,
            contact: touching(&snapshots[best]),
        });
    }
    Ok(contact_sheet(&ContactSheet {
        title: object.name.clone(),
        subtitle: format!("seed {SEED}, {}", recording.end.reason),
        moments,
        timeline: Timeline {
            times_s: recording.snapshots.iter().map(|snapshot| snapshot.time_s).collect(),
            contact: recording.snapshots.iter().map(touching).collect(),
        },
    }))
}
