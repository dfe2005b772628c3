//! A recording and its moments in words.

use std::path::Path;

use mvt_recording::{RecordedMoment, Recording, Status};
use mvt_run::report::TrackState;

/// Error below which the first pose counts as tied to the truth, metres: it is written as 0.0 mm.
const TIED_M: f64 = 0.00005;
/// From this stated deviation on, the pose is doubtful, metres.
const DOUBTFUL_M: f64 = 0.005;
/// Time for which an event is mentioned, seconds.
const RECENT_S: f64 = 1.0;

/// Returns object, mode, sensors and seed.
pub fn subject(recording: &Recording) -> String {
    let about = recording.about();
    match about.mode {
        None => format!("{}, raw log", about.object),
        Some(mode) => format!("{}, {mode} {}, seed {}", about.object, about.modality, about.seed),
    }
}

/// Returns the name of a folder with the folder above it, because most runs are called "out".
pub fn folder(folder: &Path) -> String {
    let parts: Vec<_> = folder.components().rev().take(2).map(|part| part.as_os_str().to_string_lossy()).collect();
    parts.into_iter().rev().collect::<Vec<_>>().join("/")
}

/// Whether the error is 0 at a moment only because the estimate is tied to the true object there: at the first estimate.
pub fn begins_errors(recording: &Recording, moment: usize) -> bool {
    let moments = recording.moments();
    let is_scored = |moment: &RecordedMoment| moment.estimate().is_some() && moment.row.add_s.is_some();
    moments.iter().position(is_scored) == Some(moment)
        && moments.get(moment).and_then(|now| now.row.add_s).is_some_and(|error| error.one_directional_m < TIED_M)
}

/// Returns the status of the run.
pub fn status(recording: &Recording) -> &'static str {
    match recording.status() {
        _ if recording.about().mode.is_none() => "a log: nothing is estimated",
        Status::Running => "the run is going on",
        Status::Finished => "the run is finished",
        Status::Interrupted => "the run was interrupted; this is its result so far",
        Status::Crashed => "the run has crashed; this is its result so far",
    }
}

/// Describes a moment: tracking, error, touching fingers and recent events.
pub fn moment(recording: &Recording, moment: usize) -> String {
    let Some(now) = recording.moments().get(moment) else {
        return match recording.status() {
            Status::Running => "Waiting for the first frame".to_owned(),
            _ => "There is no frame".to_owned(),
        };
    };
    let row = &now.row;
    let mut sentence = match (now.estimate().is_some(), row.state) {
        (false, _) => "As recorded".to_owned(),
        (true, TrackState::Lost | TrackState::Waiting) => {
            let before = recording.moments().get(..moment).unwrap_or_default();
            match before.iter().rposition(|moment| moment.row.state != TrackState::Lost) {
                Some(last) => {
                    let since_s = row.time_s - before.get(last).map_or(row.time_s, |moment| moment.row.time_s);
                    format!("Lost for {since_s:.1} s; searching for the object")
                }
                None => "Waiting to see the object".to_owned(),
            }
        }
        (true, TrackState::Relocalised) => "Found the object again".to_owned(),
        (true, TrackState::Tracking) => match row.deviation {
            Some(deviation) if deviation.surface_m > DOUBTFUL_M => {
                format!("Tracking with doubt: within {:.0} mm", 2e3 * deviation.surface_m)
            }
            None if row.confidence < 0.3 => "Tracking with doubt".to_owned(),
            _ => "Tracking".to_owned(),
        },
    };
    if let Some(error) = row.add_s.filter(|_| row.state != TrackState::Lost) {
        sentence += &match begins_errors(recording, moment) {
            true => "; errors are measured from this frame on".to_owned(),
            false => {
                let turn = row.rotation_error_rad().map_or_else(String::new, |angle_rad| {
                    format!(", rotation error {:.0} degrees", angle_rad.to_degrees())
                });
                format!(", ADD-S {:.1} mm{turn}", error.one_directional_m * 1e3)
            }
        };
    }
    let touching = now.touching.iter().flatten().count();
    sentence += &match touching {
        0 => String::new(),
        1 => "; one finger touches".to_owned(),
        all if all == now.touching.len() => "; all fingers touch".to_owned(),
        2 => "; two fingers touch".to_owned(),
        3 => "; three fingers touch".to_owned(),
        some => format!("; {some} fingers touch"),
    };
    let is_recent = |time_s: f64| (0.0..=RECENT_S).contains(&(row.time_s - time_s));
    for event in recording.events().iter().filter(|event| is_recent(event.time_s)) {
        // The state already says that the object is lost or found.
        if !event.text.contains("the object") {
            sentence += &format!("; {}", event.text);
        }
    }
    sentence
}
