//! What is happening, in words.

use crate::recording::{Recording, Status};
use crate::report::TrackState;

/// How long something that happened is told, seconds.
const RECENT_S: f64 = 2.0;

/// What is recorded: object, mode, sensors and seed.
pub fn subject(recording: &Recording) -> String {
    let about = recording.about();
    match about.mode.as_str() {
        "log" => format!("{}, raw log", about.object),
        mode => format!("{}, {mode} {}, seed {}", about.object, about.modality, about.seed),
    }
}

/// What happens at a moment.
pub fn happening(recording: &Recording, moment: usize) -> String {
    let Some(now) = recording.moments().get(moment) else { return whole(recording.status()).to_owned() };
    let row = &now.row;
    let state = match row.state {
        _ if now.estimate().is_none() => "nothing is estimated".to_owned(),
        TrackState::Tracking => format!("tracking, confidence {:.2}", row.confidence),
        TrackState::Lost => "lost: looking for the object".to_owned(),
        TrackState::Relocalised => "found the object again".to_owned(),
    };
    let recent = |time_s: f64| (row.time_s - RECENT_S..=row.time_s).contains(&time_s);
    match recording.events().iter().rev().find(|event| recent(event.time_s)) {
        Some(event) if !state.starts_with(&event.text) => format!("{state}; {}", event.text),
        _ => state,
    }
}

/// Whether the run goes on.
pub fn whole(status: Status) -> &'static str {
    match status {
        Status::Running => "running",
        Status::Finished => "finished",
        Status::Interrupted => "interrupted",
        Status::Crashed => "crashed: its process is gone",
    }
}
